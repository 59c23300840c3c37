"""Makes rooms: rooms/make.py --split train --count 400 [--maps] [--materials] [--first 0] [--step 1] [--out .cache/rooms] [--assets .cache/assets] [--threads 2].

One folder a room, OUT/SPLIT/SEED; one that is complete is left alone, so that a stopped run goes on where it stopped. Same seed, versions and
number of threads give the same room. Each finished room gets a line in OUT/manifest.jsonl (manifest.py). `val` and `test` use furniture that `train` never sees. training/README.md lists the content of a folder."""

import argparse
import json
import math
import os
import shutil
import sys
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent / "demo"))
import folder as scene_folder  # noqa: E402
import layout  # noqa: E402
import manifest  # noqa: E402
from assets import Library  # noqa: E402


class Quality(NamedTuple):
    """How precisely a room is rendered. Numbers of samples are square numbers."""

    photo: int  # passes of the photo
    indirect: int  # passes of each indirect picture
    direct: int  # passes of direct light; 0: neither direct nor indirect light is rendered
    texel: int  # samples of a texel of the maps of incoming radiance; 0: no maps
    clean: bool  # whether all but the photo is denoised, too; the photo always is
    photo_samples: int = 16  # of a pixel of the photo (240 x 320) in a pass
    indirect_samples: int = 16  # of a pixel of an indirect picture (120 x 160) in a pass
    direct_samples: int = 64  # of a pixel of direct light (120 x 160) in a pass
    surface_samples: int = 16  # of a pixel of albedo, normal, roughness and masks (240 x 320)


# First seed, furniture, quality. A training photo has as many samples at 240 x 320 as 16 a pixel of 120 x 160 are.
SPLITS = {
    "train": (0, "train", Quality(1, 1, 1, 9, True, 4, 9, 36, 9)),
    "val": (10_000_000, "held", Quality(4, 4, 2, 16, True)),
    "test": (20_000_000, "held", Quality(16, 64, 16, 64, False)),
}


def materials_of(quality):
    """Returns the quality without the samples that MNet does not need."""
    return quality._replace(direct=0, texel=0)


LEAST = 12  # pixels that a visible light has at least
MOST = 4  # lights that burn at most
WIDEST = 0.08  # share of the picture that lights fill at most
PATHS = 5  # most indirect pictures a room


def cameras(room, rng):
    """Places and directions to look from as people take photos: from a corner or beside a wall along the longer way, nearly level."""
    low, high = room.footprint.min(0), room.footprint.max(0)
    walls = list(room.walls())
    longest = np.linalg.norm(high - low)
    for _ in range(400):
        start, along, inward, length = walls[rng.integers(len(walls))]
        s = rng.choice([rng.uniform(0.3, 1.0), length - rng.uniform(0.3, 1.0), rng.uniform(0, length)])
        x, z = start + s * along + rng.uniform(0.25, 0.9) * inward
        at = np.array([x, np.clip(rng.normal(1.42, 0.12), 1.1, 1.75), z])
        if not room.inside(x, z, 0.22) or any((at > l - 0.25).all() and (at < h + 0.25).all() for l, h in room.taken):
            continue
        tx, tz = rng.uniform(low, high)
        if math.hypot(tx - x, tz - z) < rng.uniform(0.45, 0.8) * longest:
            continue
        yield at, math.atan2(tx - x, -(tz - z)), float(np.clip(rng.normal(-0.18, 0.08), -0.4, 0.02)), rng.uniform(54, 70)


def look(lit, scene, room, rng, samples=16):
    """A camera that sees something, mostly one that sees a light: (view, planes, names of lights seen, names of lights not seen), or None."""
    import truth

    wants_light, found = rng.random() < 0.75, None
    for number, spec in enumerate(cameras(room, rng)):
        if number == 40:
            break
        view = truth.View(*spec)
        depth = truth.depths(scene, view, 40)
        if np.percentile(depth, 10) < 1.0 or np.percentile(depth, 50) < 1.9 or np.percentile(depth, 95) < 2.6:
            continue
        if busy(depth) < BUSY:
            continue  # bare walls
        if (truth.surfaces(lit, scene, view, 1)["touch"] > 0).mean() > WIDEST:
            continue
        planes = truth.surfaces(lit, scene, view, samples)
        seen, kept = burning(planes, rng)
        if len(seen) > MOST:
            continue
        if seen or kept:
            found = found or (view, planes, seen, kept)
        if seen or (found and not wants_light):
            return view, planes, seen, kept
    return found


def burning(planes, rng):
    """The lights of a view that burn: those seen, and at most one lamp and one window out of view, MOST together where that leaves any out of view."""
    pixels = lambda plane: {name: int((planes[plane] == k + 1).sum()) for k, name in enumerate(planes["names"])}
    seen = [n for n, count in pixels("light").items() if count >= LEAST]
    # A light of a few pixels is neither visible nor invisible: it does not burn.
    hidden = [n for n, count in pixels("touch").items() if count == 0]
    lamps, windows = ([n for n in hidden if n.startswith(kind)] for kind in ("lamp", "window"))
    kept = [str(rng.choice(some)) for some in (lamps, windows) if some]
    return seen, kept[: max(MOST - len(seen), 0)]


