"""Third-party rooms: reads the Mitsuba scenes of ../shared/data/rooms (CC BY 3.0) as triangles with materials, in meters, y up, floor at y = 0.

Original emitters are left out: people_lights.py puts lights where windows and lamps are. Panes of glass are left out, so that light passes; other glass
is taken for glazed porcelain, as light that glass refracts would reach no shadow ray."""

import os
import sys
import tarfile
import xml.etree.ElementTree as ET
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

import meshes
from color import linear

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "training/demo"))
ARCHIVES = Path(os.environ.get("RELIGHT_ROOMS", ROOT.parent / "shared/data/rooms"))
CACHE = ROOT / ".cache/people"
TEXTURE = 512  # most pixels of a texture's longer side
DENSE = 1500  # triangles above which an untextured shape is simplified, to a sixth, at least this many


@dataclass
class Layout:
    """Description of one scene, found by looking at renders. Meters after p -> scale * (p - (0, floor, 0)), but for `floor`."""

    scale: float  # meters per unit
    floor: float  # height of the floor, units
    low: tuple  # closing box: what lies outside is left out, so that the room is closed on all sides
    high: tuple
    walls: tuple  # (x0, z0, x1, z1) of the walls between which lamps and furniture stand
    ceiling: float
    stands: list  # (x0, z0, x1, z1) where photographers stand
    windows: list  # (center, half width, half height, (x, z) of the inward normal, whether it is covered when it gives no light)
    shell: tuple  # names of BSDFs of walls and ceilings; each direction they face is painted on its own
    floors: tuple  # names of BSDFs of floors
    lamps: list = ()  # (kind, place, names of BSDFs that the emitter takes the place of)
    panes: tuple = ()  # names of BSDFs of window glass, left out
    blinds: tuple = ()  # names of BSDFs of blinds, left out in half of the rooms


def tubes(x, z):
    """Fluorescent tubes of one fixture of the classroom."""
    return "Box", dict(center=np.array([x, 2.885, z]), half_axes=np.diag([0.1, 0.02, 0.715])), ()


def spot(x, y, z, half, toward):
    """Recessed spotlight as a small square that faces `toward`."""
    n = np.asarray(toward, float)
    u = np.array([0, 0, 1.0]) if abs(n[1]) > 0.5 else np.array([0, 1.0, 0])
    return "Rect", dict(center=np.array([x, y, z]), half_x=half * np.cross(u, n), half_y=half * u * 1.0), ()


def shade(x, z, y0, y1, radius, names):
    """Cylindrical lamp shade."""
    import shapes

    mesh = shapes.lathe([(radius, 0), (radius * 0.98, y1 - y0)], (x, y0, z), 16, closed=True)
    return "Mesh", dict(triangles=mesh[0][mesh[3]]), names


def globe(x, y, z, radius, names):
    return "Sphere", dict(center=np.array([x, y, z]), radius=radius), names


