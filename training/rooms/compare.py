"""The mix of rooms beside real photographs: rooms/compare.py ROOMS PHOTOS

ROOMS holds rooms (truth.npz); PHOTOS holds photographs with depth, one folder each: photo.png or .jpg, depth.npy, .exr or 16-bit .png (mm). Prints, for
each measure, its 10th, 50th and 90th percentile over the pictures of either side."""

import sys
from pathlib import Path

import numpy as np
from PIL import Image

from colour import linear, luminance

MEASURES = (
    "dark (10 % of pixels)",
    "middle grey",
    "bright (90 %)",
    "saturated share",
    "colourfulness",
    "red / blue",
    "edges",
    "near depth (10 %)",
    "median depth",
    "far depth (90 %)",
)


def measures(rgb, depth):
    """Of a linear picture in units of the photo, 1 = white, and its planar depth in metres."""
    rgb = np.clip(rgb, 0, 1)
    y = luminance(rgb)
    chroma = (rgb.max(-1) - rgb.min(-1)) / np.maximum(rgb.max(-1), 1e-4)
    logs = np.log(y + 0.01)
    edges = np.abs(np.diff(logs, axis=0)).mean() + np.abs(np.diff(logs, axis=1)).mean()
    z = depth[np.isfinite(depth) & (depth > 0)]
    return [
        *np.percentile(y, (10, 50, 90)),
        (rgb.max(-1) >= 0.995).mean(),
        chroma.mean(),
        rgb[..., 0].mean() / max(rgb[..., 2].mean(), 1e-4),
        edges,
        *np.percentile(z, (10, 50, 90)),
    ]


def of_room(folder):
    truth = np.load(folder / "truth.npz")
    return measures(truth["photo"].astype(np.float32), truth["depth"])


def read_depth(folder):
    for path in sorted(folder.glob("depth.*")):
        if path.suffix == ".npy":
            return np.load(path)
        if path.suffix == ".png":
            return np.asarray(Image.open(path), np.float32) / 1000
        if path.suffix == ".exr":
            import OpenEXR

            with OpenEXR.File(str(path), separate_channels=True) as file:
                channels = file.channels()
                return channels["Z" if "Z" in channels else sorted(channels)[0]].pixels
    raise FileNotFoundError(f"{folder}: no depth.npy, depth.png or depth.exr")


def of_photo(folder):
    path = next(p for p in sorted(folder.iterdir()) if p.stem in ("photo", "input", "rgb", "image") and p.suffix in (".png", ".jpg"))
    picture = Image.open(path).convert("RGB").resize((320, 240), Image.Resampling.BOX)
    return measures(linear(np.asarray(picture, np.float32) / 255), read_depth(folder))


def main(rooms, photos):
    sides = [
        np.array([of_room(f.parent) for f in sorted(rooms.glob("*/truth.npz"))]),
        np.array([of_photo(f) for f in sorted(photos.iterdir()) if f.is_dir()]),
    ]
    print(f"{'':24s}{len(sides[0])} rooms            {len(sides[1])} photographs")
    for k, name in enumerate(MEASURES):
        print(f"{name:24s}" + "     ".join("{:6.3f} {:6.3f} {:6.3f}".format(*np.percentile(side[:, k], (10, 50, 90))) for side in sides))


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    main(Path(sys.argv[1]), Path(sys.argv[2]))
