"""Draws the lights that the trained networks estimate over photographs, beside a plan of the room and the direct light that they cast.

usage: drawn.py FOLDER ... [--runs runs] [--out drawn.png]

A FOLDER holds photo.png, depth.exr, about.json (fov_x_deg or fx; transfer) and masks/LIGHT.png, as ../shared/data/photos; or it is a room of
../shared/truth, whose true lights are drawn dotted. Albedo is MNet's. Colors are those of the radiance; an arrow is the way light comes in. Prints what
the networks say."""

import argparse
import json
import os
from pathlib import Path

import matplotlib
import numpy as np
import torch
import torch.nn.functional as F
from PIL import Image

import augment
import form
import lights
from data import full_depth, half_depth
from networks import trained
from outside import described, picture  # it puts training/rooms on the path

from color import linear
from compare import read_depth

matplotlib.use("Agg")
import matplotlib.pyplot as plt

SIZE = (320, 240)


def scaled(x, mode=Image.Resampling.BOX):
    return np.asarray(Image.fromarray(x).resize(SIZE, mode))


def read(folder):
    """Photo [3, 240, 320] linear, depth [240, 320] (m, 0 or NaN where unknown), horizontal view (degrees), masks and true lights by name."""
    if (folder / "meta.json").exists():
        meta = json.loads((folder / "meta.json").read_text())
        photo = sum(picture(folder / f"olat_{name}.exr") for name in meta["lights"])
        depth, fov, truth = picture(folder / "depth.exr")[0], float(meta["fov_x"]), described(meta)
        masks = {name: folder / f"mask_{name}.png" for name in meta["visible"]}
    else:
        about = json.loads((folder / "about.json").read_text())
        shown = np.asarray(Image.open(folder / "photo.png").convert("RGB"), np.float32) / 255
        fov = about.get("fov_x_deg") or np.degrees(2 * np.arctan(shown.shape[1] / 2 / about["fx"]))
        shown = linear(shown) if about["transfer"] == "sRGB" else shown**2.2
        photo = np.stack([scaled(c) for c in np.moveaxis(shown, -1, 0)])
        depth, truth = scaled(read_depth(folder), Image.Resampling.NEAREST), {}
        masks = {p.stem: p for p in sorted((folder / "masks").glob("*_[0-9].png"))}
    opened = {name: scaled(np.asarray(Image.open(path).convert("L"))) > 127 for name, path in masks.items()}
    return photo, depth, float(fov), opened, truth


@torch.no_grad()
def estimate(nets, photo, depth, fov, masks):
    """{light: its outputs by name}, MNet's albedo [3, 240, 320] and all direct light [3, 120, 160]."""
    glow = np.any([*masks.values(), np.zeros(depth.shape, bool)], 0)
    photo = torch.from_numpy(photo)[None]
    photo = (photo * 0.95 / torch.quantile(photo.mean(1)[torch.from_numpy(~glow)[None]], 0.98)).clamp(max=1)
    fov, light = torch.tensor([fov]), torch.from_numpy(glow).float()[None, None]

    def geometry(depth):
        points = augment.xyz(torch.from_numpy(depth).float()[None, None], fov)
        return torch.cat([augment.normals_of(points), points], 1)

    albedo, normal, _ = nets["mnet"](photo, geometry(full_depth(depth)), light)
    shape = torch.cat([augment.unit(F.avg_pool2d(normal, 2)), geometry(half_depth(depth))[:, 3:]], 1)
    half, every = lambda x: F.avg_pool2d(x, 2), F.max_pool2d(light, 2)
    found, total = {}, 0
    for name, mask in [*masks.items(), ("inv_lamp", None), ("inv_window", None)]:
        kind = ("inv" if mask is None else "vis") + ("win" if "window" in name else "lamp") + "net"
        own = 0 * every if mask is None else F.max_pool2d(torch.from_numpy(mask).float()[None, None], 2)
        mine = torch.cat([every, own], 1)
        net, start = nets[kind], lights.begin(shape, mine, kind == "viswinnet")
        found[name] = dict(zip(net.outputs, net(half(photo), shape, half(albedo), mine, start)))
        total = total + net.cast(found[name], shape)[0]
    return found, albedo[0], total


def outline(light):
    """Lines [N, 2, 3] of a box or a window."""
    if "axes" in light:
        centre, (a, b, c) = light["centre"][0].numpy(), light["axes"][0].numpy()
        signs = [(s, t) for s in (-1, 1) for t in (-1, 1)]
        return np.array([[centre - u + s * v + t * w, centre + u + s * v + t * w] for u, v, w in ((a, b, c), (b, c, a), (c, a, b)) for s, t in signs])
    centre, x, y = (light[k][0].numpy() for k in ("centre", "half_x", "half_y"))
    corners = [centre - x - y, centre + x - y, centre + x + y, centre - x + y]
    return np.array([corners, corners[1:] + corners[:1]]).transpose(1, 0, 2)


