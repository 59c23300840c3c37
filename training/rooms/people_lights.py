"""Lights and more furniture for the third-party rooms of people_scenes.py: their own windows and lamps, new windows on bare walls, and new lamps, models
and pictures of layout.py where the scene leaves room."""

import numpy as np

import layout
import shapes
from color import hsv

UP = np.array([0.0, 1, 0])


class Space(layout.Room):
    """The free space of a scene, with the interface of layout.py's rooms. `cast(origins, directions)` gives distances to the scene's surfaces."""

    def __init__(self, model, cast, night, skip):
        x0, z0, x1, z1 = model.layout.walls
        corners = np.array([[x0, z0], [x0, z1], [x1, z1], [x1, z0]], float)
        super().__init__(model.name, corners, model.layout.ceiling, night)
        self.cast = cast
        corners = model.points[model.faces[~np.isin(np.array(model.finish_of)[model.part], list(skip))]]
        self.low, self.high = corners.min(1), corners.max(1)

    def free(self, low, high):
        """Whether a box touches no bounding box of a triangle, by 1 cm, and nothing that was put there."""
        low, high = np.asarray(low, float) + 0.01, np.asarray(high, float) - 0.01
        if not super().free(low, high):
            return False
        return not ((self.low < high) & (self.high > low)).all(1).any()

    def find_tops(self, rng, tries=400):
        """Adds horizontal surfaces 0.4 to 1.2 m above the floor with 0.5 m of free height: what carries lamps and ornaments."""
        (x0, z0), (x1, z1) = self.footprint.min(0), self.footprint.max(0)
        at = np.stack([rng.uniform(x0, x1, tries), rng.uniform(1.2, 1.9, tries), rng.uniform(z0, z1, tries)], 1)
        fall = self.cast(at, -UP)
        height = at[:, 1] - fall
        for k in np.flatnonzero((height > 0.4) & (height < 1.2)):
            size = rng.uniform(0.12, 0.2)
            ring = at[k] + size * np.array([[1, 0, 0], [-1, 0, 0], [0, 0, 1], [0, 0, -1], [0.7, 0, 0.7], [-0.7, 0, -0.7]])
            if np.abs(at[k, 1] - self.cast(ring, -UP) - height[k]).max() > 0.004:
                continue
            c = np.array([at[k, 0], height[k], at[k, 2]])
            points = c + size * 1.5 * np.array([[-1, 0, -1], [1, 0, -1], [1, 0, 1], [-1, 0, 1]])
            low, high = points.min(0), points.max(0)
            self.tops.append((points, np.array([[0, 1, 2], [0, 2, 3]]), low, high))
            if len(self.tops) == 12:
                return


def normal(inward):
    """Returns the unit normal [3] of a window from its horizontal direction (x, z) into the room."""
    n = np.array([inward[0], 0, inward[1]], float)
    return n / np.linalg.norm(n)


def pane(space, rng, center, half_width, half_height, inward, sunny):
    """Adds a window: half_x cross half_y points into the room."""
    n = normal(inward)
    half_x = half_width * np.cross(UP, n)
    lobes = layout.outlook(space, rng, n[[0, 2]], sunny)
    space.windows.append(layout.Window(np.asarray(center, float), half_x, half_height * UP, lobes))


def covered(space, rng, center, half_width, half_height, inward):
    """Closes a window that gives no light: a blind, or dark glass."""
    n = normal(inward)
    dark = rng.random() < 0.4
    color = np.full(3, 0.03) if dark else hsv(rng.random(), rng.uniform(0, 0.4), rng.uniform(0.3, 0.8))
    space.add(shapes.quad(center, half_width * np.cross(UP, n), half_height * UP), color, 0.3 if dark else 1.0)


def bar(space, frame, s0, s1, y0, y1, out, color):
    """A box of a window's frame: s along the wall, `out` meters deep, in the frame (origin, along, inward)."""
    origin, along, n = frame
    mesh = shapes.box((s0, y0, 0), (s1, y1, out))
    turn = np.stack([along, UP, n], 1)
    space.add((mesh[0] @ turn.T + origin, mesh[1] @ turn.T, *mesh[2:]), color, 0.5)


