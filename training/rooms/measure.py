"""A table of statistics of generated rooms, third-party rooms and photographs, in Markdown: median (10 % .. 90 %) over the pictures of a column.

usage: measure.py [--column TITLE ROOMS]... [--truth DIR] [--photos DIR] [--count N] [--errors [RELIGHT]]

ROOMS is a glob pattern of the rooms of make.py, people.py or farm.py (".cache/rooms/train/[0-9]*"); several --column give as many columns. --truth: rooms of ../shared/truth. --photos:
photographs with depth, one folder each (photo.png or .jpg; depth.npy, .exr or .png). --errors runs the program without networks (graphs/physics.ron)
on each room and adds its change error for each kind of light switched off (docs/eval.md).

The share of a light in a room of truth.npz is that of (direct x shadow x radiance + indirect), luminance, times albedo, over the pixels that show no light;
the photo is divided between the lights in this proportion. The unseen solid angle is computed in screen space, alike in all columns: from
points on the seen surface, rays in cosine-distributed directions are followed in steps; a ray that leaves the picture or passes behind a
surface by more than 0.4 m meets nothing that is seen."""

import argparse
import glob
import json
import sys
import tempfile
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from PIL import Image

from color import linear, luminance
from pack import ROOT, evaluate

VISIBLE = 0.05  # share of the photo from which a light counts
BEHIND = 0.4  # meters by which a ray passes behind a surface without meeting it
KINDS = {"lamp": "lamp in view off", "window": "window in view off", "invisible": "invisible lights off"}


@dataclass
class Picture:
    """A picture of 320 x 240 pixels and its ground truth, as far as a column has it."""

    photo: np.ndarray  # linear, 1 = white
    depth: np.ndarray  # planar z, meters; 0 or not finite: unknown
    fov_x: float  # degrees
    albedo: np.ndarray = None
    lights: np.ndarray = None  # where lights are seen
    pictures: dict = field(default_factory=dict)  # {light: linear picture by it alone}
    arrived: list = field(default_factory=list)  # of each window, the share of its direct light that arrives
    scene: Path = None  # what `relight eval` can read, where it has truth


def chroma(rgb):
    """(max - min) / max of each pixel."""
    return (rgb.max(-1) - rgb.min(-1)) / np.maximum(rgb.max(-1), 1e-4)


def edges(y):
    """Mean absolute difference of log luminance between neighboring pixels, across plus down."""
    logs = np.log(y + 0.01)
    return np.abs(np.diff(logs, axis=0)).mean() + np.abs(np.diff(logs, axis=1)).mean()


def shares(pictures, lights=None):
    """{light: its share of the light of the photo}, over pixels that show no light."""
    keep = slice(None) if lights is None else ~lights
    sums = {name: float(luminance(picture)[keep].sum()) for name, picture in pictures.items()}
    total = max(sum(sums.values()), 1e-12)
    return {name: value / total for name, value in sums.items()}


def arrived_share(direct, shadow, weight):
    """Share of a window's direct light that arrives: direct, shadow [lobes, h, w], weight [lobes] luminances."""
    open_ = (direct.astype(float) * np.asarray(weight)[:, None, None]).sum()
    return float((direct.astype(float) * shadow * np.asarray(weight)[:, None, None]).sum() / max(open_, 1e-12))


def points_of(depth, fov_x):
    """Camera-space points [h, w, 3]: x right, y up, z backward."""
    h, w = depth.shape
    f = 0.5 * w / np.tan(np.radians(fov_x) / 2)
    x, y = np.meshgrid((np.arange(w) + 0.5 - w / 2) / f, (h / 2 - np.arange(h) - 0.5) / f)
    return np.stack([x * depth, y * depth, -depth], -1)


