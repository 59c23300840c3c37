"""A camera as NumPy functions of pictures [h, w, 3]: linear radiance in, stored 8-bit sRGB out.
`batched.py` is the same camera in torch.

The stages run in this order: soften, glare, vignette, expose, balance, add_noise, clip,
blur_chroma, sharpen, tone, encode, jpeg. The first five are linear, so the pictures of a room's
lights may go through `incident` one by one and add up to the photo's. Lengths are shares of the
picture's width, and noise and JPEG steps are those of a picture 640 pixels wide, so a room looks
alike at any resolution. Random numbers are inputs of the stages; only `photograph` draws them."""

import io
import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from PIL import Image

REFERENCE_WIDTH = 640  # pixels; noise and JPEG quality are those of a picture of this width
KNEE = 0.8  # linear value below which the tone curve is the identity; the program takes photos for sRGB
GLARE_WIDTHS = (0.004, 0.012, 0.036, 0.108, 0.324)  # standard deviations of the Gaussians that make up the glare, shares of the width
SHARPENING_RADIUS = 0.0016  # standard deviation of the unsharp mask, share of the width: one pixel of 640
SENSOR_GAINS = np.array([2.0, 1.0, 1.6])  # with which a sensor's weak red and blue are brought to green's level in neutral light: they amplify noise
LUMA = np.array([0.299, 0.587, 0.114])  # ITU-R BT.601, as JPEG has it

# The quantization tables of Annex K of the JPEG standard, for quality 50.
JPEG_LUMA = np.array(
    [
        [16, 11, 10, 16, 24, 40, 51, 61],
        [12, 12, 14, 19, 26, 58, 60, 55],
        [14, 13, 16, 24, 40, 57, 69, 56],
        [14, 17, 22, 29, 51, 87, 80, 62],
        [18, 22, 37, 56, 68, 109, 103, 77],
        [24, 35, 55, 64, 81, 104, 113, 92],
        [49, 64, 78, 87, 103, 121, 120, 101],
        [72, 92, 95, 98, 112, 100, 103, 99],
    ]
)
JPEG_CHROMA = np.full((8, 8), 99)
JPEG_CHROMA[:4, :4] = [[17, 18, 24, 47], [18, 21, 26, 66], [24, 26, 56, 99], [47, 66, 99, 99]]


@dataclass(frozen=True)
class Camera:
    """The parameters of one camera and its settings. The defaults change nothing but that the
    picture clips at 1."""

    exposure: float = 1.0  # gain, 0.1 to 10
    white_balance: tuple = (1.0, 1.0, 1.0)  # gains of red, green and blue, 0.5 to 2
    softness: float = 0.0  # standard deviation of the blur of lens and demosaicing, share of the width, 0 to 0.005
    glare: float = 0.0  # share of the light that the lens scatters, 0 to 0.2
    glare_slope: float = 0.5  # exponent, 0 to 1: scattered light falls with distance r as r^-(2 + glare_slope)
    vignetting: float = 0.0  # squared tangent of the angle whose cos^4 is the dimming of the corners, 0 to 0.5
    shot_noise: float = 0.0  # variance per unit of signal, 1 = white, of a pixel of a picture 640 wide, 0 to 0.002
    read_noise: float = 0.0  # standard deviation in units of white, likewise, 0 to 0.02
    grain: float = 0.0  # standard deviation of the Gaussian that correlates the noise of neighboring pixels, share of the width, 0 to 0.003
    saturation: float = 1.0  # linear value at which the sensor clips, stored as white, 1 to 3
    chroma_blur: float = 0.0  # standard deviation, share of the width, 0 to 0.01
    sharpening: float = 0.0  # gain of the unsharp mask, 0 to 2
    jpeg_quality: int = 100  # quality of libjpeg for a picture 640 wide, 1 to 100; 100 stores the picture without JPEG


