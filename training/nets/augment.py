"""Degrades inputs as a camera, a depth sensor and hand-drawn masks do. All on batches [B, channels, 120, 160], from one torch.Generator, hence from a seed.

A global error of the depth's scale needs no augmentation: networks divide depth by its mean. A slowly varying one does not vanish."""

import math
import sys
from dataclasses import replace
from pathlib import Path

import torch
import torch.nn.functional as F

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from camera import batched  # noqa: E402
from camera import depth as flaws  # noqa: E402


def uniform(g, x):
    """One number in 0..1 per item, [B, 1, 1, 1]."""
    return torch.rand(len(x), 1, 1, 1, generator=g)


def choose(g, probability, changed, x):
    """Per item `changed` with `probability`, else `x`."""
    return torch.where(uniform(g, x) < probability, changed, x)


def smooth(g, x, channels, grid=(4, 5)):
    """Smooth noise of unit variance, as large as `x`."""
    return batched.smooth(torch.randn(len(x), channels, *grid, generator=g), *x.shape[-2:])


def blur(x, radius):
    size = 2 * radius + 1
    return F.avg_pool2d(F.avg_pool2d(F.pad(x, (radius,) * 4, mode="replicate"), (size, 1), 1), (1, size), 1)


def unit(x):
    """Vectors [B, 3, h, w] of length 1; F.normalize takes ten times as long along this axis."""
    return x / torch.sqrt((x * x).sum(1, keepdim=True)).clamp(min=1e-12)


def mirrored(x, vector=False):
    """The horizontally mirrored room; the x of vectors changes its sign."""
    x = x.flip(-1)
    return torch.cat([-x[:, :1], x[:, 1:]], 1) if vector else x


def mirrored_maps(maps):
    """Maps [.., 30, 40, 8, 16, 3] of the mirrored room. The frame's x axis turns round against the mirrored one, so phi becomes pi - phi."""
    return maps.flip(-4).flip(-2).roll(8, -2)


def parts(g, own, every):
    """The part of a picture that each of three items of five shows, three fifths of it or more across, as a grid to sample; all of it where a mask `own`
    [B, 1, h, w] (of a light that is seen) would lose two thirds of itself. `every`: masks that must not fill it."""
    scale = 1 - 0.4 * torch.rand(len(own), 1, generator=g) * (torch.rand(len(own), 1, generator=g) < 0.6)
    at = (1 - scale) * (2 * torch.rand(len(own), 2, generator=g) - 1)
    grids = lambda scale, at: F.affine_grid(torch.cat([torch.diag_embed(scale.expand(-1, 2)), at[..., None]], 2), own.shape, align_corners=False)
    sums = lambda x: x.sum((1, 2, 3))
    some, all_of_it = grids(scale, at), grids(torch.ones_like(scale), torch.zeros_like(at))
    keep = (sums(part(own, some)) * scale[:, 0] ** 2 >= sums(own) / 3) & (part(every, some).mean((1, 2, 3)) < 0.8)
    return torch.where(keep.view(-1, 1, 1, 1), some, all_of_it)


def part(x, grid):
    """The pixels of `x` that `grid` names."""
    return F.grid_sample(x, grid, mode="nearest", align_corners=False)


def xyz(depth, fov_x):
    """Points [B, 3, h, w] in meters of planar `depth` [B, 1, h, w]; `fov_x` [B] in degrees."""
    height, width = depth.shape[-2:]
    focal = (0.5 * width / torch.tan(torch.deg2rad(fov_x) / 2)).view(-1, 1, 1, 1)
    x = (torch.arange(width) + 0.5 - width / 2).view(1, 1, 1, -1) / focal
    y = (height / 2 - torch.arange(height) - 0.5).view(1, 1, -1, 1) / focal
    return torch.cat([x * depth, y * depth, -depth], 1)


def normals_of(points):
    """Unit normals from central differences of points, facing the camera."""
    p = F.pad(points, (1, 1, 1, 1), mode="replicate")
    right, down = p[..., 1:-1, 2:] - p[..., 1:-1, :-2], p[..., 2:, 1:-1] - p[..., :-2, 1:-1]
    n = unit(torch.linalg.cross(down, right, dim=1))
    return torch.where((n * points).sum(1, keepdim=True) > 0, -n, n)


def exposed(g, photo, light):
    """Returns the photos under a random white balance, exposed so that 98 % of the pixels without a light source lie below 0.9..1, and the gains [B, 3, 1, 1]."""
    balance = batched.sampled(g, len(photo)).white_balance
    gains = []
    for x, mask in zip((photo * balance).mean(1), light[:, 0]):
        gains.append((0.9 + 0.1 * torch.rand(1, generator=g)) / x[mask == 0].quantile(0.98).clamp(min=1e-4))
    gain = torch.stack(gains).view(-1, 1, 1, 1) * balance
    return photo * gain, gain


