"""Contact sheets: rooms/sheet.py [--photos [--camera]] OUT.png FOLDER...

A row a room: photograph, albedo, normal, depth, then for the first sources true unshadowed shading, visibility, and each indirect picture. With --photos,
photographs alone, eight in a row: of rooms (truth.npz), folders of rooms, and real ones (photo.png); --camera takes those of rooms through training/camera."""

import argparse
import sys
from pathlib import Path

import numpy as np
from PIL import Image


def tone(x):
    x = np.clip(np.nan_to_num(np.asarray(x, np.float32)), 0, 1)
    return (255 * np.where(x < 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055) + 0.5).astype(np.uint8)


def row(folder, sources=3, paths=2):
    t = np.load(folder / "truth.npz")
    fit = lambda x: x / max(np.percentile(x, 98), 1e-9)
    rgb = lambda x: np.repeat(np.asarray(x, np.float32)[..., None], 3, -1) if x.ndim == 2 else np.asarray(x, np.float32)
    small = lambda x: x.reshape(120, 2, 160, 2, 3).mean((1, 3))
    cells = [
        small(rgb(t["photo"]).clip(0, 1)),
        small(rgb(t["albedo"])),
        small(rgb(t["normal"])) * 0.5 + 0.5,
        small(rgb(t["depth"] / t["depth"].max())),
    ]
    for s in range(sources):
        cells += [fit(rgb(t["direct"][s])), rgb(t["shadow"][s])] if s < len(t["direct"]) else [np.zeros((120, 160, 3))] * 2
    for p in range(paths):
        cells.append(fit(rgb(t["indirect"][p])) if p < len(t["indirect"]) else np.zeros((120, 160, 3)))
    return np.concatenate([tone(c) for c in cells], 1)


def photograph(folder, number, camera):
    """A thumbnail [120, 160, 3], of a room through the camera of a seed where `camera` says so."""
    if not (folder / "truth.npz").exists():
        return np.asarray(Image.open(folder / "photo.png").convert("RGB").resize((160, 120), Image.Resampling.BOX))
    photo = np.load(folder / "truth.npz")["photo"].astype(np.float32)
    if camera:
        from camera import model

        rng = np.random.default_rng(number)
        stored = model.photograph(photo, model.sample(rng), rng).stored
        return np.asarray(Image.fromarray(stored).resize((160, 120), Image.Resampling.BOX))
    return tone(photo.reshape(120, 2, 160, 2, 3).mean((1, 3)))


def photographs(folders, camera, across=8):
    """Thumbnails side by side."""
    cells = [photograph(f, number, camera) for number, f in enumerate(folders)]
    cells += [np.zeros_like(cells[0])] * (-len(cells) % across)
    return np.concatenate([np.concatenate(cells[k : k + across], 1) for k in range(0, len(cells), across)])


if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
    ask = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    ask.add_argument("--photos", action="store_true")
    ask.add_argument("--camera", action="store_true")
    ask.add_argument("out", type=Path)
    ask.add_argument("folders", type=Path, nargs="+")
    args = ask.parse_args()
    single = lambda f: any((f / name).exists() for name in ("truth.npz", "photo.png"))
    rooms = [room for f in args.folders for room in ([f] if single(f) else sorted(p for p in f.glob("[!.]*") if single(p)))]
    if not rooms:
        sys.exit(f"sheet.py: wanted rooms with truth.npz, got none in {' '.join(map(str, args.folders))}")
    sheet = photographs(rooms, args.camera) if args.photos else np.concatenate([row(f) for f in rooms])
    Image.fromarray(sheet).save(args.out)