def curtains(space, rng, frame, half_width, sill, top):
    """Two wavy curtains beside a window and their rail."""
    origin, along, n = frame
    color = hsv(rng.random(), rng.uniform(0, 0.5), rng.uniform(0.25, 0.8))
    hem = sill - 0.1 if rng.random() < 0.4 else 0.04
    for side in (-1, 1):
        width = rng.uniform(0.15, 0.4) * half_width + 0.12
        start = side * (half_width + 0.12) - (width if side > 0 else 0)
        folds, deep, phase = rng.integers(4, 9), rng.uniform(0.02, 0.04), rng.uniform(0, 6)

        def cloth(u, v, start=start, width=width, folds=folds, deep=deep, phase=phase):
            wave = deep * np.sin(2 * np.pi * folds * u + phase) * (1.1 - 0.3 * v)
            across = (start + u * width)[..., None] * along + (hem + v * (top + 0.08 - hem))[..., None] * UP
            return origin + across + (0.1 + wave)[..., None] * n

        space.add(shapes.sheet(cloth, 8 * folds, 1), color)
    ends = [origin + s * (half_width + 0.2) * along + (top + 0.09) * UP + 0.1 * n for s in (-1, 1)]
    space.add(shapes.rod(*ends, 0.012, 8), 0.4 * np.ones(3), 0.4)


def new_window(space, rng, sunny):
    """A window on a flat and free stretch of a wall: pane 1 cm before the wall, frame, often curtains. Whether there was room."""
    walls = list(space.walls())
    for _ in range(20):
        start, along, inward, length = walls[rng.integers(4)]
        half = rng.uniform(0.35, min(1.1, 0.4 * length))
        sill = rng.uniform(0.75, 1.1)
        top = min(rng.uniform(1.9, 2.5), space.height - 0.2)
        if length < 2 * half + 0.5:
            continue
        s = rng.uniform(half + 0.2, length - half - 0.2)
        along3, n = np.array([along[0], 0, along[1]]), np.array([inward[0], 0, inward[1]])
        center = np.array([start[0], 0, start[1]]) + s * along3
        # The wall behind is flat: rays from 0.4 m before it meet it at one distance.
        u, v = (g.ravel() for g in np.meshgrid(np.linspace(-half - 0.06, half + 0.06, 9), np.linspace(sill - 0.06, top + 0.06, 7)))
        far = space.cast(center + u[:, None] * along3 + v[:, None] * UP + 0.4 * n, -n)
        if np.ptp(far) > 0.02 or abs(far.mean() - 0.4) > 0.08:
            continue
        base = center + (0.4 - far.min()) * n
        reach = (half + 0.06) * np.abs(along3)
        depth = np.stack([base + 0.012 * n, base + 0.3 * n])
        low, high = depth.min(0) - reach + (sill - 0.06) * UP, depth.max(0) + reach + (top + 0.06) * UP
        if not space.free(low + 0.002, high):
            continue
        x = np.cross(UP, n)
        frame = base + 0.002 * n, x, n
        color, thick = hsv(rng.uniform(0.05, 0.12), rng.choice([0.0, 0.5]), rng.uniform(0.2, 0.85)), rng.uniform(0.04, 0.06)
        out = rng.uniform(0.03, 0.06)
        for box in (
            (-half - thick, -half, sill - thick, top + thick),
            (half, half + thick, sill - thick, top + thick),
            (-half, half, sill - thick, sill),
            (-half, half, top, top + thick),
        ):
            bar(space, frame, *box, out, color)
        for k in range(rng.integers(0, 3) if half > 0.4 else 0):
            at = half * (2 * (k + 1) / 3 - 1)
            bar(space, frame, at - 0.015, at + 0.015, sill, top, out, color)
        space.take(low, high + 0.1 * n * (n > 0))
        pane(space, rng, base + (sill + top) / 2 * UP + 0.01 * n, half, (top - sill) / 2, inward, sunny)
        if rng.random() < 0.4:
            curtains(space, rng, frame, half, sill, top)
        return True
    return False


