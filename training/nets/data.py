"""Rooms for training: folders of sample.npz, packed once per split into memory-mapped arrays at the networks' size.

A pack lies beside its split's folder (DIR/train -> DIR/train.pack) and is made again when the samples change. Arrays of a pack, [rows, 120, 160,
channels], float16 but for depth; one row per room, per source (one lobe of one light) or per path (light whose indirect shading is known):
 room    albedo, normal (unit), rough, depth (m, float32), light (1 at pixels of visible lights), photo (linear radiance),
         shading (E of all lights), fov_x (degrees);
         at full size, 240 x 320: photo_full, albedo_full, normal_full, rough_full, depth_full (m, float32)
 map     maps [rows, 30, 40, 8, 16, 3], maps_valid [rows, 30, 40]; one row per room that was made with maps
 light   own (1 at its pixels), form [rows, 36] and surface [rows, 64, 3] (form.py)
 source  direct, shadow, traced, unknown, traced_direct, doubt (a number: how much of the lit picture is unknown), place [rows, 12] (place.py),
         radiance [rows, 3]
 path    indirect, path_direct (E_d that the path starts from), path_traced (the same as the product has it, from depth mesh and rays),
         path_trace_indirect (TraceIndirect of that light), path_flux (m^2 times radiance, [rows, 3]; flux.py)"""

import glob
import json
import os
import shutil
import tempfile
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import torch

import flux as power
import form
import place
from layers import HEIGHT, WIDTH

FORMAT = 7
FULL = ["photo", "albedo", "normal", "rough", "depth"]
KIND = {
    **dict.fromkeys(["albedo", "normal", "rough", "depth", "light", "photo", "shading", "fov_x"], "room"),
    **dict.fromkeys(["maps", "maps_valid"], "map"),
    **dict.fromkeys([f"{name}_full" for name in FULL], "room"),
    **dict.fromkeys(["own", "form", "surface"], "light"),
    **dict.fromkeys(["direct", "shadow", "traced", "unknown", "traced_direct", "doubt", "place", "radiance"], "source"),
    **dict.fromkeys(["indirect", "path_direct", "path_traced", "path_trace_indirect", "path_flux"], "path"),
}
WANTED = {"map": "rooms with maps of incoming radiance (make.py --maps)", "source": "rooms with light (make.py without --materials)"}
DTYPE = {
    **dict.fromkeys(["depth", "depth_full", "fov_x", "doubt", "place", "radiance", "path_flux", "form", "surface"], np.float32),
    **dict.fromkeys(["light", "maps_valid", "own"], np.uint8),
}


def blocks(x):
    """A full plane as [HEIGHT, 2, WIDTH, 2, ...]: the 2 x 2 pixels of each pixel of the half plane."""
    return x.astype(np.float32).reshape(HEIGHT, 2, WIDTH, 2, *x.shape[2:])


def half(x):
    return blocks(x).mean((1, 3))


def half_depth(depth):
    """Means of valid values; a pixel without any takes the picture's mean."""
    d = blocks(depth)
    valid = np.isfinite(d) & (d > 0)
    total, number = np.where(valid, d, 0).sum((1, 3)), valid.sum((1, 3))
    return np.where(number > 0, total / np.maximum(number, 1), total.sum() / number.sum())


def full_depth(depth):
    """`depth` with the mean of what is around where it is not known."""
    return np.where(np.isfinite(depth) & (depth > 0), depth, np.kron(half_depth(depth), np.ones((2, 2))))


