"""Manifest of made rooms: OUT/manifest.jsonl, one JSON object a line, appended when a room is finished or packed.

usage: manifest.py OUT     verifies the digests of all rooms that it lists

A line: `room` (SPLIT/NAME), `seed`, `scene` ("generated" or the name of a scene by people), `commit` of the generator (with "+" where the working
tree differed), `file` and `digest` (SHA-256) of truth.npz or sample.npz, `time` (UTC). Later lines of a room and file take the place of earlier ones."""

import fcntl
import hashlib
import json
import os
import subprocess
import sys
import time
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


@cache
def commit():
    """The commit of the generator; "+" is appended where training/ differs from it. "unknown" outside a repository."""
    git = lambda *a: subprocess.run(["git", "-C", str(ROOT), *a], capture_output=True, text=True)
    head = git("rev-parse", "--short=12", "HEAD")
    if head.returncode:
        return "unknown"
    return head.stdout.strip() + "+" * bool(git("status", "--porcelain", "--", "training").stdout.strip())


def digest(path):
    """SHA-256 of a file, hexadecimal."""
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def append(out, folder, file="truth.npz"):
    """Appends the line of a room of OUT in one write under a lock, so that processes may share the manifest and no line is torn."""
    about = json.loads((folder / "room.json").read_text())
    line = dict(
        room=f"{folder.parent.name}/{folder.name}",
        seed=about.get("seed"),
        scene=about.get("scene", "generated"),
        commit=commit(),
        file=file,
        digest=digest(folder / file),
        time=time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
    )
    with open(Path(out) / "manifest.jsonl", "a+b") as log:
        fcntl.flock(log, fcntl.LOCK_EX)
        end = log.seek(0, os.SEEK_END)
        torn = b""
        if end:
            log.seek(end - 1)
            torn = b"" if log.read(1) == b"\n" else b"\n"  # after a crash in the middle of a line
        log.write(torn + json.dumps(line).encode() + b"\n")
        log.flush()
        os.fsync(log.fileno())


def read(out):
    """{(room, file): line}, the latest of each; torn lines are passed over."""
    lines = {}
    path = Path(out) / "manifest.jsonl"
    for text in path.read_text(errors="replace").splitlines() if path.exists() else []:
        try:
            line = json.loads(text)
            lines[line["room"], line["file"]] = line
        except (json.JSONDecodeError, KeyError, TypeError):
            continue
    return lines


def verify(out):
    """Rooms and files of the manifest that are missing or whose digest differs."""
    bad = []
    for (room, file), line in read(out).items():
        path = Path(out) / room / file
        if not path.exists() or digest(path) != line["digest"]:
            bad.append(f"{room}/{file}")
    return bad


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    bad = verify(sys.argv[1])
    print(f"{len(read(sys.argv[1]))} files listed, {len(bad)} missing or changed")
    sys.exit("\n".join(bad) if bad else 0)
