"""Depth as sensors and networks give it, and masks as people draw them, in NumPy; `batched.py` has
the same in torch. Planes are [h, w], depth is in meters.

Lengths are shares of the picture's width. Random numbers are inputs; `sensor_noise`,
`network_noise` and `mask_noise` draw them."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from .model import blurred

PATCHES = (12, 16)  # grid of the smooth noise that decides which dark or shiny parts a sensor misses
SLOW = (4, 5)  # grid of the scale error of a network's depth, and of the parts that a mask lacks
OUTLINE = (24, 32)  # grid of the displacement of a mask's outline
DETAIL_RADIUS = 0.02  # standard deviation of the blur that separates detail from form in a network's depth, share of the width
OUTSIDE = 0.1587  # a straight edge's value one standard deviation of its blur outside
DETAIL_DEPTH = 0.05  # relative depth above which a step is form, not detail


@dataclass(frozen=True)
class DepthSensor:
    """A sensor that measures disparity d = `base` / z. The defaults are a structured-light
    sensor's: 0.075 m between projector and camera and 525 pixels of focal length, of 640. The step
    is that of the photo `sunlit`, 3.56 mm z^2 at all distances."""

    width: int = 640  # pixels of its own map; phones have 256
    base: float = 0.0615  # disparity, share of the width, at one meter
    step: float = 2.19e-4  # quantization of disparity, share of the width: z^2 step / base meters
    noise: float = 0.3  # standard deviation of disparity before quantization, steps
    bleeding: float = 0.0012  # standard deviation of the displacement with which a pixel reads its neighbor's depth, share of the width
    shadow: float = 1.0  # width of the band beside near things that lacks depth, share of the occluded one, 0 to 1
    dark: float = 0.04  # albedo below which most readings are missing, 0 to 0.1
    shiny: float = 0.15  # roughness below which most readings are missing, 0 to 0.4
    grazing: float = 0.15  # cosine between normal and ray below which all readings are missing
    nearest: float = 0.5  # meters
    farthest: float = 10.0  # meters


@dataclass(frozen=True)
class DepthNetwork:
    """The flaws of depth estimated from a photo."""

    scale_error: float = 0.1  # standard deviation of the logarithm of a slowly varying factor, 0 to 0.2
    softness: float = 0.004  # standard deviation of the blur of inverse depth, share of the width, 0 to 0.01
    flattening: float = 0.7  # share of detail that is lost, 0 to 1


@dataclass(frozen=True)
class MaskFlaws:
    """The flaws of a mask drawn by hand or by a program."""

    shift: float = 0.003  # standard deviation of the displacement of the whole mask along either axis, share of the width, 0 to 0.01
    raggedness: float = 0.003  # standard deviation of the displacement of the outline, share of the width, 0 to 0.01
    missing: float = 3.0  # threshold, in standard deviations, of the noise beyond which a part is missing, 1 to 3
    spill: float = 0.0  # distance by which the mask covers what stands beside, as curtains of a window, share of the width, 0 to 0.03


class SensorNoise(NamedTuple):
    """Standard normal numbers: per pixel of the sensor's map, and on the grid PATCHES."""

    shift: np.ndarray  # [2, h, w]
    disparity: np.ndarray  # [h, w]
    patches: np.ndarray


class MaskNoise(NamedTuple):
    """Standard normal numbers: for the shift, on the grid OUTLINE for either axis, and on the grid SLOW."""

    shift: np.ndarray  # [2]
    outline: np.ndarray  # [2, ..]
    parts: np.ndarray


def map_size(h, w, sensor):
    """Returns the size of the sensor's own map of a picture [h, w], which no sensor makes larger
    than the picture."""
    width = min(w, sensor.width)
    return round(h * width / w), width


def sensor_noise(rng, h, w, sensor):
    """Returns the noise of a picture [h, w]."""
    size = map_size(h, w, sensor)
    return SensorNoise(rng.standard_normal((2, *size)), rng.standard_normal(size), rng.standard_normal(PATCHES))


def network_noise(rng):
    """Returns standard normal numbers on the grid SLOW."""
    return rng.standard_normal(SLOW)


def mask_noise(rng):
    """Returns the noise of one mask."""
    return MaskNoise(rng.standard_normal(2), rng.standard_normal((2, *OUTLINE)), rng.standard_normal(SLOW))


def nearest_rows(size, source):
    """Returns for each of `size` pixels the nearest of `source` pixels."""
    return np.minimum(((np.arange(size) + 0.5) * source / size).astype(int), source - 1)


def smooth_matrix(size, grid):
    """Returns the matrix [size, grid] that interpolates a row of `grid` numbers by Gaussians half a
    cell wide; the squares of a row add up to 1, so that white noise keeps its variance."""
    at = (np.arange(size) + 0.5) / size * grid - 0.5
    weights = np.exp(-2 * (at[:, None] - np.arange(grid)) ** 2)
    return weights / np.sqrt((weights**2).sum(1, keepdims=True))