def unpack(s, lights):
    """The arrays of one room, by name, from its sample.npz and lights.json; see the head of this file."""
    source = {k: s[k].astype(np.float32) for k in ["direct", "shadow", "traced", "unknown", "traced_direct", "traced_indirect"]}
    weights, indirect = s["path_weights"], s["indirect"].astype(np.float32)
    lit, traced = source["direct"] * source["shadow"], source["traced_direct"] * source["traced"]
    normal = half(s["normal"])
    bright = np.clip(source["direct"] / np.maximum(source["direct"].mean((1, 2), keepdims=True), 1e-8), 0, 1)
    return {
        "albedo": half(s["albedo"]),
        "normal": normal / np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-6),
        "rough": half(s["rough"]),
        "depth": half_depth(s["depth"]),
        "light": blocks(s["light_mask"] > 0).max((1, 3)),
        "photo": half(s["photo"]),
        "shading": np.einsum("shw,sc->hwc", lit, s["source_radiance"]) + indirect.sum(0),
        "maps": s["maps"][None] if "maps" in s else np.zeros((0, 30, 40, 8, 16, 3)),
        "maps_valid": s["maps_valid"][None] if "maps" in s else np.zeros((0, 30, 40)),
        "fov_x": s["fov_x"],
        **{f"{name}_full": s[name] for name in FULL if name != "depth"},
        "depth_full": full_depth(s["depth"]),
        "own": [blocks(s["light_mask"] == number + 1).max((1, 3)) for number in range(len(lights))],
        "form": [form.form(light) for light in lights.values()],
        "surface": [form.surface(light) for light in lights.values()],
        **{k: source[k] for k in ["direct", "shadow", "traced", "unknown", "traced_direct"]},
        "place": [place.place(lights, str(name)) for name in s["sources"]],
        "radiance": s["source_radiance"],
        "doubt": (source["unknown"] * bright).mean((1, 2)),
        "indirect": indirect,
        "path_direct": np.einsum("shw,psc->phwc", lit, weights),
        "path_traced": np.einsum("shw,psc->phwc", traced, weights),
        "path_trace_indirect": np.einsum("shwc,psc->phwc", source["traced_indirect"], weights),
        "path_flux": np.einsum("s,psc->pc", [power.flux(lights, str(name)) for name in s["sources"]], weights),
    }


def unpacked(path):
    with np.load(path) as sample, open(os.path.join(os.path.dirname(path), "lights.json")) as lights:
        return unpack(sample, json.load(lights))


def read_ahead(samples, block=64):
    """`unpacked` of each, read by all cores."""
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        for start in range(0, len(samples), block):
            yield from pool.map(unpacked, samples[start : start + block])


def pack(samples, folder):
    """Writes the pack of `samples` (paths) into `folder`."""
    rows = []
    for path in samples:
        with np.load(path) as s, open(os.path.join(os.path.dirname(path), "lights.json")) as lights:
            names = {"source": list(map(str, s["sources"])), "path": list(map(str, s["paths"]))}
            rows.append(names | {"light": list(json.load(lights)), "map": ["maps"] * ("maps" in s)})
    total = {"room": len(rows), **{kind: sum(len(r[kind]) for r in rows) for kind in rows[0]}}
    arrays, at = {}, dict.fromkeys(total, 0)
    for path, names, room in zip(samples, rows, read_ahead(samples)):
        size = {"room": 1, **{kind: len(names[kind]) for kind in names}}
        for name, value in room.items():
            value = np.asarray(value) if KIND[name] != "room" else np.asarray(value)[None]
            if not np.isfinite(value).all():
                raise SystemExit(f"{path}: {name}: wanted finite numbers, got {np.sum(~np.isfinite(value))} others")
            if not size[KIND[name]]:
                continue
            if name not in arrays:
                shape = (total[KIND[name]], *value.shape[1:])
                arrays[name] = np.lib.format.open_memmap(f"{folder}/{name}.npy", "w+", DTYPE.get(name, np.float16), shape)
            arrays[name][at[KIND[name]] : at[KIND[name]] + size[KIND[name]]] = np.minimum(
                value.astype(np.float32), 60000 if arrays[name].dtype == np.float16 else np.inf
            )
        for kind in at:
            at[kind] += size[kind]
    for array in arrays.values():
        array.flush()
    return rows


def read(index):
    if not os.path.exists(index):
        return {}
    with open(index) as file:
        return json.load(file)


