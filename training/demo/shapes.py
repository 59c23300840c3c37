"""Triangle meshes from formulas: boxes, rounded boxes, solids of revolution, tubes, sheets.

A mesh is (points [n,3], normals [n,3], uv [n,2], faces [m,3]); lengths in meters, y up, faces counter-clockwise from outside."""
import numpy as np

AXES = {"x": (1, 2, 0), "y": (2, 0, 1), "z": (0, 1, 2)}


def sheet(f, nu, nv):
    """The surface f(u, v) -> [..., 3] over the unit square; normals by differences, uv = (u, v)."""
    u, v = np.meshgrid(np.linspace(0, 1, nu + 1), np.linspace(0, 1, nv + 1))
    h = 1e-4
    p = f(u, v)
    n = np.cross(f(u + h, v) - f(u - h, v), f(u, v + h) - f(u, v - h))
    n /= np.maximum(np.linalg.norm(n, axis=-1, keepdims=True), 1e-12)
    i = np.arange((nu + 1) * (nv + 1)).reshape(nv + 1, nu + 1)
    a, b, c, d = (q.ravel() for q in (i[:-1, :-1], i[:-1, 1:], i[1:, 1:], i[1:, :-1]))
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    return p.reshape(-1, 3), n.reshape(-1, 3), np.stack([u, v], -1).reshape(-1, 2), faces


def merge(*meshes):
    """Several meshes as one."""
    start = np.cumsum([0] + [len(m[0]) for m in meshes[:-1]])
    return (*(np.concatenate([m[k] for m in meshes]) for k in range(3)), np.concatenate([m[3] + s for m, s in zip(meshes, start)]))


def moved(mesh, at=(0, 0, 0), yaw=0.0, pitch=0.0, roll=0.0):
    """Turned about x (pitch), z (roll) and then y (yaw), degrees, and carried to `at`."""
    (cx, sx), (cy, sy), (cz, sz) = ((np.cos(a), np.sin(a)) for a in np.radians([pitch, yaw, roll]))
    rx = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    ry = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    rz = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    r = ry @ rz @ rx
    return mesh[0] @ r.T + np.asarray(at, float), mesh[1] @ r.T, mesh[2], mesh[3]


def quad(center, x, y):
    """A rectangle with half edges `x`, `y`, facing `x cross y`; uv in meters."""
    c, x, y = (np.asarray(a, float) for a in (center, x, y))
    p, n, uv, f = sheet(lambda u, v: c + (2 * u - 1)[..., None] * x + (2 * v - 1)[..., None] * y, 1, 1)
    return p, n, uv * 2 * np.array([np.linalg.norm(x), np.linalg.norm(y)]), f


def box(low, high, edge=0.0, steps=4, puff=0.0):
    """A box between two corners. `edge` rounds its edges with that radius; `puff` swells its thinnest axis towards the middle like a cushion
    (share of its thickness that the rim loses; the shading normals stay those of the flat box). `steps` rings make one rounded edge. uv in meters on
    every face."""
    low, high = np.asarray(low, float), np.asarray(high, float)
    half, mid = (high - low) / 2, (high + low) / 2
    edge = min(edge, half.min() * 0.999)
    parts = []
    for a, b, c in AXES.values():
        for side in (1, -1):
            def ticks(k):
                if edge == 0:
                    return np.array([-half[k], half[k]])
                rim = edge * np.linspace(-1, 0, steps + 1) - (half[k] - edge)
                flat = np.linspace(-(half[k] - edge), half[k] - edge, 9)[1:-1]
                return np.concatenate([rim, flat, -rim[::-1]])
            s, t = np.meshgrid(ticks(a), ticks(b) * side)
            p = np.empty(s.shape + (3,))
            p[..., a], p[..., b], p[..., c] = s, t, side * half[c]
            if edge == 0:
                n = np.zeros_like(p)
                n[..., c] = side
            else:
                core = np.clip(p, -(half - edge), half - edge)
                n = (p - core) / np.linalg.norm(p - core, axis=-1, keepdims=True)
                p = core + edge * n
            if puff:
                k = int(np.argmin(half))
                i, j = [q for q in range(3) if q != k]
                fall = (np.clip(np.abs(p[..., i]) / half[i], 0, 1) ** 2.5 + np.clip(np.abs(p[..., j]) / half[j], 0, 1) ** 2.5).clip(0, 1)
                p[..., k] *= 1 - puff * fall
            uv = np.stack([s, t], -1).reshape(-1, 2)
            idx = np.arange(s.size).reshape(s.shape)
            q = [e.ravel() for e in (idx[:-1, :-1], idx[:-1, 1:], idx[1:, 1:], idx[1:, :-1])]
            faces = np.concatenate([np.stack([q[0], q[1], q[2]], 1), np.stack([q[0], q[2], q[3]], 1)])
            parts.append((p.reshape(-1, 3) + mid, n.reshape(-1, 3), uv, faces))
    return merge(*parts)


