"""Makes views of third-party rooms: rooms/people.py --scene NAME|all --count 48 [--first 0] [--out .cache/rooms/people] [--assets .cache/assets]
[--threads 1].

One folder a view, OUT/SCENE/NUMBER, as rooms/make.py makes them; one that is complete is left alone. The scenes are those of ../shared/data/rooms
(CC BY 3.0); the same scene, seed, versions and number of threads give the same view."""

import argparse
import functools
import math
import sys
import time
import zlib
from dataclasses import dataclass, replace
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent / "demo"))
import layout  # noqa: E402
import people_lights as lights  # noqa: E402
import people_scenes  # noqa: E402
import scene as scenes  # noqa: E402  (sets Mitsuba's variant)
import textures  # noqa: E402
import truth  # noqa: E402
from assets import Library  # noqa: E402
from color import hsv  # noqa: E402
from make import MOST, SPLITS, alone, burning, finish, materials_of, record  # noqa: E402

SCENES = tuple(people_scenes.SCENES)
TRIES = 60  # cameras that are looked through in a room
DARK = 0.06  # least median of a photo over its 98th percentile


@functools.cache
def loaded(name):
    """The model of a scene, kept between its rooms, and `cast` in it."""
    model = people_scenes.read(name)
    body = mi.load_dict({"type": "diffuse"})
    whole = mi.load_dict({"type": "scene", "all": scenes.mesh("all", model.points, model.faces, body)}, optimize=False)
    return model, functools.partial(cast, whole)


def cast(scene, origins, directions):
    """Distances [n] along rays [n, 3] to what is met first; infinite where nothing is."""
    o = np.asarray(origins, np.float32).reshape(-1, 3)
    d = np.broadcast_to(np.asarray(directions, np.float32), o.shape)
    vector = lambda v, kind: kind(*(mi.Float(np.ascontiguousarray(v[:, k])) for k in range(3)))
    return np.array(scene.ray_intersect_preliminary(mi.Ray3f(vector(o, mi.Point3f), vector(d, mi.Vector3f))).t)


# Paint.


@dataclass
class Surface:
    """Triangles of one key. `albedo` [m, 3] counts where `image` (linear [h, w, 3], by uv) is None."""

    points: np.ndarray
    normals: np.ndarray
    uv: np.ndarray
    faces: np.ndarray
    albedo: np.ndarray
    rough: np.ndarray
    metal: bool
    key: int
    image: np.ndarray = None


def planar(points, normals, faces, size):
    """Points, normals, uv and faces without shared vertices; uv by projection along the axis that a face faces, `size` meters a repeat."""
    points, normals = points[faces].reshape(-1, 3), normals[faces].reshape(-1, 3)
    faces = np.arange(len(points)).reshape(-1, 3)
    axis = np.repeat(np.abs(people_scenes.face_normals(points, faces)).argmax(1), 3)
    u = np.where(axis == 0, points[:, 2], points[:, 0])
    v = np.where(axis == 1, points[:, 2], points[:, 1])
    return points, normals, np.stack([u / size[0], v / size[1]], 1), faces


def color_of_things(rng):
    """Albedo of furniture and cloth: many are dark, warm or gray, some are strong colors."""
    kind = rng.choice(["warm", "grey", "strong", "light"], p=[0.4, 0.2, 0.2, 0.2])
    if kind == "warm":
        return hsv(rng.uniform(0.03, 0.13), rng.uniform(0.2, 0.75), rng.uniform(0.05, 0.55))
    if kind == "grey":
        return hsv(rng.random(), rng.uniform(0, 0.12), rng.uniform(0.04, 0.6))
    if kind == "strong":
        return hsv(rng.random(), rng.uniform(0.4, 0.85), rng.uniform(0.1, 0.6))
    return hsv(rng.uniform(0.03, 0.18), rng.uniform(0, 0.25), rng.uniform(0.5, 0.85))


