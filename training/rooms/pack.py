"""Adds to rooms what the program computes for their true lights, and packs all that a network is trained on:
rooms/pack.py FOLDER [--relight target/release/relight] [--keep].

For each FOLDER/*/truth.npz that has no sample.npz beside it: `relight run graphs/planes.ron edits/none.ron`, and sample.npz from both. What it holds:
training/README.md."""

import argparse
import json
import os
import subprocess
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
LOBES = ("sun", "sky", "ground")


def run(relight, graph, scene, out, *more):
    """Runs the program on a scene without an edit and without its cache."""
    command = [
        relight,
        "run",
        ROOT / "graphs" / graph,
        ROOT / "edits/none.ron",
        "--scene",
        scene,
        "--out",
        out,
        "--no-cache",
        "--threads",
        "1",
        *more,
    ]
    called(command, scene)


def called(command, scene):
    """Runs the program; a RuntimeError has its message where it fails."""
    done = subprocess.run([str(c) for c in command], capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(f"{scene}: relight gave up with status {done.returncode}:\n{done.stderr}")


def evaluate(relight, graph, scene, out, *more):
    """Returns the figures of `relight eval` of a graph of the project as it is: dicts with `subject`, `measure` and `value`. `more` arguments for it."""
    called([relight, "eval", scene, "--no-ablation", "--graph", ROOT / "graphs" / graph, "--out", out, *more], scene)
    return json.loads((Path(out) / "eval.json").read_text())["figures"]


def planes(folder, relight, *more):
    """The program's planes at 320 x 240: {channel: [240, 320]}; `more` arguments for it."""
    import OpenEXR

    run(relight, "planes.ron", folder, folder, *more)
    with OpenEXR.File(str(folder / "planes.exr"), separate_channels=True) as file:
        return {name: channel.pixels for name, channel in file.channels().items()}


def half(x):
    """Means of 2 x 2."""
    return x.reshape(*x.shape[:-2], x.shape[-2] // 2, 2, x.shape[-1] // 2, 2).mean((-3, -1))


def pack(folder, relight):
    """sample.npz of a room with truth.npz."""
    got, truth = planes(folder, relight), dict(np.load(folder / "truth.npz"))
    stem = lambda source: f"{source.split('.')[0]}_{LOBES.index(source.split('.')[1]) if '.' in source else 0}"
    plane = lambda kind, channel="Y": np.stack([half(got[f"{kind}_{stem(s)}.{channel}"]) for s in truth["sources"]])
    truth["traced_direct"], truth["traced"], truth["unknown"] = plane("direct"), plane("lit"), plane("unknown")
    truth["traced_indirect"] = np.stack([plane("indirect", c) for c in "RGB"], -1)
    for key in ("traced_direct", "traced", "unknown", "traced_indirect"):
        truth[key] = np.asarray(np.clip(truth[key], 0, 60000), np.float16)
    unfinished = folder / ".sample.npz"
    np.savez_compressed(unfinished, **truth)
    os.replace(unfinished, folder / "sample.npz")


def pack_room(folder, relight, keep=False):
    """Packs a room and removes the program's planes unless they are kept."""
    pack(folder, relight)
    if not keep:
        (folder / "planes.exr").unlink()


def main():
    ask = argparse.ArgumentParser(description=__doc__)
    ask.add_argument("folder", type=Path)
    ask.add_argument("--relight", type=Path, default=ROOT / "target/release/relight")
    ask.add_argument("--keep", action="store_true", help="keep planes.exr")
    args = ask.parse_args()
    for folder in sorted(f.parent for f in args.folder.glob("[!.]*/truth.npz")):
        if not (folder / "sample.npz").exists():
            pack_room(folder, args.relight, args.keep)
            print(folder / "sample.npz", flush=True)


if __name__ == "__main__":
    main()