def photographed(g, photo):
    """Exposed photos, three quarters of them as a camera stores them; the others keep what is brighter than white."""
    at = torch.rand(len(photo), generator=g) < 0.75
    if not at.any():
        return photo
    out, taken = photo.clone(), photo[at]
    camera = batched.sampled(g, len(taken))
    camera = replace(camera, white_balance=torch.ones_like(camera.white_balance))  # `exposed` applies it
    out[at] = batched.photograph(taken, camera, torch.randn(taken.shape, generator=g))
    return out


def measured_depth(g, depth):
    """Depth from sensors, holes filled from around."""
    rng = batched.generator(g)
    sensors = [flaws.sample_sensor(rng) for _ in depth]
    got = torch.empty_like(depth)
    for width in sorted({sensor.width for sensor in sensors}):
        at = [k for k, sensor in enumerate(sensors) if sensor.width == width]
        noise = batched.sensor_noise(g, len(at), *depth.shape[-2:], width)
        got[at] = batched.sensor_depth(depth[at], batched.stack([sensors[k] for k in at]), noise)
    known = (~got.isnan()).to(depth.dtype)
    weight = blur(known, 8)
    filled = torch.where(weight > 0.01, blur(got.nan_to_num(), 8) / weight.clamp(min=0.01), depth)
    return torch.where(known > 0, got, filled)


def worse_depth(g, depth):
    """Depth as networks estimate it, a third as sensors measure it."""
    networks = batched.sampled(g, len(depth), flaws.sample_network)
    estimated = batched.network_depth(depth, networks, torch.randn(len(depth), 1, *flaws.SLOW, generator=g))
    return choose(g, 1 / 3, measured_depth(g, depth), estimated)


def each_color(g, albedo):
    """A number of about unit variance for each color of the picture, [B, 1, h, w]: the same wherever a paint is."""
    color = (albedo.clamp(0, 0.999) * 5).long()
    color = color[:, 0] * 25 + color[:, 1] * 5 + color[:, 2]
    return torch.randn(len(albedo), 125, generator=g).gather(1, color.flatten(1)).view(albedo[:, :1].shape)


def worse_albedo(g, albedo):
    """Wrong level, slow color error, and an error of its own for each color, as an estimate makes from segment to segment."""
    level = 0.15 * torch.randn(len(albedo), 1, 1, 1, generator=g) + 0.15 * smooth(g, albedo, 3)
    return (albedo * torch.exp(level + 0.15 * blur(each_color(g, albedo), 1))).clamp(0.01, 0.98)


def repainted(g, albedo):
    """Another albedo for each color of the half of the items."""
    paint = torch.cat([each_color(g, albedo) for _ in range(3)], 1)
    paint = 0.4 * paint.mean(1, keepdim=True) + 0.15 * paint
    return choose(g, 0.5, (albedo * torch.exp(paint)).clamp(0.01, 0.95), albedo)


def recolored(g, photo, albedo, spread=0.35):
    """Returns photos and albedos, half of the items under other paint. The factor of an albedo is the exponential of a smooth random function of its
    logarithm, hence equal for equal paints, with a standard deviation of about `spread` in brightness and a third of that in each channel. The photo
    gets the same factor; bounces of the new paint are left out."""
    old = albedo.clamp(min=0.02)
    log = torch.log(old)
    shift = 0
    for _ in range(4):
        turns = 0.7 * torch.randn(len(albedo), 3, 3, generator=g)
        phase = 2 * math.pi * torch.rand(len(albedo), 3, 1, 1, generator=g)
        waves = torch.sin(torch.einsum("bij,bjhw->bihw", turns, log) + phase) * torch.randn(len(albedo), 3, 1, 1, generator=g)
        shift = shift + spread / 2 * (0.94 * waves[:, :1] + 0.33 * waves) * math.sqrt(2)
    new = (albedo * torch.exp(shift)).clamp(0.02, 0.92)
    at = uniform(g, albedo) < 0.5
    return torch.where(at, photo * new / old, photo), torch.where(at, new, albedo)


def ragged(g, mask):
    """Masks [B, 1, h, w], 60 % of them as people and programs draw them, unless little would be left."""
    drawn = batched.ragged_mask(mask, batched.sampled(g, len(mask), flaws.sample_mask), batched.mask_noise(g, len(mask)))
    enough = drawn.sum((1, 2, 3), keepdim=True) > 0.3 * mask.sum((1, 2, 3), keepdim=True)
    return choose(g, 0.6, torch.where(enough, drawn, mask), mask)


def geometry(g, depth, normal, fov_x, share=0.5):
    """Normal and points, [B, 6, h, w]; a `share` of items as from an estimated depth, a third of these with normals from that depth."""
    worse = worse_depth(g, depth)
    bent = unit(normal + 0.15 * smooth(g, depth, 3))
    bent = choose(g, 0.33, normals_of(xyz(worse, fov_x)), bent)
    at = uniform(g, depth) < share
    return torch.cat([torch.where(at, bent, normal), xyz(torch.where(at, worse, depth), fov_x)], 1)
