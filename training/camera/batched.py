"""The camera of `model.py` and the depth and masks of `depth.py` in torch, for batches [B, C, h,
w].

Parameters are the same dataclasses, whose numbers `stack` turns into tensors, one per item. All but
the rounding in `displaced` and `steps` is differentiable; `quantize` passes gradients straight
through its rounding."""

import math
from dataclasses import fields
from functools import lru_cache

import numpy as np
import torch
import torch.nn.functional as F

from . import depth as depth_model
from . import model


def stack(items, dtype=torch.float32):
    """Returns the parameters of several items as one: tensors [B, 1, 1, 1], or [B, 3, 1, 1] of
    triples. An int that all items share stays an int."""
    joined = {}
    for field in fields(items[0]):
        values = [getattr(item, field.name) for item in items]
        joined[field.name] = values[0] if field.name == "width" else torch.tensor(values, dtype=dtype).view(len(items), -1, 1, 1)
    return type(items[0])(**joined)


def generator(g):
    """Returns a NumPy generator seeded by the torch generator `g`."""
    return np.random.default_rng(torch.randint(2**62, (1,), generator=g).item())


def sampled(g, count, sample=model.sample):
    """Returns the stacked parameters that `sample` draws."""
    rng = generator(g)
    return stack([sample(rng) for _ in range(count)])


def incident(x, camera):
    """Returns the light that the sensors receive, in units of white."""
    x = glare(blurred(x, camera.softness), camera.glare, camera.glare_slope)
    return balance(expose(vignette(x, camera.vignetting), camera.exposure), camera.white_balance)


def develop(received, camera, noise):
    """Returns the sRGB values, 0 to 1, of the light on the sensors and of standard normal `noise`,
    before JPEG."""
    x = add_noise(received, correlate(noise, camera.grain), camera.shot_noise, camera.read_noise, camera.white_balance)
    x = blur_chroma(clip(x, camera.saturation), camera.chroma_blur)
    return encode(tone(sharpen(x, camera.sharpening), camera.saturation))


def photograph(linear, camera, noise):
    """Returns what a program reads of the stored photos, in linear light."""
    stored = jpeg(develop(incident(linear, camera), camera, noise), camera.jpeg_quality)
    return decode(stored)


def gaussian_matrix(size, sigma):
    """Returns the matrices [B, 1, size, size] that blur rows of pixels by Gaussians of `sigma` [B,
    1, 1, 1] pixels, integrated over each pixel."""
    at = torch.arange(size, dtype=sigma.dtype)
    scale = 1 / (sigma.clamp(min=1e-6) * math.sqrt(2))
    edges = torch.erf((torch.arange(size + 1, dtype=sigma.dtype) - 0.5) * scale)
    taps = (edges[..., 1:] - edges[..., :-1]) / 2
    matrix = taps[:, :, 0][:, :, (at[:, None] - at).abs().long()]
    return matrix / matrix.sum(-1, keepdim=True)


def blurred(x, sigma):
    """Returns `x` blurred by Gaussians of `sigma` shares of the width."""
    h, w = x.shape[-2:]
    return gaussian_matrix(h, sigma * w) @ x @ gaussian_matrix(w, sigma * w).mT


@lru_cache(maxsize=32)
def glare_matrices(h, w, dtype):
    """Returns the rows' and columns' matrices of each of the glare's Gaussians, and the plane [h,
    w] of the light that each keeps in the picture."""
    pairs = [[model.gaussian_matrix(n, sigma * w, False) for n in (h, w)] for sigma in model.GLARE_WIDTHS]
    return [(torch.tensor(a, dtype=dtype), torch.tensor(b, dtype=dtype), torch.tensor(np.outer(a.sum(1), b.sum(1)), dtype=dtype)) for a, b in pairs]


def glare(x, share, slope):
    """Returns the pictures of which the lenses scatter a `share`."""
    relative = torch.tensor(model.GLARE_WIDTHS, dtype=x.dtype) / model.GLARE_WIDTHS[0]
    weights = relative ** -slope.view(-1, 1)
    weights = weights / weights.sum(1, keepdim=True)
    scattered = 0
    for k, (rows, columns, kept) in enumerate(glare_matrices(*x.shape[-2:], x.dtype)):
        scattered = scattered + weights[:, k].view(-1, 1, 1, 1) * (rows @ x @ columns.T - kept * x)
    return x + share * scattered


def vignette(x, strength):
    """Returns the pictures dimmed towards their corners."""
    return x / (1 + strength * torch.tensor(model.corner_distance(*x.shape[-2:]), dtype=x.dtype)) ** 2


def expose(x, gain):
    """Returns the pictures times their exposure."""
    return x * gain


