"""A room as scenes of Mitsuba 3: what stands there once, and the lights that burn."""

import copy

import variant  # noqa: F401, I001  (sets the variant before it is used)
import drjit as dr
import mitsuba as mi
import numpy as np

import patterns
from windowlight import LOBES

PADDED = 16  # number of emitters that a scene is padded to
GLOSSY = 0.9  # GGX roughness below which a surface has a specular coat


def mesh(name, points, faces, bsdf, normals=None, albedo=None, rough=None, emitter=None, uv=None, pattern=None):
    props = mi.Properties()
    props["mesh_bsdf"] = bsdf
    if emitter is not None:
        props["mesh_emitter"] = emitter
    out = mi.Mesh(name, len(points), len(faces), has_vertex_normals=normals is not None, has_vertex_texcoords=uv is not None, props=props)
    if albedo is not None:
        out.add_attribute("face_albedo", 3, np.ascontiguousarray(albedo, np.float32).ravel())
        out.add_attribute("face_rough", 1, np.ascontiguousarray(rough, np.float32).ravel())
    if pattern is not None:
        for key, value in zip(("face_second", "face_pattern"), pattern):
            out.add_attribute(key, 3, np.ascontiguousarray(value, np.float32).ravel())
    params = mi.traverse(out)
    params["vertex_positions"] = np.ascontiguousarray(points, np.float32).ravel()
    params["faces"] = np.ascontiguousarray(faces, np.uint32).ravel()
    if normals is not None:
        params["vertex_normals"] = np.ascontiguousarray(normals, np.float32).ravel()
    if uv is not None:
        params["vertex_texcoords"] = np.ascontiguousarray(uv, np.float32).ravel()
    params.update()
    return out


def rectangle(center, half_x, half_y):
    """to_world of Mitsuba's rectangle; it faces half_x cross half_y."""
    x, y, c = (np.asarray(v, float) for v in (half_x, half_y, center))
    n = np.cross(x, y)
    return mi.ScalarTransform4f(np.vstack([np.stack([x, y, n / np.linalg.norm(n), c], 1), [0, 0, 0, 1]]))


def padding(body, glass, count):
    """Black emitters of each kind far below the floor, never sampled, that fill `count` emitters up to a multiple of PADDED.

    The compiled kernel of a path tracer depends on the kinds of emitters and on their number; padded scenes share it."""
    black = {"type": "area", "radiance": {"type": "rgb", "value": 0.0}, "sampling_weight": 0.0}
    spot = mi.ScalarPoint3f(0, -60, 0)
    x, y = (0.01, 0, 0), (0, 0, -0.01)
    pane = {"type": "windowlight", "center": spot, "half_x": mi.ScalarPoint3f(x), "half_y": mi.ScalarPoint3f(y), "sampling_weight": 0.0}
    for lobe in LOBES:
        pane |= {f"{lobe}_direction": mi.ScalarPoint3f(0, 1, 0), f"{lobe}_bandwidth": 1.0, f"{lobe}_weight": mi.ScalarPoint3f(0)}
    place = rectangle(spot, x, y)
    out = {
        "pad_sphere": {"type": "sphere", "center": spot, "radius": 0.01, "bsdf": body, "emitter": black},
        "pad_pane": {"type": "rectangle", "to_world": place, "bsdf": glass, "emitter": pane},
    }
    for name, number in (("pad_box", 12), ("pad_shade", 48)):  # triangles of a box and of a lamp shade
        corners = np.array([[0, -60, 0], [0.01, -60, 0], [0, -60, 0.01]])
        points = np.concatenate([corners + [0, 0.01 * k, 0] for k in range(number)])
        out[name] = mesh(name, points, np.arange(3 * number).reshape(-1, 3), body, emitter=mi.load_dict(black))
    for k in range(1 + -(count + len(out) + 1) % PADDED):
        out[f"pad_rect{k}"] = {"type": "rectangle", "to_world": place, "bsdf": body, "emitter": black}
    return out


def light_bodies():
    """Returns the BSDFs of lamps and of window panes, which scatter the light that falls on them."""
    diffuse = lambda albedo: {"type": "diffuse", "reflectance": {"type": "rgb", "value": albedo}}
    return mi.load_dict({"type": "twosided", "bsdf": diffuse([0.7, 0.66, 0.58])}), mi.load_dict(diffuse([0.04, 0.04, 0.04]))


