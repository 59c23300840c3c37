"""What the renderers share: the receivers, the triangles around them, and the lights."""

import json
import sys
import time
from pathlib import Path

import numpy as np

HERE = Path(__file__).parent


def surface(camera):
    """Points of the mesh and normals at them, (2, height, width, 3): a wavy wall about 3 m away with a ridge, no depth step.

    Camera at the origin, x right, y up, looking along -z; pixel (j, i) has its center at (j + 0.5, i + 0.5)."""
    width, height = camera["width"], camera["height"]
    f = 0.5 * width / np.tan(0.5 * np.radians(camera["fov_x"]))
    j, i = np.meshgrid(np.arange(width), np.arange(height))
    waves = 3.0 + 0.12 * np.sin(0.7 * j + 0.4) * np.cos(0.5 * i) + 0.08 * np.sin(0.02 * i * j)
    ridge = 0.7 * np.exp(-(((j - 16.0 + 0.25 * (i - 10.0)) / 3.0) ** 2)) * (0.75 + 0.25 * np.cos(0.4 * i))
    z = (waves - ridge).astype(np.float32)
    points = np.stack([(j + 0.5 - 0.5 * width) / f * z, (0.5 * height - i - 0.5) / f * z, -z], -1).astype(np.float32)
    normals = np.zeros(points.shape)
    corners = points.reshape(-1, 3).astype(np.float64)
    for triangle in triangles(points):
        a, b, c = corners[triangle]
        normals.reshape(-1, 3)[triangle] += np.cross(b - a, c - a)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    return np.stack([points, normals.astype(np.float32)])


def triangles(points):
    """The triangles of `SceneMesh` where no depth step tears it: each quad is split along the diagonal whose ends differ less in
    depth, top left to bottom right if they are alike; counter-clockwise as the camera sees them."""
    z = -points[..., 2]
    height, width = z.shape
    out = []
    for i in range(height - 1):
        for j in range(width - 1):
            a, b, c, d = (k + i * width + j for k in (0, 1, width, width + 1))
            rising = abs(z[i, j + 1] - z[i + 1, j]) < abs(z[i, j] - z[i + 1, j + 1])
            out += [[a, c, b], [b, c, d]] if rising else [[a, c, d], [a, d, b]]
    return np.array(out)


class Scene:
    """Receivers lie a little above the mesh, so that no renderer's own guard against self-intersection decides."""

    def __init__(self):
        text = json.loads((HERE / "configurations.json").read_text())
        self.lights = text["lights"]
        points, normals = np.load(HERE / "surface.npy")
        self.triangles = triangles(points)
        self.corners = points.reshape(-1, 3)
        self.normals = normals.reshape(-1, 3)
        self.receivers = self.corners + self.normals * np.float32(text["lift"])

    def results(self):
        """(light, lobe or None, with the mesh as an obstacle), in the order in which results are stored."""
        for light in self.lights:
            lobes = light["shape"].get("Window", {}).get("lobes", [None])
            for lobe in lobes:
                for blocked in (False, True):
                    yield light, lobe, blocked


def box_corners(center, axes):
    """Corners and outward quads of a box given by half edges."""
    center, axes = np.array(center), np.array(axes)
    if np.linalg.det(axes) < 0:
        axes = axes[[1, 0, 2]]
    signs = np.array([[x, y, z] for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)])
    quads = [[1, 3, 7, 5], [0, 4, 6, 2], [2, 6, 7, 3], [0, 1, 5, 4], [4, 5, 7, 6], [0, 2, 3, 1]]
    return center + signs @ axes, np.array(quads)


def lamp_mesh(lamp):
    """Corners and triangles, counter-clockwise from the emitting side, of a rectangle, a box or a mesh."""
    (kind, v), = lamp.items()
    if kind == "Mesh":
        return np.array(v["corners"]), np.array(v["triangles"])
    if kind == "Box":
        corners, quads = box_corners(v["center"], v["axes"])
    else:
        center, x, y = (np.array(v[k]) for k in ("center", "x", "y"))
        corners, quads = np.array([center - x - y, center + x - y, center + x + y, center - x + y]), np.array([[0, 1, 2, 3]])
    return corners, np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


def opening(window, size=60.0):
    """Corners and quads of a closed box, `size` meters wide, around the room side of a window, with the window as its only hole."""
    center, x, y = (np.array(window[k]) for k in ("center", "x", "y"))
    ex, ey = x / np.linalg.norm(x), y / np.linalg.norm(y)
    room = np.cross(ex, ey)
    ring = lambda a, b, depth: [center + sx * a * ex + sy * b * ey + depth * room for sx, sy in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    half = 0.5 * size
    corners = ring(np.linalg.norm(x), np.linalg.norm(y), 0.0) + ring(half, half, 0.0) + ring(half, half, size)
    around = lambda a, b: [[a + k, a + (k + 1) % 4, b + (k + 1) % 4, b + k] for k in range(4)]
    return np.array(corners), np.array(around(0, 4) + around(4, 8) + [[8, 9, 10, 11]])


def unit(v):
    return np.array(v, float) / np.linalg.norm(v)


def run(name, version, how, irradiance):
    """Calls `irradiance(scene, light, lobe, blocked)` -> (batches, receivers) for the lights named as arguments, or all, and stores
    `NAME.npy`: (results, 2, receivers), irradiance / pi and its standard error, and `NAME.json`: what made it, and the standard
    error of each result's mean over the receivers."""
    s = Scene()
    results = list(s.results())
    wanted = sys.argv[1:]
    shape = (len(results), 2, len(s.receivers))
    values, of_mean = np.zeros(shape, "<f4"), [0.0] * len(results)
    if wanted:
        values = np.load(HERE / f"{name}.npy")
        assert values.shape == shape, f"{name}.npy holds other results: run all"
        of_mean = json.loads((HERE / f"{name}.json").read_text())["stderr_of_mean"]
    for i, (light, lobe, blocked) in enumerate(results):
        if wanted and light["name"] not in wanted:
            continue
        began = time.time()
        batches = irradiance(s, light, lobe, blocked)
        spread = lambda v: v.std(0, ddof=1) / len(v) ** 0.5
        values[i] = batches.mean(0), spread(batches)
        of_mean[i] = float(f"{spread(batches.mean(1)):.4g}")
        label = light["name"] + (f" {lobe['bandwidth']:g}" if lobe else "") + (" blocked" if blocked else "")
        mean, error = values[i].mean(1)
        line = f"{label:44} {mean:.6g}  standard error of a receiver {error / mean:.2%}, of the mean {of_mean[i] / mean:.3%}"
        print(f"{line}  {time.time() - began:.1f} s", file=sys.stderr)
    np.save(HERE / f"{name}.npy", values)
    note = {"version": version, "how": how, "stderr_of_mean": of_mean}
    (HERE / f"{name}.json").write_text(json.dumps(note, indent=1) + "\n")


if __name__ == "__main__":
    camera = json.loads((HERE / "configurations.json").read_text())["camera"]
    np.save(HERE / "surface.npy", surface(camera))
    points, normals = np.load(HERE / "surface.npy")
    z = -points[..., 2]
    steps = [abs(a - b) / np.minimum(a, b) for a, b in ((z[1:], z[:-1]), (z[:, 1:], z[:, :-1]))]
    print("largest depth step", max(s.max() for s in steps), "depths", z.min(), z.max(), "facing", normals[..., 2].min())
