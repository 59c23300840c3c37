"""Irradiance / pi at the receivers by Mitsuba 3: its lights, its sampling of them, its shadow rays. Writes mitsuba.npy and mitsuba.json.

Lamps are `area` emitters on `sphere`, `rectangle` and `mesh` shapes. A window's lobe is an `envmap` seen through the hole of a
closed box; the map's pole is the lobe's direction, so that a narrow map has all of the resolution where the lobe is. Lobes
wider than the window is would waste nearly all samples of the map: they are a `rectangle` emitter of radiance 1, each of whose
samples counts with the lobe's value in its direction.
"""

import drjit as dr
import mitsuba as mi
import numpy as np

import common

mi.set_variant("llvm_ad_rgb")
from mitsuba import ScalarTransform4f as T  # noqa: E402  (needs the variant)

BATCHES, SPP = 32, 4096
# Up to this bandwidth the window itself is sampled.
WIDE = 50.0


def mesh(name, corners, faces, emitter=None):
    props = mi.Properties()
    if emitter:
        props["emitter"] = mi.load_dict(emitter)
    out = mi.Mesh(name, len(corners), len(faces), props=props)
    params = mi.traverse(out)
    params["vertex_positions"] = np.ravel(corners).astype(np.float32)
    params["faces"] = np.ravel(faces).astype(np.uint32)
    params.update()
    return out


def rectangle(v, emitter):
    center, x, y = (np.array(v[k], float) for k in ("center", "x", "y"))
    z = np.cross(x, y)
    to_world = np.eye(4)
    to_world[:3] = np.stack([x, y, z / np.linalg.norm(z), center], 1)
    return {"type": "rectangle", "to_world": T(to_world), "emitter": emitter}


def envmap(lobe):
    """G of a lobe around the map's pole (+y), turned to the lobe's direction."""
    d = common.unit(lobe["direction"])
    side = common.unit(np.cross(d, [0.3, -0.8, 0.5]))
    to_world = np.eye(4)
    to_world[:3, :3] = np.stack([side, d, np.cross(side, d)], 1)
    rows = 1 + (2 ** 16 if lobe["bandwidth"] > 1e3 else 2 ** 13)
    theta = np.linspace(0.0, np.pi, rows)
    g = np.exp(-2.0 * lobe["bandwidth"] * np.sin(0.5 * theta) ** 2)
    bitmap = mi.Bitmap(np.broadcast_to(g[:, None, None], (rows, 8, 3)).astype(np.float32))
    return {"type": "envmap", "bitmap": bitmap, "to_world": T(to_world)}


def scene(s, light, lobe, blocked):
    """The scene, and the factor (direction -> weight) with which each sample counts."""
    unit_radiance = {"type": "area", "radiance": {"type": "rgb", "value": 1.0}}
    parts, factor = {"type": "scene"}, lambda d: 1.0
    if lobe is None:
        lamp = light["shape"]["Lamp"]
        if "Sphere" in lamp:
            parts["lamp"] = {"type": "sphere", **lamp["Sphere"], "emitter": unit_radiance}
        elif "Rect" in lamp:
            parts["lamp"] = rectangle(lamp["Rect"], unit_radiance)
        else:
            parts["lamp"] = mesh("lamp", *common.lamp_mesh(lamp), unit_radiance)
    elif lobe["bandwidth"] <= WIDE:
        parts["window"] = rectangle(light["shape"]["Window"], unit_radiance)
        axis = mi.Vector3f(common.unit(lobe["direction"]))
        factor = lambda d: dr.exp(-0.5 * lobe["bandwidth"] * dr.squared_norm(axis - d))
    else:
        corners, quads = common.opening(light["shape"]["Window"])
        parts["walls"] = mesh("walls", corners, np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]))
        parts["surrounding"] = envmap(lobe)
    if blocked:
        parts["room"] = mesh("room", s.corners, s.triangles)
    # What a closed form would know without rays needs none here either; a window's hole always does.
    traced = blocked or "walls" in parts
    return mi.load_dict(parts), factor, traced


def irradiance(s, light, lobe, blocked):
    """Batch means, (batches, receivers)."""
    world, factor, traced = scene(s, light, lobe, blocked)
    count = len(s.receivers)
    index = dr.arange(mi.UInt32, count * SPP) // SPP
    at = lambda values: mi.Vector3f(*(dr.gather(mi.Float, mi.Float(np.ascontiguousarray(values[:, k])), index) for k in range(3)))
    p, n = at(s.receivers), at(s.normals)
    dr.eval(p, n)
    si = dr.zeros(mi.SurfaceInteraction3f, count * SPP)
    si.p, si.n = p, mi.Normal3f(n)
    si.sh_frame = mi.Frame3f(n)
    sampler = mi.load_dict({"type": "multijitter", "sample_count": SPP})
    means = []
    for batch in range(BATCHES):
        sampler.seed(batch, count * SPP)
        sampler.set_samples_per_wavefront(SPP)
        ds, weight = world.sample_emitter_direction(si, sampler.next_2d(), traced)
        part = weight.x * factor(ds.d) * dr.maximum(dr.dot(n, ds.d), 0.0) / dr.pi
        means.append(np.array(dr.block_sum(part, SPP)) / SPP)
    return np.array(means, float)


how = f"llvm_ad_rgb, multijitter sampler, {BATCHES} batches of {SPP} samples a receiver"
common.run("mitsuba", f"Mitsuba {mi.__version__}", how, irradiance)