def known(light):
    """The lines of a light of lights.json."""
    centre, axes = form.body(light)
    tensor = lambda x: torch.tensor(np.array(x, np.float32))[None]
    if light["kind"] == "Window":
        return outline({"centre": tensor(centre), "half_x": tensor(axes[0]), "half_y": tensor(axes[1])})
    return outline({"centre": tensor(centre), "axes": tensor(axes)})


def draw(panels, name, photo, depth, fov, found, albedo, total, truth):
    over, plan, shade, paint = panels
    tone = lambda x: np.moveaxis(np.clip(np.asarray(x), 0, 1) ** (1 / 2.2), 0, -1)
    focal = SIZE[0] / 2 / np.tan(np.radians(fov) / 2)
    over.imshow(tone(photo * 0.9 / np.quantile(photo, 0.98)))
    over.set(xlim=(0, SIZE[0]), ylim=(SIZE[1], 0), title=name)
    points = augment.xyz(torch.from_numpy(half_depth(depth)).float()[None, None], torch.tensor([fov]))[0].flatten(1)[:, ::7].numpy()
    points = points[:, -points[2] <= 1.5 * np.quantile(-points[2], 0.9)]  # not what lies beyond a window
    plan.scatter(points[0], -points[2], s=0.4, color="0.7")
    plan.plot(0, 0, "k^")
    plan.set(title="plan (m), camera at the triangle", aspect="equal")

    def lines(segments, color, style):
        for a, b in segments:
            plan.plot([a[0], b[0]], [-a[2], -b[2]], style, color=color, lw=1.5)
            if min(-a[2], -b[2]) > 0.05:
                at = lambda p: (SIZE[0] / 2 + focal * p[0] / -p[2], SIZE[1] / 2 - focal * p[1] / -p[2])
                over.plot(*zip(at(a), at(b)), style, color=color, lw=1.5)

    for light in truth.values():
        lines(known(light), "lime", ":")
    for label, light in found.items():
        radiance = light["radiance"][0].sum(0).numpy()
        burns = float(light["confidence"][0, 0])
        if burns > 0.5 or not label.startswith("inv"):
            color = np.clip(radiance / max(radiance.max(), 1e-6), 0, 1) ** (1 / 2.2) * 0.9
            lines(outline(light), color, "-")
            centre = light["centre"][0].numpy()
            plan.annotate(label, (centre[0], -centre[2]), fontsize=6)
            if "directions" in light:
                power = light["radiance"][0].mean(1) / (1 + light["bandwidths"][0])
                way = -light["directions"][0, int(power.argmax())].numpy()
                plan.annotate("", (centre[0] + way[0], -centre[2] - way[2]), (centre[0], -centre[2]), arrowprops={"arrowstyle": "->", "color": "red"})
    shade.imshow(tone(total * 0.5 / max(float(total.mean()), 1e-6)))
    shade.set(title=f"direct light, unshadowed (mean {float(total.mean()):.2f})")
    paint.imshow(tone(albedo))
    paint.set(title="MNet: albedo")
    for panel in (over, shade, paint):
        panel.axis("off")


def told(label, light):
    n = lambda x: "(" + ", ".join(f"{v:.2f}" for v in x) + ")"
    p, error = light["confidence"][0].tolist()
    size = light["axes"][0].norm(dim=1) if "axes" in light else torch.stack([light["half_x"][0].norm(), light["half_y"][0].norm()])
    return f"  {label}: burns {p:.2f}, error to expect {error:.2f}; centre {n(light['centre'][0])} m, half extents {n(size)} m, radiance " + " ".join(
        n(r) for r in light["radiance"][0]
    )


def main(folders, runs, out):
    nets = {name: trained(name, os.path.join(runs, name))[0] for name in ("mnet", "vislampnet", "viswinnet", "invlampnet", "invwinnet")}
    figure, rows = plt.subplots(len(folders), 4, figsize=(15, 3.2 * len(folders)), layout="constrained", squeeze=False)
    for panels, folder in zip(rows, folders):
        photo, depth, fov, masks, truth = read(folder)
        found, albedo, total = estimate(nets, photo, depth, fov, masks)
        print(folder.name, *(told(label, light) for label, light in found.items()), sep="\n")
        draw(panels, folder.name, photo, depth, fov, found, albedo, total, truth)
    figure.savefig(out, dpi=80)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", nargs="+", type=Path, metavar="FOLDER")
    parser.add_argument("--runs", default="runs")
    parser.add_argument("--out", default="drawn.png")
    a = parser.parse_args()
    main(a.folders, a.runs, a.out)
