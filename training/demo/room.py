"""The demo living room: walls, furniture and lights as meshes, meters, y up, floor at y = 0.

The plain room is that of tests/scenes/small; the rich one, that of scenes/demo, has finer textures and more in it. Lights, camera and furniture stand at
the same places in both. `build(rich)` returns the meshes by material. A material is a texture (name of an array in `TEXTURES`) or "matte" / "gloss", whose meshes carry a color
each; "gloss" has a specular coat of roughness 0.3."""
import numpy as np

import textures as tx
from shapes import ball, box, lathe, merge, moved, quad, rod, sheet, smooth_lathe

LEFT, RIGHT, BACK, FRONT, HEIGHT = -2.2, 2.3, -4.4, 1.6, 2.55
CAMERA = dict(origin=(0.9, 1.36, 0.3), target=(-0.30, 0.88, -4.1), fov_x=64.0)

# The window: an opening in the left wall; the pane stands 10 cm inside it.
WINDOW = dict(z=(-4.02, -2.56), y=(0.88, 2.22), deep=0.10)

# The shade of the table lamp: a closed frustum around a vertical axis.
SHADE = dict(base=(0.98, 0.90, -4.02), height=0.31, radius_low=0.215, radius_high=0.14)

WALNUT = ((0.075, 0.036, 0.018), (0.24, 0.13, 0.065))
WHITE = (0.78, 0.76, 0.72)


LINEN = (0.70, 0.63, 0.50)


def textures(rich):
    """(linear reflectance [h, w, 3], repeats per meter along u and v) by material; the rich room's have three times the resolution."""
    rng, k = np.random.default_rng(7), 3 if rich else 1
    plain = {
        "floor": (tx.planks(rng, 600 * k, 800 * k, 30, (0.22, 0.125, 0.06), (0.50, 0.33, 0.19)), (1 / 6.0, 1 / 4.5)),
        "wall": (tx.plaster(rng, 256 * k, 256 * k, (0.72, 0.67, 0.58)), (0.4, 0.4)),
        "accent": (tx.plaster(rng, 256 * k, 256 * k, (0.36, 0.41, 0.35)), (0.4, 0.4)),
        "walnut": (tx.wood(rng, 128 * k, 256 * k, *WALNUT), (0.8, 1.6)),
        "sofa": (tx.weave(rng, 128 * k, 128 * k, (0.46, 0.19, 0.085)), (2.0, 2.0)),
        "rug": (tx.rug(rng, 240 * k, 320 * k), (1.0, 1.0)),
        "landscape": (tx.landscape(rng, 128 * k, 176 * k)[::-1], (1.0, 1.0)),
        "stripes": (tx.stripes(rng, 96 * k, 72 * k), (1.0, 1.0)),
    }
    if not rich:
        return plain
    return plain | {
        "linen": (tx.weave(rng, 256, 256, LINEN), (2.0, 2.0)),
        "throw": (tx.banded(rng, 256, 256, ((0.60, 0.56, 0.47), (0.16, 0.24, 0.27), (0.60, 0.56, 0.47), (0.42, 0.13, 0.07))), (1 / 0.24, 1 / 0.24)),
        "cushion": (tx.banded(rng, 192, 192, ((0.66, 0.60, 0.48), (0.12, 0.20, 0.28))), (1 / 0.09, 1 / 0.09)),
        "wicker": (tx.weave(rng, 48, 48, (0.40, 0.27, 0.14)), (4.0, 4.0)),
        "cover": (tx.landscape(rng, 96, 128), (1 / 0.30, 1 / 0.22)),
    }


class Room:
    def __init__(self, rich):
        self.meshes, self.rich = {}, rich

    def cloth(self, texture, mesh, color):
        """Woven in the rich room, of one color in the plain one."""
        self.add(texture, mesh) if self.rich else self.add("matte", mesh, color)

    def add(self, material, mesh, color=None):
        colors = None if color is None else np.broadcast_to(np.asarray(color, float), mesh[0].shape)
        self.meshes.setdefault(material, []).append((mesh, colors))

    def merged(self):
        return {
            name: (merge(*(m for m, _ in parts)), None if parts[0][1] is None else np.concatenate([c for _, c in parts]))
            for name, parts in self.meshes.items()
        }