def rooms_of(net, split, every=1, without=()):
    """Returns the Rooms that a network is trained and measured on: those that have what the network needs: `source`s, unless
    it says another kind."""
    return Rooms(split, every, getattr(net, "needs", "source"), without)


class Rooms:
    """The rooms of one split. `get(name, room)` is [channels.., 120, 160] of a room, or that with the room's sources or paths in front.
    `every`: each such room only. `needs`: only rooms that have this, a value of KIND. `without`: third-party scenes that are left out."""

    def __init__(self, split, every=1, needs="room", without=()):
        samples = sorted(glob.glob(f"{split}/*/sample.npz"))
        if not samples:
            raise SystemExit(f"{split}: wanted folders with a sample.npz each, got none")
        stamp = [FORMAT] + [[os.path.basename(os.path.dirname(p)), os.stat(p).st_mtime_ns] for p in samples]
        folder = os.path.normpath(split) + ".pack"
        index = os.path.join(folder, "index.json")
        if read(index).get("stamp") != stamp:
            with tempfile.TemporaryDirectory(dir=os.path.dirname(folder) or ".") as making:
                new = os.path.join(making, "pack")
                os.makedirs(new)
                rows = pack(samples, new)
                with open(f"{new}/index.json", "w") as file:
                    json.dump({"stamp": stamp, "rows": rows}, file)
                shutil.rmtree(folder, ignore_errors=True)
                os.rename(new, folder)
        rows = read(index)["rows"]
        names = [room[0] for room in stamp[1:]]
        scenes = [name.rpartition("_")[0] for name in names]
        for scene in without:
            if scene not in scenes:
                raise SystemExit(f"{split}: wanted rooms of the scene {scene!r} to leave out, got none")
        kept = [k for k in range(0, len(rows), every) if scenes[k] not in without and (needs == "room" or rows[k].get(needs))]
        if not kept:
            raise SystemExit(f"{split}: wanted {WANTED.get(needs, 'rooms of other scenes')}, got none among {len(rows)}")
        self.split, self.names = split, [names[k] for k in kept]
        self.sources, self.paths, self.lights = ([rows[k][kind] for k in kept] for kind in ("source", "path", "light"))
        starts = {"room": range(len(rows) + 1), **{kind: np.cumsum([0] + [len(r[kind]) for r in rows]) for kind in rows[0]}}
        self.rows = {name: [slice(int(v[k]), int(v[k + 1])) for k in kept] for name, v in starts.items()}
        self.arrays = {name: np.load(f"{folder}/{name}.npy", mmap_mode="r") for name in KIND if os.path.exists(f"{folder}/{name}.npy")}

    def __len__(self):
        return len(self.names)

    def array(self, name):
        """All rows of an array: read as they are needed, or, on a GPU, held in its memory."""
        if torch.get_default_device().type != "cpu" and isinstance(self.arrays[name], np.ndarray):
            self.arrays[name] = torch.from_numpy(np.array(self.arrays[name])).to(torch.get_default_device())
        return self.arrays[name]

    def get(self, name, room, row=None):
        """A float32 tensor, channels before pixels (`maps` stay [30, 40, 8, 16, 3]); `row` picks one of the room's sources, paths or lights."""
        rows, array = self.rows[KIND[name]][room], self.array(name)
        x = array[rows] if row is None else array[rows.start + row]
        x = x[0] if KIND[name] in ("room", "map") else x
        x = (x if isinstance(x, torch.Tensor) else torch.from_numpy(np.array(x))).float()
        return x if x.ndim < 3 or x.shape[-1] == WIDTH or name in ("maps", "surface") else x.movedim(-1, -3)

    def beside(self, file, room):
        """What lies beside a room's sample.npz, or None."""
        path = os.path.join(self.split, self.names[room], file)
        return dict(np.load(path)) if os.path.exists(path) else None

    def stack(self, name, items):
        """[B, channels, 120, 160] of `items`, pairs of room and row (row None for what a room has once)."""
        x = torch.stack([self.get(name, room, row if KIND[name] != "room" else None) for room, row in items])
        return x[:, None] if x.ndim == 3 else x
