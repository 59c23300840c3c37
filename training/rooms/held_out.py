"""The held-out views, the blind test of the program: ten generated rooms and ten views of third-party rooms, which no tuning and no training may see.

    held_out.py make [--out .cache/rooms/held_out] [--samples 64] [--threads 2]
    held_out.py score [--out ..] [--relight target/release/relight] [--graphs physics indoor networks] [--views NAME..]

`make` renders the views from fixed seeds and goes on where it stopped: pictures by each light alone, and the edits `insert_lamp`, `insert_object` and
`paint`. The photo is their sum through the camera of training/camera, the depth that of a sensor; the truth is linear, with the lens's glare. `score`
runs `relight eval` on each view with each graph and prints the mean change error of each kind of edit (1 = doing nothing, 0 = perfect) and, in brackets,
the number of edits; one that hardly shows is not counted."""

import argparse
import json
import math
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE.parent), str(HERE.parent / "demo")]
import folder as scene_folder  # noqa: E402
from measure import KINDS, kind_of, points_of  # noqa: E402
from pack import ROOT, evaluate  # noqa: E402

FIRST = 30_000_000  # first seed; no other split reaches it
VIEWS = 10  # of each kind
LAMP_RADIUS, BALL_RADIUS = 0.08, 0.15  # m
LAMP_TEMPERATURE = 2700  # K
LAMP_SHADING = 0.5  # shading by the inserted lamp at 1 m, in units of the photo's white
BALL_ALBEDO = 0.75
PAINTED_SHARE = (0.05, 0.45)  # of the picture
UNSEEN = 40  # dB: an edit that changes the photo by less is not scored
GRAPHS = ("physics", "indoor", "networks")


