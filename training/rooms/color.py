"""Colors of lights and paint, linear Rec.709."""

import numpy as np

XYZ_TO_RGB = np.array([[3.2406, -1.5372, -0.4986], [-0.9689, 1.8758, 0.0415], [0.0557, -0.2040, 1.0570]])


def blackbody(kelvin):
    """Color of a black body, luminance 1; color matching functions as fitted by Wyman, Sloan and Shirley, JCGT 2(2), 2013."""
    nm = np.arange(380.0, 781.0, 5.0)
    bump = lambda mean, below, above: np.exp(-0.5 * ((nm - mean) / np.where(nm < mean, below, above)) ** 2)
    x = 1.056 * bump(599.8, 37.9, 31.0) + 0.362 * bump(442.0, 16.0, 26.7) - 0.065 * bump(501.1, 20.4, 26.2)
    y = 0.821 * bump(568.8, 46.9, 40.5) + 0.286 * bump(530.9, 16.3, 31.1)
    z = 1.217 * bump(437.0, 11.8, 36.0) + 0.681 * bump(459.0, 26.0, 13.8)
    planck = nm**-5 / np.expm1(1.4388e7 / (nm * kelvin))
    xyz = np.array([(f * planck).sum() for f in (x, y, z)])
    return np.maximum(XYZ_TO_RGB @ (xyz / xyz[1]), 0.01)


def linear(srgb):
    """sRGB 0..1 to linear."""
    srgb = np.asarray(srgb, np.float32)
    return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4).astype(np.float32)


def srgb(linear):
    """Linear to sRGB 0..1."""
    x = np.clip(linear, 0, 1)
    return np.where(x <= 0.0031308, x * 12.92, 1.055 * x ** (1 / 2.4) - 0.055)


def luminance(rgb):
    """Relative luminance of [..., 3]."""
    return np.asarray(rgb) @ np.array([0.2126, 0.7152, 0.0722])


def hsv(hue, saturation, value):
    """Albedo of a hue in 0..1, by linear mixing of the pure hue with white."""
    pure = np.clip(np.abs((hue * 6 + np.array([0, 4, 2])) % 6 - 3) - 1, 0, 1)
    return value * (1 - saturation + saturation * pure)