def own_lamp(space, rng, kind, place):
    """One of the scene's own lamps, lit."""
    place = {k: np.array(v, float) if np.ndim(v) else v for k, v in place.items()}
    mesh = place["triangles"] if kind == "Mesh" else None
    lumens = 10 ** rng.uniform(2.5, 3.4)
    if mesh is None:
        layout.emitter(space, rng, place, kind, lumens)
        return
    points, faces = mesh.reshape(-1, 3), np.arange(len(mesh) * 3).reshape(-1, 3)
    layout.emitter(space, rng, (points, None, None, faces), kind, lumens)


def furnish(space, rng, library):
    """A few more models against walls or standing free, pictures, and ornaments on what is flat."""
    classes = ["armchair", "chair", "dresser", "shelf", "plant", "bedside", "stool", "ornament", "other", "wardrobe", "sofa", "table"]
    large = (space.footprint.max(0) - space.footprint.min(0)).prod() > 20
    for _ in range(rng.integers(0, 8 if large else 4)):
        model = layout.pick(rng, library, rng.choice(classes))
        if model is not None and max(model.size) < 2.2:
            layout.against_wall(space, rng, model) if rng.random() < 0.7 else layout.anywhere(space, rng, model)
    for _ in range(rng.integers(0, 6)):
        layout.picture(space, rng)
    space.find_tops(rng)
    for _ in range(rng.integers(0, 10)):
        model = layout.pick(rng, library, "ornament")
        if model is not None and max(model.size) < 0.5:
            spot = layout.place_on_top(space, rng, max(model.size[0], model.size[2]) / 2)
            if spot:
                layout.stand(space, model, rng.uniform(0, 6.3), spot[0], spot[2], spot[1], tint=layout.tint(rng))


def plan(model, rng, night):
    """Draws the lights of a room before its geometry is built: (lit windows, unlit windows, lit lamps of the scene, names of the BSDFs to leave out)."""
    given = model.layout.windows
    some = rng.permutation(len(given))[: rng.integers(0, min(len(given), 2) + 1)] if given else []
    if night and rng.random() < 0.6:
        some = []
    lit, unlit = [given[k] for k in some], [w for k, w in enumerate(given) if k not in some]
    lamps = list(model.layout.lamps)
    count = int(rng.choice([0, 1, 2], p=[0.45, 0.35, 0.2]))
    own = [lamps[k] for k in rng.permutation(len(lamps))[:count]]
    skip = {name for _, _, names in own for name in names}
    if rng.random() < 0.5:
        skip |= set(model.layout.blinds)
    return lit, unlit, own, skip


def equip(space, model, rng, library, planned):
    """Lights and furniture of a room: windows, the scene's own lamps, furniture, new lamps."""
    lit, unlit, own, _ = planned
    sunny = rng.random() < 0.5
    for center, half_width, half_height, inward, _ in lit:
        pane(space, rng, center, half_width, half_height, inward, sunny)
    for center, half_width, half_height, inward, cover in unlit:
        if cover:
            covered(space, rng, center, half_width, half_height, inward)
    for center, half_width, half_height, inward, _ in model.layout.windows:
        n = np.array([inward[0], 0, inward[1]], float)
        reach = half_width * np.abs(np.cross(UP, n)) + half_height * UP
        ends = np.stack([center, np.asarray(center) + 0.45 * n])
        space.take(ends.min(0) - reach, ends.max(0) + reach)
    for kind, place, _ in own:
        own_lamp(space, rng, kind, place)
    if rng.random() < (0.35 if lit else 0.6):
        new_window(space, rng, sunny)
    furnish(space, rng, library)
    forms = [layout.table_lamp, layout.floor_lamp, layout.pendant, layout.ceiling_lamp, layout.strip]
    for _ in range(int(rng.choice([0, 1, 2, 3], p=[0.2, 0.35, 0.3, 0.15]))):
        rng.choice(forms, p=[0.34, 0.24, 0.14, 0.2, 0.08])(space, rng)
    for _ in range(20):
        # At night a room needs a lamp.
        if space.lamps or (space.windows and not space.night):
            break
        rng.choice(forms)(space, rng)