def smooth(noise, h, w):
    """Returns smooth noise [h, w] of unit variance from numbers on a grid."""
    return smooth_matrix(h, noise.shape[0]) @ noise @ smooth_matrix(w, noise.shape[1]).T


def displaced(x, down, right):
    """Returns `x` [h, w] read `down` and `right` pixels away, rounded, no further than the border."""
    h, w = x.shape
    y, z = np.mgrid[0:h, 0:w]
    row = np.clip(np.floor(y + down + 0.5), 0, h - 1).astype(int)
    column = np.clip(np.floor(z + right + 0.5), 0, w - 1).astype(int)
    return x[row, column]


def bleed(z, shift, sigma):
    """Returns depth in which pixels at edges read the depth across the edge."""
    return displaced(z, shift[0] * sigma * z.shape[1], shift[1] * sigma * z.shape[1])


def occluded(z, base):
    """Returns where the sensor's projector, left of the camera, does not reach: some point further
    left has a disparity larger by more than its distance."""
    column = np.arange(z.shape[1]) + base * z.shape[1] / z
    return np.maximum.accumulate(column, 1) > column + 0.5


def steps(z, noise, sensor):
    """Returns depth from disparity in whole steps."""
    disparity = np.round(sensor.base / z / sensor.step + sensor.noise * noise)
    return sensor.base / (np.maximum(disparity, 1) * sensor.step)


def sensor_depth(depth, sensor, noise, albedo=None, roughness=None, cosine=None):
    """Returns the depth [h, w] that the sensor measures, NaN where it has no reading. `albedo` and
    `roughness` are gray; `cosine` is that between normal and ray."""
    h, w = depth.shape
    rows, width = map_size(h, w, sensor)
    small = np.ix_(nearest_rows(rows, h), nearest_rows(width, w))
    true = depth[small]
    patches = smooth(noise.patches, rows, width)
    hole = occluded(true, sensor.shadow * sensor.base)
    for surface, limit in ((albedo, sensor.dark), (roughness, sensor.shiny)):
        if surface is not None:
            hole |= surface[small] < limit * np.exp(0.5 * patches)
    if cosine is not None:
        hole |= cosine[small] < sensor.grazing
    got = steps(bleed(true, noise.shift, sensor.bleeding), noise.disparity, sensor)
    got = np.where(hole | (got < sensor.nearest) | (got > sensor.farthest), np.nan, got)
    return got[np.ix_(nearest_rows(h, rows), nearest_rows(w, width))]


def network_depth(depth, network, noise):
    """Returns the depth [h, w] that a network estimates: soft edges, flat detail, a slowly varying
    scale. `noise` is on the grid SLOW."""
    log = -np.log(blurred(1 / depth[..., None], network.softness))
    base = blurred(log, DETAIL_RADIUS)
    detail = log - base
    detail = detail * (1 - network.flattening * np.exp(-((detail / DETAIL_DEPTH) ** 2)))
    return np.exp((base + detail)[..., 0] + network.scale_error * smooth(noise, *depth.shape))


def ragged_mask(mask, flaws, noise):
    """Returns the mask [h, w], 0 or 1, as drawn: shifted, with a ragged outline, without some parts."""
    h, w = mask.shape
    down, right = (w * (flaws.shift * noise.shift[k] + flaws.raggedness * smooth(noise.outline[k], h, w)) for k in range(2))
    grown = np.maximum(mask, blurred(mask[..., None], flaws.spill)[..., 0] > OUTSIDE)
    return displaced(grown, down, right) * (smooth(noise.parts, h, w) < flaws.missing)


def sample_sensor(rng):
    """Returns a Kinect or, one time of three, the coarse sensor of a phone, whose software leaves
    few holes."""
    if rng.random() < 1 / 3:
        return DepthSensor(width=256, step=1 / 16000, noise=1.0, bleeding=0.003, shadow=0.1, dark=0.01, shiny=0.05, grazing=0.05, nearest=0.2)
    strength = np.exp(0.3 * rng.standard_normal(4))
    return DepthSensor(noise=0.3 * strength[0], bleeding=0.0012 * strength[1], dark=0.04 * strength[2], shiny=0.15 * strength[3])


def sample_network(rng):
    """Returns a DepthNetwork; none of its constants is fitted, as no photo here has both measured
    and estimated depth."""
    return DepthNetwork(scale_error=rng.uniform(0, 0.15), softness=rng.uniform(0.001, 0.008), flattening=rng.uniform(0.2, 0.9))


def sample_mask(rng):
    """Returns MaskFlaws; a third of masks lack a part, a quarter cover too much."""
    shift, raggedness = 0.003 * np.exp(0.4 * rng.standard_normal(2))
    missing = 1.0 if rng.random() < 1 / 3 else 9.0
    spill = rng.uniform(0.005, 0.02) if rng.random() < 1 / 4 else 0.0
    return MaskFlaws(shift=float(shift), raggedness=float(raggedness), missing=missing, spill=float(spill))
