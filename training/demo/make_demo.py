"""Renders scenes/demo: the photograph, its depth and masks, and the truth per light and per edit.

usage: make_demo.py [--spp 64] [--out scenes/demo] [--threads 1] [--preview FILE.png] [--small]

Path tracing with Mitsuba 3 (variant llvm_ad_rgb; DRJIT_LIBLLVM_PATH names the LLVM library), each light alone in the room, then Open Image
Denoise with exact albedo and normals. The photograph is the sum of the lights at 1280 x 960 through the camera of training/camera; the truth is
what lens and sensor of that camera would record without clipping, tone curve, noise and JPEG, at 640 x 480. `--small` makes tests/scenes/small:
the plain room at 320 x 240, its photograph the clipped sum of the truth.

Same seed, versions and thread count give the same files; another thread count sums in another order, which moves about one half-float value in
a thousand by its last bit."""
import argparse
import dataclasses
import json
import math
import sys
import time
from pathlib import Path

import drjit as dr
import mitsuba as mi
import mitsuba_oidn
import numpy as np
import OpenEXR
from PIL import Image

mi.set_variant("llvm_ad_rgb")
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
import room  # noqa: E402  (the variant comes first)
from camera import model  # noqa: E402

DEPTH, SEED = 12, 1

# Radiances are in units of the photo: a white surface under irradiance pi shows 1.
LAMP = (23.0, 13.9, 6.4)
CEILING = dict(center=(0.55, 2.54, 0.85), half=(0.35, 0.35), radiance=(36.0, 33.5, 29.5))
SKY = dict(direction=(-0.65, 0.76, 0.0), bandwidth=1.5, radiance=(9.6, 11.4, 13.4))
GROUND = dict(direction=(-0.55, -0.835, 0.0), bandwidth=2.5, radiance=(3.0, 2.9, 2.2))
DESK = dict(center=(0.26, 0.495, -2.50), radius=0.07, radiance=(72.0, 44.0, 20.0))
EAST = dict(center=(-1.13, 1.56, room.BACK + 0.004), half=(0.40, 0.48), radiance=(6.5, 7.6, 8.8))

CAMERA = model.Camera(
    softness=0.0005, glare=0.03, glare_slope=0.6, vignetting=0.08, shot_noise=8e-5, read_noise=1e-3, grain=0.0006, saturation=1.25, chroma_blur=0.0012,
    sharpening=0.3, jpeg_quality=92,
)
VASE_MODEL = str(Path(__file__).resolve().parents[2] / "scenes/demo/models/vase.obj")

# The objects of edits/insert_object.ron and the paint of edits/paint.ron; pixels are those of the 1280 x 960 photo.
BALL = dict(pixel=(712, 704), radius=0.09, albedo="#e8e4da")
VASE = dict(pixel=(384, 832), height=0.35, albedo="#b4643c")
PAINT = "#b5563c"


class WindowLight(mi.Emitter):
    """A rectangle behind which a distant surrounding is seen: a sum of spherical Gaussians w exp(lambda (d . l - 1)) over the directions l from
    the room to the outside. Sampled uniformly over its area."""

    def __init__(self, props):
        super().__init__(props)
        self.m_flags = mi.EmitterFlags.Surface | mi.EmitterFlags.SpatiallyVarying
        self.center, self.half_x, self.half_y = (mi.Vector3f(props[k]) for k in ("center", "half_x", "half_y"))
        self.lobes = []
        for k in ("sky", "ground"):
            if f"{k}_radiance" in props:
                self.lobes.append((mi.Vector3f(props[f"{k}_direction"]), mi.Float(props[f"{k}_bandwidth"]), mi.Color3f(props[f"{k}_radiance"])))
        self.n = dr.cross(self.half_x, self.half_y)
        self.area = 4 * dr.norm(self.n)
        self.n = dr.normalize(self.n)

    def radiance(self, outwards):
        total = mi.Color3f(0)
        for direction, bandwidth, w in self.lobes:
            total += w * dr.exp(bandwidth * (dr.dot(direction, outwards) - 1))
        return total

    def eval(self, si, active=True):
        return dr.select(active & (dr.dot(si.n, si.to_world(si.wi)) > 0), self.radiance(-si.to_world(si.wi)), 0)

    def sample_direction(self, it, sample, active=True):
        ds = mi.DirectionSample3f()
        ds.p = self.center + (2 * sample.x - 1) * self.half_x + (2 * sample.y - 1) * self.half_y
        ds.n = mi.Normal3f(self.n)
        ds.uv, ds.time, ds.delta = sample, it.time, False
        ds.d = ds.p - it.p
        distance2 = dr.squared_norm(ds.d)
        ds.dist = dr.sqrt(distance2)
        ds.d /= ds.dist
        cosine = -dr.dot(ds.d, self.n)
        active &= cosine > 0
        ds.pdf = dr.select(active, distance2 / (self.area * cosine), 0)
        ds.emitter = mi.EmitterPtr(self)
        return ds, mi.Color3f(dr.select(active, self.radiance(ds.d) / ds.pdf, 0))

    def pdf_direction(self, it, ds, active=True):
        cosine = -dr.dot(ds.d, self.n)
        return dr.select(active & (cosine > 0), ds.dist * ds.dist / (self.area * cosine), 0)

    def eval_direction(self, it, ds, active=True):
        return dr.select(active & (dr.dot(ds.d, self.n) < 0), self.radiance(ds.d), 0)

    def traverse(self, callback):
        pass

    def to_string(self):
        return "WindowLight[]"