SCENES = {
    "classroom": Layout(
        1.0,
        0.0,
        (-4.6, -0.01, -6.05),
        (8.3, 3.1, 6.05),
        (-4.18, -5.86, 3.94, 5.9),
        2.93,
        [(-3.7, -5.2, 3.5, 5.4)],
        [
            ((-4.4, 1.68, -2.95), 2.55, 0.89, (1, 0), True),
            ((-4.4, 1.68, 2.95), 2.55, 0.89, (1, 0), True),
            ((4.06, 1.68, -1.63), 1.23, 0.89, (-1, 0), False),
            ((4.06, 1.68, 1.63), 1.23, 0.89, (-1, 0), False),
        ],
        ("Walls", "Wall", "Hallway"),
        ("Floor",),
        [tubes(x, z) for x in (-2.59, -0.13, 2.33) for z in (-3.565, -1.225, 1.635)],
    ),
    "dining-room": Layout(
        0.32,
        -1.42,
        (-2.02, -0.01, -1.47),
        (1.7, 3.0, 3.19),
        (-2.02, -1.45, 1.64, 3.16),
        2.98,
        [(-1.8, -1.2, 1.4, 3.0)],
        [((1.69, 1.85, -0.195), 1.13, 0.77, (-1, 0), True)],
        ("Walls",),
        ("FloorTiles",),
        [globe(x, 1.645, -0.62, 0.085, ()) for x in (0.305, -0.7)],
        blinds=("None",),
    ),
    "living-room-2": Layout(
        1.0,
        0.03,
        (-2.6, -0.01, 0.3),
        (3.2, 3.16, 8.2),
        (-2.44, 1.3, 3.01, 8.05),
        3.14,
        [(-2.2, 1.3, 2.8, 7.9)],
        [
            ((0.215, 1.93, 0.385), 0.43, 0.82, (0, 1), True),
            ((-1.031, 1.935, 0.665), 0.32, 0.84, (0.481, 0.877), True),
            ((1.456, 1.935, 0.665), 0.32, 0.84, (-0.475, 0.88), True),
            ((-0.15, 2.0, 8.15), 1.53, 0.965, (0, -1), True),
        ],
        ("Walls",),
        ("Floor",),
        [globe(0.385, 2.38, 2.895, 0.3, ("CeilingLampshade", "CeilingShadeWire")), shade(2.73, 1.69, 1.22, 1.57, 0.23, ("LampshaderOuter", "LampshadeInner"))],
        panes=("RadioGlass",),
        blinds=("BlindMaterial", "BlindWoodStrip", "BlindEnds", "BlindString", "BlindStringKnob"),
    ),
    "bathroom2": Layout(
        0.085,
        0.11,
        (-1.46, -0.01, -1.96),
        (1.45, 2.86, 1.93),
        (-1.45, -1.8, 1.44, 1.93),
        2.85,
        [(-1.3, -0.75, 1.3, 1.8), (-0.4, -0.7, 0.9, 1.8)],
        [((-0.14, 1.79, -1.945), 0.385, 0.455, (0, 1), True)],
        ("Wall", "WallRight"),
        ("WoodFloor",),
    ),
    "staircase2": Layout(
        0.46,
        0.0,
        (-6.6, -0.05, -1.5),
        (3.4, 5.3, 3.3),
        (-6.33, 0.05, 3.29, 1.38),
        2.58,
        [(-6.1, 0.15, 3.1, 1.25), (1.5, -1.2, 3.1, 1.3), (1.8, 1.4, 3.1, 3.0)],
        [((-6.48, 1.166, 0.71), 0.67, 1.13, (1, 0), True), ((-1.1, 1.17, 1.585), 1.488, 1.16, (0, -1), True)],
        ("Wall",),
        ("FloorTiles",),
        [spot(x, 2.576, 0.687, 0.045, (0, -1, 0)) for x in (0.83, -0.695, -2.22, -3.75, -5.27)],
        panes=("Glass",),
    ),
}


@dataclass
class Finish:
    """Reflectance of a BSDF: linear albedo [3] or texture [h, w, 3] (rows from v = 0 down from the top, as Mitsuba has it), GGX roughness, metal or not."""

    albedo: np.ndarray
    rough: float = 1.0
    metal: bool = False

    @property
    def textured(self):
        return self.albedo.ndim == 3


@dataclass
class Model:
    """A scene's triangles: normals and uv at the vertices, a part number per face; parts have a finish by its name."""

    name: str
    layout: Layout
    points: np.ndarray
    normals: np.ndarray
    uv: np.ndarray
    faces: np.ndarray
    part: np.ndarray
    finish_of: list  # name of the finish of each part
    finishes: dict


def unpacked(name):
    """Folder of a scene, unpacked from its archive where it is not there yet."""
    folder = CACHE / name
    if not (folder / "scene.xml").exists():
        CACHE.mkdir(parents=True, exist_ok=True)
        with tarfile.open(ARCHIVES / f"{name}.tar.xz") as archive:
            archive.extractall(CACHE, filter="data")
    return folder


