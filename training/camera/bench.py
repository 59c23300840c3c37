"""Scores lights off and dimmed in photos with clipped parts, ragged masks and the depth of a sensor, made of rooms whose light is known.

usage: bench.py [--relight target/release/relight] [--graph graphs/indoor.ron] [--work .cache/camera_bench] [--exact] ROOM ..

A ROOM is a folder of rooms/make.py or rooms/people.py. Its picture and the pictures without each light go through the same camera, drawn by the room's
name, whose exposure clips 2 to 10 % of the pixels; the truth has neither noise nor JPEG. The table has means over the edits of each kind, in 8-bit steps
and beside those of the unedited photo: inside what is clipped, in a band of 20 pixels around it, elsewhere; of the differences red - green and blue - green
where the photo is clipped or near it (chroma); and the mean step across the edge of what is clipped over that of the truth. `--exact` leaves masks and depth
as they are. Pixels of lights do not count. Photos, scenes and results stay in the folder --work; FOLDER/scores.json has all edits."""

import argparse
import json
import re
import shutil
import subprocess
import sys
import zlib
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
sys.path[:0] = [str(HERE.parent), str(HERE.parent / "rooms")]
from camera import depth as sensors  # noqa: E402
from camera import model  # noqa: E402
from camera.photograph import read  # noqa: E402
from known import direct_shading  # noqa: E402

BAND = 20  # pixels around what is clipped
CLIPPED = (0.02, 0.10)  # share of the pixels that the exposure clips
WHITE = 0.985  # 8-bit level, as a share of 255, from which on a pixel is clipped
EDITS = {"off": ("Off", 0.0), "dimmed": ("Scale(0.3)", 0.3)}


def depth_of(path):
    """Returns the channel Z of an OpenEXR file."""
    import OpenEXR

    with OpenEXR.File(str(path), separate_channels=True) as file:
        return np.asarray(file.channels()["Z"].pixels, np.float64)


def light_pictures(room):
    """Returns {light: its part of the picture [h, w, 3]}, from its direct light and the paths that it alone feeds."""
    truth = np.load(room / "truth.npz")
    sources = [str(name) for name in truth["sources"]]
    shading = direct_shading(truth)
    for weights, indirect in zip(truth["path_weights"], truth["indirect"]):
        (light,) = {sources[i].split(".")[0] for i in np.nonzero(weights.sum(-1))[0]}
        shading[light] = shading[light] + indirect.astype(np.float64)
    albedo = read(room / "albedo.exr")
    return {light: albedo * e.repeat(2, 0).repeat(2, 1) for light, e in shading.items()}


def near(mask, pixels):
    """Returns the pixels within `pixels` rows and columns of a mask [h, w]."""
    out = mask.copy()
    for axis in (0, 1):
        grown = out.copy()
        for k in range(1, pixels + 1):
            for shift in (-k, k):
                moved = np.roll(out, shift, axis)
                edge = [slice(None)] * 2
                edge[axis] = slice(0, shift) if shift > 0 else slice(shift, None)
                moved[tuple(edge)] = False
                grown |= moved
        out = grown
    return out


def jumps(picture):
    """Returns the sum of the differences to the pixels below and to the right, [h - 1, w - 1]."""
    return np.abs(np.diff(picture, axis=0))[:, :-1].sum(-1) + np.abs(np.diff(picture, axis=1))[:-1].sum(-1)


def scene(room, to, exact):
    """Writes the scene of a room's photo into the folder `to`; returns its camera, its masks, its linear picture and the stored photo."""
    from folder import exr, save_mask

    rng = np.random.default_rng(zlib.crc32(room.name.encode()))
    text = (room / "scene.ron").read_text()
    names = re.findall(r'"(\w+)": (?:Lamp|Window)\(mask', text)
    masks = {n: np.asarray(Image.open(room / f"masks/{n}.png").convert("L")) > 0 for n in names}
    picture = read(room / "photo.exr").clip(0)
    own = np.logical_or.reduce([*masks.values(), np.zeros(picture.shape[:2], bool)])
    camera = model.sample(rng)
    share = 1 - rng.uniform(*CLIPPED)
    camera = replace(camera, exposure=model.auto_exposure(model.incident(picture, camera), ~own, camera.saturation, share))
    stored = model.photograph(picture, camera, rng).stored
    depth = depth_of(room / "depth.exr")
    if not exact:
        sensor = sensors.sample_sensor(rng)
        depth = sensors.sensor_depth(depth, sensor, sensors.sensor_noise(rng, *depth.shape, sensor))
        flaws = sensors.sample_mask(rng)
    to.mkdir(parents=True, exist_ok=True)
    (to / "masks").mkdir(exist_ok=True)
    Image.fromarray(stored).save(to / "photo.png")
    exr(to / "depth.exr", Z=depth)
    for name, mask in masks.items():
        drawn = mask if exact else sensors.ragged_mask(mask.astype(np.float64), flaws, sensors.mask_noise(rng)) > 0.5
        save_mask(to / f"masks/{name}.png", drawn if drawn.any() else mask)
    text = re.sub(r'photo: "photo.exr", transfer: Linear', 'photo: "photo.png"', text)
    (to / "scene.ron").write_text(re.sub(r",\s*truth: \(.*\)\s*\)\s*$", ")\n", text, flags=re.S))
    return camera, own, picture, stored


