"""Maps of incoming radiance: 8 x 16 texels of the hemisphere about a normal, and spherical Gaussians drawn into them.

Texel (i, j): theta = (i + 0.5) / 8 pi / 2 from the normal, phi = (j + 0.5) / 16 2 pi - pi; direction = sin theta cos phi x + sin theta sin phi y +
cos theta n."""

import functools

import numpy as np
import torch
import torch.nn.functional as F

ROWS, COLUMNS = 8, 16


@functools.cache
def texels():
    """Unit directions [128, 3] in the local frame (x, y, n) and solid angles [128] (they sum to 2 pi)."""
    theta, phi = np.meshgrid((np.arange(ROWS) + 0.5) / ROWS * np.pi / 2, (np.arange(COLUMNS) + 0.5) / COLUMNS * 2 * np.pi - np.pi, indexing="ij")
    d = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], -1).reshape(-1, 3)
    edge = np.cos(np.arange(ROWS + 1) / ROWS * np.pi / 2)
    angle = np.repeat((edge[:-1] - edge[1:]) * 2 * np.pi / COLUMNS, COLUMNS)
    return torch.tensor(d, dtype=torch.float32), torch.tensor(angle, dtype=torch.float32)


@functools.cache
def cosine_weights():
    """[128], to sum radiance with: a constant environment of radiance 1 has the shading 1 (irradiance / pi)."""
    edge = np.sin(np.arange(ROWS + 1) / ROWS * np.pi / 2) ** 2
    return torch.tensor(np.repeat((edge[1:] - edge[:-1]) / COLUMNS, COLUMNS), dtype=torch.float32)


def shading(maps):
    """E [.., 3] of maps [.., 128, 3]."""
    return torch.einsum("...tc,t->...c", maps, cosine_weights())


def frame(normal):
    """Axes x, y, n as the rows of [.., 3, 3]: y towards camera up, or towards -z where the normal is vertical."""
    up, ahead = normal.new_tensor([0.0, 1.0, 0.0]), normal.new_tensor([0.0, 0.0, -1.0])
    up = torch.where(normal[..., 1:2].abs() > 0.99, ahead, up)
    y = F.normalize(up - (up * normal).sum(-1, keepdim=True) * normal, dim=-1)
    return torch.stack([torch.linalg.cross(y, normal), y, normal], -2)


def draw(axis, sharpness, weight):
    """Radiance [.., 128, 3] of the sums of K spherical Gaussians w exp(lambda (d.l - 1)): axis [.., K, 3], sharpness [.., K], weight [.., K, 3]."""
    d, _ = texels()
    lobes = torch.exp(sharpness[..., None] * (axis @ d.T - 1))
    return lobes.transpose(-1, -2) @ weight