def balance(x, gains):
    """Returns the pictures times the gain of each channel."""
    return x * gains


def correlate(noise, grain):
    """Returns white standard normal noise as grain."""
    taps = gaussian_matrix(65, grain * model.REFERENCE_WIDTH)[:, :, 32]
    return blurred(noise, grain) * (noise.shape[-1] / model.REFERENCE_WIDTH / (taps * taps).sum(-1).view(-1, 1, 1, 1))


def add_noise(x, noise, shot, read, gains):
    """Returns the pictures with shot and read noise."""
    gains = gains * torch.tensor(model.SENSOR_GAINS, dtype=x.dtype).view(1, 3, 1, 1)
    return x + torch.sqrt(gains * shot * x.clamp(min=0) + (gains * read) ** 2) * noise


def clip(x, saturation):
    """Returns the pictures within 0 and the sensors' saturation."""
    return x.clamp(min=0).minimum(saturation)


def split(x):
    """Returns luma [B, 1, h, w] and the channels' differences from it, both of square roots."""
    root = x.clamp(min=0).sqrt()
    luma = (root * luma_weights(x)).sum(1, keepdim=True)
    return luma, root - luma


def luma_weights(x):
    return torch.tensor(model.LUMA, dtype=x.dtype).view(1, 3, 1, 1)


def blur_chroma(x, sigma):
    """Returns the pictures with blurred chroma."""
    luma, chroma = split(x)
    return (luma + blurred(chroma, sigma)).clamp(min=0) ** 2


def sharpen(x, gain):
    """Returns the pictures with sharpened luma."""
    luma, chroma = split(x)
    soft = blurred(luma, torch.full((1, 1, 1, 1), model.SHARPENING_RADIUS, dtype=x.dtype))
    return (luma + gain * (luma - soft) + chroma).clamp(min=0) ** 2


def tone(x, saturation):
    """Returns the pictures under the tone curve with its shoulder."""
    power = (saturation - model.KNEE) / (1 - model.KNEE)
    left = ((saturation - x) / (saturation - model.KNEE)).clamp(0, 1)
    return torch.where(x < model.KNEE, x.clamp(0, 1), 1 - (1 - model.KNEE) * left**power)


def encode(x):
    """Returns sRGB values of linear ones in 0 to 1."""
    x = x.clamp(0, 1)
    return torch.where(x <= 0.0031308, 12.92 * x, 1.055 * x.clamp(min=0.0031308) ** (1 / 2.4) - 0.055)


def decode(x):
    """Returns linear values of sRGB ones in 0 to 1."""
    return torch.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4)


