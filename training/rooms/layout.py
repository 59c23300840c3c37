"""A furnished room from a seed: meters, y up, floor at y = 0; the camera comes later (see `views.py`).

Surfaces are triangles with one albedo and one GGX roughness each; printed pictures are fine grids of them, repeated patterns are those of patterns.py. Lamps are convex emitters on stands that do not emit;
windows are holes in the walls with a pane at the outer end."""

from dataclasses import dataclass, field, replace

import numpy as np
import shapes
import textures

from color import blackbody, hsv

PLAIN, WOOD, STRIPES, CHECK, PLAID, DOTS, CLOUDS, WEAVE = range(8)  # kinds of patterns, which patterns.py draws
STEP = 0.03  # side of the triangles of a pattern, meters
MATTE = 1.0


@dataclass
class Lamp:
    """A convex emitter: `kind` and `place` as in lights.json but in the world; radiance in cd/m2."""

    kind: str
    place: dict
    radiance: np.ndarray

    def mesh(self):
        """Points and faces of a Box or a Mesh, counter-clockwise from outside."""
        if self.kind == "Box":
            return box_mesh(self.place["center"], self.place["half_axes"])
        corners = self.place["triangles"].reshape(-1, 3)
        return corners, np.arange(len(corners)).reshape(-1, 3)


@dataclass
class Window:
    """A pane: half_x cross half_y points into the room. Lobes (name, direction, bandwidth, radiance in cd/m2) of the light behind it."""

    center: np.ndarray
    half_x: np.ndarray
    half_y: np.ndarray
    lobes: list


@dataclass
class Room:
    kind: str
    footprint: np.ndarray  # [n, 2] corners (x, z), the room on the left of each side seen from above with z down
    height: float
    night: bool
    hall: bool = False  # large
    parts: list = field(default_factory=list)  # (points, normals, faces, albedo [m, 3], roughness [m])
    taken: list = field(default_factory=list)  # (low, high) of what stands in the room
    tops: list = field(default_factory=list)  # (points, faces, low, high) of furniture that carries things
    lamps: list = field(default_factory=list)
    windows: list = field(default_factory=list)
    openings: list = field(default_factory=list)  # (wall, start, end, sill, top)
    patterns: dict = field(default_factory=dict)  # {place in parts: (kind, length in meters, offset, factor of the second albedo [3])}
    bare: np.ndarray = None  # faces of `merged` that have no pattern any more

    def add(self, mesh, color, rough=MATTE, pattern=None):
        if pattern is not None:
            self.patterns[len(self.parts)] = pattern
        points, normals, _, faces = mesh
        self.parts.append(
            (
                points,
                normals,
                faces,
                np.broadcast_to(np.asarray(color, float), (len(faces), 3)),
                np.broadcast_to(np.asarray(rough, float), len(faces)),
            )
        )

    def merged(self):
        """All parts as one: points, normals, faces, albedo of 0.01..0.92, roughness."""
        points, normals, faces, albedo, rough = zip(*self.parts)
        starts = np.cumsum([0] + [len(p) for p in points[:-1]])
        faces = np.concatenate([f + start for f, start in zip(faces, starts)])
        return np.concatenate(points), np.concatenate(normals), faces, np.clip(np.concatenate(albedo), 0.01, 0.92), np.concatenate(rough)

    def patterned(self):
        """Second albedo and (kind, length, offset) of the faces of `merged`."""
        second, pattern = [], []
        for number, part in enumerate(self.parts):
            kind, length, offset, factor = self.patterns.get(number, (0, 1.0, 0.0, np.ones(3)))
            second.append(np.clip(part[3] * factor, 0.01, 0.92))
            pattern.append(np.broadcast_to(np.array([kind, length, offset], float), (len(part[2]), 3)))
        second, pattern = np.concatenate(second), np.concatenate(pattern)
        if self.bare is not None:
            pattern[self.bare, 0] = PLAIN
        return second, pattern

    def walls(self):
        """(start, along, inward, length) of each, seen from above."""
        for a, b in zip(self.footprint, np.roll(self.footprint, -1, 0)):
            along = (b - a) / np.linalg.norm(b - a)
            yield a, along, np.array([along[1], -along[0]]), np.linalg.norm(b - a)

    def inside(self, x, z, margin=0.0):
        """Whether points lie in the room, at least `margin` from its walls."""
        x, z = np.asarray(x, float), np.asarray(z, float)
        odd, far = np.zeros(x.shape, bool), np.ones(x.shape, bool)
        for (start, along, _, length), b in zip(self.walls(), np.roll(self.footprint, -1, 0)):
            (ax, az), (bx, bz) = start, b
            crosses = (az > z) != (bz > z)
            odd ^= crosses & (x < ax + (z - az) * (bx - ax) / (bz - az if bz != az else 1.0))
            s = np.clip((x - ax) * along[0] + (z - az) * along[1], 0, length)
            far &= np.hypot(x - ax - s * along[0], z - az - s * along[1]) >= margin
        return odd & far

    def free(self, low, high):
        """Whether a box stands in the room and touches nothing."""
        xs, zs = (
            np.array([low[0], high[0], low[0], high[0], (low[0] + high[0]) / 2]),
            np.array([low[2], low[2], high[2], high[2], (low[2] + high[2]) / 2]),
        )
        if not self.inside(xs, zs).all() or high[1] > self.height:
            return False
        return not any((low < h - 1e-3).all() and (high > l + 1e-3).all() for l, h in self.taken)

    def take(self, low, high):
        self.taken.append((np.asarray(low, float), np.asarray(high, float)))