def lathe(profile, at=(0, 0, 0), around=48, closed=False):
    """A solid of revolution about y through `at`: straight segments between (radius, height) pairs, each with its own normals, listed from the
    bottom up on the outside. `closed` adds discs at both ends."""
    profile = [(float(r), float(y)) for r, y in profile]
    if closed:
        profile = [(1e-6, profile[0][1])] + profile + [(1e-6, profile[-1][1])]
    parts = []
    for (r0, y0), (r1, y1) in zip(profile[:-1], profile[1:]):
        slope = np.array([y1 - y0, r0 - r1]) / max(np.hypot(y1 - y0, r1 - r0), 1e-9)
        turn = np.linspace(0, -2 * np.pi, around + 1)
        ring = np.stack([np.cos(turn), np.sin(turn)], -1)
        p = np.concatenate([np.stack([r * ring[:, 0], np.full(around + 1, y), r * ring[:, 1]], -1) for r, y in ((r0, y0), (r1, y1))])
        n = np.tile(np.stack([slope[0] * ring[:, 0], np.full(around + 1, slope[1]), slope[0] * ring[:, 1]], -1), (2, 1))
        uv = np.stack([np.tile(np.linspace(0, 1, around + 1), 2), np.repeat([y0, y1], around + 1)], -1)
        i = np.arange(around)
        a, b, c, d = i, i + 1, i + around + 2, i + around + 1
        parts.append((p, n, uv, np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])))
    return moved(merge(*parts), at)


def smooth_lathe(profile, at=(0, 0, 0), around=48):
    """As `lathe`, through the points of `profile` as a smooth (Catmull-Rom) curve."""
    q = np.asarray(profile, float)
    q = np.concatenate([[2 * q[0] - q[1]], q, [2 * q[-1] - q[-2]]])

    def curve(t):
        x = np.clip(t, 0, 1) * (len(q) - 3)
        i = np.minimum(x.astype(int), len(q) - 4)
        s = (x - i)[..., None]
        a, b, c, d = q[i], q[i + 1], q[i + 2], q[i + 3]
        return 0.5 * (2 * b + (c - a) * s + (2 * a - 5 * b + 4 * c - d) * s**2 + (3 * b - a - 3 * c + d) * s**3)

    def f(u, v):
        r, turn = curve(v), -2 * np.pi * u
        return np.stack([r[..., 0] * np.cos(turn), r[..., 1], r[..., 0] * np.sin(turn)], -1)

    return moved(sheet(f, around, 8 * (len(q) - 3)), at)


def rod(a, b, radius, around=16):
    """A straight round bar from `a` to `b`, with ends."""
    a, b = np.asarray(a, float), np.asarray(b, float)
    length = np.linalg.norm(b - a)
    y = (b - a) / length
    x = np.cross(y, [0, 0, 1] if abs(y[2]) < 0.9 else [1, 0, 0])
    x /= np.linalg.norm(x)
    r = np.stack([x, y, np.cross(x, y)], 1)
    m = lathe([(radius, 0), (radius, length)], around=around, closed=True)
    return m[0] @ r.T + a, m[1] @ r.T, m[2], m[3]


def ball(center, radius, n=24):
    """A sphere."""
    def f(u, v):
        a, b = -2 * np.pi * u, np.pi * (v - 0.5)
        return np.stack([np.cos(a) * np.cos(b), np.sin(b), np.sin(a) * np.cos(b)], -1) * radius

    p, _, uv, faces = sheet(f, n, n // 2)
    return p + np.asarray(center, float), p / radius, uv, faces