# The fitted distribution: medians of log-normal parameters, standard deviations of their logarithms,
# ranges; and the statistic of the photos that `fit.py` prints and each is chosen by.
FITTED = {
    "softness": (0.0010, 0.25, 0.0005, 0.003),  # width of edges
    "glare": (0.07, 0.4, 0.02, 0.2),  # excess around what is clipped; not told apart from lit walls
    "vignetting": (0.05, 0.7, 0.0, 0.4),  # not seen in the photos: a guess
    "shot_noise": (2.6e-4, 0.5, 1e-5, 1e-3),  # noise floor by signal
    "read_noise": (2.2e-3, 0.4, 2e-4, 8e-3),  # noise floor at 0.01 to 0.05
    "grain": (0.0016, 0.2, 0.0008, 0.003),  # correlation of the noise
    "saturation": (1.25, 0.2, 1.0, 2.5),  # pixels just below white
    "chroma_blur": (0.0021, 0.25, 0.0006, 0.005),  # bandwidth and noise of chroma
    "sharpening": (0.25, 0.6, 0.0, 1.5),  # no overshoot in the photos reduced to 320 pixels, little at their own size
}
FITTED_SLOPE = (0.5, 0.9)  # of the glare, uniform
FITTED_WARMTH, FITTED_TINT = 0.15, 0.05  # standard deviations of logarithms: of red and, inversely, blue; of both against green
FITTED_QUALITY = (70, 95)  # of JPEG, uniform


def sample(rng):
    """Returns a Camera of the fitted distribution, with exposure 1."""
    drawn = {name: float(np.clip(m * np.exp(sd * rng.standard_normal()), low, high)) for name, (m, sd, low, high) in FITTED.items()}
    warmth, tint = np.array((FITTED_WARMTH, FITTED_TINT)) * np.clip(rng.standard_normal(2), -2, 2)
    red, blue = np.exp((tint + warmth, tint - warmth))
    quality = int(rng.integers(FITTED_QUALITY[0], FITTED_QUALITY[1] + 1))
    return Camera(white_balance=(float(red), 1.0, float(blue)), glare_slope=float(rng.uniform(*FITTED_SLOPE)), jpeg_quality=quality, **drawn)


class Photo(NamedTuple):
    """`stored` is [h, w, 3] in 8-bit sRGB. `linear` is the light that the sensor receives, in units
    of white: without noise, clipping and all that follows."""

    stored: np.ndarray
    linear: np.ndarray


def photograph(linear, camera, rng):
    """Returns the Photo of linear radiance [h, w, 3]. Its JPEG is libjpeg's (Pillow); `jpeg` models
    it for training."""
    received = incident(linear, camera)
    noise = rng.standard_normal(received.shape)
    stored = np.round(255 * develop(received, camera, noise)).astype(np.uint8)
    return Photo(stored if camera.jpeg_quality >= 100 else decoded(stored, camera), received)


def incident(linear, camera):
    """Returns the light that the sensor receives, in units of white; a linear function of the picture."""
    x = np.asarray(linear, np.float64)
    x = soften(x, camera.softness)
    x = glare(x, camera.glare, camera.glare_slope)
    x = vignette(x, camera.vignetting)
    x = expose(x, camera.exposure)
    return balance(x, camera.white_balance)


def develop(received, camera, noise):
    """Returns the sRGB values, 0 to 1, of the light on the sensor and of standard normal `noise`,
    before JPEG."""
    x = add_noise(received, correlate(noise, camera.grain), camera.shot_noise, camera.read_noise, camera.white_balance)
    x = clip(x, camera.saturation)
    x = blur_chroma(x, camera.chroma_blur)
    x = sharpen(x, camera.sharpening)
    return encode(tone(x, camera.saturation))


def auto_exposure(linear, counted, level=0.95, share=0.98):
    """Returns the gain that brings a `share` of the `counted` pixels (True where no light is seen)
    below `level`."""
    return level / max(np.quantile(linear.mean(-1)[counted], share), 1e-4)


def gaussian_matrix(size, sigma, normalized=True):
    """Returns the matrix [size, size] that blurs a row of pixels by a Gaussian of `sigma` pixels,
    integrated over each pixel. `normalized` rows have sum 1."""
    if sigma <= 0:
        return np.eye(size)
    edges = [math.erf((k - 0.5) / (sigma * math.sqrt(2))) for k in range(size + 1)]
    taps = np.diff(edges) / 2
    at = np.abs(np.arange(size)[:, None] - np.arange(size))
    matrix = taps[at]
    return matrix / matrix.sum(1, keepdims=True) if normalized else matrix


