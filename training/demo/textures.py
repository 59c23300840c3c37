"""Procedural textures: small arrays of linear reflectance [h, w, 3], made from a seed."""
import numpy as np


def noise(rng, h, w, cells_y, cells_x):
    """Smooth noise in 0..1: random values on a grid, cosine-interpolated."""
    g = rng.random((cells_y + 2, cells_x + 2))

    def ease(n, cells):
        t = np.arange(n) / n * cells
        i = t.astype(int)
        return i, (1 - np.cos(np.pi * (t - i))) / 2

    (i, s), (j, t) = ease(h, cells_y), ease(w, cells_x)
    s, t = s[:, None], t[None, :]
    at = lambda di, dj: g[np.ix_(i + di, j + dj)]
    return (at(0, 0) * (1 - s) + at(1, 0) * s) * (1 - t) + (at(0, 1) * (1 - s) + at(1, 1) * s) * t


def wood(rng, h, w, dark, light):
    """Grain along x."""
    bend = noise(rng, h, w, 3, 3) * 6
    y = np.linspace(0, 1, h)[:, None]
    rings = 0.5 + 0.5 * np.sin(2 * np.pi * (y * 5 + bend * 0.5))
    fine = noise(rng, h, w, h // 2, max(2, w // 48))
    t = np.clip(0.15 + 0.45 * rings * noise(rng, h, w, 6, 2) + 0.4 * fine, 0, 1)[..., None]
    return np.asarray(dark) * (1 - t) + np.asarray(light) * t


def planks(rng, h, w, rows, dark, light):
    """A floor of boards along x, `rows` of them side by side, with staggered joints."""
    grain = wood(rng, h, w, dark, light)
    out = grain.copy()
    edge = np.linspace(0, h, rows + 1).astype(int)
    for top, bottom in zip(edge[:-1], edge[1:]):
        cuts = [0, *np.sort(rng.integers(w // 6, w, 2)), w]
        for a, b in zip(cuts[:-1], cuts[1:]):
            board = np.roll(grain, rng.integers(0, h), 0)[top:bottom, a:b]
            out[top:bottom, a:b] = board * rng.uniform(0.78, 1.12)
            if b > a:
                out[top:bottom, a : a + 2] *= 0.45
        out[top : top + 2] *= 0.45
    return out.clip(0.01, 0.9)


def plaster(rng, h, w, color):
    """Paint with a slight unevenness."""
    t = 0.5 * noise(rng, h, w, 6, 6) + 0.3 * noise(rng, h, w, 24, 24) + 0.2 * noise(rng, h, w, h // 3, w // 3)
    return np.asarray(color) * (0.95 + 0.1 * t)[..., None]


def weave(rng, h, w, color):
    """Coarse cloth."""
    y, x = np.mgrid[0:h, 0:w]
    t = 0.6 * rng.random((h, w)) + 0.4 * ((x + y) % 2)
    return np.asarray(color) * (0.82 + 0.36 * (0.5 * t + 0.5 * noise(rng, h, w, 8, 8)))[..., None]


def banded(rng, h, w, colors):
    """Cloth with bands of these colors across u."""
    x = np.mgrid[0:h, 0:w][1] * len(colors) // w
    return np.asarray(colors)[x] * weave(rng, h, w, (1.0, 1.0, 1.0))


def rug(rng, h, w):
    """Cream wool with bands of diamonds and a striped border."""
    cream, rust, blue, ochre = (np.array(c) for c in ((0.62, 0.54, 0.43), (0.36, 0.11, 0.06), (0.07, 0.12, 0.20), (0.50, 0.30, 0.09)))
    y, x = np.mgrid[0:h, 0:w] / float(min(h, w))
    out = np.broadcast_to(cream, (h, w, 3)).copy()
    long, margin = w / min(h, w), 1 / 6
    field = (x > margin) & (x < long - margin) & (y > margin) & (y < h / min(h, w) - margin)
    s, t = (x - margin) * 6, (y - margin) * 6
    d = np.abs(s % 1 - 0.5) + np.abs(t % 1 - 0.5)
    odd = (np.floor(s) + np.floor(t)) % 2 == 1
    for where, reach, color in ((odd, 0.44, rust), (odd, 0.30, cream), (odd, 0.18, blue), (~odd, 0.30, blue), (~odd, 0.18, ochre)):
        out[field & where & (d < reach)] = color
    rim = np.minimum(np.minimum(x, long - x), np.minimum(y, h / min(h, w) - y))
    for width, color in ((0.12, rust), (0.10, cream), (0.085, blue), (0.03, cream)):
        out[rim < width] = color
    return out * (0.8 + 0.3 * rng.random((h, w)) + 0.1 * noise(rng, h, w, 9, 9))[..., None]


def landscape(rng, h, w):
    """A painting: a low sun over hills."""
    y, x = np.mgrid[0:h, 0:w] / float(h)
    t = y[..., None]
    out = np.array([0.35, 0.42, 0.48]) * (1 - t) + np.array([0.85, 0.52, 0.24]) * t * 1.2
    sun = np.hypot(x - 0.62 * w / h, y - 0.40)
    out[sun < 0.11] = (0.80, 0.30, 0.10)
    for k, color in enumerate(((0.38, 0.30, 0.28), (0.22, 0.24, 0.24), (0.13, 0.19, 0.16), (0.07, 0.11, 0.09))):
        ridge = 0.52 + 0.12 * k + 0.09 * np.sin(x * (3.0 + 1.3 * k) + 2.1 * k) + 0.03 * np.sin(x * (9 + 2 * k) + k)
        out[y > ridge] = color
    return (out * (0.85 + 0.3 * noise(rng, h, w, h // 3, w // 8))[..., None]).clip(0.02, 0.9)


def stripes(rng, h, w):
    """A print of soft upright bars."""
    x = np.mgrid[0:h, 0:w][1] / float(w)
    colors = np.array([(0.70, 0.64, 0.52), (0.14, 0.26, 0.28), (0.62, 0.36, 0.12), (0.70, 0.64, 0.52), (0.40, 0.13, 0.07), (0.70, 0.64, 0.52)])
    out = colors[np.minimum((x * len(colors)).astype(int), len(colors) - 1)]
    return out * (0.9 + 0.2 * noise(rng, h, w, h // 2, w // 2))[..., None]
