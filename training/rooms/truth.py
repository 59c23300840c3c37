"""Ground truth of a room seen by a camera: masks, geometry, materials, shading per light with and without shadow, indirect shading, incoming radiance, and
the photograph. Shading is irradiance / pi; planes are in camera space (x right, y up, z backward)."""

import math

import drjit as dr
import mitsuba as mi
import numpy as np

import variant
from windowlight import LOBES, Pane

WIDTH, HEIGHT = 320, 240
DEPTH = 8  # bounces followed, as Mitsuba counts
GPU_SAMPLES = 256  # of a pixel of a photo at least, on a GPU


def opaque(value):
    """A number as a variable of a kernel, not a literal in its code: rooms that differ in it share the compiled kernel."""
    return dr.opaque(mi.Float, float(value))


def vector(v):
    """Three numbers as variables of a kernel."""
    return mi.Vector3f(*(opaque(c) for c in v))


def pointer(shape):
    """A shape as a variable of a kernel."""
    out = mi.ShapePtr(shape)
    dr.make_opaque(out)
    return out


def generator(size, seed):
    """Random numbers of `size` lanes from a seed."""
    return mi.PCG32(size=size, initstate=dr.opaque(mi.UInt64, seed))


class View:
    """A camera: origin, rows right, up, back of `turn`, field of view in degrees."""

    def __init__(self, origin, yaw, pitch, fov_x):
        self.origin, self.fov_x = np.asarray(origin, float), fov_x
        back = -np.array([math.sin(yaw) * math.cos(pitch), math.sin(pitch), -math.cos(yaw) * math.cos(pitch)])
        right = np.cross([0, 1, 0], back)
        right /= np.linalg.norm(right)
        self.turn = np.stack([right, np.cross(back, right), back])

    @staticmethod
    def of(record):
        """As room.json has it."""
        view = View(record["origin"], 0.0, 0.0, record["fov_x"])
        view.turn = np.array(record["turn"])
        return view

    def point(self, p):
        return self.turn @ (np.asarray(p, float) - self.origin)

    def direction(self, d):
        return self.turn @ np.asarray(d, float)

    def rays(self, x, y, width):
        """Rays through places (pixels of a picture of that width, 4:3; first center at 0.5). Their length per planar z comes second."""
        f = opaque(0.5 * width / math.tan(math.radians(self.fov_x) / 2))
        d = mi.Vector3f((x - width / 2) / f, (width * 3 / 8 - y) / f, -1)
        length = dr.norm(d)
        return mi.Ray3f(mi.Point3f(vector(self.origin)), self.matrix(self.turn.T) @ (d / length)), length

    @staticmethod
    def matrix(rows):
        """A 3 x 3 matrix as variables of a kernel."""
        return mi.Matrix3f(*(opaque(c) for c in np.asarray(rows).ravel()))


