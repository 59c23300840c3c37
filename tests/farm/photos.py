#!/usr/bin/env python3
"""Makes small photos of scenes/demo and of the rooms in ../shared/truth: exposure, crops, light weights.

    photos.py FOLDER COUNT    (needs numpy, pillow, OpenEXR)

Each is a scene folder FOLDER/p000 .. with a photo of at most 320 x 240 pixels. The same arguments
give the same files."""

import json
import math
import random
import sys
from pathlib import Path

import numpy as np
import OpenEXR
from PIL import Image

REPO = Path(__file__).resolve().parents[2]
TRUTH = REPO / "../shared/truth"
WIDTH = 320


def read_exr(path):
    channels = OpenEXR.File(str(path)).channels()
    if "RGB" in channels:
        return np.asarray(channels["RGB"].pixels, np.float32)
    if len(channels) == 1:
        return np.asarray(next(iter(channels.values())).pixels, np.float32)
    return np.stack([np.asarray(channels[c].pixels, np.float32) for c in "RGB"], -1)


def shrink(plane, factor):
    h, w = (size // factor * factor for size in plane.shape[:2])
    shape = (h // factor, factor, w // factor, factor) + plane.shape[2:]
    return plane[:h, :w].reshape(shape).mean((1, 3))


def sample(depth, shape):
    """One pixel of each block, not their mean, as depth has edges."""
    depth = depth if depth.ndim == 2 else depth[..., 0]
    rows, columns = (np.arange(size) * of // size + of // size // 2 for size, of in zip(shape, depth.shape))
    return depth[np.ix_(rows, columns)]


def to_linear(x):
    return np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4)


def to_srgb(x):
    x = np.clip(x, 0, 1)
    return np.where(x <= 0.0031308, x * 12.92, 1.055 * x ** (1 / 2.4) - 0.055)


def room(photo, depth, masks, layers, fov, factor):
    """Planes of a room: the linear photo, depth, masks, and the light of each lamp."""
    photo = to_linear(np.asarray(Image.open(photo).convert("RGB"), np.float32) / 255)
    masks = {name: np.asarray(Image.open(path).convert("L"), np.float32) for name, path in masks.items()}
    return {
        "photo": shrink(photo, factor),
        "depth": sample(read_exr(depth), (photo.shape[0] // factor, photo.shape[1] // factor)),
        "masks": {name: shrink(mask, factor) for name, mask in masks.items()},
        "layers": {name: read_exr(path) for name, path in layers.items()},
        "fov": fov,
    }


def rooms():
    demo = REPO / "scenes/demo"
    names = ["lamp_0", "window_0"]
    yield room(
        demo / "photo.jpg",
        demo / "depth.exr",
        {name: demo / f"masks/{name}.png" for name in names},
        {name: demo / f"truth/light_{name}.exr" for name in names},
        64.0,
        4,
    )
    for folder in sorted(TRUTH.glob("dev-*")):
        meta = json.loads((folder / "meta.json").read_text())
        names = [name for name in meta["visible"] if (folder / f"mask_{name}.png").exists()]
        yield room(
            folder / "input.png",
            folder / "depth.exr",
            {name: folder / f"mask_{name}.png" for name in names},
            {name: folder / f"olat_{name}.exr" for name in names},
            meta["fov_x"],
            1,
        )


def fit(layer, shape):
    factor = layer.shape[1] // shape[1]
    return shrink(layer, factor) if factor > 1 else layer


def make(folder, source, rng):
    photo = source["photo"].copy()
    h, w = photo.shape[:2]
    for name, layer in source["layers"].items():
        light = fit(layer, photo.shape)
        if light.shape == photo.shape:
            photo = np.maximum(photo + (rng.uniform(0.6, 1.3) - 1) * light, 0)
    photo *= 2 ** rng.uniform(-0.5, 0.3)
    share = rng.uniform(0.8, 1.0)
    cw, ch = round(w * share), round(h * share)
    # Lights stay in view, as a crop without them is another scene.
    boxes = [np.argwhere(mask > 127) for mask in source["masks"].values()]
    boxes = np.concatenate([box for box in boxes if len(box)])
    (top, left), (bottom, right) = boxes.min(0), boxes.max(0)
    x = rng.randint(max(0, min(left, right + 1 - cw)), max(0, min(left, w - cw)))
    y = rng.randint(max(0, min(top, bottom + 1 - ch)), max(0, min(top, h - ch)))
    x, y = min(x, w - cw), min(y, h - ch)
    cut = lambda plane: np.ascontiguousarray(plane[y : y + ch, x : x + cw])
    folder.mkdir(parents=True, exist_ok=True)
    Image.fromarray((to_srgb(cut(photo)) * 255 + 0.5).astype(np.uint8)).save(folder / "photo.png")
    np.save(folder / "depth.npy", cut(source["depth"]).astype(np.float32))
    lights = []
    for name, mask in source["masks"].items():
        mask = cut(mask) > 127
        if mask.sum() >= 8:
            Image.fromarray((mask * 255).astype(np.uint8)).save(folder / f"{name}.png")
            kind = "Lamp" if "lamp" in name else "Window"
            lights.append(f'"{name}": {kind}(mask: "{name}.png")')
    f = w / 2 / math.tan(math.radians(source["fov"]) / 2)
    (folder / "scene.ron").write_text(
        "Scene(\n    version: 1,\n"
        '    photo: "photo.png", transfer: Srgb,\n'
        f"    camera: Pinhole(fx: {f:.4f}, fy: {f:.4f}, cx: {w / 2 - x:.1f}, cy: {h / 2 - y:.1f}),\n"
        '    depth: (path: "depth.npy", kind: PlanarZ, scale: 1.0),\n'
        f"    lights: {{ {', '.join(lights)} }},\n)\n"
    )


def main():
    folder, count = Path(sys.argv[1]), int(sys.argv[2])
    sources = list(rooms())
    for number in range(count):
        make(folder / f"p{number:03}", sources[number % len(sources)], random.Random(number))


main()
