"""Contact sheets: rooms/sheet.py [--photos] OUT.png FOLDER...

With --photos, photographs alone, eight in a row: of rooms (truth.npz) or of folders of rooms. Else a row a room: photograph, albedo, normal, depth, then for the first sources true unshadowed shading, visibility, and each indirect picture."""

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


def photographs(folders, across=8):
    """Thumbnails of the photos, 160 x 120, side by side."""
    cells = [tone(np.load(f / "truth.npz")["photo"].astype(np.float32).reshape(120, 2, 160, 2, 3).mean((1, 3))) for f in folders]
    cells += [np.zeros_like(cells[0])] * (-len(cells) % across)
    return np.concatenate([np.concatenate(cells[k : k + across], 1) for k in range(0, len(cells), across)])


if __name__ == "__main__":
    photos = "--photos" in sys.argv
    names = [a for a in sys.argv[1:] if a != "--photos"]
    if len(names) < 2:
        sys.exit(__doc__)
    rooms = [room for f in map(Path, names[1:]) for room in ([f] if (f / "truth.npz").exists() else sorted(p.parent for p in f.glob("[!.]*/truth.npz")))]
    if not rooms:
        sys.exit(f"sheet.py: wanted rooms with truth.npz, got none in {' '.join(names[1:])}")
    Image.fromarray(photographs(rooms) if photos else np.concatenate([row(f) for f in rooms])).save(names[0])
