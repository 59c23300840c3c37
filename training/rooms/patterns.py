"""Patterns of cloth, wood and wallpaper as a texture of Mitsuba: each face mixes its albedo with a second one by a function of the position.

A face carries `face_albedo`, `face_second` and `face_pattern` = (kind, length of the pattern in meters, offset). Positions are those of the world,
projected along the axis nearest to the normal."""

import drjit as dr
import mitsuba as mi

from layout import CHECK, CLOUDS, DOTS, PLAID, STRIPES, WEAVE, WOOD


def hashed(x, y):
    """Uniform number in 0..1 of a cell of the integer grid."""
    h = mi.UInt32(mi.Int32(x)) * mi.UInt32(0x8DA6B343) ^ mi.UInt32(mi.Int32(y)) * mi.UInt32(0xD8163841)
    h = (h ^ (h >> 15)) * mi.UInt32(0x2C1B3C6D)
    h = (h ^ (h >> 12)) * mi.UInt32(0x297A2D39)
    return mi.Float((h ^ (h >> 15)) >> 8) / 16777216.0


def noise(u, v):
    """Value noise in 0..1 with cells of size 1."""
    x, y = dr.floor(u), dr.floor(v)
    s, t = u - x, v - y
    s, t = s * s * (3 - 2 * s), t * t * (3 - 2 * t)
    return dr.lerp(dr.lerp(hashed(x, y), hashed(x + 1, y), s), dr.lerp(hashed(x, y + 1), hashed(x + 1, y + 1), s), t)


def weight(kind, u, v):
    """Share of the second albedo, 0..1, at pattern coordinates."""
    bit = lambda x: dr.select(x - dr.floor(x) < 0.5, mi.Float(1), mi.Float(0))
    fine = noise(5.3 * u, 5.3 * v)
    coarse = 0.6 * noise(1.1 * u, 1.1 * v) + 0.4 * fine
    a, b = bit(u), bit(v)
    du, dv = u - dr.floor(u) - 0.5, v - dr.floor(v) - 0.5
    grain = noise(1.5 * u, 21 * v)
    board = hashed(dr.floor(0.25 * u), dr.floor(v))
    out = mi.Float(0)
    for number, value in (
        (WOOD, 0.45 * grain + 0.2 * noise(6 * u, 60 * v) + 0.35 * board),
        (STRIPES, a),
        (CHECK, a + b - 2 * a * b),
        (PLAID, 0.5 * (a + b)),
        (DOTS, dr.select(du * du + dv * dv < 0.08, mi.Float(1), mi.Float(0))),
        (CLOUDS, dr.clip(2.4 * coarse - 0.7, 0, 1)),
        (WEAVE, hashed(dr.floor(4 * u), dr.floor(4 * v))),
    ):
        out = dr.select(kind == number, value, out)
    return out


def albedo(si, active=True):
    """Albedo of a hit on a mesh with the three attributes."""
    first = si.shape.eval_attribute_3("face_albedo", si, active)
    second = si.shape.eval_attribute_3("face_second", si, active)
    pattern = si.shape.eval_attribute_3("face_pattern", si, active)
    n, p = dr.abs(si.n), si.p
    flat, across = (n.y > n.x) & (n.y > n.z), n.x > n.z
    u = dr.select(flat, p.x, dr.select(across, p.z, p.x)) / pattern.y + pattern.z
    v = dr.select(flat, p.z, p.y) / pattern.y + pattern.z
    return dr.lerp(first, second, weight(dr.round(pattern.x), u, v))


class Pattern(mi.Texture):
    """The albedo of a mesh with patterns."""

    def __init__(self, props):
        super().__init__(props)

    def eval(self, si, active=True):
        return mi.Color3f(albedo(si, active))

    def eval_1(self, si, active=True):
        return mi.luminance(mi.Color3f(albedo(si, active)))

    def mean(self):
        return mi.Float(0.5)

    def is_spatially_varying(self):
        return True

    def traverse(self, callback):
        pass

    def to_string(self):
        return "Pattern[]"


mi.register_texture("pattern", Pattern)
