"""Measures the rendering networks on rooms by other people, of which each light's own picture is known.

usage: outside.py ROOMS [--relight target/release/relight] [--runs runs] [--sheet sheet.png]

ROOMS holds folders with olat_LIGHT.exr (linear picture by this light alone), albedo.exr, normal.exr, depth.exr, mask_LIGHT.png and meta.json. For
every light whose shape meta.json tells, the program computes direct light, shadow and TraceIndirect (graphs/planes.ron); the networks go on from
there. The truth is the light's picture over albedo, its whole diffuse shading; what shines there by gloss is in it too. Errors are L1 over L1 of the
truth, on pixels of no light and albedo above 0.05; as they are, and after the least-squares factor of each light, as the program fits radiances to
a photo. For LightNet there is no truth but this: the shading that its maps imply."""

import argparse
import os
import sys
import tempfile
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from PIL import Image

import augment
import flux
import hemisphere
import indirectnet
import place
import shadownet
from lightnet import CELL
from networks import trained

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "training/rooms"))
import folder as scene_folder  # noqa: E402
import foreign  # noqa: E402
from pack import half, planes  # noqa: E402


def first(x):
    """[h, w, 3] to [3, h, w]."""
    return np.moveaxis(x, -1, 0)


def computed(source, relight):
    """Returns the inputs of the networks for a room, and its truth: tensors at half size, lights in front."""
    room = foreign.read(source)
    lights, photo = room.lights, sum(room.pictures.values())
    with tempfile.TemporaryDirectory() as folder:
        masks = {name: mask for name, mask in room.masks.items() if name in lights}
        scene_folder.write(Path(folder), float(room.meta["fov_x"]), photo, room.depth, room.albedo, masks, lights)
        got = planes(Path(folder), relight)
    glow = np.any([*room.masks.values(), np.zeros(room.depth.shape, bool)], 0)
    names = list(lights)
    stem = lambda name: f"{name}_{1 if 'window' in name else 0}"
    plane = lambda kind, c="Y": torch.from_numpy(np.stack([half(got[f"{kind}_{stem(n)}.{c}"]) for n in names])[:, None]).float()
    one = lambda x: torch.from_numpy(np.ascontiguousarray(half(x))).float()[None]
    albedo, fov = one(first(room.albedo)), torch.tensor([float(room.meta["fov_x"])])
    normal = F.normalize(one(first(room.normal)), dim=1)
    geometry = torch.cat([normal, augment.xyz(one(room.depth[None]), fov)], 1)
    radiance = torch.tensor([lights[n]["radiance"] if "radiance" in lights[n] else lights[n]["lobes"][0]["radiance"] for n in names]).float()
    tag = lambda n: n + (".sky" if "window" in n else "")
    light = F.max_pool2d(torch.from_numpy(glow).float()[None, None], 2)
    return {
        "names": names,
        "photo": one(first(photo)),
        "albedo": albedo,
        "geometry": geometry,
        "light": light,
        "valid": (1 - light) * (albedo.amin(1, keepdim=True) > 0.05),
        "direct": plane("direct"),
        "traced": plane("lit"),
        "unknown": plane("unknown"),
        "bounced": torch.cat([plane("indirect", c) for c in "RGB"], 1),
        "radiance": radiance[..., None, None],
        "flux": torch.tensor([flux.flux(lights, tag(n)) for n in names]).float().view(-1, 1, 1, 1),
        "place": torch.from_numpy(np.stack([place.place(lights, tag(n)) for n in names])).float()[..., None, None],
        "truth": torch.cat([one(first(room.pictures[n])) for n in names]) / albedo.clamp(min=0.05),
    }


@torch.no_grad()
def predict(x, nets):
    """Shading by each light: {estimate: [lights, 3, h, w]}; shadows; and the maps of all these lights together."""
    count = len(x["names"])
    many = lambda v: v.expand(count, -1, -1, -1)
    explained = ((x["direct"] * x["traced"] + x["bounced"]) * x["radiance"]).sum(0, keepdim=True)
    planes = {"traced": x["traced"], "unknown": x["unknown"], "traced_direct": x["direct"], "radiance": x["radiance"]}
    seen = shadownet.evidence(planes | {"photo": x["photo"], "albedo": x["albedo"]}, explained)
    visibility = shadownet.visibility(planes, seen)
    shadow = shadownet.combine(visibility, nets["shadownet"](visibility, many(x["geometry"]), x["place"]))
    lit = lambda s: x["direct"] * s * x["radiance"]

    def indirect(s):
        flux = x["flux"] * x["radiance"]
        told = indirectnet.evidence(x["photo"][0], x["albedo"][0], x["light"][0], lit(s).sum(0), flux.sum(0))
        return nets["indirectnet"](*(many(x[k]) for k in ("geometry", "albedo", "light")), lit(s), flux, *(many(v) for v in told))

    estimates = {
        "no shadow, no indirect": lit(1),
        "ray-traced shadow, no indirect": lit(x["traced"]),
        "ray-traced shadow, TraceIndirect": lit(x["traced"]) + x["bounced"] * x["radiance"],
        "ray-traced shadow, IndirectNet": lit(x["traced"]) + indirect(x["traced"]),
        "ShadowNet, no indirect": lit(shadow),
        "ShadowNet, IndirectNet": lit(shadow) + indirect(shadow),
    }
    whole = torch.where(x["light"] > 0, x["photo"], estimates["ShadowNet, IndirectNet"].sum(0, keepdim=True))
    maps = nets["lightnet"].maps(*nets["lightnet"](x["geometry"], x["albedo"], torch.full_like(x["light"], 0.8), x["light"], whole))[0]
    return estimates, shadow, maps