def patch(origin, u, v, s, t, color, skip=None):
    """Quads between the ticks `s` along `u` and `t` along `v`, facing u cross v; `color(s, t)` gives the albedo at their centers."""
    origin, u, v = (np.asarray(a, float) for a in (origin, u, v))
    ss, tt = np.meshgrid(s, t)
    points = origin + ss[..., None] * u + tt[..., None] * v
    index = np.arange(ss.size).reshape(ss.shape)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
    cs, ct = np.meshgrid((s[:-1] + s[1:]) / 2, (t[:-1] + t[1:]) / 2)
    keep = np.ones(cs.shape, bool) if skip is None else ~skip(cs, ct)
    faces = np.concatenate([np.stack([a[keep], b[keep], c[keep]], 1), np.stack([a[keep], c[keep], d[keep]], 1)])
    n = np.cross(u, v)
    normals = np.broadcast_to(n / np.linalg.norm(n), (ss.size, 3))
    colors = color(cs[keep], ct[keep])
    return (points.reshape(-1, 3), normals, np.zeros((ss.size, 2)), faces), np.concatenate([colors, colors])


def ticks(length, extra=(), step=None):
    """0, length, the given places and, with a step, as many between."""
    regular = np.linspace(0, length, max(2, int(np.ceil(length / step)) + 1)) if step else np.array([0.0, length])
    extra = np.array([e for e in extra if 0 < e < length], float)
    near = (np.abs(regular[:, None] - extra).min(1) < 1e-6) if len(extra) else np.zeros(len(regular), bool)
    return np.sort(np.concatenate([regular[~near], extra]))


def box_mesh(center, half_axes):
    """Corners and faces, counter-clockwise from outside, of a box."""
    axes = np.asarray(half_axes, float)
    if np.linalg.det(axes) < 0:
        axes = axes * np.array([[1], [1], [-1]])
    signs = np.array([[x, y, z] for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)], float)
    faces = [(0, 2, 3), (0, 3, 1), (4, 5, 7), (4, 7, 6), (0, 1, 5), (0, 5, 4), (2, 6, 7), (2, 7, 3), (0, 4, 6), (0, 6, 2), (1, 3, 7), (1, 7, 5)]
    return np.asarray(center) + signs @ axes, np.array(faces)


def plain(color):
    return lambda s, t: np.broadcast_to(np.asarray(color, float), s.shape + (3,))


def tiled(image, meters):
    """A picture [h, w, 3] of albedo repeated every `metres` (along s, along t)."""
    h, w = image.shape[:2]
    return lambda s, t: image[(t / meters[1] * h).astype(int) % h, (s / meters[0] * w).astype(int) % w]


def textured(rng, library, place, gain=1.0):
    """One of the library's floors or walls."""
    choice = [t for t in library.textures if t.place == place]
    texture = choice[rng.integers(len(choice))]
    return tiled(np.clip(texture.albedo() * gain, 0.02, 0.9), texture.size)


# The shell.


HALLS = 0.2  # share of the rooms that are large: halls, classrooms, lofts


def footprint(rng, kind, hall=False):
    w, d = {"bedroom": (3.6, 4.0), "living": (4.6, 5.2), "office": (4.2, 4.6), "kitchen": (3.4, 4.0)}[kind] * rng.uniform(0.8, 1.3, 2)
    if hall:
        w, d = (w, d) * rng.uniform(1.3, 2.1, 2)
    corners = np.array([[0, 0], [0, d], [w, d], [w, 0]], float)
    if rng.random() < 0.3:  # L-shaped: one corner cut out
        cw, cd = w * rng.uniform(0.25, 0.5), d * rng.uniform(0.25, 0.5)
        corners = np.array([[0, 0], [0, d], [w, d], [w, cd], [w - cw, cd], [w - cw, 0]], float)
        for _ in range(rng.integers(4)):
            corners = np.stack([corners[:, 1], corners[:, 0].max() - corners[:, 0]], 1)
        corners -= corners.min(0)
    return corners


def wall_color(rng):
    kind = rng.random()
    if kind < 0.72:  # white, cream, beige
        return hsv(rng.uniform(0.05, 0.13), rng.uniform(0.03, 0.35), rng.uniform(0.55, 0.85))
    hue = rng.uniform(0.0, 0.17) if rng.random() < 0.6 else rng.random()
    if kind < 0.92:
        return hsv(hue, rng.uniform(0.15, 0.5), rng.uniform(0.35, 0.75))
    return hsv(hue, rng.uniform(0.3, 0.7), rng.uniform(0.12, 0.45))


