"""A room by other people, of which each light's own picture is known, as a scene with its truth for `relight eval`.

usage: foreign.py ROOM SCENE [--without LIGHT]

ROOM holds olat_LIGHT.exr (linear picture by this light alone), albedo.exr, normal.exr, depth.exr, mask_LIGHT.png and meta.json; paint.exr and object.exr with
their masks where meta.json tells of such edits. Without LIGHT, the photo is that of the other lights and the edit inserts it: a lamp that is a ball.
Lights of which meta.json does not tell the whole shape leave the truth without any: then eval scores pictures only."""

import argparse
import json
from pathlib import Path
from typing import NamedTuple

import numpy as np
from PIL import Image

import folder


class Room(NamedTuple):
    """Pictures are [h, w, 3]; lights as in docs/planes.md, as far as meta.json tells them."""

    meta: dict
    lights: dict
    pictures: dict
    masks: dict
    depth: np.ndarray
    albedo: np.ndarray
    normal: np.ndarray


def picture(path):
    """[h, w, 3]."""
    import OpenEXR

    with OpenEXR.File(str(path), separate_channels=True) as file:
        channels = file.channels()
        return np.stack([np.asarray(channels[k].pixels, np.float32) for k in "RGB"], -1)


def mask(path):
    return np.asarray(Image.open(path).convert("L")) > 0


def described(meta):
    """Lights as graphs/planes.ron reads them. A rectangle that stands for a window is one of uniform sky."""
    lights, up = {}, -np.array(meta["lamps"]["inv_lamp"]["normal"])  # the lamps of these rooms that hang shine down
    for name, lamp in meta["lamps"].items():
        common = {"center": lamp.get("center"), "radiance": lamp.get("radiance")}
        if lamp["kind"] == "sphere":
            lights[name] = common | {"kind": "Sphere", "radius": lamp["radius"]}
        elif lamp["kind"] == "rect":
            n = np.array(lamp["normal"]) / np.linalg.norm(lamp["normal"])
            x = np.cross(up, n) if abs(n @ up) < 0.9 else np.cross([0, 0, 1], n)
            x /= np.linalg.norm(x)
            sides = {"half_x": (lamp["half"][0] * x).tolist(), "half_y": (lamp["half"][1] * np.cross(n, x)).tolist()}
            if name.startswith("window"):
                sky = {"name": "sky", "direction": (-n).tolist(), "bandwidth": 0.0, "radiance": common.pop("radiance")}
                lights[called(name, meta)] = common | sides | {"kind": "Window", "lobes": [sky]}
            else:
                lights[name] = common | sides | {"kind": "Rect"}
    return lights


def called(name, meta):
    """Returns the name of a light in the program: those out of view are one lamp and one window."""
    return name if name in meta["visible"] else "inv_window" if name.startswith("window") else "inv_lamp"


def read(source):
    meta = json.loads((source / "meta.json").read_text())
    pictures = {}
    for name in meta["lights"]:
        pictures[called(name, meta)] = pictures.get(called(name, meta), 0) + picture(source / f"olat_{name}.exr")
    return Room(
        meta,
        described(meta),
        pictures,
        {name: mask(source / f"mask_{name}.png") for name in meta["visible"]},
        picture(source / "depth.exr")[..., 0],
        picture(source / "albedo.exr").clip(0, 1),
        picture(source / "normal.exr"),
    )


def edits(room, source, to):
    """The edits of meta.json: {name: (text, true picture)}; the mask of painted pixels goes into the folder `to`."""
    out, triple = {}, lambda v: ", ".join(str(float(x)) for x in v)
    if "paint" in room.meta["edits"]:
        Image.fromarray(mask(source / "mask_paint.png").astype(np.uint8) * 255).save(to / "paint.png")
        paint = f'Paint(region: Mask("../paint.png"), albedo: Linear({triple(room.meta["edits"]["paint"]["albedo"])}))'
        out["paint"] = f"materials: [ {paint} ]", picture(source / "paint.exr")
    ball = room.meta["edits"].get("object", {})
    if ball.get("pixels", 0) > 30:
        material = f"(albedo: Linear({triple(ball['albedo'])}), roughness: 1.0)"
        sphere = f"Sphere(radius: {ball['radius']}, at: Point({triple(ball['center'])}), material: {material})"
        out["insert_object"] = f"objects: [ {sphere} ]", picture(source / "object.exr")
    return out


def main(source, to, without):
    room = read(source)
    to.mkdir(parents=True, exist_ok=True)
    pictures, masks, lights, changes = room.pictures, room.masks, room.lights, {}
    if without is None:
        changes = edits(room, source, to)
    else:
        lamp = room.meta["lamps"].get(without, {})
        if without not in masks or lamp.get("kind") != "sphere":
            raise SystemExit(f"--without: wanted a visible lamp that is a ball, got {without}")
        place, radiance = (", ".join(str(x) for x in lamp[k]) for k in ("center", "radiance"))
        new = f'"new": Lamp(shape: Sphere(radius: {lamp["radius"]}), at: Point({place}), radiance: ({radiance}))'
        changes["insert_lamp"] = f"lights: {{ {new} }}", sum(pictures.values())
        pictures, masks, lights = ({k: v for k, v in x.items() if k != without} for x in (pictures, masks, lights))
    unknown = [name for name in pictures if name not in lights]
    if unknown:
        print(f"{source}: the shape of {', '.join(unknown)} is not known: no true lights")
    folder.write(
        to,
        float(room.meta["fov_x"]),
        folder.stored(sum(pictures.values())),
        room.depth,
        room.albedo,
        masks,
        None if unknown else lights,
        normal=room.normal,
        pictures=pictures,
        edits={name: (f"Edit(version: 1, {text})\n", truth) for name, (text, truth) in changes.items()},
    )


if __name__ == "__main__":
    ask = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    ask.add_argument("room", type=Path)
    ask.add_argument("scene", type=Path)
    ask.add_argument("--without")
    a = ask.parse_args()
    main(a.room, a.scene, a.without)