def error(got, want, valid):
    return float(((got - want).abs() * valid).sum() / (want * valid).sum().clamp(min=1e-9))


def fitted(got, want, valid):
    """`got` of [lights, 3, h, w] times the least-squares factor of each light."""
    sums = lambda x: (x * valid).sum((1, 2, 3), keepdim=True)
    return got * sums(got * want) / sums(got * got).clamp(min=1e-12)


def table(columns, measure):
    """Lines of Markdown: a row an estimate, a column a light, and the mean of the columns."""
    rows = list(dict.fromkeys(e for values in columns.values() for e in values[measure]))
    lines = [f"| {measure} | " + " | ".join([*columns, "mean"]) + " |", "| --- " * (len(columns) + 2) + "|"]
    for row in rows:
        values = [c[measure][row] for c in columns.values()]
        lines.append(f"| {row} | " + " | ".join(f"{v:.2f}" for v in [*values, np.mean(values)]) + " |")
    return "\n".join(lines) + "\n"


def shown(x, estimates, shadow, k):
    """A row of pictures: photo, ray-traced shadow, ShadowNet's, shading without networks, with them, truth."""
    tone = lambda v, scale=1.0: np.asarray((v * scale).clamp(0, 1).expand(3, -1, -1)) ** (1 / 2.2)
    scale = 0.5 / float(x["truth"][k].mean())
    shadings = [estimates["ray-traced shadow, TraceIndirect"][k], estimates["ShadowNet, IndirectNet"][k], x["truth"][k]]
    return np.concatenate(
        [tone(x["photo"][0])] + [np.asarray(v[k].expand(3, -1, -1)) for v in (x["traced"], shadow)] + [tone(v, scale) for v in shadings], 2
    )


def main(rooms, relight, runs, sheet):
    nets = {name: trained(name, os.path.join(runs, name))[0] for name in ("shadownet", "indirectnet", "lightnet")}
    lights, whole, pictures = {}, {}, []
    for source in sorted(p for p in rooms.iterdir() if (p / "meta.json").exists()):
        x = computed(source, relight)
        estimates, shadow, maps = predict(x, nets)
        truth, valid = x["truth"], x["valid"]
        fits = {e: fitted(v, truth, valid) for e, v in estimates.items()}
        for k, name in enumerate(x["names"]):
            both = {"as they are": estimates, "fitted": fits}
            lights[f"{source.name} {name}"] = {m: {e: error(v[k], truth[k], valid[0]) for e, v in some.items()} for m, some in both.items()}
            pictures.append(shown(x, estimates, shadow, k))
        cells = lambda v: F.avg_pool2d(v[..., 1:-1, 1:-1], 2, CELL)  # the 2 x 2 pixels about a cell's center
        implied = error(hemisphere.shading(maps).movedim(-1, 0), cells(truth.sum(0)), (cells(valid[0]) > 0.99).float())
        sums = {e: error(v.sum(0), truth.sum(0), valid[0]) for e, v in estimates.items()}
        whole[source.name] = {"all lights together": sums | {"implied by LightNet's maps": implied}}
    print(table(lights, "as they are"), table(lights, "fitted"), table(whole, "all lights together"), sep="\n")
    if sheet:
        flat = np.moveaxis(np.concatenate(pictures, 1), 0, -1)
        Image.fromarray((flat.clip(0, 1) * 255).round().astype(np.uint8)).save(sheet)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("rooms", type=Path)
    parser.add_argument("--relight", type=Path, default=ROOT / "target/release/relight")
    parser.add_argument("--runs", default="runs")
    parser.add_argument("--sheet")
    a = parser.parse_args()
    main(a.rooms, a.relight, a.runs, a.sheet)