def picture(path):
    """Linear texture of an image file, at most TEXTURE pixels wide and high."""
    image = Image.open(path).convert("RGB")
    image.thumbnail((TEXTURE, TEXTURE))
    return np.clip(linear(np.asarray(image, np.float32) / 255), 0.01, 0.92)


def numbers(element, name):
    found = element.find(f"*[@name='{name}']")
    value = found.get("value") if found is not None else None
    return None if value is None else np.array([float(v) for v in value.split(",")])


def reflectance(element, name, folder, default):
    """Albedo or texture of the parameter `name` of a BSDF."""
    texture = element.find(f"texture[@name='{name}']")
    if texture is not None:
        return picture(folder / texture.find("string[@name='filename']").get("value"))
    value = numbers(element, name)
    return np.clip(np.broadcast_to(default if value is None else value, 3), 0.01, 0.92).astype(np.float32)


def conductor(element):
    """Reflectance of a metal at normal incidence."""
    tint, eta, k = (numbers(element, name) for name in ("specularReflectance", "eta", "k"))
    r = np.full(3, 0.9) if eta is None else ((eta - 1) ** 2 + k**2) / ((eta + 1) ** 2 + k**2)
    return np.clip(r * (1 if tint is None else tint), 0.01, 0.92).astype(np.float32)


def finish(bsdf, folder):
    """`Finish` of a BSDF. Roughness r has GGX alpha = r^2; mirrors get 0.15, as sharper reflections are noise at few samples a pixel. Glass has the
    albedo 0.6 of porcelain, dark screens (no transmission) 0.03."""
    while bsdf.get("type") in ("twosided", "mask", "bumpmap"):
        bsdf = bsdf.find("bsdf")
    kind, alpha = bsdf.get("type"), numbers(bsdf, "alpha")
    rough = float(np.clip(np.sqrt(0.01 if alpha is None else alpha[0]), 0.15, 0.85))
    if kind == "diffuse":
        return Finish(reflectance(bsdf, "reflectance", folder, 0.5))
    if "plastic" in kind:
        return Finish(reflectance(bsdf, "diffuseReflectance", folder, 0.5), rough)
    if "conductor" in kind:
        return Finish(conductor(bsdf), rough, True)
    dark = numbers(bsdf, "specularTransmittance") is not None
    return Finish(np.full(3, 0.03 if dark else 0.6, np.float32), max(rough, 0.2))


def shape(element, folder):
    """(points, normals, uv, faces) of an obj file or a rectangle, in its place, units of the scene."""
    import mitsuba as mi

    matrix = element.find("transform/matrix")
    at = {"to_world": mi.ScalarTransform4f(np.array(matrix.get("value").split(), float).reshape(4, 4))} if matrix is not None else {}
    if element.get("type") == "obj":
        flat = element.find("boolean[@name='faceNormals']")
        file = folder / element.find("string[@name='filename']").get("value")
        if not file.exists():
            return None
        mesh = mi.load_dict({"type": "obj", "filename": str(file), "face_normals": flat is not None and flat.get("value") == "true"} | at)
    else:
        return None
    params = mi.traverse(mesh)
    points = np.array(params["vertex_positions"], float).reshape(-1, 3)
    faces = np.array(params["faces"], np.int64).reshape(-1, 3)
    there = lambda key, n: np.array(params[key], float).reshape(-1, n) if key in params and len(params[key]) else None
    return points, there("vertex_normals", 3), there("vertex_texcoords", 2), faces


def face_normals(points, faces):
    a, b, c = (points[faces[:, k]] for k in range(3))
    n = np.cross(b - a, c - a)
    return n / np.maximum(np.linalg.norm(n, axis=1, keepdims=True), 1e-12)


def shading_normals(points, normals, faces):
    """Vertex normals that exist and are finite: those of the faces where the file has none; then vertices are unshared."""
    if normals is not None and np.isfinite(normals).all() and (np.linalg.norm(normals, axis=1) > 0.5).all():
        return None
    return np.repeat(face_normals(points, faces), 3, axis=0)