class Lit:
    """The room of layout.py, in Mitsuba."""

    def __init__(self, room):
        color = {"type": "pattern"}
        rough = {"type": "mesh_attribute", "name": "face_rough"}
        matte = mi.load_dict({"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": color}})
        gloss = mi.load_dict({"type": "twosided", "bsdf": {"type": "principled", "base_color": color, "roughness": rough, "specular": 0.5}})
        self.body, self.glass = light_bodies()
        points, normals, faces, albedo, roughness = room.merged()
        second, pattern = room.patterned()
        self.room, self.static, self.keep = room, {}, {}
        for name, bsdf, keep in (("matte", matte, roughness >= GLOSSY), ("gloss", gloss, roughness < GLOSSY)):
            keep = np.flatnonzero(keep) if keep.any() else np.array([0])
            self.keep[name] = keep
            used, renumbered = np.unique(faces[keep], return_inverse=True)
            self.static[name] = mesh(
                name,
                points[used],
                renumbered.reshape(-1, 3),
                bsdf,
                normals[used],
                albedo[keep],
                roughness[keep],
                pattern=(second[keep], pattern[keep]),
            )
        self.lamps = {f"lamp{k}": lamp for k, lamp in enumerate(room.lamps)}
        self.windows = {f"window{k}": w for k, w in enumerate(room.windows)}

    def lamp(self, name, on):
        lamp = self.lamps[name]
        emitter = {"type": "area", "radiance": {"type": "rgb", "value": [float(c) for c in lamp.radiance]}} if on else None
        place = lamp.place
        if lamp.kind == "Sphere":
            out = {"type": "sphere", "id": name, "center": [float(c) for c in place["center"]], "radius": float(place["radius"]), "bsdf": self.body}
        elif lamp.kind == "Rect":
            out = {"type": "rectangle", "id": name, "to_world": rectangle(place["center"], place["half_x"], place["half_y"]), "bsdf": self.body}
        else:
            points, faces = lamp.mesh()
            return mesh(name, points, faces, self.body, emitter=mi.load_dict(emitter) if on else None)
        return out | ({"emitter": emitter} if on else {})

    def pane(self, name, only=None):
        """A pane's lobes: direction, bandwidth and weight of sun, sky and ground; absent ones weigh nothing. `only` leaves out the others."""
        lobes = {n: (d, b, w) for n, d, b, w in self.windows[name].lobes if only is None or n in only}
        absent = ((0, 1, 0), 1.0, (0, 0, 0))
        return [lobes.get(k, absent) for k in LOBES]

    def window(self, name, only=None, on=True):
        w = self.windows[name]
        out = {"type": "rectangle", "id": name, "to_world": rectangle(w.center, w.half_x, w.half_y), "bsdf": self.glass}
        if on:
            light = {
                "type": "windowlight",
                "center": mi.ScalarPoint3f(w.center),
                "half_x": mi.ScalarPoint3f(w.half_x),
                "half_y": mi.ScalarPoint3f(w.half_y),
            }
            for lobe, (d, b, weight) in zip(LOBES, self.pane(name, only)):
                light |= {f"{lobe}_direction": mi.ScalarPoint3f(d), f"{lobe}_bandwidth": float(b), f"{lobe}_weight": mi.ScalarPoint3f(weight)}
            out["emitter"] = light
        return out

    def materials(self, scene, si):
        """Albedo and GGX roughness where rays hit; 0.5 and 1 on lights."""
        known = {s.id(): mi.ShapePtr(s) for s in scene.shapes() if s.id() in self.static}
        for shape in known.values():
            dr.make_opaque(shape)  # not a literal in the kernel's code, so that rooms share kernels
        furniture = (si.shape == known["matte"]) | (si.shape == known["gloss"])
        albedo = dr.select(furniture, patterns.albedo(si, furniture), 0.5)
        return albedo, dr.select(furniture, si.shape.eval_attribute_1("face_rough", si, furniture), 1.0)

    def keys(self):
        """Number of the surface of each face: equal for faces of one part of the room that have exactly the same albedo."""
        part = np.repeat(np.arange(len(self.room.parts)), [len(p[2]) for p in self.room.parts])
        return np.unique(np.column_stack([part, self.room.merged()[3]]), axis=0, return_inverse=True)[1].ravel()

    def key(self, scene, si):
        """Integer per hit, equal on one surface (that `repainted` paints as a whole); -1 on lights and where nothing is hit."""
        keys, out = None, mi.Float(-1)
        for shape in scene.shapes():
            if shape.id() in self.keep:
                if not shape.has_mesh_attributes() or not shape.has_attribute("face_key"):
                    keys = self.keys() if keys is None else keys
                    shape.add_attribute("face_key", 1, keys[self.keep[shape.id()]].astype(np.float32))
                there = si.shape == mi.ShapePtr(shape)
                out = dr.select(there, si.shape.eval_attribute_1("face_key", si, there), out)
        return mi.Int32(dr.round(out))

    def repainted(self, key, color):
        """Returns a `Lit` in which the surface `key` has the constant albedo `color` [3] in place of its pattern."""
        keys, start, room = self.keys(), 0, copy.copy(self.room)
        room.parts = []
        for points, normals, faces, albedo, rough in self.room.parts:
            there = keys[start : start + len(faces)] == key
            room.parts.append((points, normals, faces, np.where(there[:, None], color, albedo), rough))
            start += len(faces)
        bare = keys == key
        room.bare = bare if room.bare is None else room.bare | bare
        out = type(self)(room)
        out.lamps, out.windows = self.lamps, self.windows  # which may have been scaled
        return out

    def scene(self, burning, extra=None):
        """With these lights on: {name: the lobes of a window that shine, None for all}; `extra` shapes as Mitsuba has them, by name."""
        out = {"type": "scene"} | self.static | (extra or {}) | (padding(self.body, self.glass, len(burning)) if burning else {})
        for name in self.lamps:
            out[name] = self.lamp(name, name in burning)
        for name in self.windows:
            out[name] = self.window(name, burning.get(name), name in burning)
        return mi.load_dict(out, optimize=False)