def score(got, want, photo, own):
    """Returns the measures of one edit of which `got`, `want` and the photo are [h, w, 3] in 0..1."""
    clipped = (photo.max(-1) >= WHITE) & ~own
    band = near(clipped, BAND) & ~clipped & ~own
    around = near(clipped, 2) & near(~clipped, 2) & ~near(own, 2)
    mean = lambda error, where: float(255 * error[where].mean()) if where.any() else np.nan
    out = {}
    for name, where in {"clipped": clipped, "band": band, "elsewhere": ~(clipped | band | own)}.items():
        out[name] = mean(np.abs(got - want).mean(-1), where)
        out[f"{name} unchanged"] = mean(np.abs(photo - want).mean(-1), where)
    chroma = lambda x: x[..., [0, 2]] - x[..., [1]]
    out["chroma"] = mean(np.abs(chroma(got) - chroma(want)).mean(-1), clipped | band)
    out["chroma unchanged"] = mean(np.abs(chroma(photo) - chroma(want)).mean(-1), clipped | band)
    edge = around[:-1, :-1]
    out["step"] = float(jumps(got)[edge].mean() / max(jumps(want)[edge].mean(), 1e-4)) if edge.any() else np.nan
    return out


def main(a):
    rows = []
    for room in map(Path, a.rooms):
        to = a.work / room.name
        shutil.rmtree(to, ignore_errors=True)
        camera, own, picture, stored = scene(room, to, a.exact)
        shown = lambda linear: model.develop(model.incident(linear.clip(0), camera), replace(camera, shot_noise=0, read_noise=0), np.zeros_like(linear))
        visible = {path.stem for path in (to / "masks").iterdir()}
        parts = light_pictures(room)
        hidden = [light for light in parts if light not in visible]
        groups = {light: [light] for light in parts if light in visible} | ({"out of view": hidden} if hidden else {})
        for group, lights in groups.items():
            part = sum(parts[light] for light in lights)
            for kind, (change, left) in EDITS.items():
                names = lights if group in visible else ["inv_lamp", "inv_window"]
                entries = ", ".join(f'"{name}": {change}' for name in names)
                (to / "edit.ron").write_text(f"Edit(version: 1, lights: {{ {entries} }})\n")
                command = [a.relight, "run", a.graph, to / "edit.ron", "--scene", to, "--out", to / "out", "--cache", to / "cache"]
                subprocess.run(list(map(str, command)), check=True, capture_output=True)
                got = np.asarray(Image.open(to / "out/picture.png").convert("RGB")) / 255
                want = shown(picture - (1 - left) * part)
                photo = stored / 255
                if np.abs(shown(picture) - want)[~own].mean() < 0.01:
                    continue  # the edit hardly shows
                of = "out of view" if group not in visible else "in view"
                rows.append({"room": room.name, "light": group, "kind": f"{kind}, {of}"} | score(got, want, photo, own))
    kinds = sorted({row["kind"] for row in rows})
    print("| edit | number | clipped (unchanged) | band | elsewhere | chroma | step |\n| --- | --- | --- | --- | --- | --- | --- |")
    for kind in [*kinds, "all"]:
        of = [row for row in rows if kind in (row["kind"], "all")]
        mean = lambda key: np.nanmean([row[key] for row in of])
        cells = [f"{mean(k):.1f} ({mean(k + ' unchanged'):.1f})" for k in ("clipped", "band", "elsewhere", "chroma")]
        print(f"| {kind} | {len(of)} | {' | '.join(cells)} | {mean('step'):.2f} |")
    (a.work / "scores.json").write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("rooms", nargs="+", metavar="ROOM")
    parser.add_argument("--relight", default=ROOT / "target/release/relight")
    parser.add_argument("--graph", default=ROOT / "graphs/indoor.ron")
    parser.add_argument("--work", type=Path, default=ROOT / ".cache/camera_bench")
    parser.add_argument("--exact", action="store_true")
    main(parser.parse_args())
