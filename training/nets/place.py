"""Where a light is, an input of ShadowNet: center, half_x, half_y (zeros but for windows; m) and the direction to a sun (zeros but for suns), 12
numbers in camera space."""

import numpy as np


def place(lights, source):
    """Of a source by its name, "lamp_0" or "window_0.sun"."""
    name, _, part = source.partition(".")
    light = lights[name]
    centre = np.mean(light["triangles"], (0, 1)) if "triangles" in light else light["center"]
    axes = [light["half_x"], light["half_y"]] if light["kind"] == "Window" else np.zeros((2, 3))
    sun = np.zeros(3)
    if part == "sun":
        sun = np.array(next(x for x in light["lobes"] if x["name"] == part)["direction"], float)
        sun = sun / np.linalg.norm(sun)
    return np.concatenate([centre, *axes, sun]).astype(np.float32)


def mirrored(place):
    """[B, 12, 1, 1] in the horizontally mirrored room; half_x turns round, so that half_x cross half_y still points into the room."""
    return place * place.new_tensor([-1, 1, 1, 1, -1, -1, -1, 1, 1, -1, 1, 1]).view(1, 12, 1, 1)