def stretched(mesh):
    """uv over the unit square, for a texture that fills one rectangle."""
    uv = mesh[2] - mesh[2].min(0)
    return mesh[0], mesh[1], uv / uv.max(0), mesh[3]


def shell(room):
    x, y, z = (LEFT + RIGHT) / 2, HEIGHT / 2, (BACK + FRONT) / 2
    hx, hy, hz = (RIGHT - LEFT) / 2, HEIGHT / 2, (FRONT - BACK) / 2
    room.add("floor", quad((x, 0, z), (0, 0, hz), (hx, 0, 0)))
    room.add("matte", quad((x, HEIGHT, z), (hx, 0, 0), (0, 0, hz)), (0.80, 0.79, 0.76))
    room.add("accent", quad((x, y, BACK), (hx, 0, 0), (0, hy, 0)))
    room.add("wall", quad((x, y, FRONT), (-hx, 0, 0), (0, hy, 0)))
    room.add("wall", quad((RIGHT, y, z), (0, 0, hz), (0, hy, 0)))
    (z0, z1), (y0, y1), deep = WINDOW["z"], WINDOW["y"], 0.16
    for a, b, c, d in ((BACK, z0, 0, HEIGHT), (z1, FRONT, 0, HEIGHT), (z0, z1, 0, y0), (z0, z1, y1, HEIGHT)):
        room.add("wall", quad((LEFT, (c + d) / 2, (a + b) / 2), (0, 0, -(b - a) / 2), (0, (d - c) / 2, 0)))
    middle = LEFT - deep / 2
    room.add("matte", quad((middle, y0, (z0 + z1) / 2), (0, 0, (z1 - z0) / 2), (deep / 2, 0, 0)), WHITE)
    room.add("matte", quad((middle, y1, (z0 + z1) / 2), (deep / 2, 0, 0), (0, 0, (z1 - z0) / 2)), WHITE)
    room.add("matte", quad((middle, (y0 + y1) / 2, z0), (deep / 2, 0, 0), (0, (y1 - y0) / 2, 0)), WHITE)
    room.add("matte", quad((middle, (y0 + y1) / 2, z1), (-deep / 2, 0, 0), (0, (y1 - y0) / 2, 0)), WHITE)
    for low, high in (
        ((LEFT, 0, BACK), (RIGHT, 0.09, BACK + 0.018)),
        ((LEFT, 0, BACK), (LEFT + 0.018, 0.09, FRONT)),
        ((RIGHT - 0.018, 0, BACK), (RIGHT, 0.09, FRONT)),
    ):
        room.add("matte", box(low, high), WHITE)


def window_frame(room):
    (z0, z1), (y0, y1) = WINDOW["z"], WINDOW["y"]
    x, w, t = LEFT - WINDOW["deep"], 0.055, 0.025
    bar = lambda za, zb, ya, yb: room.add("matte", box((x - t, ya, za), (x + t, yb, zb)), WHITE)
    bar(z0, z1, y0, y0 + w)
    bar(z0, z1, y1 - w, y1)
    bar(z0, z0 + w, y0, y1)
    bar(z1 - w, z1, y0, y1)
    middle = (z0 + z1) / 2
    bar(middle - w / 2, middle + w / 2, y0, y1)
    bar(z0, z1, y1 - 0.42, y1 - 0.42 + w * 0.7)
    room.add("gloss", box((LEFT - 0.10, y0 - 0.03, z0 - 0.05), (LEFT + 0.10, y0, z1 + 0.05), 0.008), WHITE)


def curtains(room):
    (z0, z1), y1 = WINDOW["z"], WINDOW["y"][1] + 0.12

    def cloth(za, zb, folds):
        def f(u, v):
            wave = np.sin(2 * np.pi * folds * u + 0.4 * np.sin(5 * u)) * (0.035 + 0.015 * (1 - v))
            return np.stack([LEFT + 0.11 + wave, 0.03 + v * (y1 - 0.03), za + u * (zb - za) + 0.01 * np.sin(9 * v + 3 * u)], -1)

        return sheet(f, 120, 24)

    room.cloth("linen", cloth(z0 - 0.02, BACK + 0.04, 4.5), LINEN)
    room.cloth("linen", cloth(z1 + 0.34, z1 - 0.02, 5.0), LINEN)
    room.add("gloss", rod((LEFT + 0.11, y1 + 0.02, BACK + 0.03), (LEFT + 0.11, y1 + 0.02, z1 + 0.45), 0.013), (0.05, 0.04, 0.035))
    room.add("gloss", ball((LEFT + 0.11, y1 + 0.02, z1 + 0.46), 0.028), (0.05, 0.04, 0.035))