def floor_image(rng, library):
    """(linear image, meters a repeat) of a floor: boards, a texture of the library, or cloth."""
    kind = rng.random()
    if kind < 0.45:
        light = hsv(rng.uniform(0.04, 0.1), rng.uniform(0.3, 0.75), rng.uniform(0.12, 0.55))
        return textures.planks(rng, 300, 400, 20, light * rng.uniform(0.35, 0.6), light), (4.0, 2.6)
    return wall_image(rng, library, "floor") if kind < 0.85 else (textures.weave(rng, 64, 64, color_of_things(rng)), (1.0, 1.0))


def wall_image(rng, library, place="wall"):
    choice = [t for t in library.textures if t.place == place]
    texture = choice[rng.integers(len(choice))]
    return texture.albedo() * rng.uniform(0.6, 1.05), texture.size


def varied(finish, rng):
    """A finish with new paint in 60 % of the cases; textures are kept half of the time, tinted. Mirrors and dark screens stay, other metals mostly."""
    image, mean = finish.textured, finish.albedo.reshape(-1, 3).mean()
    if finish.metal and (mean > 0.85 or rng.random() < 0.7):
        return replace(finish, rough=0.15 if mean > 0.85 else rng.uniform(0.15, 0.5))
    if mean < 0.035 and rng.random() < 0.7:
        return finish
    if image and rng.random() < 0.5:
        finish = replace(finish, albedo=finish.albedo * hsv(rng.random(), rng.uniform(0, 0.35), rng.uniform(0.6, 1.1)))
    elif image or finish.metal or rng.random() < 0.6:
        finish = replace(finish, albedo=color_of_things(rng), metal=False)
    else:
        finish = replace(finish, albedo=finish.albedo * rng.uniform(0.7, 1.0) + rng.uniform(0, 0.02))
    if finish.rough >= scenes.GLOSSY:
        return replace(finish, rough=rng.uniform(0.2, 0.6)) if rng.random() < 0.3 else finish
    return replace(finish, rough=1.0 if rng.random() < 0.2 else float(np.clip(finish.rough * rng.uniform(0.7, 1.6), 0.2, 0.8)))


def painted(model, rng, library, skip):
    """Surfaces of a scene with the paint of a seed."""
    spec, own, out = model.layout, {}, []
    wall = layout.wall_color(rng)
    paper = wall_image(rng, library) if rng.random() < 0.2 else None
    ceiling = hsv(rng.random(), rng.uniform(0, 0.05), rng.uniform(0.7, 0.88))
    floor = floor_image(rng, library) if rng.random() < 0.7 else None
    floor_rough = rng.choice([0.3, 0.45, 0.6, 1.0])
    accents = {axis: layout.wall_color(rng) if rng.random() < 0.25 else wall for axis in range(6)}
    for number, name in enumerate(model.finish_of):
        here = model.part == number
        used, faces = np.unique(model.faces[here], return_inverse=True)
        points, normals, uv, faces = model.points[used], model.normals[used], model.uv[used], faces.reshape(-1, 3)
        axis = np.abs(people_scenes.face_normals(points, faces)).mean(0).argmax()
        finish, image = model.finishes[name], None
        if name in skip:
            continue
        if name in spec.shell or name == "closing":
            up = axis == 1
            low = up and points[:, 1].mean() < 1.0
            albedo = ceiling if up and not low else accents[2 * axis + (normals[:, axis].mean() > 0)]
            finish = people_scenes.Finish(np.asarray(albedo))
            if paper and not up and name in spec.shell:
                image, size = paper
                points, normals, uv, faces = planar(points, normals, faces, size)
        elif name in spec.floors:
            finish = replace(finish, rough=floor_rough)
            if floor:
                image, size = floor
                points, normals, uv, faces = planar(points, normals, faces, size)
            elif finish.textured:
                finish = replace(finish, albedo=finish.albedo * hsv(rng.uniform(0.03, 0.15), rng.uniform(0, 0.4), rng.uniform(0.5, 1.1)))
            else:
                finish = replace(finish, albedo=color_of_things(rng))
        else:
            if name not in own or rng.random() < 0.15:
                own[name] = varied(finish, rng)
            finish = own[name]
        if finish.textured and image is None:
            image = finish.albedo
        albedo = np.full(3, 0.5) if image is not None else finish.albedo
        image = None if image is None else np.clip(image, 0.01, 0.92).astype(np.float32)
        m = len(faces)
        albedo = np.broadcast_to(np.clip(albedo, 0.01, 0.92), (m, 3))
        out.append(Surface(points, normals, uv, faces, albedo, np.full(m, finish.rough), finish.metal, number, image))
    return out


