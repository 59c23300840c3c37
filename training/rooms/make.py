"""Makes rooms: rooms/make.py --split train --count 400 [--first 0] [--step 1] [--out .cache/rooms] [--assets .cache/assets] [--threads 2].

One folder a room, OUT/SPLIT/SEED; one that is complete is left alone, so that a stopped run goes on where it stopped. Same seed, versions and
number of threads give the same room. `val` and `test` use furniture that `train` never sees. What a folder holds: training/README.md."""

import argparse
import json
import math
import os
import shutil
import sys
import time
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent / "demo"))
import folder as scene_folder  # noqa: E402
import layout  # noqa: E402
from assets import Library  # noqa: E402

# First seed; furniture; passes of 16 samples a pixel of the photo and of indirect light, passes of 64 of direct light; samples a texel of the maps (a
# square number); whether all but the photo is denoised, too.
SPLITS = {
    "train": (0, "train", (1, 1, 1, 9, True)),
    "val": (10_000_000, "held", (4, 4, 2, 16, True)),
    "test": (20_000_000, "held", (16, 64, 16, 64, False)),
}
LEAST = 12  # pixels that a visible light has at least
PATHS = 5  # most indirect pictures a room


def cameras(room, rng):
    """Places and directions to look from, at head height, into the room."""
    low, high = room.footprint.min(0), room.footprint.max(0)
    for _ in range(200):
        x, z = rng.uniform(low, high)
        y = rng.uniform(1.1, 1.7)
        at = np.array([x, y, z])
        if not room.inside(x, z, 0.3) or any((at > l - 0.25).all() and (at < h + 0.25).all() for l, h in room.taken):
            continue
        tx, tz = rng.uniform(low, high)
        if math.hypot(tx - x, tz - z) < 1.5:
            continue
        yield at, math.atan2(tx - x, -(tz - z)), rng.uniform(-0.22, 0.03), rng.uniform(52, 75)


def look(lit, scene, room, rng):
    """A camera that sees something, mostly one that sees a light: (view, planes, names of lights seen, names of lights not seen), or None."""
    import truth

    wants_light, found = rng.random() < 0.75, None
    for number, spec in enumerate(cameras(room, rng)):
        if number == 25:
            break
        view = truth.View(*spec)
        depth = truth.depths(scene, view, 40)
        if np.percentile(depth, 10) < 0.8 or np.percentile(depth, 50) < 1.8 or np.percentile(depth, 95) < 2.4:
            continue
        planes = truth.surfaces(lit, scene, view)
        pixels = lambda plane: {name: int((planes[plane] == k + 1).sum()) for k, name in enumerate(planes["names"])}
        seen = [n for n, count in pixels("light").items() if count >= LEAST]
        # A light of a few pixels is neither visible nor invisible: it does not burn.
        hidden = [n for n, count in pixels("touch").items() if count == 0]
        lamps, windows = ([n for n in hidden if n.startswith(kind)] for kind in ("lamp", "window"))
        kept = [str(rng.choice(some)) for some in (lamps, windows) if some]
        if seen or kept:
            found = found or (view, planes, seen, kept)
        if seen or (found and not wants_light):
            return view, planes, seen, kept
    return found


def names_of(seen, hidden):
    """{our name in the room: name of the light in lights.json}, visible lamps, visible windows, invisible ones."""
    out = {}
    for kind in ("lamp", "window"):
        out |= {name: f"{kind}_{k}" for k, name in enumerate(n for n in seen if n.startswith(kind))}
    return out | {n: "inv_lamp" if n.startswith("lamp") else "inv_window" for n in hidden}


def numbers(value):
    return np.round(np.asarray(value, float), 6).tolist()


def describe(lit, view, name, gain):
    """A light as lights.json has it: camera space, photo units."""
    if name in lit.lamps:
        lamp, place = lit.lamps[name], lit.lamps[name].place
        out = {"kind": lamp.kind}
        for key, value in place.items():
            if key == "center":
                out[key] = numbers(view.point(value))
            elif key == "radius":
                out[key] = float(value)
            elif key == "triangles":
                out[key] = numbers((value - view.origin) @ view.turn.T)
            else:
                out[key] = numbers(np.asarray(value) @ view.turn.T)
        return out | {"radiance": numbers(lamp.radiance * gain)}
    w = lit.windows[name]
    lobes = [
        dict(name=n, direction=numbers(view.direction(d) / np.linalg.norm(d)), bandwidth=float(b), radiance=numbers(r * gain))
        for n, d, b, r in w.lobes
    ]
    return dict(
        kind="Window",
        center=numbers(view.point(w.center)),
        half_x=numbers(view.direction(w.half_x)),
        half_y=numbers(view.direction(w.half_y)),
        lobes=lobes,
    )


def groups(lit, names):
    """What burns in each indirect picture: {title: {light: its lobes, None for a lamp}}. The sun apart; beyond PATHS pictures the last ones are one."""
    out = {}
    for name, title in names.items():
        if name in lit.lamps:
            out[title] = {name: None}
            continue
        lobes = [n for n, *_ in lit.windows[name].lobes]
        for part in ([n for n in lobes if n == "sun"], [n for n in lobes if n != "sun"]):
            if part:
                out[f"{title}.{'+'.join(part)}"] = {name: part}
    while len(out) > PATHS:
        (b, last), (a, before) = out.popitem(), out.popitem()
        for name, lobes in last.items():
            before[name] = before[name] + lobes if name in before else lobes
        out[f"{a}+{b}"] = before
    return out