def unseen(depth, fov_x, rays=48, steps=48, reach=8.0, seed=0):
    """Mean share of cosine-distributed directions from seen points along which no seen surface is met."""
    depth = np.where(np.isfinite(depth), depth, 0.0).astype(float)
    h, w = depth.shape
    f = 0.5 * w / np.tan(np.radians(fov_x) / 2)
    p = points_of(depth, fov_x)
    s = max(w // 80, 1)
    rows, columns = np.meshgrid(np.arange(5 * s // 2, h - 2 * s, 5 * s), np.arange(5 * s // 2, w - 2 * s, 5 * s), indexing="ij")
    at = lambda dr, dc: p[rows + dr, columns + dc]
    n = np.cross(at(0, s) - at(0, -s), at(-s, 0) - at(s, 0))
    there = np.all([depth[rows + dr, columns + dc] > 0 for dr, dc in ((0, 0), (0, s), (0, -s), (s, 0), (-s, 0))], 0) & (np.linalg.norm(n, axis=-1) > 0)
    origin, n = at(0, 0)[there], n[there]
    n /= np.linalg.norm(n, axis=-1, keepdims=True)
    n *= np.where((n * origin).sum(-1) > 0, -1, 1)[:, None]
    rng = np.random.default_rng(seed)
    # A unit normal plus a uniform point of the unit sphere has a cosine distribution.
    d = rng.normal(size=(len(origin), rays, 3))
    d = d / np.linalg.norm(d, axis=-1, keepdims=True) + n[:, None]
    d /= np.maximum(np.linalg.norm(d, axis=-1, keepdims=True), 1e-9)
    met, gone = np.zeros(d.shape[:2], bool), np.zeros(d.shape[:2], bool)
    start = 0.03 * -origin[:, None, 2:]
    for t in np.geomspace(0.08, reach, steps):
        q = origin[:, None] + (start + t) * d
        z = -q[..., 2]
        column, row = (np.floor(c).astype(int) for c in (w / 2 + f * q[..., 0] / np.maximum(z, 1e-6), h / 2 - f * q[..., 1] / np.maximum(z, 1e-6)))
        inside = (z > 0.05) & (column >= 0) & (column < w) & (row >= 0) & (row < h)
        gone |= ~inside & ~met
        behind = z - np.where(inside, depth[row.clip(0, h - 1), column.clip(0, w - 1)], np.inf)
        step = t * 0.12
        met |= inside & ~gone & (behind > 0) & (behind < BEHIND + step)
        gone |= inside & ~met & (behind >= BEHIND + step)
    return float(1 - met.mean())


def of_room(folder):
    """A room of make.py or people.py: its lights from the planes of truth.npz."""
    t = np.load(folder / "truth.npz")
    photo, albedo = t["photo"].astype(np.float32), t["albedo"].astype(np.float32)
    shading, arrived, lobes = {}, [], {}
    for source, radiance, direct, shadow in zip(*(t[k] for k in ("sources", "source_radiance", "direct", "shadow"))):
        light = str(source).split(".")[0]
        direct, shadow = direct.astype(np.float32), shadow.astype(np.float32)
        shading[light] = shading.get(light, 0) + (direct * shadow)[..., None] * radiance
        if "window" in light:
            lobes.setdefault(light, []).append((direct, shadow, luminance(radiance)))
    for parts in lobes.values():
        direct, shadow, weight = (np.array(x) for x in zip(*parts))
        if direct.max() > 0:
            arrived.append(arrived_share(direct, shadow, weight))
    names = [str(s).split(".")[0] for s in t["sources"]]
    power = {k: float(luminance(v).mean()) + 1e-9 for k, v in shading.items()}
    for weights, indirect in zip(t["path_weights"], t["indirect"].astype(np.float32)):
        burning = {names[s] for s in np.flatnonzero(weights.max(-1) > 0)}
        for light in burning:  # a path of several lights is divided by their direct light
            shading[light] = shading[light] + indirect * power[light] / sum(power[k] for k in burning)
    small = {k: np.asarray(v, float) for k, v in shading.items()}
    total = sum(small.values()) + 1e-9
    mask = t["light_mask"]
    titles = list(json.loads((folder / "lights.json").read_text()))
    pictures = {}
    for light, value in small.items():
        part = np.repeat(np.repeat(value / total, 2, 0), 2, 1)
        part[mask > 0] = 0
        part[mask == titles.index(light) + 1] = 1
        pictures[light] = photo * part
    return Picture(photo, t["depth"], float(t["fov_x"]), albedo, mask > 0, pictures, arrived, folder)


def of_truth(source):
    """A room of ../shared/truth."""
    import foreign

    room = foreign.read(source)
    seen = np.any(list(room.masks.values()), 0)
    return Picture(sum(room.pictures.values()), room.depth, float(room.meta["fov_x"]), room.albedo, seen, room.pictures, [], source)


def read_depth(folder):
    for path in sorted(folder.glob("depth.*")):
        if path.suffix == ".npy":
            return np.load(path)
        if path.suffix == ".png":
            return np.asarray(Image.open(path), np.float32) / 1000
        if path.suffix == ".exr":
            import OpenEXR

            with OpenEXR.File(str(path), separate_channels=True) as file:
                channels = file.channels()
                return channels["Z" if "Z" in channels else sorted(channels)[0]].pixels
    raise FileNotFoundError(f"{folder}: no depth.npy, depth.png or depth.exr")


def of_photo(folder):
    """A photograph with depth and what about.json says of its camera."""
    path = next(p for p in sorted(folder.iterdir()) if p.stem in ("photo", "input", "rgb", "image") and p.suffix in (".png", ".jpg"))
    whole = Image.open(path).convert("RGB")
    about = json.loads((folder / "about.json").read_text()) if (folder / "about.json").exists() else {}
    fov = about.get("fov_x_deg") or (np.degrees(2 * np.arctan(whole.width / 2 / about["fx"])) if "fx" in about else 60.0)
    depth = np.asarray(read_depth(folder), np.float32)
    rows, columns = ((np.arange(n) + 0.5) * size / n for n, size in zip((240, 320), depth.shape))
    picture = np.asarray(whole.resize((320, 240), Image.Resampling.BOX), np.float32) / 255
    return Picture(linear(picture), depth[rows.astype(int)][:, columns.astype(int)], float(fov))


def change_errors(picture, relight):
    """{kind of light: [change errors]} of the program without networks; `relight eval` on a scene made of the picture."""
    import folder as scene_folder
    import foreign

    with tempfile.TemporaryDirectory() as place:
        to = Path(place, "scene")
        to.mkdir()
        if (picture.scene / "truth.npz").exists():
            titles = list(json.loads((picture.scene / "lights.json").read_text()))
            mask = np.load(picture.scene / "truth.npz")["light_mask"]
            masks = {t: mask == k + 1 for k, t in enumerate(titles) if not t.startswith("inv_")}
            lights = json.loads((picture.scene / "lights.json").read_text())
            scene_folder.write(to, picture.fov_x, picture.photo, picture.depth, picture.albedo, masks, lights, pictures=picture.pictures)
        else:
            foreign.main(picture.scene, to, None)
        try:
            return errors_of(evaluate(relight, "physics.ron", to, Path(place, "out"), "--no-cache", "--threads", 1))
        except RuntimeError as error:
            print(error, file=sys.stderr)
            return {}


def kind_of(subject):
    """Returns the kind of light, of KINDS, that an edit of `relight eval` switches off; None for other edits."""
    return next((kind for kind in KINDS if subject.startswith(kind) and subject.endswith(" off")), None)


def errors_of(figures):
    """Returns {kind of light: [change errors]} of the figures of `relight eval`."""
    out = {}
    for figure in figures:
        kind = kind_of(figure["subject"])
        if kind and figure["measure"] == "change error":
            out.setdefault(kind, []).append(figure["value"])
    return out


def measures(picture):
    """{row: [values]} of one picture; a row that cannot be measured has none."""
    rgb = np.clip(picture.photo, 0, 1)
    y = luminance(rgb)
    z = picture.depth[np.isfinite(picture.depth) & (picture.depth > 0)]
    out = {}
    if picture.pictures:
        parts = sorted(shares(picture.pictures, picture.lights).values())
        out["strongest light, share of the photo"] = [parts[-1]]
        out[f"lights above {VISIBLE:.0%} of the photo"] = [sum(p > VISIBLE for p in parts)]
    out["window light that arrives"] = picture.arrived
    if picture.albedo is not None:
        keep = ~picture.lights
        a = picture.albedo[keep]
        out |= {f"albedo, {q} % of pixels": [np.percentile(luminance(a), q)] for q in (10, 50, 90)}
        out |= {"albedo chroma, median": [np.median(chroma(a))], "albedo chroma, 90 %": [np.percentile(chroma(a), 90)]}
        out["albedo edges"] = [edges(np.where(keep, luminance(picture.albedo), 0.5))]
    out |= {f"photo chroma, {q} %": [np.percentile(chroma(rgb), q)] for q in (10, 50, 90)} | {"photo chroma, mean": [chroma(rgb).mean()]}
    out["red / blue"] = [rgb[..., 0].mean() / max(rgb[..., 2].mean(), 1e-4)]
    out["photo edges"] = [edges(y)]
    out |= {f"brightness, {q} %": [np.percentile(y, q)] for q in (10, 50, 90)}
    out["saturated share"] = [(rgb.max(-1) >= 0.995).mean()]
    out |= {f"depth, {q} % (m)": [np.percentile(z, q)] for q in (10, 50, 90)}
    out["field of view (degrees)"] = [picture.fov_x]
    out["unseen solid angle"] = [unseen(picture.depth, picture.fov_x)]
    return out


def cell(values):
    """Median (10 % .. 90 %), or a dash."""
    if not len(values):
        return "-"
    low, mid, high = np.percentile(np.asarray(values, float), (10, 50, 90))
    return f"{mid:.3g} ({low:.3g} .. {high:.3g})"


def table(columns):
    """Markdown of {title: [measures of a picture]}."""
    rows = list(dict.fromkeys(row for some in columns.values() for m in some for row in m))
    first = [r for r in rows if r.startswith(("strongest", "lights above", "change error"))]
    rows = first + [r for r in rows if r not in first]
    lines = ["| | " + " | ".join(f"{title} ({len(some)})" for title, some in columns.items()) + " |", "| --- " * (len(columns) + 1) + "|"]
    for row in rows:
        lines.append(f"| {row} | " + " | ".join(cell([v for m in some for v in m.get(row, [])]) for some in columns.values()) + " |")
    return "\n".join(lines)


def main():
    ask = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    ask.add_argument("--column", nargs=2, action="append", default=[], metavar=("TITLE", "ROOMS"))
    ask.add_argument("--truth", type=Path)
    ask.add_argument("--photos", type=Path)
    ask.add_argument("--count", type=int, default=1000, help="rooms of a column at most")
    ask.add_argument("--errors", type=Path, nargs="?", const=ROOT / "target/release/relight", help="the program")
    args = ask.parse_args()
    pictures = {title: [of_room(Path(f).parent) for f in sorted(glob.glob(f"{at}/truth.npz"))[: args.count]] for title, at in args.column}
    if args.truth:
        pictures["third-party truth"] = [of_truth(f.parent) for f in sorted(args.truth.glob("*/meta.json"))]
    if args.photos:
        pictures["photographs"] = [of_photo(f) for f in sorted(args.photos.iterdir()) if f.is_dir()]
    columns = {}
    for title, some in pictures.items():
        columns[title] = [measures(p) for p in some]
        for picture, row in zip(some, columns[title]):
            if args.errors and picture.pictures:
                errors = change_errors(picture, args.errors)
                row |= {f"change error, {text}": errors.get(kind, []) for kind, text in KINDS.items()}
                row["change error, all"] = [e for some in errors.values() for e in some]
    print(table(columns))


if __name__ == "__main__":
    main()