def added(parts, first):
    """Surfaces of what layout.py's functions put into a room, matte and glossy faces apart, keys from `first`."""
    for number, (points, normals, faces, albedo, rough) in enumerate(parts):
        for glossy in (False, True):
            keep = (rough < scenes.GLOSSY) == glossy
            if keep.any():
                used, index = np.unique(faces[keep], return_inverse=True)
                color = np.clip(albedo[keep], 0.01, 0.92)
                yield Surface(points[used], normals[used], np.zeros((len(used), 2)), index.reshape(-1, 3), color, rough[keep], False, first + number)


def one_of_each(surfaces):
    """A tiny triangle below the floor for each kind of BSDF: kernels depend on which kinds there are, and are compiled once for all rooms so."""
    low = min(s.points.min() for s in surfaces) - 1
    points, faces = low + 1e-3 * np.eye(3), np.array([[0, 1, 2]])
    image = np.full((2, 2, 3), 0.5, np.float32)
    kinds = ((1.0, False, None), (0.5, False, None), (0.5, True, None), (1.0, False, image), (0.5, False, image))
    normals, uv, albedo = np.tile([0.0, 1, 0], (3, 1)), np.zeros((3, 2)), np.full((1, 3), 0.5)
    return [Surface(points, normals, uv, faces, albedo, np.array([rough]), metal, 0, image) for rough, metal, image in kinds]