def floor_color(rng, library):
    kind = rng.choice(["planks", "texture", "carpet", "tiles"], p=[0.45, 0.25, 0.2, 0.1])
    if kind == "texture":
        return textured(rng, library, "floor", rng.uniform(0.4, 1.05)), rng.choice([0.35, 0.6, 1.0])
    if kind == "carpet":
        return tiled(textures.weave(rng, 64, 64, hsv(rng.random(), rng.uniform(0, 0.5), rng.uniform(0.1, 0.5))).clip(0.02, 0.9), (1.0, 1.0)), MATTE
    if kind == "tiles":
        a, b = hsv(rng.random(), rng.uniform(0, 0.3), rng.uniform(0.2, 0.7)), rng.uniform(0.8, 1.1)
        image = np.broadcast_to(a, (20, 20, 3)) * np.where((np.add.outer(np.arange(20) // 10, np.arange(20) // 10) % 2)[..., None], 1, b)
        image = np.where(((np.arange(20) % 10 == 0)[:, None] | (np.arange(20) % 10 == 0)[None])[..., None], 0.6 * a, image)
        return tiled(image.clip(0.02, 0.9), (0.6, 0.6)), rng.choice([0.3, 0.5])
    light = hsv(rng.uniform(0.04, 0.1), rng.uniform(0.3, 0.75), rng.uniform(0.12, 0.55))
    return tiled(textures.planks(rng, 300, 400, 20, light * rng.uniform(0.35, 0.6), light), (4.0, 2.6)), rng.choice([0.4, 0.6, 1.0])


def shell(room, rng, library):
    low, high = room.footprint.min(0), room.footprint.max(0)
    size = high - low
    outside = lambda s, t: ~room.inside(low[0] + s, high[1] - t)
    edges = ([x - low[0] for x in room.footprint[:, 0]], [high[1] - z for z in room.footprint[:, 1]])
    color, rough = floor_color(rng, library)
    room.add(
        *patch((low[0], 0, high[1]), (1, 0, 0), (0, 0, -1), ticks(size[0], edges[0], STEP), ticks(size[1], edges[1], STEP), color, outside),
        rough,
        fabric(rng) if rough == MATTE and rng.random() < 0.6 else None,
    )
    ceiling = plain(hsv(rng.random(), rng.uniform(0, 0.05), rng.uniform(0.7, 0.88)))
    up = lambda s, t: ~room.inside(low[0] + s, low[1] + t)
    room.add(
        *patch(
            (low[0], room.height, low[1]),
            (1, 0, 0),
            (0, 0, 1),
            ticks(size[0], edges[0]),
            ticks(size[1], [size[1] - e for e in edges[1]]),
            ceiling,
            up,
        )
    )
    paint, skirting = wall_color(rng), hsv(0.1, rng.uniform(0, 0.3), rng.uniform(0.3, 0.85))
    skirt = rng.choice([0.0, 0.07, 0.1])
    papered, kind = rng.random() < 0.35, rng.choice([STRIPES, PLAID, DOTS, CLOUDS, CLOUDS])
    wallpaper = (kind, rng.uniform(0.08, 0.3), rng.random(), hsv(rng.random(), rng.uniform(0, 0.4), rng.uniform(0.45, 0.9)))
    for number, (start, along, _, length) in enumerate(room.walls()):
        own = paint if rng.random() < 0.85 else wall_color(rng)
        holes = [o[1:] for o in room.openings if o[0] == number]
        patterned = rng.random() < 0.1
        color = textured(rng, library, "wall") if patterned else plain(own)
        paper = None if patterned or not papered else wallpaper
        if skirt:
            inner = color
            color = lambda s, t, inner=inner: np.where((t < skirt)[..., None], skirting, inner(s, t))
        s = ticks(length, [x for h in holes for x in h[:2]], STEP if patterned else None)
        t = ticks(room.height, [skirt] + [y for h in holes for y in h[2:]], STEP if patterned else None)
        hole = lambda s, t: np.any([(s > h[0]) & (s < h[1]) & (t > h[2]) & (t < h[3]) for h in holes], 0) if holes else np.zeros(s.shape, bool)
        # Seen from inside the wall runs from its end to its start.
        end = start + length * along
        room.add(
            *patch(
                (end[0], 0, end[1]),
                (-along[0], 0, -along[1]),
                (0, 1, 0),
                length - s[::-1],
                t,
                lambda a, b, c=color, l=length: c(l - a, b),
                lambda a, b, l=length: hole(l - a, b),
            ),
            pattern=paper,
        )


# Windows.


def open_windows(room, rng):
    """Chooses the holes; one to three windows on different walls or side by side."""
    walls = list(room.walls())
    for _ in range(rng.choice([1, 2, 3], p=[0.5, 0.3, 0.2] if room.hall else [0.65, 0.3, 0.05])):
        for _ in range(8):
            number = rng.integers(len(walls))
            length = walls[number][3]
            width = rng.uniform(0.6, min(1.8 if length < 6 else 3.0, 0.7 * length))
            sill = rng.uniform(0.7, 1.2)
            top = min(room.height - rng.uniform(0.15, 0.6), sill + rng.uniform(0.8, 1.7))
            if rng.random() < 0.08:
                sill = 0.05  # a French window
            start = rng.uniform(0.1 * length, max(0.1 * length, 0.9 * length - width))
            if start + width < length - 0.1 and all(o[0] != number or start + width < o[1] - 0.1 or start > o[2] + 0.1 for o in room.openings):
                room.openings.append((number, start, start + width, sill, top))
                break


def outlook(room, rng, inward, share_sun):
    """Returns the light outside of a window: sun, sky and ground lobes in cd/m2."""
    out3 = np.array([-inward[0], 0, -inward[1]])
    side = np.array([-out3[2], 0, out3[0]])
    level = 10 ** (rng.uniform(-1.5, 0.5) if room.night else rng.uniform(3.0, 3.9))
    turn = lambda azimuth, elevation: (np.cos(azimuth) * out3 + np.sin(azimuth) * side) * np.cos(elevation) + np.array([0, np.sin(elevation), 0])
    sky = level * blackbody(rng.uniform(5500, 12000)) if not room.night else level * blackbody(rng.uniform(2500, 6500))
    ground = sky * rng.uniform(0.1, 0.5) * hsv(rng.uniform(0.05, 0.35), rng.uniform(0, 0.4), 1.0)
    lobes = [
        ("sky", turn(rng.uniform(-0.6, 0.6), rng.uniform(0.3, 1.3)), 10 ** rng.uniform(-0.3, 0.6), sky),
        ("ground", turn(rng.uniform(-0.4, 0.4), -rng.uniform(0.4, 1.3)), 10 ** rng.uniform(-0.3, 0.6), ground),
    ]
    if share_sun and not room.night:
        bandwidth = 10 ** rng.uniform(3.0, 4.5)
        # The sun's irradiance is that of its sky times a factor: 2 pi / bandwidth is the lobe's integral.
        sun = rng.uniform(1.5, 6.0) * level * bandwidth / 2 * blackbody(rng.uniform(4000, 5800))
        lobes.insert(0, ("sun", turn(rng.uniform(-1.1, 1.1), rng.uniform(0.15, 1.0)), bandwidth, sun))
    return lobes


def windows(room, rng):
    walls, sunny = list(room.walls()), rng.random() < 0.5
    frame_color = hsv(rng.uniform(0.05, 0.12), rng.choice([0.0, 0.5]), rng.uniform(0.2, 0.85))
    curtain_color = hsv(rng.random(), rng.uniform(0, 0.5), rng.uniform(0.25, 0.8))
    curtained, depth = rng.random() < 0.35, rng.uniform(0.03, 0.16)
    cloth_pattern = fabric(rng)
    bare = rng.random() < 0.25  # panes flush with the wall, nothing before them
    if bare:
        curtained, depth = False, 0.01
    for number, a, b, sill, top in room.openings:
        start, along, inward, _ = walls[number]
        along3, in3, up = np.array([along[0], 0, along[1]]), np.array([inward[0], 0, inward[1]]), np.array([0.0, 1, 0])
        base = np.array([start[0], 0, start[1]])
        at = lambda s, y, out=0.0: base + s * along3 + y * up - out * in3
        center, hw, hh = at((a + b) / 2, (sill + top) / 2, depth), (b - a) / 2, (top - sill) / 2
        reveal = 0.8 * np.ones(3)
        half_in = depth / 2 * in3
        for middle, across, toward in (
            (at(a, (sill + top) / 2, depth / 2), hh * up, along3),
            (at(b, (sill + top) / 2, depth / 2), hh * up, -along3),
            (at((a + b) / 2, sill, depth / 2), hw * along3, up),
            (at((a + b) / 2, top, depth / 2), hw * along3, -up),
        ):
            u, v = half_in, across
            if np.dot(np.cross(u, v), toward) < 0:
                v = -v
            room.add(shapes.quad(middle, u, v), reveal)
        x = -hw * along3 if np.dot(np.cross(hw * along3, hh * up), in3) < 0 else hw * along3
        thick = rng.uniform(0.04, 0.07)

        def bar(s0, s1, y0, y1):
            mesh = shapes.box((s0, y0, 0), (s1, y1, 0.045))
            turn = np.stack([along3, up, in3], 1)
            room.add((mesh[0] @ turn.T + base - (depth - 0.005) * in3, mesh[1] @ turn.T, *mesh[2:]), frame_color, 0.5)

        if not bare:
            for s0, s1, y0, y1 in ((a, a + thick, sill, top), (b - thick, b, sill, top), (a, b, sill, sill + thick), (a, b, top - thick, top)):
                bar(s0, s1, y0, y1)
            for k in range(rng.integers(0, 2)):
                s = a + (b - a) * (k + 1) / 3 if rng.random() < 0.5 else (a + b) / 2
                bar(s - thick / 3, s + thick / 3, sill, top)
            if rng.random() < 0.3:
                y = sill + (top - sill) * rng.uniform(0.4, 0.7)
                bar(a, b, y - thick / 3, y + thick / 3)
        room.windows.append(Window(center, x, hh * up, outlook(room, rng, inward, sunny)))
        room.take(np.minimum(at(a, sill), at(b, top, -0.1)), np.maximum(at(a, sill), at(b, top, -0.1)))
        if curtained:
            hem = sill - 0.1 if rng.random() < 0.3 else 0.04
            for side, outer in ((-1, a - 0.15), (1, b + 0.15)):
                width = rng.uniform(0.1, 0.25) * (b - a + 0.3) / 1.5 + 0.12
                s0 = outer if side < 0 else outer - width
                folds, deep, phase = rng.integers(4, 9), rng.uniform(0.02, 0.045), rng.uniform(0, 6)

                def cloth(u, v, s0=s0, width=width, hem=hem, folds=folds, deep=deep, phase=phase):
                    wave = deep * np.sin(2 * np.pi * folds * u + phase) * (1.1 - 0.3 * v)
                    return (
                        base + (s0 + u * width)[..., None] * along3 + (hem + v * (top + 0.08 - hem))[..., None] * up + (0.09 + wave)[..., None] * in3
                    )

                room.add(shapes.sheet(cloth, 8 * folds, 1), curtain_color, MATTE, cloth_pattern)
            rail = shapes.rod(at(a - 0.25, top + 0.09, -0.09), at(b + 0.25, top + 0.09, -0.09), 0.012, 8)
            room.add(rail, frame_color * 0.6, 0.4)


# Furniture.


def fabric(rng):
    """A pattern of cloth, as Room.patterns has it, or None for plain cloth."""
    kind = rng.choice([PLAIN, STRIPES, CHECK, PLAID, DOTS, CLOUDS, WEAVE], p=[0.04, 0.14, 0.08, 0.14, 0.08, 0.27, 0.25])
    length = rng.uniform(0.02, 0.05) if kind == WEAVE else rng.uniform(0.04, 0.22)
    factor = rng.uniform(0.3, 0.75) * hsv(rng.random(), rng.uniform(0, 0.5), 1.0)
    return (kind, length, rng.random(), factor) if kind != PLAIN else None


def grain(rng):
    """Wood."""
    return WOOD, rng.uniform(0.08, 0.2), rng.random(), rng.uniform(0.2, 0.55) * hsv(0.07, rng.uniform(0, 0.4), 1.0)


SMALL = {"ornament"}
SOFT = {"bed", "sofa", "armchair"}
WOODEN = {"table", "desk", "coffee_table", "bedside", "dresser", "wardrobe", "shelf", "chair", "stool"}


def stand(room, model, yaw, x, z, y=0.0, tint=None, touch=True):
    """Puts a model there if it fits; `touch` says that it takes its place. Returns its box, or None."""
    c, s = np.cos(yaw), np.sin(yaw)
    w, h, d = model.size
    half = np.array([abs(c) * w + abs(s) * d, 0, abs(s) * w + abs(c) * d]) / 2
    low, high = np.array([x, y, z]) - half, np.array([x, y + h, z]) + half
    if not room.free(low, high):
        return None
    turn = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    points = model.vertices @ turn.T + np.array([x, y, z])
    albedo = np.clip(model.albedo * (1 if tint is None else tint), 0.02, 0.9)
    # The place decides, so that no caller's random numbers move.
    own = np.random.default_rng([int(abs(v) * 1e4) for v in (x, z, y)])
    pattern = fabric(own) if model.cls in SOFT else grain(own) if model.cls in WOODEN and own.random() < 0.85 else None
    if pattern is None and model.cls in SMALL and own.random() < 0.6:  # prints and labels
        kind = own.choice([STRIPES, CHECK, PLAID, DOTS, CLOUDS])
        pattern = kind, own.uniform(0.015, 0.08), own.random(), own.uniform(0.1, 0.7) * hsv(own.random(), own.uniform(0, 0.8), 1.0)
    if pattern is not None:
        room.patterns[len(room.parts)] = pattern
    room.parts.append((points, model.normals @ turn.T, model.faces, albedo, model.rough))
    if touch:
        room.take(low, high)
    if model.cls in CARRIERS:
        room.tops.append((points, model.faces, low, high))
    return low, high


CARRIERS = {"table", "desk", "coffee_table", "bedside", "dresser", "kitchen_unit", "shelf"}


def tint(rng):
    """Returns the factor of the colors of a piece of furniture: many are darker and warmer than in the catalog."""
    if rng.random() < 0.25:
        return np.ones(3)
    if rng.random() < 0.7:
        return hsv(rng.uniform(0.02, 0.12), rng.uniform(0, 0.6), rng.uniform(0.4, 1.2))
    return hsv(rng.random(), rng.uniform(0, 0.35), rng.uniform(0.4, 1.2))


def against_wall(room, rng, model, gap=0.03):
    """Somewhere along a wall, its back to it; not before a window that it would hide."""
    walls = list(room.walls())
    for _ in range(12):
        number = rng.integers(len(walls))
        start, along, inward, length = walls[number]
        if length < model.size[0] + 0.1:
            continue
        s = rng.uniform(model.size[0] / 2 + 0.05, length - model.size[0] / 2 - 0.05)
        if any(
            o[0] == number and o[1] < s + model.size[0] / 2 and o[2] > s - model.size[0] / 2 and model.size[1] > o[3] + 0.1 for o in room.openings
        ):
            continue
        x, z = start + s * along + (model.size[2] / 2 + gap) * inward
        yaw = np.arctan2(inward[0], inward[1])
        box = stand(room, model, yaw, x, z, tint=tint(rng))
        if box is not None:
            return np.array([x, z]), yaw, inward, along
    return None


def anywhere(room, rng, model, turned=True):
    low, high = room.footprint.min(0), room.footprint.max(0)
    for _ in range(12):
        x, z = rng.uniform(low + 0.3, high - 0.3)
        yaw = rng.uniform(0, 2 * np.pi) if turned else rng.integers(4) * np.pi / 2
        if stand(room, model, yaw, x, z, tint=tint(rng)) is not None:
            return np.array([x, z]), yaw
    return None


def pick(rng, library, cls):
    models = library.models(cls)
    return models[rng.integers(len(models))] if models else None


def rug(room, rng, at, library):
    w, d = rng.uniform(1.2, 2.6), rng.uniform(0.9, 1.8)
    color = rng.integers(3)
    image = (
        textures.rug(rng, 96, 128) if color == 0 else textures.weave(rng, 64, 64, hsv(rng.random(), rng.uniform(0.1, 0.6), rng.uniform(0.15, 0.6)))
    )
    if color == 2:
        image = image * np.where((np.arange(64) // 8 % 2)[:, None, None], 1, 0.55)
    mesh, colors = patch(
        (at[0] - w / 2, 0.012, at[1] + d / 2), (1, 0, 0), (0, 0, -1), ticks(w, (), STEP), ticks(d, (), STEP), tiled(image.clip(0.02, 0.9), (w, d))
    )
    inside = room.inside(mesh[0][:, 0], mesh[0][:, 2], 0.02)
    keep = inside[mesh[3]].all(1)
    room.add((*mesh[:3], mesh[3][keep]), colors[keep])


def blobs(rng, h, w):
    """A print of patches in a few colors."""
    colors = np.array([hsv(rng.random(), rng.uniform(0, 0.9), rng.uniform(0.02, 0.85)) for _ in range(5)])
    t = 0.7 * textures.noise(rng, h, w, 5, 6) + 0.3 * textures.noise(rng, h, w, 15, 18)
    return colors[np.clip((t - 0.2) / 0.6 * 5, 0, 4).astype(int)]


def picture(room, rng):
    walls = list(room.walls())
    number = rng.integers(len(walls))
    start, along, inward, length = walls[number]
    w, h = rng.uniform(0.2, 1.2), rng.uniform(0.2, 0.9)
    if length < w + 0.3:
        return
    s, y = rng.uniform(w / 2 + 0.1, length - w / 2 - 0.1), rng.uniform(1.2, 1.85)
    along3, in3, up = np.array([along[0], 0, along[1]]), np.array([inward[0], 0, inward[1]]), np.array([0.0, 1, 0])
    center = np.array([start[0], y, start[1]]) + s * along3 + 0.015 * in3
    reach = w / 2 * np.abs(along3) + h / 2 * up + 0.012 * np.abs(in3)
    if any(o[0] == number and o[1] < s + w / 2 and o[2] > s - w / 2 for o in room.openings) or not room.free(center - reach, center + reach):
        return
    image = [textures.landscape, textures.stripes, blobs, blobs, lambda r, a, b: textures.weave(r, a, b, hsv(r.random(), 0.4, 0.6))][
        rng.integers(5)
    ](rng, 48, 64)
    image = image * hsv(rng.random(), rng.uniform(0, 0.5), rng.uniform(0.5, 1.0))
    turn = np.stack([-along3, up, in3], 1)
    frame = shapes.box((-w / 2, -h / 2, -0.012), (w / 2, h / 2, 0.008))
    room.add((frame[0] @ turn.T + center, frame[1] @ turn.T, *frame[2:]), hsv(0.08, rng.uniform(0, 0.6), rng.uniform(0.03, 0.8)), 0.5)
    rim = 0.03
    origin = center + (w / 2 - rim) * along3 - (h / 2 - rim) * up + 0.009 * in3
    paper = tiled(image[::-1].clip(0.02, 0.9), (w - 2 * rim, h - 2 * rim))
    room.add(*patch(origin, -along3, up, ticks(w - 2 * rim, (), 0.02), ticks(h - 2 * rim, (), 0.02), paper), rng.choice([0.25, 1.0]))
    room.take(center - reach, center + reach)


def top_at(points, faces, x, z):
    """Height of the highest surface of a mesh above (x, z), or None."""
    a, b, c = (points[faces[:, k]] for k in range(3))
    u, v, w = b[:, [0, 2]] - a[:, [0, 2]], c[:, [0, 2]] - a[:, [0, 2]], np.array([x, z]) - a[:, [0, 2]]
    det = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
    det = np.where(np.abs(det) < 1e-9, np.inf, det)
    s, t = (w[:, 0] * v[:, 1] - w[:, 1] * v[:, 0]) / det, (u[:, 0] * w[:, 1] - u[:, 1] * w[:, 0]) / det
    hit = (s >= 0) & (t >= 0) & (s + t <= 1) & np.isfinite(det)
    return (a[:, 1] + s * (b[:, 1] - a[:, 1]) + t * (c[:, 1] - a[:, 1]))[hit].max() if hit.any() else None


def place_on_top(room, rng, radius):
    """A spot (x, y, z) on a table or shelf with room around it, or None."""
    for _ in range(8):
        if not room.tops:
            return None
        points, faces, low, high = room.tops[rng.integers(len(room.tops))]
        reach = (high - low)[[0, 2]] / 2 - radius
        if (reach <= 0).any():
            continue
        x, z = ((low + high) / 2)[[0, 2]] + rng.uniform(-1, 1, 2) * reach
        heights = [top_at(points, faces, x + dx * radius * 0.7, z + dz * radius * 0.7) for dx, dz in ((0, 0), (1, 0), (-1, 0), (0, 1), (0, -1))]
        if None not in heights and max(heights) - min(heights) < 0.015:
            return x, max(heights) + 1e-3, z
    return None


def books(room, rng):
    """A row of books that stand, or a pile of them, on a top."""
    spot = place_on_top(room, rng, 0.12)
    if spot is None:
        return
    x, y, z = spot
    if not room.free(np.array([x - 0.12, y, z - 0.12]), np.array([x + 0.12, y + 0.25, z + 0.12])):
        return
    turned, at, upright = rng.integers(2) * np.pi / 2, 0.0, rng.random() < 0.6
    c, s = np.cos(turned), np.sin(turned)
    turn = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    for _ in range(rng.integers(3, 9)):
        thick, tall, deep = rng.uniform(0.012, 0.045), rng.uniform(0.17, 0.27), rng.uniform(0.12, 0.18)
        if upright:
            low, high = (at - 0.12, 0, -deep / 2), (at + thick - 0.12, tall, deep / 2)
        else:
            low, high = (-tall / 2, at, -deep / 2), (tall / 2, at + thick, deep / 2)
        at += thick + 0.001
        if at > 0.24:
            break
        mesh = shapes.box(low, high)
        corners = mesh[0] @ turn.T + np.array([x, y, z])
        room.add((corners, mesh[1] @ turn.T, *mesh[2:]), hsv(rng.random(), rng.uniform(0, 0.75), rng.uniform(0.04, 0.6)), 0.5)
    room.take((x - 0.12, y, z - 0.12), (x + 0.12, y + 0.25, z + 0.12))


def furnish(room, rng, library):
    put = lambda cls: (m := pick(rng, library, cls)) is not None and against_wall(room, rng, m)
    some = lambda cls, most: [put(cls) for _ in range(rng.integers(0, most + 1))]

    def beside(cls, at, yaw, offset, facing=0.0):
        """A model at an offset (to the right, forwards) of something that stands there and faces `yaw`."""
        model = pick(rng, library, cls)
        if model is None:
            return None
        right, ahead = np.array([np.cos(yaw), -np.sin(yaw)]), np.array([np.sin(yaw), np.cos(yaw)])
        x, z = at + offset[0] * right + offset[1] * ahead
        return stand(room, model, yaw + facing, x, z, tint=tint(rng))

    def dining():
        model = pick(rng, library, "table")
        spot = model is not None and anywhere(room, rng, model, False)
        if spot:
            for side in range(4):
                if rng.random() < 0.7:
                    reach = (model.size[2] if side % 2 == 0 else model.size[0]) / 2 + 0.3
                    chair = pick(rng, library, "chair")
                    turn = spot[1] + side * np.pi / 2
                    x, z = spot[0] + reach * np.array([np.sin(turn), np.cos(turn)])
                    if chair is not None:
                        stand(room, chair, turn + np.pi + rng.normal(0, 0.15), x, z, tint=tint(rng))

    def rows():
        """Desks with chairs behind each other, as in a classroom."""
        desk, chair = pick(rng, library, "desk"), pick(rng, library, "chair")
        if desk is None or chair is None:
            return
        low, high = room.footprint.min(0) + 1.0, room.footprint.max(0) - 1.0
        yaw, step = rng.integers(4) * np.pi / 2, np.array([desk.size[0] + rng.uniform(0.2, 0.8), desk.size[2] + rng.uniform(0.7, 1.2)])
        if yaw % np.pi > 1:
            step = step[::-1]
        back = -np.array([np.sin(yaw), np.cos(yaw)]) * (desk.size[2] / 2 + 0.25)
        for x in np.arange(low[0], high[0], step[0])[:6]:
            for z in np.arange(low[1], high[1], step[1])[:6]:
                if stand(room, desk, yaw, x, z):
                    stand(room, chair, yaw + rng.normal(0, 0.1), x + back[0], z + back[1], touch=False)

    if room.hall and rng.random() < 0.4:
        rows()
    if room.kind == "bedroom":
        bed = pick(rng, library, "bed")
        spot = bed is not None and against_wall(room, rng, bed)
        if spot:
            for side in (-1, 1):
                if rng.random() < 0.8:
                    beside("bedside", spot[0], spot[1], (side * (bed.size[0] / 2 + 0.35), -bed.size[2] / 2 + 0.25))
        put("wardrobe"), some("dresser", 1), some("armchair", 1), some("shelf", 1)
    if room.kind == "living":
        sofa = pick(rng, library, "sofa")
        spot = sofa is not None and against_wall(room, rng, sofa)
        if spot:
            beside("coffee_table", spot[0], spot[1], (rng.uniform(-0.2, 0.2), sofa.size[2] / 2 + rng.uniform(0.5, 0.9)))
            if rng.random() < 0.6:
                rug(room, rng, spot[0] + np.array([np.sin(spot[1]), np.cos(spot[1])]) * 1.1, library)
        some("sofa", 1), some("armchair", 2), some("shelf", 2), some("tv", 1), some("dresser", 1)
        if rng.random() < 0.5:
            dining()
    if room.kind == "office":
        for _ in range(rng.integers(1, 4)):
            desk = pick(rng, library, "desk")
            spot = desk is not None and against_wall(room, rng, desk)
            if spot:
                beside("chair", spot[0], spot[1], (rng.uniform(-0.2, 0.2), desk.size[2] / 2 + 0.3), np.pi)
        put("shelf"), some("shelf", 2), some("wardrobe", 1), some("armchair", 1)
    if room.kind == "kitchen":
        for cls in ("fridge", "kitchen_unit", "sink", "oven", "kitchen_unit", "kitchen_unit", "dresser"):
            if rng.random() < 0.75:
                put(cls)
        dining()
    for _ in range(rng.integers(0, 4)):
        plant = pick(rng, library, "plant")
        if plant is not None and plant.size[1] < 2.0:
            anywhere(room, rng, plant) if rng.random() < 0.3 else against_wall(room, rng, plant)
    for _ in range(rng.integers(6, 26) if room.hall else rng.integers(4, 12)):  # anything
        cls = rng.choice(["chair", "stool", "armchair", "other", "table", "coffee_table", "ornament", "ornament"])
        model = pick(rng, library, cls)
        if model is not None and max(model.size) < 2.2:
            anywhere(room, rng, model)
    if rng.random() < 0.3:
        rug(room, rng, room.footprint.mean(0), library)
    for _ in range(rng.integers(6, 18)):
        picture(room, rng)
    for _ in range(rng.integers(8, 24)):
        books(room, rng)
    for _ in range(rng.integers(20, 60)):
        model = pick(rng, library, "ornament")
        if model is not None and max(model.size) < 0.6:
            spot = place_on_top(room, rng, max(model.size[0], model.size[2]) / 2)
            if spot:
                stand(room, model, rng.uniform(0, 6.3), spot[0], spot[2], spot[1], tint=tint(rng))


# Lamps.


def frustum(low, high, height, at, around=12):
    """A shade of 48 triangles: the program's closed form costs by the triangle."""
    return shapes.lathe([(low, 0), (high, height)], at, around, closed=True)


def flux_to_radiance(rng, lumens, area, kelvin):
    """cd/m2 per channel of a Lambertian emitter of that area, m2."""
    return lumens / (np.pi * area) * blackbody(kelvin)


def scale(lit, name, factor):
    """Makes a light of a lit room (scene.Lit) that much brighter."""
    if name in lit.lamps:
        lit.lamps[name] = replace(lit.lamps[name], radiance=lit.lamps[name].radiance * factor)
    else:
        window = lit.windows[name]
        lit.windows[name] = replace(window, lobes=[(n, d, b, np.asarray(w) * factor) for n, d, b, w in window.lobes])


def triangles(mesh):
    return mesh[0][mesh[3]]


def area_of(corners):
    return 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum()


def emitter(room, rng, mesh_or_place, kind, lumens):
    kelvin = rng.uniform(2200, 3200) if rng.random() < 0.85 else rng.uniform(3200, 5500)
    if kind == "Mesh":
        corners = triangles(mesh_or_place)
        corners = corners[np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) > 1e-8]
        place, area = {"triangles": corners}, area_of(corners)
        low, high = corners.min((0, 1)), corners.max((0, 1))
    else:
        place = mesh_or_place
        c = np.asarray(place["center"])
        if kind == "Sphere":
            area, reach = 4 * np.pi * place["radius"] ** 2, np.full(3, place["radius"])
        elif kind == "Rect":
            x, y = place["half_x"], place["half_y"]
            area, reach = 4 * np.linalg.norm(np.cross(x, y)), np.abs(x) + np.abs(y)
        else:
            axes = np.array(place["half_axes"])
            lengths = np.linalg.norm(axes, axis=1)
            area, reach = 8 * (lengths[0] * lengths[1] + lengths[1] * lengths[2] + lengths[2] * lengths[0]), np.abs(axes).sum(0)
        low, high = c - reach, c + reach
    room.lamps.append(Lamp(kind, place, flux_to_radiance(rng, lumens, area, kelvin)))
    room.take(low - 0.005, high + 0.005)


def table_lamp(room, rng):
    spot = place_on_top(room, rng, 0.1)
    if spot is None:
        return
    x, y, z = spot
    shape, height = rng.choice(["shade", "globe"], p=[0.75, 0.25]), rng.uniform(0.12, 0.32)
    low = rng.uniform(0.09, 0.2)
    if not room.free(np.array([x - low, y, z - low]), np.array([x + low, y + height + 0.3, z + low])):
        return
    color = hsv(rng.random(), rng.uniform(0, 0.6), rng.uniform(0.05, 0.7))
    r = rng.uniform(0.03, 0.08)
    body = (
        shapes.smooth_lathe([(r, 0), (r * rng.uniform(0.4, 1.4), height * 0.4), (0.012, height)], (x, y, z), 20)
        if rng.random() < 0.5
        else shapes.merge(shapes.lathe([(r, 0), (r, 0.015)], (x, y, z), 20, True), shapes.rod((x, y + 0.015, z), (x, y + height, z), 0.01, 8))
    )
    room.add(body, color, rng.choice([0.3, 1.0]))
    lumens = 10 ** rng.uniform(2.2, 2.9)
    if shape == "globe":
        radius = rng.uniform(0.05, 0.12)
        emitter(room, rng, {"center": np.array([x, y + height + radius, z]), "radius": radius}, "Sphere", lumens)
    else:
        tall = rng.uniform(0.12, 0.28)
        emitter(room, rng, frustum(low, low * rng.uniform(0.45, 1.0), tall, (x, y + height, z)), "Mesh", lumens)


def floor_lamp(room, rng):
    for _ in range(10):
        low, high = room.footprint.min(0), room.footprint.max(0)
        x, z = rng.uniform(low, high)
        height, r = rng.uniform(1.2, 1.7), rng.uniform(0.12, 0.24)
        if not room.inside(x, z, r + 0.03) or not room.free(np.array([x - r, 0, z - r]), np.array([x + r, height + 0.4, z + r])):
            continue
        color = hsv(rng.random(), rng.uniform(0, 0.4), rng.uniform(0.04, 0.6))
        room.add(shapes.lathe([(0.14, 0), (0.14, 0.02)], (x, 0, z), 20, True), color, 0.4)
        room.add(shapes.rod((x, 0.02, z), (x, height, z), 0.012, 8), color, 0.4)
        room.take((x - 0.14, 0, z - 0.14), (x + 0.14, height, z + 0.14))
        lumens = 10 ** rng.uniform(2.5, 3.2)
        if rng.random() < 0.25:
            emitter(room, rng, {"center": np.array([x, height + r, z]), "radius": r}, "Sphere", lumens)
        else:
            emitter(room, rng, frustum(r, r * rng.uniform(0.5, 1.0), rng.uniform(0.2, 0.38), (x, height, z)), "Mesh", lumens)
        return


def pendant(room, rng):
    centre = (
        room.footprint.mean(0)
        if room.inside(*room.footprint.mean(0), 0.4)
        else room.footprint[0] + 0.7 * np.sign(room.footprint.mean(0) - room.footprint[0])
    )
    x, z = centre + rng.normal(0, 0.4, 2)
    if not room.inside(x, z, 0.3):
        return
    bottom, lumens = rng.uniform(1.7, room.height - 0.35), 10 ** rng.uniform(2.6, 3.3)
    kind = rng.choice(["globe", "shade", "box"], p=[0.45, 0.4, 0.15])
    r = rng.uniform(0.09, 0.22)
    if not room.free(np.array([x - r, bottom, z - r]), np.array([x + r, room.height - 0.01, z + r])):
        return
    if kind == "globe":
        emitter(room, rng, {"center": np.array([x, bottom + r, z]), "radius": r}, "Sphere", lumens)
        top = bottom + 2 * r
    elif kind == "shade":
        tall = rng.uniform(0.12, 0.25)
        emitter(room, rng, frustum(r, r * rng.uniform(0.3, 1.0), tall, (x, bottom, z)), "Mesh", lumens)
        top = bottom + tall
    else:
        half, yaw = np.array([rng.uniform(0.1, 0.5), rng.uniform(0.02, 0.1), rng.uniform(0.05, 0.15)]), rng.uniform(0, np.pi)
        axes = np.diag(half) @ np.array([[np.cos(yaw), 0, -np.sin(yaw)], [0, 1, 0], [np.sin(yaw), 0, np.cos(yaw)]])
        emitter(room, rng, {"center": np.array([x, bottom + half[1], z]), "half_axes": axes}, "Box", lumens)
        top = bottom + 2 * half[1]
    if room.height - top > 0.03:
        room.add(shapes.rod((x, top, z), (x, room.height, z), 0.004, 6), 0.1 * np.ones(3))


def ceiling_lamp(room, rng):
    low, high = room.footprint.min(0), room.footprint.max(0)
    for _ in range(10):
        x, z = rng.uniform(low, high)
        if not room.inside(x, z, 0.45):
            continue
        lumens, kind, y = 10 ** rng.uniform(2.8, 3.5), rng.choice(["panel", "drum", "globe"]), room.height
        if kind == "panel":
            a, b = rng.uniform(0.15, 0.6), rng.uniform(0.15, 0.3)
            place = {"center": np.array([x, y - 0.012, z]), "half_x": np.array([a, 0, 0]), "half_y": np.array([0, 0, b])}
            if room.inside([x - a, x + a], [z - b, z + b]).all():
                emitter(room, rng, place, "Rect", lumens)
        elif kind == "drum":
            r, tall = rng.uniform(0.12, 0.28), rng.uniform(0.06, 0.14)
            emitter(room, rng, frustum(r * rng.uniform(0.7, 1.0), r, tall, (x, y - tall - 0.003, z)), "Mesh", lumens)
        else:
            r = rng.uniform(0.09, 0.17)
            emitter(room, rng, {"center": np.array([x, y - r - 0.02, z]), "radius": r}, "Sphere", lumens)
        return


def strip(room, rng):
    walls = list(room.walls())
    start, along, inward, length = walls[rng.integers(len(walls))]
    half = np.array([rng.uniform(0.2, min(0.75, length / 2 - 0.1)), rng.uniform(0.012, 0.03), rng.uniform(0.012, 0.03)])
    s, y = rng.uniform(half[0] + 0.05, length - half[0] - 0.05), rng.uniform(1.75, room.height - 0.08)
    center = np.array([start[0], y, start[1]]) + s * np.array([along[0], 0, along[1]]) + 0.06 * np.array([inward[0], 0, inward[1]])
    axes = half[:, None] * np.array([[along[0], 0, along[1]], [0, 1, 0], [inward[0], 0, inward[1]]])
    reach = np.abs(axes).sum(0)
    if room.free(center - reach, center + reach):
        emitter(room, rng, {"center": center, "half_axes": axes}, "Box", 10 ** rng.uniform(2.4, 3.1))


def lamps(room, rng):
    wanted = rng.integers(2, 6 if room.hall else 5)
    for _ in range(wanted):
        rng.choice([table_lamp, floor_lamp, pendant, ceiling_lamp, strip], p=[0.32, 0.22, 0.16, 0.2, 0.1])(room, rng)


def make(seed, library):
    """The room of a seed. `library` is that of assets.py, or part of it."""
    rng = np.random.default_rng(seed)
    kind = rng.choice(["bedroom", "living", "office", "kitchen"], p=[0.32, 0.36, 0.16, 0.16])
    hall = rng.random() < HALLS
    room = Room(kind, footprint(rng, kind, hall), rng.uniform(2.8, 4.2) if hall else rng.uniform(2.4, 3.1), rng.random() < 0.3, hall)
    open_windows(room, rng)
    windows(room, rng)
    shell(room, rng, library)
    furnish(room, rng, library)
    lamps(room, rng)
    return room, rng
