"""Tiny made-up rooms in the format of sample.npz, for tests: no light transport, only arrays of the right kind that hang together.

usage: synthetic.py DIR [--rooms 4]"""

import argparse
import json
import os

import numpy as np

import hemisphere


def smooth(rng, height, width, grid=(4, 5)):
    """Noise in about -1..1 that varies slowly."""
    noise, out = rng.uniform(-1, 1, grid), 0
    i, j = np.linspace(0, grid[0] - 1, height), np.linspace(0, grid[1] - 1, width)
    for a in range(grid[0]):
        for b in range(grid[1]):
            out = out + noise[a, b] * np.outer(np.clip(1 - abs(i - a), 0, 1), np.clip(1 - abs(j - b), 0, 1))
    return out


def sample(seed):
    """A box seen from inside: walls, lamps near the ceiling, shadows with slow edges, indirect light as a share of all light."""
    rng = np.random.default_rng(seed)
    fov = rng.uniform(50, 65)
    i, j = np.mgrid[0:240, 0:320] + 0.5
    focal = 160 / np.tan(np.radians(fov) / 2)
    ray = np.stack([(j - 160) / focal, (120 - i) / focal, -np.ones_like(i)], -1)
    walls = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1]], float)
    distance = np.array([rng.uniform(1, 3), rng.uniform(1, 3), 1.5, 1.3, rng.uniform(3, 5)])
    with np.errstate(divide="ignore"):
        reach = np.where(ray @ walls.T < 0, -distance / (ray @ walls.T), np.inf)
    wall, depth = reach.argmin(-1), reach.min(-1)
    normal, point = walls[wall], ray * depth[..., None]
    albedo = rng.uniform(0.2, 0.9, (5, 3))[wall]
    half = lambda x: x.reshape(120, 2, 160, 2, *x.shape[2:]).mean((1, 3))
    mask = np.zeros((240, 320), np.uint8)
    mask[4:16, 150:170] = 1
    sources, radiance, direct, shadow, traced, unknown = ["lamp_0", "inv_lamp", "inv_window.sky"], rng.uniform(2, 6, (3, 3)), [], [], [], []
    for _ in sources:
        to = np.array([rng.uniform(-1, 1), rng.uniform(0, 1.2), rng.uniform(-3, 0)]) - point
        square = (to * to).sum(-1)
        direct.append(half(np.clip((to * normal).sum(-1), 0, None) / square**1.5 * 0.1 * (mask == 0)))
        shadow.append(np.where(direct[-1] > 0, np.clip(0.5 + 4 * smooth(rng, 120, 160), 0, 1), 1))
        unknown.append(np.clip(3 * smooth(rng, 120, 160) - 0.5, 0, 1))
        traced.append(np.minimum(shadow[-1] * (1 - unknown[-1]) + unknown[-1], 1))
    direct, shadow, traced, unknown = map(np.stack, (direct, shadow, traced, unknown))
    weights = np.eye(3)[:, :, None] * radiance
    lit = np.einsum("shw,psc->phwc", direct * shadow, weights)
    bounce = lambda x: 0.5 * (half(albedo) * x).mean((1, 2), keepdims=True) * (1 + 0.3 * half(normal)[..., 1:2])
    indirect = bounce(lit)
    shading = lit.sum(0) + indirect.sum(0)
    maps = np.broadcast_to(shading[2::4, 2::4, None, None], (30, 40, hemisphere.ROWS, hemisphere.COLUMNS, 3)) * (
        1 + 0.5 * np.sin(np.arange(16) / 16 * 2 * np.pi)[:, None]
    )
    f16 = lambda x: x.astype(np.float16)
    return {
        "photo": f16(np.kron(half(albedo) * shading, np.ones((2, 2, 1))) + 5 * mask[..., None]),
        "albedo": f16(albedo),
        "normal": f16(normal),
        "rough": np.full((240, 320), 0.6, np.float16),
        "depth": depth.astype(np.float32),
        "light_mask": mask,
        "fov_x": np.float32(fov),
        "sources": np.array(sources),
        "source_radiance": radiance.astype(np.float32),
        "direct": f16(direct),
        "shadow": f16(shadow),
        "traced": f16(traced),
        "unknown": f16(unknown),
        "traced_direct": f16(direct),
        "traced_indirect": f16(0.7 * bounce(np.repeat((direct * traced)[..., None], 3, -1))),
        "paths": np.array(sources),
        "path_weights": weights.astype(np.float32),
        "indirect": f16(indirect),
        "maps": f16(maps),
        "maps_valid": (half(mask)[2::4, 2::4] == 0).astype(np.uint8),
    }


def write(folder, rooms):
    """`rooms` rooms in folder/train, a third as many in folder/val."""
    for split, seeds in {"train": range(rooms), "val": range(1000, 1000 + max(rooms // 3, 1))}.items():
        for seed in seeds:
            os.makedirs(f"{folder}/{split}/{seed:06d}", exist_ok=True)
            room = sample(seed)
            np.savez_compressed(f"{folder}/{split}/{seed:06d}/sample.npz", **room)
            sky = {"name": "sky", "direction": [0, 1, 0], "bandwidth": 1.0, "radiance": room["source_radiance"][2].tolist()}
            lights = {
                k: {"kind": "Sphere", "center": [0, 1, -2], "radius": 0.15, "radiance": room["source_radiance"][0].tolist()}
                for k in ("lamp_0", "inv_lamp")
            }
            lights["inv_window"] = {"kind": "Window", "center": [0, 0, 1], "half_x": [-1, 0, 0], "half_y": [0, 1, 0], "lobes": [sky]}
            with open(f"{folder}/{split}/{seed:06d}/lights.json", "w") as file:
                json.dump(lights, file)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder")
    parser.add_argument("--rooms", type=int, default=4)
    a = parser.parse_args()
    write(a.folder, a.rooms)