class Lit(scenes.Lit):
    """A third-party room in Mitsuba, with the interface of scene.Lit. Albedo is the base color of the principled BSDF (reflectance at normal incidence of
    metals), the diffuse reflectance of matte surfaces; roughness is GGX, alpha = r^2."""

    def __init__(self, surfaces, lamps, windows):
        self.surfaces, self.lamps, self.windows = surfaces, lamps, windows
        self.body, self.glass = scenes.light_bodies()
        groups = {}
        for s in surfaces + one_of_each(surfaces):
            form = "metal" if s.metal else "gloss" if s.rough[0] < scenes.GLOSSY else "matte"
            groups.setdefault((form, id(s.image) if s.image is not None else None), []).append(s)
        self.static = {}
        for number, ((form, _), some) in enumerate(sorted(groups.items(), key=lambda g: (g[0][0], g[1][0].key))):
            self.static[f"{form}{number}"] = self.group(f"{form}{number}", form, some)

    def group(self, name, form, some):
        """Mesh of surfaces with one BSDF."""
        color, rough = {"type": "mesh_attribute", "name": "face_albedo"}, {"type": "mesh_attribute", "name": "face_rough"}
        if some[0].image is not None:
            bitmap = mi.Bitmap(np.ascontiguousarray(some[0].image, np.float32))
            color = {"type": "bitmap", "bitmap": bitmap, "raw": True}
        if form == "matte":
            bsdf = {"type": "diffuse", "reflectance": color}
        else:
            bsdf = {"type": "principled", "base_color": color, "roughness": rough} | ({"metallic": 1.0} if form == "metal" else {"specular": 0.5})
        starts = np.cumsum([0] + [len(s.points) for s in some[:-1]])
        join = lambda field: np.concatenate([getattr(s, field) for s in some])
        faces = np.concatenate([s.faces + start for s, start in zip(some, starts)])
        bsdf = mi.load_dict({"type": "twosided", "bsdf": bsdf})
        uv = join("uv") if some[0].image is not None else None
        mesh = scenes.mesh(name, join("points"), faces, bsdf, join("normals"), join("albedo"), join("rough"), uv=uv)
        mesh.add_attribute("face_key", 1, np.repeat([s.key for s in some], [len(s.faces) for s in some]).astype(np.float32))
        return mesh

    def lookup(self, scene, si, values, other):
        """`values` of the meshes of `static`, by name, where rays hit them; a table by shape, so that kernels do not depend on their number."""
        number = lambda shape: dr.reinterpret_array(mi.UInt32, shape)
        places = {s.id(): int(number(mi.ShapePtr(s))[0]) for s in scene.shapes()}
        table = np.full(max(places.values(), default=0) + 1, other, np.float32)
        for name, value in values.items():
            table[places[name]] = value
        return dr.gather(mi.Float, mi.Float(table), number(si.shape), si.is_valid())

    def materials(self, scene, si):
        """Albedo and GGX roughness where rays hit; 0.5 and 1 on lights and on shapes that came in by `extra`."""
        own = self.lookup(scene, si, dict.fromkeys(self.static, 1.0), 0.0) > 0.5
        albedo = dr.select(own, si.bsdf().eval_diffuse_reflectance(si, own), 0.5)
        return albedo, dr.select(own, si.shape.eval_attribute_1("face_rough", si, own), 1.0)

    def key(self, scene, si):
        """As scene.Lit has it: the number of the part of the scene, or of what was put into it."""
        own = self.lookup(scene, si, dict.fromkeys(self.static, 1.0), 0.0) > 0.5
        return mi.Int32(dr.select(own, dr.round(si.shape.eval_attribute_1("face_key", si, own)), -1))

    def repainted(self, key, color):
        """Returns a `Lit` in which the surface `key` has the constant albedo `color` [3] in place of its texture."""
        plain = lambda s: replace(s, image=None, metal=False, albedo=np.broadcast_to(np.asarray(color, float), s.albedo.shape))
        return Lit([plain(s) if s.key == key else s for s in self.surfaces], self.lamps, self.windows)


def room(name, seed, library):
    """(Lit, Space, random numbers that go on) of a seed."""
    model, ray = loaded(name)
    rng = np.random.default_rng([seed, zlib.crc32(name.encode())])
    night = rng.random() < 0.35
    planned = lights.plan(model, rng, night)
    space = lights.Space(model, ray, night, planned[3])
    lights.equip(space, model, rng, library, planned)
    surfaces = painted(model, rng, library, planned[3]) + list(added(space.parts, len(model.finish_of)))
    lamps = {f"lamp{k}": lamp for k, lamp in enumerate(space.lamps)}
    windows = {f"window{k}": w for k, w in enumerate(space.windows)}
    return Lit(surfaces, lamps, windows), space, rng


# Cameras.


def sphere(count=40):
    """Even directions [count, 3]."""
    k = np.arange(count) + 0.5
    y, turn = 1 - 2 * k / count, k * math.pi * (3 - math.sqrt(5))
    return np.stack([np.sqrt(1 - y * y) * np.cos(turn), y, np.sqrt(1 - y * y) * np.sin(turn)], 1)


