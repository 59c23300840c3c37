"""A window as an emitter of Mitsuba: a pane behind which a distant surrounding of up to three spherical Gaussians is seen."""

import drjit as dr
import mitsuba as mi

LOBES = ("sun", "sky", "ground")


def basis(d):
    """Two unit vectors at right angles to d (Duff et al., JCGT 6(1), 2017)."""
    sign = dr.copysign(mi.Float(1), d.z)
    a = -1 / (sign + d.z)
    b = d.x * d.y * a
    return mi.Vector3f(1 + sign * d.x * d.x * a, sign * b, -sign * d.x), mi.Vector3f(b, sign + d.y * d.y * a, -d.y)


class Pane:
    """The rectangle center + u half_x + v half_y, u and v in -1..1, and its lobes; half_x x half_y points into the room."""

    def __init__(self, center, half_x, half_y, directions, bandwidths, weights):
        self.center, self.x, self.y = (mi.Point3f(*(dr.opaque(mi.Float, float(c)) for c in v)) for v in (center, half_x, half_y))
        self.directions = [mi.Vector3f(*(dr.opaque(mi.Float, float(c)) for c in d)) for d in directions]
        self.bandwidths = [dr.opaque(mi.Float, max(float(b), 1e-3)) for b in bandwidths]
        self.weights = [mi.Color3f(*(dr.opaque(mi.Float, float(c)) for c in w)) for w in weights]
        # The share of samples that follow the sun.
        self.sunny = dr.opaque(mi.Float, 0.5 if max(weights[0]) > 0 else 0.0)
        n = dr.cross(mi.Vector3f(self.x), mi.Vector3f(self.y))
        self.area, self.n = 4 * dr.norm(n), dr.normalize(n)

    def lobe(self, k, d):
        """Lobe k of weight 1 towards d, out of the room."""
        return dr.exp(self.bandwidths[k] * (dr.dot(self.directions[k], d) - 1))

    def radiance(self, d):
        return sum((self.weights[k] * self.lobe(k, d) for k in range(3)), mi.Color3f(0))

    def area_pdf(self, d, distance2):
        """Density over solid angle of uniform points of the pane."""
        return distance2 / dr.maximum(self.area * -dr.dot(d, self.n), 1e-12)

    def lobe_pdf(self, k, d):
        """Density of directions drawn from lobe k alone."""
        b = self.bandwidths[k]
        return b * dr.exp(b * (dr.dot(self.directions[k], d) - 1)) / (dr.two_pi * (1 - dr.exp(-2 * b)))

    def sample_area(self, p, u):
        """(point, direction, squared distance)."""
        q = self.center + (2 * u.x - 1) * mi.Point3f(self.x) + (2 * u.y - 1) * mi.Point3f(self.y)
        d = q - p
        distance2 = dr.squared_norm(d)
        return q, d * dr.rsqrt(distance2), distance2

    def sample_lobe(self, k, p, u):
        """(point, direction, squared distance, whether it meets the pane)."""
        b = self.bandwidths[k]
        fall = -dr.log(1 - u.x * (1 - dr.exp(-2 * b))) / b  # 1 - cos
        sine, turn = dr.safe_sqrt(fall * (2 - fall)), dr.two_pi * u.y
        s, t = basis(self.directions[k])
        d = dr.normalize(sine * (dr.cos(turn) * s + dr.sin(turn) * t) + (1 - fall) * self.directions[k])
        facing = dr.dot(d, self.n)
        along = dr.dot(mi.Vector3f(self.center - p), self.n) / dr.select(facing < 0, facing, -1)
        q = p + along * d
        offset = q - mi.Point3f(self.center)
        x, y = mi.Vector3f(self.x), mi.Vector3f(self.y)
        inside = (dr.abs(dr.dot(offset, x)) <= dr.squared_norm(x)) & (dr.abs(dr.dot(offset, y)) <= dr.squared_norm(y))
        return q, d, along * along, inside & (facing < 0) & (along > 0)


class WindowLight(mi.Emitter):
    """Sampled half by area and half by its sun, where there is one."""

    def __init__(self, props):
        super().__init__(props)
        self.m_flags = mi.EmitterFlags.Surface | mi.EmitterFlags.SpatiallyVarying
        vector = lambda name: [float(c) for c in props[name]]
        self.pane = Pane(
            vector("center"),
            vector("half_x"),
            vector("half_y"),
            [vector(f"{k}_direction") for k in LOBES],
            [float(props[f"{k}_bandwidth"]) for k in LOBES],
            [vector(f"{k}_weight") for k in LOBES],
        )

    def eval(self, si, active=True):
        wi = si.to_world(si.wi)
        return dr.select(active & (dr.dot(si.n, wi) > 0), self.pane.radiance(-wi), 0)

    def density(self, d, distance2):
        return (1 - self.pane.sunny) * self.pane.area_pdf(d, distance2) + self.pane.sunny * self.pane.lobe_pdf(0, d)

    def sample_direction(self, it, sample, active=True):
        pane = self.pane
        sunny = sample.x < pane.sunny
        rest = dr.select(sunny, 2 * sample.x, (sample.x - pane.sunny) / (1 - pane.sunny))
        u = mi.Point2f(dr.clip(rest, 0, 0.99999994), sample.y)
        q0, d0, far0 = pane.sample_area(it.p, u)
        q1, d1, far1, meets = pane.sample_lobe(0, it.p, u)
        ds = mi.DirectionSample3f()
        ds.p, ds.d = dr.select(sunny, q1, q0), dr.select(sunny, d1, d0)
        distance2 = dr.select(sunny, far1, far0)
        ds.n, ds.uv, ds.time, ds.delta, ds.dist = mi.Normal3f(pane.n), sample, it.time, False, dr.sqrt(distance2)
        active &= (~sunny | meets) & (dr.dot(ds.d, pane.n) < 0)
        ds.pdf = dr.select(active, self.density(ds.d, distance2), 0)
        ds.emitter = mi.EmitterPtr(self)
        return ds, mi.Color3f(dr.select(active, pane.radiance(ds.d) / ds.pdf, 0))

    def pdf_direction(self, it, ds, active=True):
        return dr.select(active & (dr.dot(ds.d, self.pane.n) < 0), self.density(ds.d, ds.dist * ds.dist), 0)

    def eval_direction(self, it, ds, active=True):
        return dr.select(active & (dr.dot(ds.d, self.pane.n) < 0), self.pane.radiance(ds.d), 0)

    def traverse(self, callback):
        pass

    def to_string(self):
        return "WindowLight[]"


mi.register_emitter("windowlight", WindowLight)
