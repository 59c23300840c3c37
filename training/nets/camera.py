"""What a camera does to linear light, for training: exposure, white balance, vignetting, tone curve, white, noise, JPEG. Batches [B, 3, h, w]."""

import math

import torch
import torch.nn.functional as F

from augment import choose, uniform


def exposed(g, photo, light):
    """The photo with 98 % of the pixels that are no light below 0.9..1, white balance off by about 10 %; and the gain [B, 3, 1, 1]."""
    balance = torch.exp(0.1 * torch.randn(len(photo), 3, 1, 1, generator=g))
    gains = []
    for x, mask in zip((photo * balance).mean(1), light[:, 0]):
        gains.append((0.9 + 0.1 * torch.rand(1, generator=g)) / x[mask == 0].quantile(0.98).clamp(min=1e-4))
    gain = torch.stack(gains).view(-1, 1, 1, 1) * balance
    return photo * gain, gain


def photographed(g, photo):
    """Most photos clip at white; a quarter keep what is brighter. A half has gone through tone curve, vignetting and JPEG."""
    h, w = photo.shape[-2:]
    y, x = torch.meshgrid(torch.linspace(-h / w, h / w, h), torch.linspace(-1, 1, w), indexing="ij")
    worse = photo * (1 - 0.35 * uniform(g, photo) * (x * x + y * y))
    bend = torch.exp(0.25 * torch.randn(len(photo), 1, 1, 1, generator=g))
    worse = torch.where(worse < 1, worse.clamp(min=0) ** bend, worse)
    worse = worse * (1 + 0.02 * torch.randn(photo.shape, generator=g))
    out = choose(g, 0.5, worse.clamp(min=0), photo)
    out = choose(g, 0.75, out.clamp(max=1), out)
    return choose(g, 0.3, jpeg(out.clamp(max=1), 2 + 20 * uniform(g, photo)), out)


def jpeg(photo, step):
    """Blocks of 8 x 8 whose cosine terms are rounded, finer frequencies more: `step` of 255 for the first."""
    k = torch.arange(8)
    basis = torch.cos((2 * k[None] + 1) * k[:, None] * math.pi / 16) * torch.where(k == 0, 0.125**0.5, 0.5)[:, None]
    size = step / 255 * (1 + (k[:, None] + k[None]) / 2)
    b, c, h, w = photo.shape
    blocks = F.unfold((photo ** (1 / 2.2)).reshape(b * c, 1, h, w), 8, stride=8).unflatten(1, (8, 8)).permute(0, 3, 1, 2)
    terms = basis @ blocks @ basis.T
    size = size.expand(b, c, 8, 8).reshape(b * c, 1, 8, 8)
    blocks = basis.T @ ((terms / size).round() * size) @ basis
    out = F.fold(blocks.permute(0, 2, 3, 1).flatten(1, 2), (h, w), 8, stride=8).reshape(b, c, h, w)
    return out.clamp(0, 1) ** 2.2
