"""Direct shading per unit radiance, differentiable in a light's place, size, direction and bandwidth: the twin of the program's stage Direct, through
which the networks that estimate lights learn. Points and normals are [B, P, 3], meters.

Lamps are boxes, in closed form (Lambert's formula with the horizon cut). Windows are sums over CELLS x CELLS places of the pane, for each lobe by itself;
a lobe sharper than those places can show is blurred to SHARPEST, which keeps what it sends."""

import torch

CELLS = 12
SHARPEST = 300.0


def dot(a, b):
    return (a * b).sum(-1)


def edge(a, b, normals):
    """Lambert's term of an edge: the angle it is seen under times its plane's normal along `normals`. Zero for an edge without length."""
    across = torch.linalg.cross(a, b, dim=-1)
    sine = torch.sqrt(dot(across, across) + 1e-20)
    return torch.atan2(sine, dot(a, b)) * dot(across, normals) / sine


def polygon(corners, points, normals):
    """E / L of convex polygons [B, K, 3] that shine to where their corners run counter-clockwise: [B, P]."""
    a = corners[:, None] - points[:, :, None]
    n = normals[:, :, None]
    b = a.roll(-1, 2)
    high, next_high = dot(a, n), dot(b, n)
    leaves, enters = (high >= 0) & (next_high < 0), (high < 0) & (next_high >= 0)
    cut = leaves | enters
    horizon = a + (b - a) * (high / torch.where(cut, high - next_high, 1.0))[..., None]
    at = lambda which: torch.where(which[..., None], horizon, 0).sum(2)
    start, end = torch.where(enters[..., None], horizon, a), torch.where(leaves[..., None], horizon, b)
    sides = torch.where((high >= 0) | (next_high >= 0), edge(start, end, n), 0).sum(2)
    closing = torch.where(cut.any(2), edge(at(leaves), at(enters), normals), 0)
    faced = dot(torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0], dim=-1)[:, None], a[:, :, 0]) < 0
    return torch.where(faced, (sides + closing).abs() / (2 * torch.pi), 0)


def box(centre, axes, points, normals):
    """E / L of boxes with half axes [B, 3, 3] that shine outwards: [B, P]."""
    axes = torch.where(torch.linalg.det(axes)[:, None, None] < 0, -axes, axes)
    total = 0
    for k in range(3):
        out, x, y = axes[:, k], axes[:, (k + 1) % 3], axes[:, (k + 2) % 3]
        for side in (1, -1):
            c = centre + side * out
            corners = torch.stack([c - x - side * y, c + x - side * y, c + x + side * y, c - x + side * y], 1)
            total = total + polygon(corners, points, normals)
    return total


def window(centre, x, y, directions, bandwidths, points, normals):
    """E / L of the lobes of windows with half axes x and y; the room lies where x cross y points. directions [B, L, 3] of unit length, bandwidths
    [B, L]: [B, L, P]."""
    k = (torch.arange(CELLS) + 0.5) / CELLS * 2 - 1
    u, v = (t.reshape(1, -1, 1) for t in torch.meshgrid(k, k, indexing="ij"))
    places = centre[:, None] + u * x[:, None] + v * y[:, None]
    inward = torch.linalg.cross(x, y, dim=-1)
    to = places[:, None] - points[:, :, None]
    square = dot(to, to) + 1e-4
    l = to / square.sqrt()[..., None]
    weight = dot(l, normals[:, :, None]).clamp(min=0) * -dot(l, inward[:, None, None]).clamp(max=0) * 4 / (square * torch.pi * CELLS**2)
    blunt = bandwidths.clamp(max=SHARPEST)
    lobes = [
        (weight * torch.exp(blunt[:, k, None, None] * (dot(l, directions[:, None, None, k]) - 1))).sum(2)
        * (blunt / bandwidths.clamp(min=1e-6))[:, k, None]
        for k in range(directions.shape[1])
    ]
    return torch.stack(lobes, 1)