def sofa(room):
    x0, x1, z0, z1 = -1.42, 0.62, BACK + 0.06, BACK + 0.94
    arm, seat = 0.17, 0.26
    room.add("sofa", box((x0, 0.13, z0), (x1, seat, z1 - 0.02), 0.03))
    room.add("sofa", box((x0, 0.13, z0), (x1, 0.74, z0 + 0.20), 0.06))
    for a in (x0, x1 - arm):
        room.add("sofa", box((a, 0.13, z0), (a + arm, 0.60, z1), 0.06))
    inner = (x1 - x0 - 2 * arm) / 2
    for k in range(2):
        a = x0 + arm + k * inner
        room.add("sofa", box((a + 0.005, seat, z0 + 0.18), (a + inner - 0.005, seat + 0.17, z1 + 0.015), 0.05, puff=0.12))
        back = box((-inner / 2 + 0.008, 0, -0.085), (inner / 2 - 0.008, 0.42, 0.085), 0.06, puff=0.25)
        room.add("sofa", moved(back, (a + inner / 2, seat + 0.15, z0 + 0.30), pitch=-12))
    for x in (x0 + 0.08, x1 - 0.08):
        for z in (z0 + 0.08, z1 - 0.10):
            room.add("walnut", rod((x, 0, z), (x, 0.14, z), 0.022))
    cushion = box((-0.22, -0.22, -0.075), (0.22, 0.22, 0.075), 0.05, puff=0.62)
    room.cloth("cushion", moved(cushion, (x0 + 0.43, 0.645, z0 + 0.50), pitch=-22, yaw=14), (0.66, 0.60, 0.48))
    room.add("matte", moved(cushion, (x0 + 0.72, 0.625, z0 + 0.56), pitch=-26, yaw=-8, roll=9), (0.58, 0.34, 0.06))
    room.add("matte", moved(cushion, (x1 - 0.44, 0.64, z0 + 0.51), pitch=-22, yaw=-16, roll=-5), (0.05, 0.16, 0.17))


def coffee_table(room):
    x, z, top = 0.02, -2.62, 0.41
    room.add("walnut", lathe([(0.43, top - 0.03), (0.445, top - 0.015), (0.44, top)], (x, 0, z), 72, closed=True))
    for k in range(3):
        a = np.radians(90 + 120 * k)
        foot, head = 0.36, 0.24
        room.add("walnut", rod((x + foot * np.cos(a), 0.012, z + foot * np.sin(a)), (x + head * np.cos(a), top - 0.02, z + head * np.sin(a)), 0.02))
    stack = ((0.24, 0.17, 0.030, (0.05, 0.10, 0.16), 8), (0.22, 0.16, 0.024, (0.62, 0.55, 0.42), -6), (0.19, 0.14, 0.022, (0.42, 0.08, 0.05), 15))
    y = top
    for w, d, h, color, yaw in stack:
        room.add("gloss", moved(box((-w / 2, 0, -d / 2), (w / 2, h, d / 2), 0.003, 1), (x - 0.17, y, z + 0.10), yaw=yaw), color)
        y += h
    room.add("gloss", smooth_lathe([(0.035, 0), (0.075, 0.02), (0.10, 0.055), (0.105, 0.062), (0.098, 0.056), (0.07, 0.024), (0.002, 0.016)], (x - 0.16, y, z + 0.10)), (0.60, 0.58, 0.52))
    room.add("gloss", smooth_lathe([(0.002, 0), (0.038, 0.002), (0.042, 0.03), (0.042, 0.085), (0.038, 0.083), (0.036, 0.01), (0.002, 0.008)], (x + 0.07, top, z + 0.25)), (0.10, 0.22, 0.24))