BUSY = 0.07  # least share of pixels of a preview at which depth bends


def busy(depth):
    """Share of pixels at which inverse depth, linear on a plane, bends: edges of furniture."""
    inverse = 1 / np.maximum(depth, 1e-3)
    bend = np.abs(np.diff(inverse, 2, axis=0))[:, 1:-1] + np.abs(np.diff(inverse, 2, axis=1))[1:-1]
    return float((bend > 0.03 * inverse[1:-1, 1:-1]).mean())


def alone(lit, view, names, width, bounces):
    """{light: gray picture, flattened, by it alone with its indirect light}, `width` wide, 0 where a light is seen."""
    import drjit as dr

    import truth

    out = {}
    for name in names:
        scene = lit.scene({name: None})
        ray, _ = truth.places(view, width, 16, 9)
        si = scene.ray_intersect(ray)
        dark = ~truth.is_light(si, scene, lit) & si.is_valid()
        got = np.array(dr.select(dark, truth.radiance(scene, ray, 9, bounces), 0)).mean(0).reshape(-1, 16).mean(1)
        out[name] = np.minimum(got, np.percentile(got, 99))  # fireflies of 16 samples must not decide
    return out


def balance(lit, view, seen, hidden, night, rng):
    """Scales the lights of a view to shares of the photo's light as in rooms by people, and drops unseen ones that would give nothing: (seen, hidden).

    Photographs of rooms are taken when lamps and windows are comparably bright; with physical powers a window outshines all lamps by day."""
    import truth

    given = {name: float(picture.mean()) for name, picture in alone(lit, view, [*seen, *hidden], 40, truth.DEPTH).items()}
    most = max(given.values(), default=0)
    hidden = [n for n in hidden if given[n] > 1e-4 * most]
    names = [n for n in [*seen, *hidden] if given[n] > 1e-6 * most]
    if len(names) > 1:
        for name, share in zip(names, np.maximum(rng.dirichlet(np.full(len(names), 4.0)), 0.04)):
            if night and name.startswith("window"):
                share = min(share, 0.1)
            layout.scale(lit, name, share / given[name] * most)
    return seen, hidden


def names_of(seen, hidden):
    """{our name in the room: name of the light in lights.json}, visible lamps, visible windows, invisible ones."""
    out = {}
    for kind in ("lamp", "window"):
        out |= {name: f"{kind}_{k}" for k, name in enumerate(n for n in seen if n.startswith(kind))}
    return out | {n: "inv_lamp" if n.startswith("lamp") else "inv_window" for n in hidden}


def half(x):
    """Non-negative values as 16-bit floats."""
    return np.asarray(np.clip(x, 0, 60000), np.float16)


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
    """Renders the room of a seed into `folder`; None when no camera sees anything. `quality`: a Quality."""
    found = find(seed, library, Quality(*quality).surface_samples)
    return found and record(*found[:3], folder, quality, found[3])


def find(seed, library, samples=16):
    """The room of a seed, lit, and a view of it: (Lit, (view, planes, names of lights seen, of lights not seen), random numbers, what room.json tells);
    None when no camera sees anything."""
    import scene as scenes

    room, rng = layout.make(seed, library)
    lit = scenes.Lit(room)
    found = look(lit, lit.scene({}), room, rng, samples)
    if found is None:
        return None
    view, planes, seen, hidden = found
    burning = balance(lit, view, seen, hidden, room.night, rng)
    about = dict(seed=seed, scene="generated", kind=room.kind, night=bool(room.night), corners=len(room.footprint))
    return lit, (view, planes, *burning), rng, about


def white_balance(pixels, rng):
    """Gains of red, green and blue that take away a part of the color of the brightest tenth of `pixels` [n, 3], as cameras do."""
    cast = np.percentile(pixels, 90, axis=0)
    return (cast.mean() / np.maximum(cast, 1e-3 * cast.max())) ** rng.uniform(0.35, 0.95)