def simplified(points, normals, faces):
    """Fewer triangles of a dense shape, smooth below a crease."""
    welded, index = meshes.weld(points)
    index = index[faces]
    index = index[(index[:, 0] != index[:, 1]) & (index[:, 1] != index[:, 2]) & (index[:, 2] != index[:, 0])]
    kept = meshes.simplify(welded, index, max(DENSE, len(faces) // 6))
    if len(kept) < 50:
        return points, normals, faces
    points, normals, faces = meshes.smooth(welded[kept])
    return points, normals, np.asarray(faces)


def read(name):
    """`Model` of a scene."""
    folder, layout = unpacked(name), SCENES[name]
    root = ET.parse(folder / "scene.xml").getroot()
    finishes = {b.get("id"): finish(b, folder) for b in root.findall("bsdf")}
    low, high, parts, finish_of = np.array(layout.low), np.array(layout.high), [], []
    for element in root.findall("shape"):
        ref = element.find("ref")
        if ref is None or ref.get("id") in layout.panes or element.find("emitter") is not None:
            continue
        got = shape(element, folder)
        if got is None:
            continue
        points, normals, uv, faces = got
        points = (points - [0, layout.floor, 0]) * layout.scale
        own = finishes[ref.get("id")]
        inside = ((points[faces].max(1) > low) & (points[faces].min(1) < high)).all(1)
        faces = faces[inside]
        if not len(faces):
            continue
        fresh = shading_normals(points, normals, faces)
        if fresh is not None:
            points, uv = points[faces].reshape(-1, 3), None if uv is None else uv[faces].reshape(-1, 2)
            normals, faces = fresh, np.arange(len(faces) * 3).reshape(-1, 3)
        if len(faces) > DENSE and not own.textured:
            points, normals, faces = simplified(points, normals, faces)
            uv = None
        uv = np.zeros((len(points), 2)) if uv is None else uv
        # Walls are one mesh in these files; each direction they face is a part of its own.
        facing = face_normals(points, faces)
        turned = np.abs(facing).argmax(1) * 2 + (np.take_along_axis(facing, np.abs(facing).argmax(1)[:, None], 1)[:, 0] > 0)
        for side in np.unique(turned) if ref.get("id") in layout.shell else [None]:
            some = faces if side is None else faces[turned == side]
            used, index = np.unique(some, return_inverse=True)
            parts.append((points[used], normals[used], uv[used], index.reshape(-1, 3)))
            finish_of.append(ref.get("id"))
    return joined(name, layout, parts, finish_of, finishes)


def joined(name, layout, parts, finish_of, finishes):
    """`Model` of parts, clipped to the closing box; its six sides are parts as well, with the finish "closing"."""
    low, high = np.array(layout.low), np.array(layout.high)
    for axis in range(3):
        for end, sign in ((low, 1), (high, -1)):
            c, u, v = (low + high) / 2, np.zeros(3), np.zeros(3)
            c[axis] = end[axis]
            u[(axis + 1) % 3], v[(axis + 2) % 3] = (high - low)[(axis + 1) % 3] / 2, (high - low)[(axis + 2) % 3] / 2
            n = np.zeros(3)
            n[axis] = sign
            corners = np.array([c - u - v, c + u - v, c + u + v, c - u + v])
            parts.append((corners, np.tile(n, (4, 1)), np.zeros((4, 2)), np.array([[0, 1, 2], [0, 2, 3]])))
            finish_of.append("closing")
    finishes = finishes | {"closing": Finish(np.full(3, 0.6, np.float32))}
    starts = np.cumsum([0] + [len(p[0]) for p in parts[:-1]])
    points, normals, uv = (np.concatenate([p[k] for p in parts]) for k in range(3))
    # Ground planes that reach far beyond the box would only cost ray tests.
    points = np.clip(points, low - 0.02, high + 0.02)
    faces = np.concatenate([p[3] + start for p, start in zip(parts, starts)])
    part = np.repeat(np.arange(len(parts)), [len(p[3]) for p in parts])
    return Model(name, layout, points, normals, uv, faces, part, finish_of, finishes)
