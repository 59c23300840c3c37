"""The power of a light, per unit radiance: what a source sends into the room, in m^2 (lights.json gives shapes in meters).

A lamp of area S: pi S. A lobe of a window of area S and normal n into the room: S times the integral of exp(lambda (d.l - 1)) max(0, -n.l) over l."""

import numpy as np


def area(light):
    """Surface that shines, m^2."""
    of = lambda a, b: np.linalg.norm(np.cross(a, b))
    if light["kind"] == "Sphere":
        return 4 * np.pi * light["radius"] ** 2
    if light["kind"] == "Box":
        a, b, c = light["half_axes"]
        return 8 * (of(a, b) + of(b, c) + of(c, a))
    if light["kind"] == "Mesh":
        corners = np.array(light["triangles"], float)
        return 0.5 * sum(of(b - a, c - a) for a, b, c in corners)
    return 4 * of(light["half_x"], light["half_y"])  # Rect, Window


def lobe(window, lobe, samples=4096):
    """Directions drawn from the lobe itself, so that a sun is as exact as a sky."""
    n, d, b = np.cross(window["half_x"], window["half_y"]), np.array(lobe["direction"], float), max(lobe["bandwidth"], 1e-4)
    n, d = n / np.linalg.norm(n), d / np.linalg.norm(d)
    u, phi = (np.arange(samples) + 0.5) / samples, np.arange(samples) * 2.399963
    fall = -np.log(1 - u * (1 - np.exp(-2 * b))) / b  # 1 - cos of the angle to d
    s = np.cross(d, [1, 0, 0] if abs(d[0]) < 0.9 else [0, 1, 0])
    s /= np.linalg.norm(s)
    sine = np.sqrt(np.clip(fall * (2 - fall), 0, None))[:, None]
    l = sine * (np.cos(phi)[:, None] * s + np.sin(phi)[:, None] * np.cross(d, s)) + (1 - fall)[:, None] * d
    return area(window) * np.clip(-l @ n, 0, None).mean() * 2 * np.pi * -np.expm1(-2 * b) / b


def flux(lights, source):
    """Of a source by its name, "lamp_0" or "window_0.sky"."""
    name, _, part = source.partition(".")
    return lobe(lights[name], next(x for x in lights[name]["lobes"] if x["name"] == part)) if part else np.pi * area(lights[name])