def blurred(x, sigma):
    """Returns `x` [h, w, c] blurred by a Gaussian of `sigma` shares of the width."""
    h, w = x.shape[:2]
    return separable(x, gaussian_matrix(h, sigma * w), gaussian_matrix(w, sigma * w))


def separable(x, rows, columns):
    """Returns rows x columns^T for each channel of `x` [h, w, c]."""
    return np.moveaxis(rows @ np.moveaxis(x, 2, 0) @ columns.T, 0, 2)


def soften(x, sigma):
    """Returns the picture behind the blur of lens and demosaicing."""
    return blurred(x, sigma) if sigma > 0 else x


def glare_weights(slope):
    """Returns the weights of the Gaussians of GLARE_WIDTHS, whose sum is 1."""
    weights = np.array([(s / GLARE_WIDTHS[0]) ** -slope for s in GLARE_WIDTHS])
    return weights / weights.sum()


def glare(x, share, slope):
    """Returns the picture of which the lens scatters a `share`. Light scattered out of the picture
    is held back, so the sum over the picture does not change, nor does a uniform picture."""
    h, w = x.shape[:2]
    scattered, kept = np.zeros_like(x), np.zeros((h, w, 1))
    for weight, sigma in zip(glare_weights(slope), GLARE_WIDTHS):
        rows, columns = gaussian_matrix(h, sigma * w, False), gaussian_matrix(w, sigma * w, False)
        scattered += weight * separable(x, rows, columns)
        kept += weight * np.outer(rows.sum(1), columns.sum(1))[..., None]
    return x + share * (scattered - kept * x)


def corner_distance(h, w):
    """Returns the squared distance from the middle of the picture [h, w], 1 in the corners."""
    y, x = np.mgrid[0:h, 0:w] + 0.5
    return ((2 * x - w) ** 2 + (2 * y - h) ** 2) / (w * w + h * h)


def vignette(x, strength):
    """Returns the picture dimmed towards its corners by cos^4 of the angle from the axis."""
    return x / (1 + strength * corner_distance(*x.shape[:2])[..., None]) ** 2


def expose(x, gain):
    """Returns the picture times the exposure."""
    return x * gain


def balance(x, gains):
    """Returns the picture times the gain of each channel."""
    return x * np.asarray(gains)


def correlate(noise, grain):
    """Returns white standard normal `noise` [h, w, 3] as grain that has unit variance in a picture
    REFERENCE_WIDTH wide. A pixel of a smaller picture is the mean of several of those, of a larger
    one a part."""
    taps = gaussian_matrix(65, grain * REFERENCE_WIDTH)[32]
    return blurred(noise, grain) * (noise.shape[1] / REFERENCE_WIDTH / (taps @ taps))


def add_noise(x, noise, shot, read, gains):
    """Returns the picture with shot and read noise, which the gain of a channel amplifies:
    SENSOR_GAINS times that of white balance."""
    gains = SENSOR_GAINS * gains
    return x + np.sqrt(gains * shot * np.maximum(x, 0) + (gains * read) ** 2) * noise


def clip(x, saturation):
    """Returns the picture within 0 and the sensor's saturation."""
    return np.clip(x, 0, saturation)


def split(x):
    """Returns luma [h, w, 1] and the channels' differences from it, both of square roots, near to
    what the eye and the camera's own filters see."""
    root = np.sqrt(np.maximum(x, 0))
    luma = root @ LUMA[:, None]
    return luma, root - luma


def blur_chroma(x, sigma):
    """Returns the picture with blurred chroma: demosaicing, denoising and chroma subsampling."""
    if sigma <= 0:
        return x
    luma, chroma = split(x)
    return np.maximum(luma + blurred(chroma, sigma), 0) ** 2