def make(seed, library, folder, quality):
    """Renders the room of a seed into `folder`; None when no camera sees anything. `quality`: see SPLITS."""
    import scene as scenes

    room, rng = layout.make(seed, library)
    lit = scenes.Lit(room)
    found = look(lit, lit.scene({}), room, rng)
    about = dict(seed=seed, scene="generated", kind=room.kind, night=bool(room.night), corners=len(room.footprint))
    return found and record(lit, found, rng, folder, quality, about)


def record(lit, found, rng, folder, quality, about):
    """Renders what is true of a lit room from the view that `look` found into `folder`; None when it is dark there. `about` goes into room.json."""
    import truth

    photo_passes, passes, direct_passes, texel_samples, clean = quality
    view, planes, seen, hidden = found
    names = names_of(seen, hidden)
    all_on = lit.scene(dict.fromkeys(names))
    picture = truth.photo(all_on, view, planes["albedo"], planes["normal"], photo_passes)
    dark = planes["touch"] == 0
    if np.percentile(picture[dark].mean(-1), 98) <= 0:
        return None

    # White balance and exposure, as a camera would; all that is linear in the lights takes the same gain.
    cast = np.array([np.percentile(picture[dark][:, c], 90) for c in range(3)])
    balance = (cast.mean() / np.maximum(cast, 1e-3 * cast.max())) ** rng.uniform(0.0, 0.8)
    gain = balance * rng.uniform(0.9, 1.0) / np.percentile((picture * balance)[dark].mean(-1), 98)

    lights = {title: describe(lit, view, name, gain) for name, title in names.items()}
    direct, normal = truth.shading(lit, all_on, view, names, direct_passes, clean)
    sources, weights = [], []
    for name, title in names.items():
        if name in lit.lamps:
            sources.append((name, title)), weights.append(lights[title]["radiance"])
        else:
            for lobe in lights[title]["lobes"]:
                sources.append((f"{name}.{lobe['name']}", f"{title}.{lobe['name']}")), weights.append(lobe["radiance"])
    weights = np.array(weights)
    parts = groups(lit, names)
    path_weights = np.zeros((len(parts), len(sources), 3))
    indirect = []
    for p, burn in enumerate(parts.values()):
        for name, lobes in burn.items():
            for s, (source, _) in enumerate(sources):
                if source == name or (lobes and source in [f"{name}.{n}" for n in lobes]):
                    path_weights[p, s] = weights[s]
        indirect.append(truth.indirect(lit, lit.scene(burn), view, normal, passes, clean) * gain)
    maps, valid = truth.maps(lit, all_on, view, names, texel_samples)

    titles = list(lights)
    mask = np.zeros(planes["light"].shape, np.uint8)
    for k, name in enumerate(planes["names"]):
        if name in names:
            mask[planes["light"] == k + 1] = titles.index(names[name]) + 1
    half = lambda x: np.asarray(np.clip(x, 0, 60000), np.float16)
    np.savez_compressed(
        folder / "truth.npz",
        photo=half(picture * gain),
        albedo=half(planes["albedo"]),
        normal=planes["normal"].astype(np.float16),
        rough=half(planes["rough"]),
        depth=planes["depth"].astype(np.float32),
        light_mask=mask,
        fov_x=np.float32(view.fov_x),
        sources=np.array([t for _, t in sources]),
        source_radiance=weights.astype(np.float32),
        direct=half([direct[s][0] for s, _ in sources]),
        shadow=half([direct[s][1] for s, _ in sources]),
        paths=np.array(list(parts)),
        path_weights=path_weights.astype(np.float32),
        indirect=half(indirect),
        maps=half(maps * gain),
        maps_valid=valid.astype(np.uint8),
    )
    masks = {title: mask == k + 1 for k, title in enumerate(titles) if not title.startswith("inv_")}
    scene_folder.write(folder, view.fov_x, picture * gain, planes["depth"], planes["albedo"], masks, lights)
    (folder / "room.json").write_text(
        json.dumps(
            dict(
                about,
                gain=gain.tolist(),
                view=dict(origin=view.origin.tolist(), turn=view.turn.tolist(), fov_x=view.fov_x),
                names=names,
            ),
            indent=1,
        )
    )
    return folder


def main():
    ask = argparse.ArgumentParser(description=__doc__)
    ask.add_argument("--split", choices=SPLITS, default="train")
    ask.add_argument("--first", type=int, default=0)
    ask.add_argument("--step", type=int, default=1, help="every which seed; two processes with --step 2 share the work")
    ask.add_argument("--count", type=int, default=1)
    ask.add_argument("--out", type=Path, default=Path(".cache/rooms"))
    ask.add_argument("--assets", type=Path, default=Path(".cache/assets"))
    ask.add_argument("--threads", type=int, default=2)
    args = ask.parse_args()
    import drjit as dr
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb")
    dr.set_thread_count(args.threads)
    first, split, quality = SPLITS[args.split]
    library = Library.load(args.assets).only(split)
    for number in range(args.first, args.first + args.count, args.step):
        folder = args.out / args.split / f"{number:06d}"
        if (folder / "room.json").exists() or (folder / "skipped").exists():
            continue
        began = time.time()
        unfinished = folder.with_name(f".{number:06d}")
        shutil.rmtree(unfinished, ignore_errors=True)
        shutil.rmtree(folder, ignore_errors=True)
        unfinished.mkdir(parents=True)
        done = make(first + number, library, unfinished, quality)
        if done is None:
            (unfinished / "skipped").write_text("no camera sees anything\n")
        os.replace(unfinished, folder)
        dr.flush_malloc_cache()
        print(f"{folder} {'skipped' if done is None else 'made'} in {time.time() - began:.1f} s", flush=True)


if __name__ == "__main__":
    main()