mi.register_emitter("windowlight", WindowLight)


def material(name, images, rich):
    """A Mitsuba material: Lambertian but for gloss and walnut, which have a specular coat of roughness 0.3, and the floor of the rich room, which has a
    weaker one of 0.35."""
    color = {"type": "mesh_attribute", "name": "vertex_color"}
    if name in images:
        pixels, scale = images[name]
        to_uv = mi.ScalarTransform4f().scale(mi.ScalarPoint3f(scale[0], scale[1], 1))
        color = {"type": "bitmap", "bitmap": mi.Bitmap(pixels.astype(np.float32)), "raw": True, "to_uv": to_uv}
    if name in ("gloss", "walnut"):
        return {"type": "twosided", "bsdf": {"type": "principled", "base_color": color, "roughness": 0.3, "specular": 0.5}}
    if name == "floor" and rich:
        return {"type": "twosided", "bsdf": {"type": "principled", "base_color": color, "roughness": 0.35, "specular": 0.35}}
    return {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": color}}


def mesh(name, data, colors, bsdf, emitter=None):
    """A Mitsuba mesh of a mesh of shapes.py."""
    props = mi.Properties()
    props["mesh_bsdf"] = bsdf
    if emitter is not None:
        props["mesh_emitter"] = emitter
    points, normals, uv, faces = data
    out = mi.Mesh(name, len(points), len(faces), has_vertex_normals=True, has_vertex_texcoords=True, props=props)
    if colors is not None:
        out.add_attribute("vertex_color", 3, np.ascontiguousarray(colors, np.float32).ravel())
    params = mi.traverse(out)
    for key, value in (("vertex_positions", points), ("vertex_normals", normals), ("vertex_texcoords", uv), ("faces", faces)):
        params[key] = np.ascontiguousarray(value).ravel().astype(np.uint32 if key == "faces" else np.float32)
    params.update()
    return out


def rectangle(center, half_x, half_y):
    """to_world of Mitsuba's rectangle for half edges; it faces half_x cross half_y."""
    x, y, c = np.asarray(half_x, float), np.asarray(half_y, float), np.asarray(center, float)
    n = np.cross(x, y)
    return mi.ScalarTransform4f(np.vstack([np.stack([x, y, n / np.linalg.norm(n), c], 1), [0, 0, 0, 1]]))


def window(center, half_x, half_y, lobes, on):
    """A pane: black when off, so that what it shows is its light."""
    shape = {"type": "rectangle", "to_world": rectangle(center, half_x, half_y), "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.04}}}
    if on:
        light = {"type": "windowlight", "center": mi.ScalarPoint3f(center), "half_x": mi.ScalarPoint3f(half_x), "half_y": mi.ScalarPoint3f(half_y)}
        for name, lobe in lobes.items():
            light |= {
                f"{name}_direction": mi.ScalarPoint3f(lobe["direction"]),
                f"{name}_bandwidth": float(lobe["bandwidth"]),
                f"{name}_radiance": mi.ScalarPoint3f(lobe["radiance"]),
            }
        shape["emitter"] = light
    return shape


def area(radiance):
    return {"type": "area", "radiance": {"type": "rgb", "value": list(radiance)}}


def gray(value):
    return {"type": "diffuse", "reflectance": {"type": "rgb", "value": value}}


def demo_window():
    (z0, z1), (y0, y1) = room.WINDOW["z"], room.WINDOW["y"]
    return (room.LEFT - room.WINDOW["deep"], (y0 + y1) / 2, (z0 + z1) / 2), (0, 0, -(z1 - z0) / 2), (0, (y1 - y0) / 2, 0)


def linear(color):
    """Linear Rec. 709 of an sRGB color "#rrggbb"."""
    return model.decode(np.array([int(color[k : k + 2], 16) for k in (1, 3, 5)]) / 255)


class Demo:
    """The rich or the plain room, seen in `width` x `height` pixels."""

    def __init__(self, rich, width, height):
        self.width, self.height = width, height
        images = room.textures(rich)
        self.static = {}
        for name, (data, colors) in room.build(rich).items():
            self.static[name] = mesh(name, data, colors, mi.load_dict(material(name, images, rich)))
            if name == "accent":
                texels, scale = images[name]
                paint = texels * linear(PAINT) / texels.mean((0, 1))
                self.painted = mesh(name, data, None, mi.load_dict(material(name, {name: (paint, scale)}, rich)))
        self.shade_bsdf = mi.load_dict({"type": "twosided", "bsdf": gray([0.80, 0.72, 0.58])})

        origin, target = (np.array(room.CAMERA[k], float) for k in ("origin", "target"))
        forward = (target - origin) / np.linalg.norm(target - origin)
        right = np.cross(forward, [0, 1, 0])
        right /= np.linalg.norm(right)
        self.origin, self.basis = origin, np.stack([right, np.cross(right, forward), -forward])

    def to_camera(self, point):
        return self.basis @ (np.asarray(point, float) - self.origin)

    def turn(self, direction):
        return self.basis @ np.asarray(direction, float)

    def pixel(self, point):
        """Where a world point is seen, in pixels; centers at + 0.5."""
        p, f = self.to_camera(point), self.focal()
        return (self.width / 2 + f * p[0] / -p[2], self.height / 2 - f * p[1] / -p[2])

    def seen(self, pixel):
        """The world point at a pixel of the photo of 1280 x 960."""
        f = self.focal() * 1280 / self.width
        ray = self.basis.T @ np.array([(pixel[0] - 640) / f, (480 - pixel[1]) / f, -1.0])
        hit = self.scene([]).ray_intersect(mi.Ray3f(mi.Point3f(self.origin), mi.Vector3f(ray / np.linalg.norm(ray))))
        return np.array(hit.p).ravel()

    def focal(self):
        return 0.5 * self.width / math.tan(math.radians(room.CAMERA["fov_x"]) / 2)

    def scene(self, on, extra=()):
        """The room with the lights named in `on` burning; `extra` names what is changed in it: "desk", "east", "paint", "objects"."""
        c = CEILING
        out = {
            "type": "scene",
            "sensor": {
                "type": "perspective",
                "fov": room.CAMERA["fov_x"],
                "near_clip": 0.01,
                "to_world": mi.ScalarTransform4f().look_at(origin=room.CAMERA["origin"], target=room.CAMERA["target"], up=[0, 1, 0]),
                "film": {"type": "hdrfilm", "width": self.width, "height": self.height, "pixel_format": "rgb", "component_format": "float32", "rfilter": {"type": "box"}},
                "sampler": {"type": "independent"},
            },
            "lamp_0": mesh("lamp_0", room.shade(), None, self.shade_bsdf, mi.load_dict(area(LAMP)) if "lamp_0" in on else None),
            "window_0": window(*demo_window(), dict(sky=SKY, ground=GROUND), "window_0" in on),
            "inv_lamp": {"type": "rectangle", "to_world": rectangle(c["center"], (c["half"][0], 0, 0), (0, 0, c["half"][1])), "bsdf": gray(0.6)},
        } | self.static
        if "inv_lamp" in on:
            out["inv_lamp"]["emitter"] = area(c["radiance"])
        if "desk" in extra:
            out["desk"] = {"type": "sphere", "center": list(DESK["center"]), "radius": DESK["radius"], "bsdf": gray(0.7)}
            if "desk" in on:
                out["desk"]["emitter"] = area(DESK["radiance"])
        if "east" in extra:
            (x, y) = EAST["half"]
            uniform = dict(direction=(0, 1, 0), bandwidth=0.0, radiance=EAST["radiance"])
            out["east"] = window(EAST["center"], (x, 0, 0), (0, y, 0), dict(sky=uniform), "east" in on)
        if "paint" in extra:
            out["accent"] = self.painted
        if "objects" in extra:
            matte = lambda thing: {"type": "diffuse", "reflectance": {"type": "rgb", "value": list(linear(thing["albedo"]))}}
            center = self.seen(BALL["pixel"]) + (0, BALL["radius"], 0)
            out["ball"] = {"type": "sphere", "center": list(center), "radius": BALL["radius"], "bsdf": matte(BALL)}
            stands = mi.ScalarTransform4f().translate(mi.ScalarPoint3f(self.seen(VASE["pixel"]))).scale(VASE["height"])
            out["vase"] = {"type": "obj", "filename": VASE_MODEL, "to_world": stands, "bsdf": {"type": "twosided", "bsdf": matte(VASE)}}
        return mi.load_dict(out)

    def light(self, name, extra, spp, aux):
        """The linear picture of one light alone, denoised, and its relative error, from two halves of the samples."""
        scene = self.scene([name], extra)
        integrator = mi.load_dict({"type": "path", "max_depth": DEPTH, "rr_depth": 6})
        passes = 2 * max(1, spp // 128)
        halves = [np.zeros((self.height, self.width, 3)) for _ in range(2)]
        for k in range(passes):
            halves[k % 2] += np.array(mi.render(scene, integrator=integrator, spp=spp // passes, seed=SEED + k)) * (2 / passes)
        clean = [denoised(h, aux) for h in halves]
        whole = denoised((halves[0] + halves[1]) / 2, aux)
        error = float(np.median(np.abs(clean[0] - clean[1]) / 2 / np.maximum(whole, 1e-4)))
        return whole, error

    def aux(self, extra=(), spp=64):
        """Antialiased albedo and camera-space normals."""
        integrator = mi.load_dict({"type": "aov", "aovs": "a:albedo,n:sh_normal"})
        a = np.array(mi.render(self.scene([], extra), integrator=integrator, spp=spp, seed=SEED))
        return a[..., -6:-3].astype(np.float32), np.ascontiguousarray(a[..., -3:] @ self.basis.T, dtype=np.float32)

    def geometry(self, grid=8):
        """Planar z and normals at the pixel centers, and per light the pixels that it shows in. A pixel of a light has the light's depth and
        normal, also where its center just misses it."""
        scene = self.scene([])
        names = {"lamp_0": None, "window_0": None}
        for s in scene.shapes():
            if s.id() in names:
                names[s.id()] = mi.ShapePtr(s)
        f = self.focal()

        def shoot(dx, dy):
            j, i = np.meshgrid(np.arange(self.width) + dx, np.arange(self.height) + dy)
            d = np.stack([(j - self.width / 2) / f, (self.height / 2 - i) / f, -np.ones_like(j)], -1).reshape(-1, 3)
            length = np.linalg.norm(d, axis=1)
            ray = mi.Ray3f(mi.Point3f(self.origin), mi.Vector3f(((d / length[:, None]) @ self.basis).T))
            si = scene.ray_intersect(ray)
            z = np.array(si.t) / length
            n = np.array(si.sh_frame.n).T @ self.basis.T
            n *= np.where((n * d).sum(1) > 0, -1, 1)[:, None]
            return z, n, {k: np.array(si.shape == v) for k, v in names.items()}

        z, n, at_centre = shoot(0.5, 0.5)
        masks = {k: np.zeros(self.width * self.height, bool) for k in names}
        steps = (np.arange(grid) + 0.5) / grid
        first = {k: (np.zeros(z.shape), np.zeros(n.shape)) for k in names}
        for dy in steps:
            for dx in steps:
                zs, ns, hit = shoot(dx, dy)
                for k in names:
                    new = hit[k] & ~masks[k]
                    first[k][0][new], first[k][1][new] = zs[new], ns[new]
                    masks[k] |= hit[k]
        for k in names:
            edge = masks[k] & ~at_centre[k]
            z[edge], n[edge] = first[k][0][edge], first[k][1][edge]
        size = self.height, self.width
        return z.reshape(size), n.reshape(*size, 3), {k: m.reshape(size) for k, m in masks.items()}


def denoised(color, aux):
    albedo, normal = aux
    out = mitsuba_oidn.denoise(np.ascontiguousarray(color, np.float32), albedo=albedo, normal=normal, hdr=True, clean_aux=True)
    return np.maximum(np.array(out), 0)


def photograph(path, received):
    """The JPEG that CAMERA makes of linear light."""
    received = model.incident(received, CAMERA)
    noise = np.random.default_rng(SEED).standard_normal(received.shape)
    stored = np.round(255 * model.develop(received, CAMERA, noise)).astype(np.uint8)
    Image.fromarray(stored).save(path, quality=CAMERA.jpeg_quality)


def png(path, linear):
    Image.fromarray((model.encode(linear) * 255 + 0.5).astype("uint8")).save(path, optimize=True)


def exr(path, **channels):
    header = {"type": OpenEXR.scanlineimage, "compression": OpenEXR.ZIP_COMPRESSION}
    OpenEXR.File(header, {k: np.ascontiguousarray(v) for k, v in channels.items()}).write(str(path))


def numbers(v):
    return [round(float(x), 5) for x in v]


def describe(demo):
    """The lights in camera space, meters, photo units."""
    shade, c, (x, y) = room.SHADE, CEILING, EAST["half"]
    center, half_x, half_y = demo_window()
    lobes = {k: dict(direction=numbers(demo.turn(np.array(v["direction"]) / np.linalg.norm(v["direction"]))), bandwidth=v["bandwidth"], radiance=v["radiance"]) for k, v in (("sky", SKY), ("ground", GROUND))}
    up = demo.turn((0, 1, 0))
    lights = {
        "lamp_0": dict(
            kind="frustum", base=numbers(demo.to_camera(shade["base"])), axis=numbers(up), height=shade["height"],
            radius_base=shade["radius_low"], radius_top=shade["radius_high"], closed=True, radiance=LAMP,
        ),
        "window_0": dict(kind="window", center=numbers(demo.to_camera(center)), half_x=numbers(demo.turn(half_x)), half_y=numbers(demo.turn(half_y)), lobes=lobes),
        "inv_lamp": dict(kind="rect", center=numbers(demo.to_camera(c["center"])), half_x=numbers(demo.turn((c["half"][0], 0, 0))), half_y=numbers(demo.turn((0, 0, c["half"][1]))), radiance=c["radiance"]),
    }
    corners = [np.array(EAST["center"]) + (sx * x, sy * y, 0) for sx, sy in ((-1, 1), (1, 1), (1, -1), (-1, -1))]
    edits = {
        "insert_lamp": dict(light="desk", kind="sphere", center=numbers(demo.to_camera(DESK["center"])), radius=DESK["radius"], radiance=DESK["radiance"]),
        "open_window": dict(
            light="east", kind="window", corners=[[round(float(v), 2) for v in demo.pixel(p)] for p in corners],
            center=numbers(demo.to_camera(EAST["center"])), half_x=numbers(demo.turn((x, 0, 0))), half_y=numbers(demo.turn((0, y, 0))), radiance=EAST["radiance"],
        ),
    }
    return lights, edits, up


def known(demo, lights):
    """`lights` as truth/lights.json tells them to the stage ReadLights."""
    points, _, _, faces = room.shade()
    triangles = [[numbers(demo.to_camera(points[i])) for i in face] for face in faces]
    triangles = [[a, b, c] for a, b, c in triangles if np.linalg.norm(np.cross(np.subtract(b, a), np.subtract(c, a))) > 1e-6]
    window, panel = dict(lights["window_0"]), dict(lights["inv_lamp"])
    window["lobes"] = [dict(name=name, **lobe) for name, lobe in window["lobes"].items()]
    return {
        "lamp_0": dict(kind="Mesh", radiance=LAMP, triangles=triangles),
        "window_0": window | dict(kind="Window"),
        "inv_lamp": panel | dict(kind="Rect"),
    }


def write_lights(path, lights):
    """One light a line: triangles make long lines, which nobody reads."""
    lines = ",\n".join(f" {json.dumps(name)}: {json.dumps(light)}" for name, light in lights.items())
    with open(path, "w") as file:
        file.write("{\n" + lines + "\n}\n")


SCENE = """// A living room of our own, path-traced: training/demo/make_demo.py makes every file here{which}.
Scene(
    version: 1,
    photo: "{photo}", transfer: Srgb,
    camera: FovX({fov_x}),
    depth: (path: "depth.exr", kind: PlanarZ, scale: 1.0),
    lights: {{
        "lamp_0": Lamp(mask: "masks/lamp_0.png"),
        "window_0": Window(mask: "masks/window_0.png"),
    }},
    truth: (
        lights: "truth/lights.json", albedo: "truth/albedo.exr", normal: "truth/normal.exr",
        pictures: {{
            "lamp_0": "truth/light_lamp_0.exr", "window_0": "truth/light_window_0.exr", "inv_lamp": "truth/light_inv_lamp.exr",
        }},
        edits: {{
{edits}
        }},
    ),
)
"""

BASE = ["lamp_0", "window_0", "inv_lamp"]
# Edit -> what is changed in the room for it.
EDITS = {"insert_lamp": "desk", "open_window": "east", "paint": "paint", "insert_object": "objects"}


def render(demo, names, extra, spp, errors, aux_spp=128, keep=None):
    """{light: its linear picture, all else dark} in the room with `extra`; the median relative errors go into `errors`. Pictures that lie in the folder
    `keep` are taken from there."""
    start, aux, out = time.time(), None, {}
    for name in names:
        key = "+".join((name, *(e for e in extra if e != name)))
        kept = keep and keep / f"{key}_{demo.width}_{spp}.npz"
        if kept and kept.exists():
            out[name], errors[key] = (np.load(kept)[k] for k in ("picture", "error"))
            continue
        aux = aux or demo.aux(extra, aux_spp)
        out[name], errors[key] = demo.light(name, extra, spp, aux)
        if kept:
            np.savez(kept, picture=out[name], error=errors[key])
        print(f"{key:20s} mean {out[name].mean():.4f}  median error {errors[key]:.4f}  {time.time() - start:.0f} s", flush=True)
    return out


def total(pictures):
    return sum(p.astype(np.float32) for p in pictures.values())


def look(demo, spp, path):
    """All lights, lamp, lamp inserted / window, ceiling, window opened / painted, objects, nothing."""
    shown = lambda names, *extra: render(demo, names, extra, spp, {}, 16)
    parts = shown(BASE)
    desk, east = (total(parts) + shown([e], e)[e] for e in ("desk", "east"))
    paint, objects = (total(shown(BASE, e)) for e in ("paint", "objects"))
    rows = [total(parts), parts["lamp_0"], desk], [parts["window_0"], parts["inv_lamp"], east], [paint, objects, 0 * paint]
    png(path, np.vstack([np.hstack(row) for row in rows]))


def shortened(x, bits):
    """Floats rounded to `bits` of the fraction, which then compress well: the relative error is at most 2^-(bits + 1)."""
    fraction, exponent = np.frexp(np.asarray(x, np.float32))
    return np.ldexp(np.round(np.ldexp(fraction, bits + 1)), exponent - bits - 1).astype(np.float32)


def main():
    here = Path(__file__).resolve().parent
    args = argparse.ArgumentParser()
    args.add_argument("--spp", type=int, help="samples per pixel of each light, at least 2; 64, and 256 for the small room")
    args.add_argument("--out", type=Path)
    args.add_argument("--preview", help="only a quick look: pictures of each light and each edit")
    args.add_argument("--small", action="store_true", help="the plain room at 320 x 240")
    args.add_argument("--threads", type=int, default=1)
    args.add_argument("--resume", type=Path, help="a folder that keeps the picture of each light, so that a stopped run goes on from there")
    args = args.parse_args()
    if args.resume:
        args.resume.mkdir(parents=True, exist_ok=True)
    dr.set_thread_count(args.threads)
    rich, errors = not args.small, {}
    args.spp = args.spp or (64 if rich else 256)
    demo = Demo(rich, 640, 480) if rich else Demo(rich, 320, 240)
    if args.preview:
        return look(demo, args.spp, args.preview)
    out = args.out or here.parents[1] / ("scenes/demo" if rich else "tests/scenes/small")
    for folder in ("masks", "truth"):
        (out / folder).mkdir(parents=True, exist_ok=True)

    # Every light again in the changed room, with the same seeds: what the change does not reach keeps its noise, and the difference is clean.
    rendered = lambda demo, names, extra, spp, errors: render(demo, names, extra, spp, errors, keep=args.resume)
    parts = rendered(demo, BASE, (), args.spp, errors)
    edits = EDITS if rich else dict(list(EDITS.items())[:2])
    added = lambda extra: [extra] if extra in ("desk", "east") else []
    changed = {edit: total(rendered(demo, BASE + added(extra), (extra,), args.spp, errors)) for edit, extra in edits.items()}
    albedo = demo.aux((), 256)[0]
    z, normal, seen = demo.geometry()
    masks = seen
    lens = lambda picture: picture
    if rich:
        full = Demo(rich, 1280, 960)
        photograph(out / "photo.jpg", total(rendered(full, BASE, (), max(2, args.spp // 4), {})))
        lens = lambda picture: model.incident(picture, CAMERA)
        masks, described = full.geometry()[2], describe(full)
    else:
        png(out / "photo.png", total({k: v.astype(np.float16) for k, v in parts.items()}))
        described = describe(demo)
    stored = (lambda x: shortened(x, 7).astype(np.float16)) if rich else (lambda x: x.astype(np.float16))
    parts = {k: stored(lens(v)) for k, v in parts.items()}
    exr(out / "depth.exr", Z=shortened(z, 13) if rich else z.astype(np.float32))
    for name, mask in masks.items():
        Image.fromarray((mask * 255).astype("uint8")).save(out / f"masks/{name}.png", optimize=True)
    places = {edit: "../../edits/" if rich else "edits/" for edit in edits}
    listed = ",\n".join(f'            "{place}{edit}.ron": "truth/{edit}.exr"' for edit, place in places.items())
    photo, which = ("photo.jpg", "") if rich else ("photo.png", " by its --small")
    (out / "scene.ron").write_text(SCENE.format(fov_x=room.CAMERA["fov_x"], photo=photo, which=which, edits=listed + ","))
    for name, picture in parts.items():
        exr(out / f"truth/light_{name}.exr", RGB=picture)
    exr(out / "truth/albedo.exr", RGB=stored(albedo))
    exr(out / "truth/normal.exr", RGB=(shortened(normal, 6) if rich else normal).astype(np.float16))
    for edit, picture in changed.items():
        exr(out / f"truth/{edit}.exr", RGB=stored(lens(picture)))

    lights, told, up = described
    whole = total(parts)
    glow = seen["lamp_0"] | seen["window_0"]
    share = {k: numbers(np.percentile((v.astype(float).mean(-1) / whole.mean(-1))[~glow], (10, 50, 90)).round(3)) for k, v in parts.items()}
    meta = dict(
        width=demo.width, height=demo.height, fov_x=room.CAMERA["fov_x"], up=numbers(up), visible=["lamp_0", "window_0"], lights=lights, edits=told,
        spp=args.spp, seed=SEED, max_depth=DEPTH, denoised=True,
        median_relative_error={k: round(float(v), 5) for k, v in errors.items()},
        share_of_light_10_50_90=share,
        saturated=round(float((whole.max(-1) > 1)[~glow].mean()), 4),
        versions=dict(mitsuba=mi.__version__, drjit=dr.__version__, oidn=str(mitsuba_oidn.oidn_version()), numpy=np.__version__, variant=mi.variant()),
    ) | (dict(camera=dataclasses.asdict(CAMERA)) if rich else {})
    (out / "truth/meta.json").write_text(json.dumps(meta, indent=1))
    write_lights(out / "truth/lights.json", known(demo, lights))
    print(json.dumps({k: meta[k] for k in ("saturated", "share_of_light_10_50_90", "edits")}, indent=1))


if __name__ == "__main__":
    main()
