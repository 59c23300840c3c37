"""Direct light with shadows of the three lights of benches/direct.rs: our time to an error against that of Mitsuba's `direct` integrator.

    cargo bench --no-run --bench direct  # tells HASH
    DRJIT_LIBLLVM_PATH=.. python benches/peers/mitsuba_direct.py target/release/deps/direct-HASH --error 0.01

Both have the same triangles, points, normals and lights, and two threads. Mitsuba gets the rays to the receivers as they are, so
that it neither jitters in the pixel nor fills a film; its kernels are compiled and its hierarchy is built beforehand, and told
apart. Of some settings of the integrator the one with the least error for its time is taken. Its samples double, our target shrinks, until
the error is reached; then the two take turns. The error is the mean absolute error as a share of the mean, from two runs with different random
numbers, whose difference is sqrt(2) times it (the root mean square would tell more of the few receivers beside the window, where
samples by area are worst). Times are of the estimate alone, by the clock and of processors: on a busy machine compare the latter.
"""

import argparse
import json
import math
import os
import subprocess
import tempfile
import time
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np

mi.set_variant("llvm_ad_rgb")
from mitsuba import ScalarTransform4f as T  # noqa: E402  (needs the variant)

STEP = np.float32(0.12)
# Rays of one launch; more are taken in several.
LAUNCH = 20_000_000


def floats(folder, name, *shape):
    return np.fromfile(folder / f"{name}.f32", "<f4").reshape(shape)


def triangles(points, outside):
    """As `SceneMesh`: no triangle across a depth step, each quad split along the diagonal that keeps more."""
    height, width = outside.shape
    index = np.arange(height * width).reshape(height, width)
    quad = [index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]]
    z = -points[..., 2].ravel()
    room = ~outside.ravel()

    def held(a, b):
        za, zb = z[quad[a]], z[quad[b]]
        limit = STEP * (np.float32(math.sqrt(2)) if a + b == 3 else np.float32(1)) * np.minimum(za, zb)
        return room[quad[a]] & room[quad[b]] & (abs(za - zb) <= limit)

    def halves(corners):
        return [held(a, b) & held(b, c) & held(c, a) for a, b, c in corners]

    falling, rising = [(0, 2, 3), (0, 3, 1)], [(0, 2, 1), (1, 2, 3)]
    keep_falling, keep_rising = halves(falling), halves(rising)
    more = sum(map(np.int8, keep_rising)) - sum(map(np.int8, keep_falling))
    flatter = abs(z[quad[1]] - z[quad[2]]) < abs(z[quad[0]] - z[quad[3]])
    rises = (more > 0) | ((more == 0) & flatter)
    out = []
    for corners, keep, chosen in ((falling, keep_falling, ~rises), (rising, keep_rising, rises)):
        for (a, b, c), k in zip(corners, keep):
            out.append(np.stack([quad[i][k & chosen] for i in (a, b, c)], -1))
    return np.concatenate(out)


def room_mesh(points, normals, faces):
    props = mi.Properties()
    props["bsdf"] = mi.load_dict({"type": "diffuse", "reflectance": {"type": "rgb", "value": 1.0}})
    mesh = mi.Mesh("room", points.shape[0] * points.shape[1], len(faces), has_vertex_normals=True, props=props)
    params = mi.traverse(mesh)
    params["vertex_positions"], params["vertex_normals"] = points.ravel(), normals.ravel()
    params["faces"] = faces.ravel().astype(np.uint32)
    params.update()
    return mesh


def light(described):
    emitter = {"type": "area", "radiance": {"type": "rgb", "value": described["radiance"]}}
    (kind, shape), = described["shape"].items()
    if "Sphere" in shape:
        return {"type": "sphere", **shape["Sphere"], "emitter": emitter}
    v = shape if kind == "Window" else shape["Rect"]
    center, x, y = (np.array(v[k]) for k in ("center", "x", "y"))
    z = np.cross(x, y)
    to_world = np.eye(4)
    to_world[:3] = np.stack([x, y, z / np.linalg.norm(z), center], 1)
    return {"type": "rectangle", "to_world": T(to_world), "emitter": emitter}


