"""The floor of LightNet: maps gathered from the picture itself, without learning."""

import math

import torch

import hemisphere

STEPS = 48
NEAR, FAR = 0.05, 12.0  # m, the range of a ray's samples


def gather(points, radiance, places, fov_x):
    """Maps [N, 128, 3] at `places` [N, 6] (normal, xyz) of a picture: `points` [3, h, w] (m) and linear `radiance` [3, h, w].

    A ray takes the radiance of the pixel where it first passes behind the seen depth, by less than a fifth of that; one that meets nothing takes the
    picture's mean."""
    _, height, width = points.shape
    depth, focal = -points[2], 0.5 * width / math.tan(math.radians(fov_x) / 2)
    normal, origin = places[:, :3] / places[:, :3].norm(dim=1, keepdim=True), places[:, 3:]
    d = hemisphere.texels()[0] @ hemisphere.frame(normal)  # [N, 128, 3]
    pixel, done = torch.full(d.shape[:2], -1), torch.zeros(d.shape[:2], dtype=torch.bool)
    for step in range(STEPS):
        p = (origin + 0.02 * normal)[:, None] + d * NEAR * (FAR / NEAR) ** (step / (STEPS - 1))
        z = -p[..., 2]
        column = torch.floor(width / 2 + focal * p[..., 0] / z.clamp(min=0.01)).long()
        row = torch.floor(height / 2 - focal * p[..., 1] / z.clamp(min=0.01)).long()
        inside = (z > 0.01) & (column >= 0) & (column < width) & (row >= 0) & (row < height)
        at = row.clamp(0, height - 1) * width + column.clamp(0, width - 1)
        behind = z - depth.flatten()[at]
        hit = inside & ~done & (behind > 0) & (behind < 0.2 * depth.flatten()[at])
        pixel[hit] = at[hit]
        done |= hit | ~inside
    colors = radiance.flatten(1).T
    return torch.where((pixel >= 0)[..., None], colors[pixel.clamp(min=0)], colors.mean(0))