def names():
    """{folder: (scene, seed)}; the scene of generated rooms is None."""
    import people

    out = {f"generated_{k:02d}": (None, FIRST + k) for k in range(VIEWS)}
    return out | {f"{scene}_{k}": (scene, FIRST + k) for scene in people.SCENES for k in range(VIEWS // len(people.SCENES))}


def seen(scene, seed, library):
    """A room and the view of it; the seeds after it step in where a room has no view."""
    import make
    import people

    for again in range(20):
        found = make.find(seed + 100 * again, library) if scene is None else people.find(scene, seed + 100 * again, library)
        if found is not None:
            return found
    raise RuntimeError(f"{scene} {seed}: no camera sees anything")


def places(scene, view, planes, rng, radius, lift):
    """Returns the world-space center of a ball `lift` meters above a visible horizontal surface, free of other geometry; None if no surface has room for it."""
    import drjit as dr
    import mitsuba as mi

    up = planes["normal"] @ view.turn[:, 1] > 0.95
    good = up & (planes["touch"] == 0) & (planes["depth"] > 1.2) & (planes["depth"] < 5)
    good[:16] = good[-8:] = good[:, :24] = good[:, -24:] = False
    rows, columns = np.nonzero(good)
    points = points_of(planes["depth"], view.fov_x)
    for pick in rng.permutation(len(rows))[:60]:
        y, x = rows[pick], columns[pick]
        center = view.turn.T @ points[y, x] + view.origin + (0, radius + lift, 0)
        sphere = np.random.default_rng(0).normal(size=(400, 3))
        sphere /= np.linalg.norm(sphere, axis=1, keepdims=True)
        ray = mi.Ray3f(mi.Point3f(*center.tolist()), mi.Vector3f(*sphere.T.astype(np.float32)))
        near = np.array(scene.ray_intersect_preliminary(ray).t)
        toward = view.origin - center
        sight = mi.Ray3f(mi.Point3f(*center.tolist()), mi.Vector3f(*(toward / np.linalg.norm(toward)).tolist()), float(np.linalg.norm(toward)), 0.0, [])
        if near.min() > 0.97 * radius and not dr.any(scene.ray_test(sight)):
            return center
    return None


def wall(lit, scene, view, planes):
    """(key, mask [h, w]) of a surface to paint: the one nearest to a fifth of the picture; upright and plain ones before others."""
    import truth

    samples = 9
    si, _ = truth.hits(scene, view, truth.WIDTH, samples, 11)
    key = np.array(lit.key(scene, si)).reshape(truth.HEIGHT, truth.WIDTH, samples)
    upright = np.abs(planes["normal"] @ view.turn[:, 1]) < 0.3
    albedo, best = planes["albedo"].mean(-1), (math.inf,)
    for number in np.unique(key[key >= 0]):
        mask = (key == number).mean(-1) > 0.5
        if PAINTED_SHARE[0] <= mask.mean() <= PAINTED_SHARE[1]:
            patterned = albedo[mask].std() > 0.1 * albedo[mask].mean()
            cost = abs(mask.mean() - 0.2) + (upright[mask].mean() < 0.8) + patterned
            best = min(best, (cost, int(number), mask), key=lambda b: b[0])
    return best[1:] or None


def render(found, to, rng, samples):
    """Writes the scene of a view and its truth into the folder `to`."""
    import layout
    import make
    import truth
    from camera import depth as sensors
    from camera import model
    from color import hsv

    lit, (view, planes, visible, hidden), _, about = found
    lights = make.names_of(visible, hidden)
    rendered = lambda scene: truth.photo(scene, view, planes["albedo"], planes["normal"], max(1, samples // 16))
    pictures = {}
    for name, title in lights.items():
        pictures[title] = pictures.get(title, 0) + rendered(lit.scene({name: None}))
    whole, dark = sum(pictures.values()), planes["touch"] == 0
    camera = model.sample(rng)
    balance = make.white_balance(whole[dark], rng) * camera.white_balance
    camera = replace(camera, white_balance=tuple(balance.tolist()))
    camera = replace(camera, exposure=model.auto_exposure(model.incident(whole, camera), dark))
    lens = lambda picture: model.incident(picture, camera)
    gain = camera.exposure * np.array(camera.white_balance)

    everything, edits = dict.fromkeys(lights), {}
    bare = lit.scene({})
    triple = lambda v: ", ".join(f"{float(x):.6g}" for x in v)
    center = places(bare, view, planes, rng, LAMP_RADIUS, 0.25)
    if center is not None:
        radiance = LAMP_SHADING / LAMP_RADIUS**2 * layout.blackbody(LAMP_TEMPERATURE)
        emitter = {"type": "area", "radiance": {"type": "rgb", "value": (radiance / gain).tolist()}}
        lamp = {"type": "sphere", "center": center.tolist(), "radius": LAMP_RADIUS, "emitter": emitter}
        shape = f'Lamp(shape: Sphere(radius: {LAMP_RADIUS}), at: Point({triple(view.point(center))}), radiance: ({triple(radiance)}))'
        edits["insert_lamp"] = f'lights: {{ "new": {shape} }}', rendered(lit.scene(everything, extra={"new": lamp}))
    center = places(bare, view, planes, rng, BALL_RADIUS, 0.0)
    if center is not None:
        white = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [BALL_ALBEDO] * 3}}
        ball = {"type": "sphere", "center": center.tolist(), "radius": BALL_RADIUS, "bsdf": white}
        at = f"at: Point({triple(view.point(center))}), material: (albedo: Linear({triple([BALL_ALBEDO] * 3)}))"
        edits["insert_object"] = f"objects: [ Sphere(radius: {BALL_RADIUS}, {at}) ]", rendered(lit.scene(everything, extra={"ball": ball}))
    chosen = wall(lit, bare, view, planes)
    if chosen:
        key, mask = chosen
        color = hsv(rng.random(), rng.uniform(0.3, 0.7), rng.uniform(0.3, 0.7))
        edits["paint"] = (
            f'materials: [ Paint(region: Mask("../paint.png"), albedo: Linear({triple(color)})) ]',
            rendered(lit.repainted(key, color).scene(everything)),
        )
        scene_folder.save_mask(to / "paint.png", mask)

    titles = {title: make.describe(lit, view, name, gain) for name, title in lights.items()}
    masks = {}
    for k, name in enumerate(planes["names"]):
        if lights.get(name, "inv_").startswith("inv_"):
            continue
        masks[lights[name]] = planes["touch"] == k + 1
    photo = model.photograph(whole, camera, rng)
    sensor = sensors.DepthSensor()
    noise = sensors.sensor_noise(rng, *planes["depth"].shape, sensor)
    points = points_of(planes["depth"], view.fov_x)
    cosine = np.abs((planes["normal"] * points).sum(-1)) / np.linalg.norm(points, axis=-1)
    scene_folder.write(
        to,
        view.fov_x,
        photo.stored,
        sensors.sensor_depth(planes["depth"], sensor, noise, planes["albedo"].mean(-1), planes["rough"], cosine),
        planes["albedo"],
        masks,
        titles,
        normal=planes["normal"],
        pictures={title: lens(picture) for title, picture in pictures.items()},
        edits={name: (f"Edit(version: 1, {text})\n", lens(picture)) for name, (text, picture) in edits.items()},
        true_depth=planes["depth"],
    )
    (to / "room.json").write_text(json.dumps(about | dict(held_out=True, samples=samples), indent=1))
    return to


def make_all(args):
    import drjit as dr
    import make
    from assets import Library

    dr.set_thread_count(args.threads)
    library = Library.load(args.assets).only("held")
    for name, (scene, seed) in names().items():
        to = args.out / name
        if to.exists():
            continue
        make.complete(to, lambda folder: render(seen(scene, seed, library), folder, np.random.default_rng(seed), args.samples))
        print(to, flush=True)


def score_all(args):
    views = [args.out / v for v in args.views] if args.views else sorted(p.parent for p in args.out.glob("*/scene.ron"))
    rows = {}
    for graph in args.graphs:
        for view in views:
            figures = evaluate(args.relight, f"{graph}.ron", view, args.out / ".eval" / graph / view.name)
            side = "generated" if view.name.startswith("generated") else "third-party"
            seen = {f["subject"]: f["value"] for f in figures if f["measure"] == "unchanged"}
            for figure in figures:
                subject = figure["subject"]
                if figure["measure"] == "change error" and seen[subject] < UNSEEN:
                    rows.setdefault((graph, side), {}).setdefault(KINDS.get(kind_of(subject), subject), []).append(figure["value"])
            print(f"{graph} {view.name}", file=sys.stderr, flush=True)
    kinds = [*KINDS.values(), "insert_lamp", "insert_object", "paint"]
    print("| graph | views | " + " | ".join(kinds) + " | mean of kinds |")
    print("| --- " * (len(kinds) + 3) + "|")
    for (graph, side), got in rows.items():
        means = [np.mean(got[k]) if k in got else np.nan for k in kinds]
        cells = [f"{m:.3f} ({len(got.get(k, []))})" for k, m in zip(kinds, means)]
        print(f"| {graph} | {side} | " + " | ".join(cells) + f" | {np.nanmean(means):.3f} |")


def main():
    ask = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    ask.add_argument("what", choices=("make", "score"))
    ask.add_argument("--out", type=Path, default=Path(".cache/rooms/held_out"))
    ask.add_argument("--assets", type=Path, default=Path(".cache/assets"))
    ask.add_argument("--samples", type=int, default=64)
    ask.add_argument("--threads", type=int, default=2)
    ask.add_argument("--relight", type=Path, default=ROOT / "target/release/relight")
    ask.add_argument("--graphs", nargs="+", default=GRAPHS)
    ask.add_argument("--views", nargs="+")
    args = ask.parse_args()
    (make_all if args.what == "make" else score_all)(args)


if __name__ == "__main__":
    main()