def side_table(room):
    x, _, z = SHADE["base"]
    top, foot = 0.52, SHADE["base"][1]
    room.add("walnut", lathe([(0.25, top - 0.025), (0.25, top)], (x, 0, z), 64, closed=True))
    room.add("walnut", rod((x, 0.02, z), (x, top - 0.02, z), 0.025))
    room.add("walnut", lathe([(0.17, 0.0), (0.16, 0.02), (0.03, 0.03)], (x, 0, z), 48, closed=True))
    room.add("gloss", smooth_lathe([(0.002, 0), (0.07, 0.004), (0.105, 0.07), (0.115, 0.14), (0.085, 0.225), (0.035, 0.275), (0.022, 0.30), (0.022, 0.34)], (x, top, z)), (0.50, 0.50, 0.46))
    room.add("gloss", rod((x, top + 0.30, z), (x, foot + 0.02, z), 0.012), (0.45, 0.32, 0.14))
    room.add("gloss", moved(box((-0.07, 0, -0.10), (0.07, 0.022, 0.10), 0.003, 1), (x + 0.02, top, z + 0.15), yaw=70), (0.06, 0.13, 0.09))


def shelf(room):
    rng = np.random.default_rng(11)
    x0, x1, z0, z1, top, t = 1.34, 2.27, BACK + 0.01, BACK + 0.31, 2.02, 0.025
    boards = np.array([0.06, 0.44, 0.80, 1.16, 1.52, top])
    for a in (x0, x1 - t):
        room.add("walnut", box((a, 0, z0), (a + t, top, z1)))
    for y in boards:
        room.add("walnut", box((x0 + t, y - t, z0), (x1 - t, y, z1)))
    room.add("walnut", box((x0, 0.0, z0), (x1, top, z0 + 0.012)))
    tones = np.array([
        (0.42, 0.09, 0.05), (0.07, 0.13, 0.22), (0.58, 0.40, 0.12), (0.64, 0.58, 0.46), (0.09, 0.20, 0.15), (0.30, 0.29, 0.27), (0.50, 0.22, 0.08),
        (0.12, 0.07, 0.06), (0.55, 0.53, 0.50), (0.14, 0.27, 0.32), (0.36, 0.14, 0.18), (0.70, 0.66, 0.58),
    ])

    def row(a, b, y, room_above):
        x = a
        while True:
            w, h, d = rng.uniform(0.018, 0.045), rng.uniform(0.62, 0.92) * room_above, rng.uniform(0.15, 0.22)
            if x + w > b:
                return
            color = tones[rng.integers(len(tones))] * rng.uniform(0.8, 1.15)
            room.add("gloss" if rng.random() < 0.3 else "matte", box((x, y, z1 - 0.03 - d), (x + w - 0.002, y + h, z1 - 0.03), 0.002, 1), color)
            if room.rich:  # a label or two on the spine
                for k in range(1 + int(97 * w * h) % 2):
                    label = y + h * (0.72 - 0.5 * k)
                    tone = tones[int(1e4 * w) % len(tones)] if k else (0.62, 0.52, 0.30)
                    room.add("matte", box((x, label, z1 - 0.031), (x + w - 0.002, label + 0.025, z1 - 0.0295)), tone)
            x += w

    a, b = x0 + t + 0.006, x1 - t - 0.006
    gap = 0.335
    row(a, b, boards[0], gap)
    row(a + 0.30, b, boards[1], gap * 0.95)
    row(a, a + 0.52, boards[2], gap)
    row(a, b - 0.24, boards[3], gap * 0.9)
    row(a + 0.42, b, boards[4], gap * 1.1)
    zc = (z0 + z1) / 2 + 0.03
    room.add("matte", box((a + 0.02, boards[1], zc - 0.1), (a + 0.26, boards[1] + 0.20, zc + 0.1), 0.012), (0.50, 0.38, 0.22))
    room.add("gloss", smooth_lathe([(0.002, 0), (0.05, 0.003), (0.085, 0.08), (0.06, 0.16), (0.03, 0.20), (0.045, 0.235)], (b - 0.16, boards[2], zc)), (0.62, 0.30, 0.12))
    room.add("gloss", ball((b - 0.11, boards[3] + 0.075, zc), 0.075), (0.10, 0.24, 0.26))
    for k, color in enumerate(((0.07, 0.13, 0.22), (0.64, 0.58, 0.46), (0.42, 0.09, 0.05))):
        room.add("matte", moved(box((-0.12, 0, -0.085), (0.12, 0.032, 0.085), 0.003, 1), (a + 0.17, boards[4] + 0.033 * k, zc), yaw=4 * k - 3), color)
    room.add("gloss", smooth_lathe([(0.002, 0), (0.05, 0.002), (0.06, 0.06), (0.035, 0.13), (0.045, 0.15)], (a + 0.17, boards[4] + 0.10, zc)), (0.66, 0.62, 0.54))
    room.add("matte", box((x0 + 0.12, top, z0 + 0.05), (x0 + 0.46, top + 0.16, z1 - 0.03), 0.01), (0.44, 0.36, 0.26))