def quantize(plane, table):
    """Returns planes [B, C, h, w] whose blocks' cosine terms are multiples of `table` [B, 8, 8] of 255."""
    b, c, h, w = plane.shape
    transform = torch.tensor(model.cosines(), dtype=plane.dtype)
    size = table.view(b, 1, 1, 1, 8, 8) / 255
    terms = transform @ plane.reshape(b, c, h // 8, 8, w // 8, 8).transpose(3, 4) @ transform.T / size
    terms = (terms + (terms.round() - terms).detach()) * size
    return (transform.T @ terms @ transform).transpose(3, 4).reshape(b, c, h, w)


def jpeg(x, quality):
    """Returns sRGB values, 0 to 1, as JPEG would store them; a `quality` of 100 leaves an item as it is."""
    h, w = x.shape[-2:]
    n = model.chroma_step(w)
    padded = F.pad(x, (0, -w % 16, 0, -h % 16), mode="replicate") - 0.5
    scale = torch.where(quality < 50, 50 / quality, 2 - quality / 50) * min(1, w / model.REFERENCE_WIDTH)
    table = lambda base: (torch.tensor(base, dtype=x.dtype) * scale[:, 0]).clamp(1e-3, 255)
    weights = luma_weights(x)
    y = (padded * weights).sum(1, keepdim=True)
    size = 0.5 / (1 - weights[:, [2, 0]])
    shared = F.avg_pool2d(padded[:, [2, 0]] - y, n)
    chroma = quantize(shared * size, table(model.JPEG_CHROMA)) / size
    blue, red = chroma.repeat_interleave(n, -1).repeat_interleave(n, -2).split(1, 1)
    y = quantize(y, table(model.JPEG_LUMA))
    green = y - (weights[:, :1] * red + weights[:, 2:] * blue) / weights[:, 1:2]
    out = torch.cat([y + red, green, y + blue], 1)[..., :h, :w] + 0.5
    return torch.where(quality >= 100, x, out.clamp(0, 1))


def normal_noise(g, *shape):
    """Returns standard normal numbers."""
    return torch.randn(*shape, generator=g)


def sensor_noise(g, b, h, w, width):
    """Returns the noise of a batch of sensors `width` pixels wide."""
    size = depth_model.map_size(h, w, depth_model.DepthSensor(width=width))
    return depth_model.SensorNoise(normal_noise(g, b, 2, *size), normal_noise(g, b, 1, *size), normal_noise(g, b, 1, *depth_model.PATCHES))


def mask_noise(g, b):
    """Returns the noise of a batch of masks."""
    return depth_model.MaskNoise(normal_noise(g, b, 2), normal_noise(g, b, 2, *depth_model.OUTLINE), normal_noise(g, b, 1, *depth_model.SLOW))


@lru_cache(maxsize=32)
def smooth_matrix(size, grid, dtype):
    return torch.tensor(depth_model.smooth_matrix(size, grid), dtype=dtype)


def smooth(noise, h, w):
    """Returns smooth noise [B, C, h, w] of unit variance from numbers on a grid."""
    rows, columns = (smooth_matrix(n, grid, noise.dtype) for n, grid in zip((h, w), noise.shape[-2:]))
    return rows @ noise @ columns.T


def displaced(x, down, right):
    """Returns `x` [B, 1, h, w] read `down` and `right` pixels away, rounded, no further than the border."""
    h, w = x.shape[-2:]
    row = (torch.arange(h, dtype=x.dtype)[:, None] + down + 0.5).floor().clamp(0, h - 1).long()
    column = (torch.arange(w, dtype=x.dtype) + right + 0.5).floor().clamp(0, w - 1).long()
    return x.flatten(2).gather(2, (row * w + column).flatten(2)).view(x.shape)


def bleed(z, shift, sigma):
    """Returns depth in which pixels at edges read the depth across the edge."""
    down, right = (shift * sigma * z.shape[-1]).split(1, 1)
    return displaced(z, down, right)


def occluded(z, base):
    """Returns where the sensors' projectors do not reach."""
    column = torch.arange(z.shape[-1], dtype=z.dtype) + base * z.shape[-1] / z
    return column.cummax(-1).values > column + 0.5


def steps(z, noise, sensor):
    """Returns depth from disparity in whole steps."""
    disparity = (sensor.base / z / sensor.step + sensor.noise * noise).round()
    return sensor.base / (disparity.clamp(min=1) * sensor.step)


def sensor_depth(depth, sensor, noise, albedo=None, roughness=None, cosine=None):
    """Returns the depth [B, 1, h, w] that the sensors measure, NaN where they have no reading.
    `albedo` and `roughness` are gray planes, `cosine` that between normal and ray."""
    h, w = depth.shape[-2:]
    rows, width = depth_model.map_size(h, w, sensor)
    at = lambda x, i, j: x[..., torch.as_tensor(i)[:, None], torch.as_tensor(j)]
    small = lambda x: at(x, depth_model.nearest_rows(rows, h), depth_model.nearest_rows(width, w))
    true, patches = small(depth), smooth(noise.patches, rows, width)
    hole = occluded(true, sensor.shadow * sensor.base)
    for surface, limit in ((albedo, sensor.dark), (roughness, sensor.shiny)):
        if surface is not None:
            hole = hole | (small(surface) < limit * torch.exp(0.5 * patches))
    if cosine is not None:
        hole = hole | (small(cosine) < sensor.grazing)
    got = steps(bleed(true, noise.shift, sensor.bleeding), noise.disparity, sensor)
    got = torch.where(hole | (got < sensor.nearest) | (got > sensor.farthest), torch.nan, got)
    return at(got, depth_model.nearest_rows(h, rows), depth_model.nearest_rows(w, width))


def network_depth(depth, network, noise):
    """Returns the depth [B, 1, h, w] that networks estimate. `noise` is [B, 1, ..] on the grid SLOW."""
    log = -torch.log(blurred(1 / depth, network.softness))
    base = blurred(log, torch.full((1, 1, 1, 1), depth_model.DETAIL_RADIUS, dtype=depth.dtype))
    detail = log - base
    detail = detail * (1 - network.flattening * torch.exp(-((detail / depth_model.DETAIL_DEPTH) ** 2)))
    return torch.exp(base + detail + network.scale_error * smooth(noise, *depth.shape[-2:]))


def ragged_mask(mask, flaws, noise):
    """Returns masks [B, 1, h, w], 0 or 1, as drawn."""
    h, w = mask.shape[-2:]
    down, right = (w * (flaws.shift * noise.shift[..., None, None] + flaws.raggedness * smooth(noise.outline, h, w))).split(1, 1)
    grown = torch.maximum(mask, (blurred(mask, flaws.spill) > depth_model.OUTSIDE).to(mask.dtype))
    return displaced(grown, down, right) * (smooth(noise.parts, h, w) < flaws.missing)
