"""The shape of a light as numbers: what the networks that estimate lights learn from. All in camera space, meters, from an entry of lights.json."""

import numpy as np

LOBES = ("sun", "sky", "ground")
POINTS = 64


def form(light):
    """36 numbers: center 3; half axes 3 x 3 (of a window x, y and zeros); of three lobes direction 3, bandwidth, radiance 3 (zeros where there is none);
    radiance of a lamp 3."""
    lobes = np.zeros((3, 7))
    for lobe in light.get("lobes", []):
        d = np.array(lobe["direction"], float)
        lobes[LOBES.index(lobe["name"])] = [*d / np.linalg.norm(d), lobe["bandwidth"], *lobe["radiance"]]
    centre, axes = body(light)
    return np.concatenate([centre, axes.ravel(), lobes.ravel(), light.get("radiance", np.zeros(3))]).astype(np.float32)


def body(light):
    """Center and half axes of the box that holds a light."""
    kind = light["kind"]
    if kind == "Mesh":
        corners = np.unique(np.array(light["triangles"], float).reshape(-1, 3), axis=0)
        _, _, axes = np.linalg.svd(corners - corners.mean(0), full_matrices=False)
        along = corners @ axes.T
        low, high = along.min(0), along.max(0)
        return (low + high) / 2 @ axes, axes * ((high - low) / 2)[:, None]
    if kind == "Sphere":
        axes = np.eye(3) * light["radius"]
    elif kind == "Box":
        axes = np.array(light["half_axes"], float)
    else:
        axes = np.array([light["half_x"], light["half_y"], np.zeros(3)], float)
    return np.array(light["center"], float), axes


def surface(light):
    """64 points on what shines, the same for the same light."""
    kind, k = light["kind"], np.arange(POINTS)
    if kind == "Sphere":
        z, phi = 1 - (k + 0.5) / POINTS * 2, k * 2.399963
        ball = np.stack([np.sqrt(1 - z * z) * np.cos(phi), np.sqrt(1 - z * z) * np.sin(phi), z], 1)
        return np.array(light["center"]) + light["radius"] * ball
    if kind == "Mesh":
        triangles = np.array(light["triangles"], float)
    else:
        centre, axes = body(light)
        pairs = [(0, 1, 2)] if kind != "Box" else [(0, 1, 2), (1, 2, 0), (2, 0, 1)]
        triangles = []
        for i, j, n in pairs:
            for side in (1, -1) if kind == "Box" else (0,):
                c, (x, y) = centre + side * axes[n], (axes[i], axes[j])
                triangles += [[c - x - y, c + x - y, c + x + y], [c - x - y, c + x + y, c - x + y]]
        triangles = np.array(triangles)
    a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    which = np.searchsorted(np.cumsum(area) / area.sum(), (k + 0.5) / POINTS).clip(max=len(area) - 1)
    u, v = (k * 0.7548776662) % 1, (k * 0.5698402910) % 1  # the R2 sequence, folded into the triangle
    u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
    return a[which] + u[:, None] * (b - a)[which] + v[:, None] * (c - a)[which]