def pictures(room):
    def framed(texture, x, y, w, h, frame, mat):
        z, t = BACK, 0.034
        for low, high in (
            ((x - w / 2, y - h / 2, z), (x + w / 2, y - h / 2 + t, z + 0.03)),
            ((x - w / 2, y + h / 2 - t, z), (x + w / 2, y + h / 2, z + 0.03)),
            ((x - w / 2, y - h / 2, z), (x - w / 2 + t, y + h / 2, z + 0.03)),
            ((x + w / 2 - t, y - h / 2, z), (x + w / 2, y + h / 2, z + 0.03)),
        ):
            room.add("matte", box(low, high), frame)
        room.add("matte", quad((x, y, z + 0.008), (w / 2, 0, 0), (0, h / 2, 0)), (0.74, 0.72, 0.67))
        room.add(texture, stretched(quad((x, y, z + 0.010), (w / 2 - t - mat, 0, 0), (0, h / 2 - t - mat, 0))))

    framed("landscape", -0.10, 1.52, 0.98, 0.74, (0.035, 0.025, 0.02), 0.06)
    framed("stripes", 0.72, 1.62, 0.36, 0.46, (0.40, 0.27, 0.13), 0.04)


def plant(room):
    rng = np.random.default_rng(5)
    x, z = -1.80, -3.98
    room.add("gloss", smooth_lathe([(0.002, 0.0), (0.11, 0.002), (0.14, 0.10), (0.165, 0.30), (0.168, 0.32), (0.155, 0.315), (0.15, 0.28), (0.002, 0.275)], (x, 0, z)), (0.60, 0.56, 0.48))
    for k in range(15):
        turn, lean, tall = 2.4 * k + rng.uniform(-0.3, 0.3), rng.uniform(0.06, 0.30), rng.uniform(0.42, 0.78)
        wide, foot = rng.uniform(0.035, 0.050), rng.uniform(0.01, 0.09)

        def blade(u, v):
            out = foot + lean * np.abs(v) ** 1.8
            side = (2 * u - 1) * wide * np.minimum(1.0, 0.55 + 1.4 * v) * np.sqrt(np.clip(1 - v**3, 0, 1))
            twist = turn + 0.8 * v
            return np.stack([
                x + out * np.cos(turn) - side * np.sin(twist),
                0.26 + tall * v,
                z + out * np.sin(turn) + side * np.cos(twist) + 0.012 * (2 * u - 1) ** 2,
            ], -1)

        room.add("matte", sheet(blade, 6, 18), np.array([0.07, 0.20, 0.06]) * rng.uniform(0.7, 1.5))


def rug(room):
    low, high = np.array([-1.30, 0.0, -3.62]), np.array([1.26, 0.014, -1.72])
    room.add("rug", stretched(quad(((low[0] + high[0]) / 2, 0.014, (low[2] + high[2]) / 2), ((high[0] - low[0]) / 2, 0, 0), (0, 0, -(high[2] - low[2]) / 2))))
    room.add("matte", box(low, high - np.array([0, 0.001, 0])), (0.5, 0.44, 0.36))


def pouf(room):
    room.add("matte", smooth_lathe([(0.002, 0.0), (0.20, 0.003), (0.255, 0.06), (0.275, 0.17), (0.255, 0.29), (0.20, 0.35), (0.10, 0.366), (0.002, 0.37)], (1.42, 0.0, -2.72)), (0.50, 0.33, 0.10))
    room.add("matte", moved(box((-0.15, 0, -0.11), (0.15, 0.028, 0.11), 0.004, 1), (1.40, 0.368, -2.72), yaw=25), (0.62, 0.57, 0.48))


