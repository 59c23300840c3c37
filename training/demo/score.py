"""Scores relit pictures of scenes/demo against the path-traced truth.

usage: score.py OUT [EDIT ...]       OUT/EDIT/picture.png for EDIT in none, lamp_off, window_dim, warm, insert_lamp, open_window

Per edit: PSNR of the 8-bit picture against truth, PSNR of the unchanged photo beside it, and the error of the change
|(got - photo) - (truth - photo)| / |truth - photo| in linear light clipped to 0..1 (1 = doing nothing, 0 = perfect). Pixels of a visible light, of
the photo or of the edit, do not count. Exit status 1 when a picture is missing or of another size."""
import json
import os
import sys

import numpy as np
import OpenEXR
from PIL import Image

SCENE = os.path.join(os.path.dirname(os.path.abspath(__file__)), "../../scenes/demo")
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])


def encode(x):
    x = np.clip(x, 0, 1)
    return np.where(x <= 0.0031308, x * 12.92, 1.055 * x ** (1 / 2.4) - 0.055)


def decode(x):
    return np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4)


def exr(name):
    return OpenEXR.File(os.path.join(SCENE, "truth", f"{name}.exr")).channels()["RGB"].pixels.astype(np.float64)


def blackbody(kelvin):
    """Linear Rec.709 of unit luminance: Planck's locus after Kim et al. 2002, for 1667..4000 K."""
    t = 1e3 / kelvin
    x = -0.2661239 * t**3 - 0.2343589 * t**2 + 0.8776956 * t + 0.179910
    y = -1.1063814 * x**3 - 1.34811020 * x**2 + 2.18555832 * x - 0.20219683 if kelvin <= 2222 else -0.9549476 * x**3 - 1.37418593 * x**2 + 2.09137015 * x - 0.16748867
    xyz = np.array([x / y, 1, (1 - x - y) / y])
    rgb = np.array([[3.2404542, -1.5371385, -0.4985314], [-0.9692660, 1.8760108, 0.0415560], [0.0556434, -0.2040259, 1.0572252]]) @ xyz
    return np.maximum(rgb, 0) / (np.maximum(rgb, 0) @ LUMINANCE)


def truths():
    """The linear photo, and the linear truth of every edit."""
    meta = json.load(open(os.path.join(SCENE, "truth/meta.json")))
    light = {k: exr(f"light_{k}") for k in meta["lights"]}
    photo = sum(light.values())
    ceiling = np.array(meta["lights"]["inv_lamp"]["radiance"])
    return meta, photo, {
        "none": photo,
        "lamp_off": photo - light["lamp_0"],
        "window_dim": photo - 0.6 * light["window_0"],
        "warm": photo + light["inv_lamp"] * (blackbody(2700) * (ceiling @ LUMINANCE) / ceiling - 1),
        "insert_lamp": exr("insert_lamp"),
        "open_window": exr("open_window"),
    }


def glow(meta, shape):
    """Pixels of visible lights, by edit."""
    masks = [np.array(Image.open(os.path.join(SCENE, "masks", f"{k}.png")).convert("L")) > 0 for k in meta["visible"]]
    own = np.any(masks, 0)
    i, j = np.mgrid[0 : shape[0], 0 : shape[1]] + 0.5
    focal = 0.5 * shape[1] / np.tan(np.radians(meta["fov_x"]) / 2)
    ray = np.stack([(j - shape[1] / 2) / focal, (shape[0] / 2 - i) / focal, -np.ones_like(i)], -1)
    ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
    ball, pane = meta["edits"]["insert_lamp"], meta["edits"]["open_window"]
    c = np.array(ball["center"])
    along = ray @ c
    globe = c @ c - along**2 < (ball["radius"] + 0.01) ** 2
    corners = np.array(pane["corners"])
    inside = np.ones(shape, bool)
    for a, b in zip(corners, np.roll(corners, -1, 0)):
        inside &= (b[0] - a[0]) * (i - a[1]) - (b[1] - a[1]) * (j - a[0]) > -np.hypot(*(b - a))
    return {"insert_lamp": own | globe, "open_window": own | inside}, own


def main(out, edits):
    meta, photo, truth = truths()
    extra, own = glow(meta, photo.shape[:2])
    failed = False
    for edit in edits or truth:
        path = os.path.join(out, edit, "picture.png")
        if not os.path.exists(path):
            print(f"{edit:12s} no {path}")
            failed = True
            continue
        got = decode(np.asarray(Image.open(path).convert("RGB"), np.float64) / 255)
        if got.shape != photo.shape:
            print(f"{edit:12s} {path}: wanted {photo.shape[1]} x {photo.shape[0]}, got {got.shape[1]} x {got.shape[0]}")
            failed = True
            continue
        m = ~extra.get(edit, own)
        psnr = lambda a, b: -10 * np.log10(max(((encode(a) - encode(b))[m] ** 2).mean(), 1e-10))
        base, want = np.clip(photo, 0, 1), np.clip(truth[edit], 0, 1)
        moved = np.abs(want - base)[m].sum()
        change = f"{np.abs(got - want)[m].sum() / moved:.2f}" if moved > 0 else "-"
        print(f"{edit:12s} PSNR {psnr(got, want):5.2f}  unchanged {psnr(base, want):5.2f}  change error {change}")
    return 1 if failed else 0


if __name__ == "__main__":
    if len(sys.argv) < 2:
        sys.exit(__doc__)
    sys.exit(main(sys.argv[1], sys.argv[2:]))