def places(view, width, spp, seed):
    """Rays through a picture of that width, stratified, pixel by pixel `spp` (a square number) each; and the random numbers that go on."""
    side = math.isqrt(spp)
    index = dr.arange(mi.UInt32, width * width * 3 // 4 * spp)
    rng = generator(dr.width(index), seed)
    pixel, k = index // spp, index % spp
    x = mi.Float(pixel % width) + (mi.Float(k % side) + rng.next_float32()) / side
    y = mi.Float(pixel // width) + (mi.Float(k // side) + rng.next_float32()) / side
    return view.rays(x, y, width)[0], rng


def hit(scene, ray):
    """What rays meet first; its normals face the camera."""
    si = scene.ray_intersect(ray)
    facing = lambda n: dr.select(dr.dot(n, ray.d) > 0, -n, n)
    si.n, si.sh_frame = facing(si.n), mi.Frame3f(facing(si.sh_frame.n))
    return si


def hits(scene, view, width, spp, seed):
    """Returns the first hits of the rays of `places`, and the random numbers that go on."""
    ray, rng = places(view, width, spp, seed)
    return hit(scene, ray), rng


def shapes_of(scene):
    return {s.id(): s for s in scene.shapes()}


def is_light(si, scene, lit):
    """Whether a hit is on a lamp or a pane."""
    lights = [s for name, s in shapes_of(scene).items() if name in lit.lamps or name in lit.windows]
    # As many comparisons in each room, so that rooms share the kernel.
    lights += lights[:1] * (-len(lights) % 16)
    return dr.any([si.shape == pointer(s) for s in lights] or [mi.Bool(False)])


def per_pixel(value, width, spp):
    """Means over the samples of a pixel: [h, w], of vectors [h, w, 3]."""
    value = np.array(value, np.float32)
    mean = value.reshape(*value.shape[:-1], width * 3 // 4, width, spp).mean(-1)
    return np.moveaxis(mean, 0, -1) if mean.ndim == 3 else mean


def normals(si, view, width, spp):
    """Mean normals of the pixels, camera space."""
    mean = per_pixel(View.matrix(view.turn) @ mi.Vector3f(si.sh_frame.n), width, spp)
    return mean / np.maximum(np.linalg.norm(mean, axis=-1, keepdims=True), 1e-6)


def denoise(color, albedo, normal, scale):
    """Open Image Denoise on [h, w, 3] with clean albedo and normals; `scale` is about as bright as the picture. On a GPU `color` as it
    is: `photo` takes more samples there."""
    if variant.ON_GPU:
        return color
    import mitsuba_oidn

    aux = [np.ascontiguousarray(a, np.float32) for a in (albedo, normal)]
    out = mitsuba_oidn.denoise(np.ascontiguousarray(color / scale, np.float32), albedo=aux[0], normal=aux[1], hdr=True, clean_aux=True)
    return np.maximum(np.array(out), 0) * scale


def denoised(color, normal):
    """Shading [h, w] or [h, w, 3], denoised."""
    rgb = np.ascontiguousarray(np.broadcast_to(color[..., None] if color.ndim == 2 else color, normal.shape), np.float32)
    out = denoise(rgb, np.ones_like(rgb), normal, max(float(rgb.mean()), 1e-12))
    return out.mean(-1) if color.ndim == 2 else out


def depths(scene, view, width):
    """Planar z at the centers of the pixels of a picture of that width."""
    index = dr.arange(mi.UInt32, width * width * 3 // 4)
    ray, length = view.rays(mi.Float(index % width) + 0.5, mi.Float(index // width) + 0.5, width)
    return (np.array(scene.ray_intersect_preliminary(ray).t) / np.array(length)).reshape(width * 3 // 4, width)


def surfaces(lit, scene, view, spp=16):
    """Planes at full size: albedo, normal, rough, depth (planar z, meters); of lights 0 or 1 + place in `names`: `light` where more than half of a pixel
    is light, `touch` where any is."""
    names = [*lit.lamps, *lit.windows]
    si, _ = hits(scene, view, WIDTH, spp, 1)
    known = {name: pointer(s) for name, s in shapes_of(scene).items()}
    albedo, rough = lit.materials(scene, si)
    planes = {"albedo": per_pixel(albedo, WIDTH, spp), "rough": per_pixel(rough, WIDTH, spp), "normal": normals(si, view, WIDTH, spp)}
    light, touch = np.zeros((2, HEIGHT, WIDTH), int)
    for k, name in enumerate(names):
        share = per_pixel(mi.Float(dr.select(si.shape == known[name], 1, 0)), WIDTH, spp)
        light[share > 0.5] = touch[share > 0] = k + 1
    planes["depth"] = depths(scene, view, WIDTH)
    return planes | {"light": light, "touch": touch, "names": names}


def light_samples(lit, scene, burning, si, rng):
    """For each source of `burning` one sample a hit: (source, its radiance, point, direction, unit radiance over density, whether it is one)."""
    shapes = shapes_of(scene)
    for name in burning:
        dr.eval(rng)  # each source then starts from a state in memory and shares the kernel of its kind
        u = mi.Point2f(rng.next_float32(), rng.next_float32())
        if name in lit.lamps:
            color = lit.lamps[name].radiance
            ds, weight = shapes[name].emitter().sample_direction(si, u)
            yield name, color, ds.p, ds.d, weight.x / opaque(color[0]), ds.pdf > 0
            continue
        w, lobes = lit.windows[name], lit.pane(name)
        pane = Pane(w.center, w.half_x, w.half_y, *zip(*lobes))
        for k, lobe in enumerate(LOBES):
            if max(lobes[k][2]) == 0:
                continue
            # Half by area, half by the lobe.
            dr.eval(rng)
            u, pick = mi.Point2f(rng.next_float32(), rng.next_float32()), rng.next_float32() < 0.5
            q0, d0, far0 = pane.sample_area(si.p, u)
            q1, d1, far1, meets = pane.sample_lobe(k, si.p, u)
            q, d, far = dr.select(pick, q1, q0), dr.select(pick, d1, d0), dr.select(pick, far1, far0)
            pdf = 0.5 * pane.area_pdf(d, far) + 0.5 * pane.lobe_pdf(k, d)
            yield f"{name}.{lobe}", lobes[k][2], q, d, pane.lobe(k, d) / dr.maximum(pdf, 1e-20), (~pick | meets) & (dr.dot(d, pane.n) < 0)


def mean_of(passes, one):
    """Mean of what `one` gives for the numbers of the passes, which keep memory small."""
    total = 0
    for k in range(passes):
        total = total + np.asarray(one(k), np.float64)
    return total / passes


def shading(lit, scene, view, burning, passes=1, clean=True, spp=64):
    """{source: [2, h, w]} of unit radiance, half size: unshadowed shading, `clean` if wanted, and the share of it that arrives; and normals. `scene` has
    the lights `burning` on."""
    names = []

    def one(k):
        """Normals weighted with the share of the pixel that is room, that share, and of each source what is open and what arrives."""
        some, normal, share = shading_pass(lit, scene, view, burning, spp, 2 + 100 * k)
        names[:] = some
        return np.concatenate([np.moveaxis(normal, -1, 0), share[None], *some.values()])

    planes = mean_of(passes, one)
    normal, share = np.moveaxis(planes[:3], 0, -1), planes[3]
    normal = normal / np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-6)
    out = {}
    for name, (open_, arrived) in zip(names, planes[4:].reshape(-1, 2, *share.shape)):
        shadow = np.where(open_ > 0, arrived / np.maximum(open_, 1e-20), 1)
        mean = open_ / np.maximum(share, 1e-6)
        out[name] = ((denoised(mean, normal) if clean else mean) * (share > 0.5), shadow)
    return out, normal


def shading_pass(lit, scene, view, burning, spp, seed):
    """{source: [2, h, w]}: open and arrived shading, sums over the part of a pixel that is room; normals; that part."""
    width = WIDTH // 2
    si, rng = hits(scene, view, width, spp, seed)
    room = ~is_light(si, scene, lit) & si.is_valid()
    dr.eval(si, room, rng)
    normal = normals(si, view, width, spp)
    share = per_pixel(dr.select(room, mi.Float(1), 0), width, spp)
    out = {}
    for name, _, point, direction, weight, active in light_samples(lit, scene, burning, si, rng):
        e = dr.select(active & room, weight * dr.maximum(dr.dot(si.sh_frame.n, direction), 0) / dr.pi, 0)
        blocked = scene.ray_test(si.spawn_ray_to(point), e > 0)
        out[name] = np.stack([per_pixel(e, width, spp), per_pixel(dr.select(blocked, 0, e), width, spp)])
    return out, normal, share


def radiance(scene, ray, seed, depth=DEPTH):
    """What arrives along rays, after up to `depth` bounces as Mitsuba counts."""
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(seed, dr.width(ray.d.x))
    integrator = mi.load_dict({"type": "path", "max_depth": depth, "rr_depth": 3})
    return integrator.sample(scene, sampler, ray)[0]


def reflected(scene, ray, seed):
    """What arrives along rays, without what lights send along them themselves."""
    seen = scene.ray_intersect(ray)
    return dr.maximum(radiance(scene, ray, seed) - dr.select(seen.is_valid(), seen.emitter(scene).eval(seen), 0), 0)


def indirect(lit, scene, view, normal, passes=1, clean=True, spp=16):
    """Indirect shading [h, w, 3] at half size, by what of the lights is on in `scene`, `clean` if wanted."""
    width = WIDTH // 2

    def one(k):
        seed = 3 + 100 * k
        si, rng = hits(scene, view, width, spp, seed)
        room = ~is_light(si, scene, lit) & si.is_valid()
        ray = si.spawn_ray(si.sh_frame.to_world(mi.warp.square_to_cosine_hemisphere(mi.Point2f(rng.next_float32(), rng.next_float32()))))
        e = per_pixel(dr.select(room, reflected(scene, ray, seed), 0), width, spp)
        return np.concatenate([e, per_pixel(dr.select(room, mi.Float(1), 0), width, spp)[..., None]], -1)

    sums = mean_of(passes, one)
    mean, share = sums[..., :3] / np.maximum(sums[..., 3:], 1e-6), sums[..., 3:]
    return (denoised(mean, normal) if clean else mean) * (share > 0.5)


def maps(lit, scene, view, burning, spp, seed=4):
    """Incoming radiance [30, 40, 8, 16, 3] in the frame of the normal at the centers of 4 x 4 blocks of half pixels, and whether it is the room that is
    seen there, no light. Light that comes straight from a light is sampled from the light. `spp`, of a texel, is a square number."""
    width, side = 40, math.isqrt(spp)
    index = dr.arange(mi.UInt32, 30 * width * 128 * spp)
    rng = generator(dr.width(index), seed)
    cell, texel, k = index // (128 * spp), (index // spp) % 128, index % spp
    ray, _ = view.rays(mi.Float(cell % width) + 0.5, mi.Float(cell // width) + 0.5, width)
    si = hit(scene, ray)
    n = mi.Vector3f(si.sh_frame.n)
    back, up = vector(view.turn[2]), vector(view.turn[1])
    pole = dr.select(dr.abs(dr.dot(up, n)) > 0.99, -back, up)
    y = dr.normalize(pole - dr.dot(pole, n) * n)
    x = dr.cross(y, n)
    theta = (mi.Float(texel // 16) + (mi.Float(k % side) + rng.next_float32()) / side) / 8 * (dr.pi / 2)
    phi = (mi.Float(texel % 16) + (mi.Float(k // side) + rng.next_float32()) / side) / 16 * dr.two_pi - dr.pi
    d = dr.sin(theta) * (dr.cos(phi) * x + dr.sin(phi) * y) + dr.cos(theta) * n
    dr.eval(si, n, x, y, rng)
    got = np.array(reflected(scene, si.spawn_ray(d), seed)).reshape(3, 30, 40, 8, 16, spp).mean(-1)
    edges = np.cos(np.linspace(0, math.pi / 2, 9))
    texels = np.repeat((edges[:-1] - edges[1:]) * (2 * math.pi / 16), 16).reshape(8, 16)  # solid angles
    valid = np.array(~is_light(si, scene, lit) & si.is_valid()).reshape(30, 40, 128 * spp)[..., 0]
    samples = 16 * spp  # of each light
    keep = dr.compress(index % (128 * spp) < samples)
    si, n, x, y, cell = (dr.gather(type(v), v, keep) for v in (si, n, x, y, cell))
    rng = generator(dr.width(keep), seed + 1)
    for _, color, point, d, weight, active in light_samples(lit, scene, burning, si, rng):
        height = dr.dot(d, n)
        active &= (height > 0) & ~scene.ray_test(si.spawn_ray_to(point), active & (height > 0))
        row = dr.clip(mi.UInt32(dr.acos(dr.clip(height, 0, 1)) / (dr.pi / 2) * 8), 0, 7)
        column = dr.clip(mi.UInt32((dr.atan2(dr.dot(d, y), dr.dot(d, x)) + dr.pi) / dr.two_pi * 16), 0, 15)
        sums = dr.zeros(mi.Float, 30 * width * 128)
        dr.scatter_reduce(dr.ReduceOp.Add, sums, weight, cell * 128 + row * 16 + column, active)
        got += np.array(sums).reshape(30, 40, 8, 16) / samples / texels * np.asarray(color)[:, None, None, None, None]
    return np.moveaxis(got, 0, -1), valid


def raw_photo(scene, view, spp, seed, depth=DEPTH):
    """The picture, linear, with its noise."""
    ray, _ = places(view, WIDTH, spp, seed)
    return per_pixel(radiance(scene, mi.RayDifferential3f(ray), seed, depth), WIDTH, spp)


def photo(scene, view, albedo, normal, passes=1, spp=16):
    """The picture, linear; denoised in every split, as it is an input and no truth."""
    if variant.ON_GPU:
        spp = max(spp, GPU_SAMPLES)
    picture = mean_of(passes, lambda k: raw_photo(scene, view, spp, 5 + 100 * k))
    return denoise(picture, albedo, normal, max(float(np.median(picture)), 1e-12))