# The rich room has these in addition.


def cornice(room):
    for low, high in (
        ((LEFT, HEIGHT - 0.07, BACK), (RIGHT, HEIGHT, BACK + 0.05)),
        ((LEFT, HEIGHT - 0.07, BACK), (LEFT + 0.05, HEIGHT, FRONT)),
        ((RIGHT - 0.05, HEIGHT - 0.07, BACK), (RIGHT, HEIGHT, FRONT)),
    ):
        room.add("matte", box(low, high, 0.02), WHITE)


def throw(room):
    """A blanket over the left arm of the sofa and a corner of its seat."""
    path = np.array([(-1.455, 0.20), (-1.452, 0.40), (-1.448, 0.56), (-1.40, 0.620), (-1.335, 0.632), (-1.27, 0.622), (-1.225, 0.575), (-1.20, 0.49), (-1.13, 0.452), (-1.02, 0.456)])
    at = np.concatenate([[0], np.cumsum(np.hypot(*np.diff(path, axis=0).T))])

    def f(u, v):
        s = u * at[-1]
        wave = 0.010 * np.sin(23 * v + 3 * u) * (1 - 0.5 * u)
        x, y = (np.interp(s, at, path[:, k]) for k in (0, 1))
        return np.stack([x - wave * (u < 0.5), y + 0.004 + np.abs(wave) * (u >= 0.3), BACK + 0.46 + 0.42 * v + 0.02 * np.sin(9 * u)], -1)

    cloth = sheet(f, 60, 40)
    room.add("throw", (cloth[0], cloth[1], cloth[2] * [at[-1], 0.42], cloth[3]))


def basket(room):
    x, z = -1.66, -3.05
    rings = [(0.15, 0.0)] + [(0.15 + 0.055 * t + 0.006 * (k % 2), 0.30 * t) for k, t in enumerate(np.linspace(0.05, 1, 20))]
    weave = lathe(rings, (x, 0, z), 48)
    room.add("wicker", weave)
    room.add("matte", lathe([(0.002, 0.02), (0.14, 0.021)], (x, 0, z)), (0.2, 0.13, 0.07))
    for k, color in enumerate(((0.58, 0.34, 0.06), (0.62, 0.58, 0.50))):
        roll = lathe([(0.065, -0.16), (0.07, -0.15), (0.07, 0.15), (0.065, 0.16)], closed=True)
        room.add("matte", moved(roll, (x - 0.07 + 0.13 * k, 0.27, z), pitch=18 - 40 * k, roll=8), color)


def table_things(room):
    """A magazine and a candle on the coffee table, behind its books and cup."""
    x, z, top = 0.02, -2.62, 0.41
    room.add("cover", moved(box((-0.15, 0, -0.11), (0.15, 0.006, 0.11)), (x - 0.02, top, z - 0.24), yaw=-18))
    room.add("gloss", lathe([(0.036, 0), (0.036, 0.075)], (x + 0.27, top, z - 0.17), closed=True), (0.62, 0.58, 0.50))
    room.add("matte", rod((x + 0.27, top + 0.07, z - 0.17), (x + 0.272, top + 0.09, z - 0.17), 0.002), (0.05, 0.05, 0.05))


def fringe(room):
    """Tassels at both ends of the rug."""
    rng = np.random.default_rng(3)
    for x, out in ((-1.30, -1), (1.26, 1)):
        for z in np.arange(-3.60, -1.73, 0.022):
            tip = out * rng.uniform(0.05, 0.07)
            room.add("matte", rod((x, 0.008, z), (x + tip, 0.004, z + rng.normal(0, 0.006)), 0.004, 5), (0.62, 0.54, 0.43))


def build(rich):
    room = Room(rich)
    parts = [shell, window_frame, curtains, sofa, coffee_table, side_table, shelf, pictures, plant, rug, pouf]
    for part in parts + [cornice, throw, basket, table_things, fringe] * rich:
        part(room)
    return room.merged()


def shade():
    s = SHADE
    return lathe([(s["radius_low"], 0), (s["radius_high"], s["height"])], s["base"], 64, closed=True)