def sharpen(x, gain):
    """Returns the picture with its luma sharpened by an unsharp mask."""
    if gain <= 0:
        return x
    luma, chroma = split(x)
    return np.maximum(luma + gain * (luma - blurred(luma, SHARPENING_RADIUS)) + chroma, 0) ** 2


def tone(x, saturation):
    """Returns the picture under a tone curve that is the identity up to KNEE and then bends, with a
    continuous slope, to reach 1 at `saturation`."""
    power = (saturation - KNEE) / (1 - KNEE)
    left = np.clip((saturation - x) / (saturation - KNEE), 0, 1)
    return np.where(x < KNEE, np.clip(x, 0, 1), 1 - (1 - KNEE) * left**power)


def encode(x):
    """Returns sRGB values of linear ones in 0 to 1."""
    x = np.clip(x, 0, 1)
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * np.maximum(x, 0.0031308) ** (1 / 2.4) - 0.055)


def decode(x):
    """Returns linear values of sRGB ones in 0 to 1."""
    return np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4)


def jpeg_scale(quality, width):
    """Returns the factor of the quantization tables: libjpeg's for `quality`, less for a picture
    narrower than REFERENCE_WIDTH, whose pixels are means of several."""
    factor = 50 / quality if quality < 50 else 2 - quality / 50
    return factor * min(1, width / REFERENCE_WIDTH)


def chroma_step(width):
    """Returns how many pixels share a chroma value in either direction: 2, as 4:2:0 has it, but 1
    in a picture half as wide as REFERENCE_WIDTH or less."""
    return 2 if width > REFERENCE_WIDTH / 2 else 1


def decoded(stored, camera):
    """Returns 8-bit sRGB after libjpeg at the camera's quality, as files have it."""
    scale = jpeg_scale(camera.jpeg_quality, stored.shape[1])
    quality = round(50 / scale if scale > 1 else 100 - 50 * scale)
    file = io.BytesIO()
    subsampling = "4:2:0" if chroma_step(stored.shape[1]) == 2 else "4:4:4"
    Image.fromarray(stored).save(file, "JPEG", quality=int(np.clip(quality, 1, 100)), subsampling=subsampling)
    return np.asarray(Image.open(file).convert("RGB"))


def cosines():
    """Returns the orthonormal matrix [8, 8] of the cosine transform, frequencies in rows."""
    k = np.arange(8)
    return np.cos((2 * k + 1) * k[:, None] * np.pi / 16) * np.where(k == 0, 0.125**0.5, 0.5)[:, None]


def quantize(plane, table):
    """Returns a plane [h, w], sides multiples of 8, whose blocks' cosine terms are multiples of
    `table` of 255."""
    h, w = plane.shape
    transform = cosines()
    terms = transform @ plane.reshape(h // 8, 8, w // 8, 8).swapaxes(1, 2) @ transform.T
    terms = np.round(terms * 255 / table) * table / 255
    return (transform.T @ terms @ transform).swapaxes(1, 2).reshape(h, w)


def jpeg(x, quality):
    """Returns sRGB values, 0 to 1, as JPEG would store them: the model that training uses.
    `decoded` is the real thing."""
    h, w = x.shape[:2]
    n = chroma_step(w)
    x = np.pad(x, ((0, -h % 16), (0, -w % 16), (0, 0)), mode="edge") - 0.5
    scale = jpeg_scale(quality, w)
    table = lambda base: np.clip(base * scale, 1e-3, 255)
    y = x @ LUMA
    difference = x[..., [2, 0]] - y[..., None]
    shared = difference.reshape(x.shape[0] // n, n, x.shape[1] // n, n, 2).mean((1, 3))
    size = 0.5 / (1 - LUMA[[2, 0]])  # Cb and Cr in units of the differences of blue and red from luma
    chroma = [quantize(shared[..., k] * size[k], table(JPEG_CHROMA)) / size[k] for k in range(2)]
    blue, red = (c.repeat(n, 0).repeat(n, 1) for c in chroma)
    y = quantize(y, table(JPEG_LUMA))
    green = y - (LUMA[0] * red + LUMA[2] * blue) / LUMA[1]
    return np.clip(np.stack([y + red, green, y + blue], -1)[:h, :w] + 0.5, 0, 1)