def cameras(scene, spec, rng, targets):
    """(position, yaw, pitch, fov_x) at eye height with 0.35 m of air around: towards one of the points `targets` in half of the cases where there are
    any, else mostly along the longer way or towards a corner."""
    around = np.linspace(0, 2 * math.pi, 48, endpoint=False)
    level = np.stack([np.sin(around), 0 * around, -np.cos(around)], 1)
    sides = np.concatenate([sphere(), level])
    for _ in range(6 * TRIES):
        x0, z0, x1, z1 = spec.stands[rng.integers(len(spec.stands))]
        y = rng.uniform(1.2, 1.6) if rng.random() < 0.8 else rng.uniform(0.9, 1.7)
        at = np.array([rng.uniform(x0, x1), y, rng.uniform(z0, z1)])
        far = cast(scene, np.broadcast_to(at, sides.shape), sides)
        if not np.isfinite(far).all() or far.min() < 0.35:
            continue
        far = far[len(sides) - len(around) :]
        # A direction counts by how far one sees in the 50 degrees around it.
        open_ = np.convolve(np.concatenate([far[-3:], far, far[:3]]), np.ones(7) / 7, "valid")
        yaw = rng.choice(around, p=open_**2 / (open_**2).sum()) + rng.normal(0, 0.12)
        if targets and rng.random() < 0.5:
            to = targets[rng.integers(len(targets))] - at
            yaw = math.atan2(to[0], -to[2]) + rng.normal(0, 0.3)
        yield at, yaw, math.radians(rng.uniform(-12, 3)), rng.uniform(50, 75)