class Mitsuba:
    def __init__(self, folder, settings):
        about = json.loads((folder / "lights.json").read_text())
        height, width = about["height"], about["width"]
        self.points = floats(folder, "points", height, width, 3)
        normals = floats(folder, "normals", height, width, 3)
        faces = triangles(self.points, floats(folder, "outside", height, width) > 0.5)
        assert len(faces) == about["triangles"], f"{len(faces)} triangles, wanted {about['triangles']}"
        self.inside = floats(folder, "inside", height * width) > 0.5
        began = time.perf_counter()
        parts = {f"light_{i}": light(l) for i, l in enumerate(about["lights"])}
        self.scene = mi.load_dict({"type": "scene", "room": room_mesh(self.points, normals, faces), **parts})
        self.build = time.perf_counter() - began
        self.sampler_type, self.per_ray, bsdf = settings
        self.integrator = mi.load_dict({"type": "direct", "emitter_samples": self.per_ray, "bsdf_samples": bsdf})
        # Rays meet the mesh a fifth of a pixel beside its corners, where none slips through; receivers at whose depth they meet
        # nothing (beside depth steps) or the window do not
        # take part.
        pixel = self.points[0, 1, 0] / -self.points[0, 1, 2] - self.points[0, 0, 0] / -self.points[0, 0, 2]
        self.directions = self.points.reshape(-1, 3) / -self.points.reshape(-1, 1, 3)[..., 2] + pixel * np.float32([0.2, 0.15, 0.0])
        d = dr.normalize(mi.Vector3f(self.directions.T))
        met = self.scene.ray_intersect(mi.Ray3f(mi.Point3f(0.0), d))
        at_depth = abs(met.p.numpy()[2] / self.points[..., 2].ravel() - 1.0) < 0.03
        self.inside &= at_depth & ~met.shape.is_emitter().numpy()

    def estimate(self, samples, seed):
        """Radiance of the white room at each receiver, from `samples` samples of any light."""
        count = len(self.directions)
        axes = [mi.Float(np.ascontiguousarray(self.directions[:, k])) for k in range(3)]
        rays = -(-samples // self.per_ray)
        # Powers of two, which every sampler takes.
        each = min(1 << (rays - 1).bit_length(), 1 << int(math.log2(LAUNCH / count)))
        launches = -(-rays // each)
        total = np.zeros(count)
        for launch in range(launches):
            sampler = mi.load_dict({"type": self.sampler_type, "sample_count": each})
            sampler.seed(seed * 1000 + launch, count * each)
            if self.sampler_type != "independent":
                sampler.set_samples_per_wavefront(each)
            index = dr.arange(mi.UInt32, count * each) // each
            d = dr.normalize(mi.Vector3f(*(dr.gather(mi.Float, axes[k], index) for k in range(3))))
            ray = mi.RayDifferential3f(mi.Ray3f(mi.Point3f(0.0), d))
            value, _, _ = self.integrator.sample(self.scene, sampler, ray)
            total += np.array(dr.block_sum(value.x, each))
        return total / (launches * each)

    def run(self, samples):
        """Seconds of one run by the clock and of processors, and its error."""
        wall, cpu = time.perf_counter(), time.process_time()
        a, b = self.estimate(samples, 1), self.estimate(samples, 2)
        wall, cpu = (time.perf_counter() - wall) / 2, (time.process_time() - cpu) / 2
        a, b = a[self.inside], b[self.inside]
        return wall, cpu, abs(a - b).mean() / math.sqrt(2) / a.mean()


def ours(program, effort):
    out = subprocess.run([program, "run", effort], check=True, capture_output=True, text=True).stdout
    told = json.loads(out)
    return told["seconds"], told["cpu"], told["error"]


def search(run, error, samples):
    """The samples that reach the error: as many as given, or twice, four times as many ..."""
    while True:
        wall, cpu, reached = run(samples)
        print(f"  {samples:6} samples: error {reached:.2%}, {wall:.2f} s, processors {cpu:.2f} s", flush=True)
        if reached <= error:
            return samples
        samples *= 2


def main():
    arguments = argparse.ArgumentParser()
    arguments.add_argument("program", help="the built bench `direct`")
    arguments.add_argument("--error", type=float, default=0.01)
    arguments.add_argument("--rounds", type=int, default=3)
    a = arguments.parse_args()
    threads = int(os.environ.setdefault("RAYON_NUM_THREADS", "2"))
    dr.set_thread_count(threads)
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run([a.program, folder, "prepare"], check=True)
        candidates = []
        for settings in (("independent", 1, 1), ("independent", 1, 0), ("multijitter", 4, 0)):
            m = Mitsuba(Path(folder), settings)
            began = time.process_time()
            m.estimate(256, 0)
            first = time.process_time() - began
            wall, cpu, error = m.run(256)
            print(
                f"Mitsuba, {settings[0]} sampler, {settings[1]} samples of lights and {settings[2]} of the surface a ray: built {m.build:.2f} s, "
                f"compiling {first - cpu:.2f} s of processors; 256 samples: error {error:.2%}, {wall:.2f} s, processors {cpu:.2f} s",
                flush=True,
            )
            candidates.append((error**2 * cpu, error, m, settings))
    _, error, m, settings = min(candidates, key=lambda c: c[0])
    print("ours, target error of each light")
    # The target holds in each tile, so the whole gets better than that.
    for effort in (f"{100 * a.error * factor:.3g}%" for factor in (8, 5.6, 4, 2.8, 2, 1.4, 1, 0.7)):
        wall, cpu, reached = ours(a.program, effort)
        print(f"  {effort:>6}: error {reached:.2%}, {wall:.2f} s, processors {cpu:.2f} s", flush=True)
        if reached <= a.error:
            break
    print("Mitsuba", settings, "samples of any light")
    # Independent samples: the error falls with the square root, so there is no need to try much fewer.
    samples = search(m.run, a.error, 2 ** int(math.log2(256 * max(1.0, error / a.error) ** 2)))
    table = []
    for _ in range(a.rounds):
        table.append([ours(a.program, effort), m.run(samples)])
    # Other work only ever adds.
    (wall, cpu, error), (their_wall, their_cpu, their_error) = np.array(table).min(0)
    print(f"ours {wall:.2f} s, processors {cpu:.2f} s, error {error:.2%}; Mitsuba {their_wall:.2f} s, {their_cpu:.2f} s, {their_error:.2%}")
    # Both errors fall with the samples; bring the times to the same error, Mitsuba's by the square root, ours as if it did too.
    same = (their_error / error) ** 2
    print(f"Mitsuba takes {their_wall / wall:.1f} x the time by the clock, {their_cpu / cpu:.1f} x of processors; at equal error {their_cpu / cpu * same:.1f} x")


main()