def record(lit, found, rng, folder, quality, about):
    """Renders what is true of a lit room from the view that `look` found into `folder`; None when it is dark there. `about` goes into room.json."""
    import truth

    quality = Quality(*quality)
    view, planes, seen, hidden = found
    names = names_of(seen, hidden)
    all_on = lit.scene(dict.fromkeys(names))
    picture = truth.photo(all_on, view, planes["albedo"], planes["normal"], quality.photo, quality.photo_samples)
    dark = planes["touch"] == 0
    if np.percentile(picture[dark].mean(-1), 98) <= 0:
        return None

    # White balance and exposure, as a camera would; all that is linear in the lights takes the same gain.
    balance = white_balance(picture[dark], rng)
    gain = balance * rng.uniform(0.6, 1.0) / np.percentile((picture * balance)[dark].max(-1), 98)

    lights = {title: describe(lit, view, name, gain) for name, title in names.items()}
    shading = shadings(lit, all_on, view, names, lights, gain, quality) if quality.direct else no_shading()
    lighting = {}
    if quality.texel:
        maps, valid = truth.maps(lit, all_on, view, names, quality.texel)
        lighting = dict(maps=half(maps * gain), maps_valid=valid.astype(np.uint8))

    titles = list(lights)
    mask = np.zeros(planes["light"].shape, np.uint8)
    for k, name in enumerate(planes["names"]):
        if name in names:
            mask[planes["light"] == k + 1] = titles.index(names[name]) + 1
    np.savez_compressed(
        folder / "truth.npz",
        photo=half(picture * gain),
        albedo=half(planes["albedo"]),
        normal=planes["normal"].astype(np.float16),
        rough=half(planes["rough"]),
        depth=planes["depth"].astype(np.float32),
        light_mask=mask,
        fov_x=np.float32(view.fov_x),
        **shading,
        **lighting,
    )
    if not quality.direct:
        os.link(folder / "truth.npz", folder / "sample.npz")  # the program has nothing to add
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


def shadings(lit, all_on, view, names, lights, gain, quality):
    """Returns the arrays of truth.npz with the light of each source."""
    import truth

    direct, normal = truth.shading(lit, all_on, view, names, quality.direct, quality.clean, quality.direct_samples)
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
        indirect.append(truth.indirect(lit, lit.scene(burn), view, normal, quality.indirect, quality.clean, quality.indirect_samples) * gain)
    return dict(
        sources=np.array([t for _, t in sources]),
        source_radiance=weights.astype(np.float32),
        direct=half([direct[s][0] for s, _ in sources]),
        shadow=half([direct[s][1] for s, _ in sources]),
        paths=np.array(list(parts)),
        path_weights=path_weights.astype(np.float32),
        indirect=half(indirect),
    )


def no_shading():
    """Returns the arrays of `shadings`, and those of the program, for no source at all."""
    import truth

    plane = np.zeros((0, truth.HEIGHT // 2, truth.WIDTH // 2), np.float16)
    color = np.zeros((*plane.shape, 3), np.float16)
    return dict.fromkeys(["direct", "shadow", "traced_direct", "traced", "unknown"], plane) | dict(
        sources=np.array([], str),
        source_radiance=np.zeros((0, 3), np.float32),
        paths=np.array([], str),
        path_weights=np.zeros((0, 0, 3), np.float32),
        indirect=color,
        traced_indirect=color,
    )


def complete(folder, render):
    """Makes a folder by `render(unfinished folder)` and puts it in place at once; returns what `render` returned, None where there is nothing to see."""
    unfinished = folder.with_name(f".{folder.name}")
    shutil.rmtree(unfinished, ignore_errors=True)
    unfinished.mkdir(parents=True)
    done = render(unfinished)
    if done is None:
        (unfinished / "skipped").write_text("no camera sees anything\n")
    os.replace(unfinished, folder)
    return done


def finish(folder, render):
    """Makes OUT/SPLIT/NAME as `complete` does and appends its line to OUT/manifest.jsonl; whether a room came out."""
    done = complete(folder, render)
    if done is not None:
        manifest.append(folder.parent.parent, folder)
    return done is not None


def main():
    ask = argparse.ArgumentParser(description=__doc__)
    ask.add_argument("--split", choices=SPLITS, default="train")
    ask.add_argument("--first", type=int, default=0)
    ask.add_argument("--step", type=int, default=1, help="every which seed; two processes with --step 2 share the work")
    ask.add_argument("--count", type=int, default=1)
    ask.add_argument("--out", type=Path, default=Path(".cache/rooms"))
    ask.add_argument("--assets", type=Path, default=Path(".cache/assets"))
    ask.add_argument("--threads", type=int, default=2)
    ask.add_argument("--quality", choices=SPLITS, help="render as this split does; by default, as its own")
    ask.add_argument("--maps", action="store_true", help="maps of incoming radiance, too, which LightNet alone needs")
    ask.add_argument("--materials", action="store_true", help="the photo, geometry and materials alone, which are all that MNet needs")
    args = ask.parse_args()
    import drjit as dr

    import variant  # noqa: F401  (sets the variant)

    dr.set_thread_count(args.threads)
    first, split, quality = SPLITS[args.split]
    quality = SPLITS[args.quality][2] if args.quality else quality
    quality = quality if args.maps else quality._replace(texel=0)
    quality = materials_of(quality) if args.materials else quality
    library = Library.load(args.assets).only(split)
    for number in range(args.first, args.first + args.count, args.step):
        folder = args.out / args.split / f"{number:06d}"
        if folder.exists():
            continue
        began = time.time()
        done = finish(folder, lambda to: make(first + number, library, to, quality))
        dr.flush_malloc_cache()
        print(f"{folder} {'made' if done else 'skipped'} in {time.time() - began:.1f} s", flush=True)


if __name__ == "__main__":
    main()