def varied_view(lit, scene, spec, model, view):
    """Whether a view has several surfaces and edges, no plane or surface fills it, and 15 % or more of it is neither wall nor floor nor ceiling."""
    width, count = 64, 64 * 48
    index = dr.arange(mi.UInt32, count)
    ray, _ = view.rays(mi.Float(index % width) + 0.5, mi.Float(index // width) + 0.5, width)
    si = scene.ray_intersect(ray)
    keys, n, p = np.array(lit.key(scene, si)), np.array(si.n).T, np.array(si.p).T
    _, counts = np.unique(keys[keys >= 0], return_counts=True)
    plane = np.column_stack([np.round(n * 4), np.round((n * p).sum(1) * 5)])
    _, flat = np.unique(plane, axis=0, return_counts=True)
    bare = [k for k, name in enumerate(model.finish_of) if name in (*spec.shell, *spec.floors, "closing")]
    things = (keys >= 0) & ~np.isin(keys, bare)
    keys, n = keys.reshape(48, 64), n.reshape(48, 64, 3)
    edge = lambda a, b: (keys[a] != keys[b]) | (np.abs(n[a] - n[b]).max(-1) > 0.4)
    edges = edge(np.s_[1:, 1:], np.s_[:-1, 1:]) | edge(np.s_[1:, 1:], np.s_[1:, :-1])
    return edges.mean() > 0.09 and (counts > 0.003 * count).sum() >= 7 and counts.max() < 0.45 * count and flat.max() < 0.42 * count and things.mean() > 0.15


def middle(light):
    """A point in a lamp or a pane."""
    if isinstance(light, layout.Lamp) and light.kind == "Mesh":
        return light.place["triangles"].mean((0, 1))
    return np.asarray(light.place["center"] if isinstance(light, layout.Lamp) else light.center, float)


def look(lit, scene, model, rng):
    """As make.look: (view, planes, names of lights seen, names of lights not seen), or None."""
    spec, wants_light, found = model.layout, rng.random() < 0.77, None
    size = min(spec.walls[2] - spec.walls[0], spec.walls[3] - spec.walls[1])
    targets = [middle(light) for light in (*lit.lamps.values(), *lit.windows.values())] if wants_light else []
    for number, camera in enumerate(cameras(scene, spec, rng, targets)):
        if number == TRIES:
            break
        view = truth.View(*camera)
        depth = truth.depths(scene, view, 40)
        wanted = (0.7, min(1.1, 0.4 * size), min(1.8, 0.55 * size), min(2.4, 0.8 * size))
        if not np.isfinite(depth).all() or (np.percentile(depth, (10, 25, 50, 95)) < wanted).any():
            continue
        if not varied_view(lit, scene, spec, model, view):
            continue
        planes = truth.surfaces(lit, scene, view)
        seen, kept = burning(planes, rng)
        # A light that fills the picture leaves no room to see.
        if len(seen) > MOST or (planes["touch"] > 0).mean() > 0.35 or not seen + kept:
            continue
        found = found or (view, planes, seen, kept)
        if seen or not wants_light:
            return view, planes, seen, kept
    return found


def balance(lit, view, seen, hidden, night, rng):
    """Scales the lights of a view so that the strongest gives 40 to 80 % of its light, as in photographs; 30 % of the views stay as they are where no
    light gives more than 90 %. Drops unseen lights that give nothing. Returns (seen, hidden), or None where most of the view stays dark."""
    pictures = alone(lit, view, seen + hidden, 64, 4)
    given = {name: float(picture.mean()) for name, picture in pictures.items()}
    most = max(given.values())
    hidden = [n for n in hidden if given[n] > 1e-3 * most]
    names = [n for n in seen + hidden if given[n] > 0]
    if not names:
        return None
    movable = [n for n in names if not (night and n.startswith("window"))]
    if len(movable) > 1 and not (rng.random() < 0.3 and most < 0.9 * sum(given.values())):
        first = [str(n) for n in rng.permutation(movable)]
        strongest = rng.uniform(0.4, 0.8) if len(movable) > 2 else rng.uniform(0.5, 0.8)
        rest = rng.dirichlet(np.full(len(first) - 1, 2.0)) * (1 - strongest)
        for name, share in zip(first, (strongest, *np.minimum(rest, strongest))):
            layout.scale(lit, name, share / given[name] * most)
            pictures[name] = pictures[name] * (share / given[name] * most)
    together = sum(pictures[n] for n in seen + hidden)
    together = together[together > 0]
    if len(together) < 1500 or np.median(together) < DARK * np.percentile(together, 98):
        return None
    return seen, hidden


def make(name, seed, library, folder, quality):
    """Renders a view of a scene into `folder`; None when no camera sees anything, or only darkness. `quality`: see make.SPLITS."""
    found = find(name, seed, library)
    return found and record(*found[:3], folder, quality, found[3])


def find(name, seed, library):
    """A scene under the paint and the lights of a seed, and a view of it, as make.find gives them; None when no camera sees anything, or only darkness."""
    lit, space, rng = room(name, seed, library)
    scene = lit.scene({})
    for _ in range(3):
        found = look(lit, scene, loaded(name)[0], rng)
        if found is None:
            return None
        view, planes, seen, hidden = found
        balanced = balance(lit, view, seen, hidden, space.night, rng)
        if balanced is not None:
            break
    else:
        return None
    seen, hidden = balanced
    about = dict(seed=seed, scene=name, kind=name, night=bool(space.night), corners=4)
    return lit, (view, planes, seen, hidden), rng, about


def main():
    ask = argparse.ArgumentParser(description=__doc__)
    ask.add_argument("--scene", choices=(*SCENES, "all"), default="all")
    ask.add_argument("--first", type=int, default=0)
    ask.add_argument("--count", type=int, default=1)
    ask.add_argument("--out", type=Path, default=Path(".cache/rooms/people"))
    ask.add_argument("--assets", type=Path, default=Path(".cache/assets"))
    ask.add_argument("--quality", choices=SPLITS, default="train")
    ask.add_argument("--threads", type=int, default=1)
    ask.add_argument("--materials", action="store_true", help="the photo, geometry and materials alone, which are all that MNet needs")
    args = ask.parse_args()
    dr.set_thread_count(args.threads)
    _, split, quality = SPLITS[args.quality]
    quality = materials_of(quality) if args.materials else quality
    library = Library.load(args.assets).only(split)
    for number in range(args.first, args.first + args.count):
        for name in SCENES if args.scene == "all" else (args.scene,):
            folder = args.out / name / f"{number:06d}"
            if folder.exists():
                continue
            began = time.time()
            done = finish(folder, lambda to: make(name, number, library, to, quality))
            dr.flush_malloc_cache()
            print(f"{folder} {'made' if done else 'skipped'} in {time.time() - began:.1f} s", flush=True)


if __name__ == "__main__":
    main()
