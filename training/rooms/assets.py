"""Makes the furniture library of the room generator, and loads it.

usage: assets.py [--out .cache/assets]

Fetches the Debian packages `sweethome3d-furniture` and `sweethome3d` with `apt-get download` (nothing is installed) and writes

 models.npz    all meshes end to end: vertices, normals float32 [n,3]; faces int32 [m,3]; albedo float32 [m,3]; rough float32 [m]; group int16 [m]
 models.json   what the catalogs say of each model, and where its vertices and faces start in models.npz
 textures/     floor and wall pictures, 8-bit sRGB PNG, one tile each; textures.json says kind and size
 LICENCES.md   who made what, under which license

Frame of a model: meters, y up, centered in x and z, lowest point at y = 0, front towards +z. The catalogs state width (x), height (y) and
depth (z) of the mesh once it is turned by their modelRotation; each axis is scaled to that. Faces are not wound alike everywhere: render them
from both sides.
Which models are taken, and as what, is classes.json; what is not listed there is left out. One model in five of each class is `held`: for
rooms that no network is trained on. Same packages, same files; a run that was cut off goes on where it stopped."""
import argparse
import hashlib
import io
import json
import os
import re
import shutil
import subprocess
import sys
import zipfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from meshes import linear, make_mesh, read_mtl

HERE = Path(__file__).resolve().parent
FOLDER = HERE.parents[1] / ".cache" / "assets"
PACKAGES = ("sweethome3d-furniture", "sweethome3d")
SHARE = "usr/share/sweethome3d/"
MODEL_CATALOGUES = {  # file: (catalog inside it, license)
    "furniture/BlendSwap-CC-0.sh3f": ("PluginFurnitureCatalog", "CC0 1.0"),
    "furniture/BlendSwap-CC-BY.sh3f": ("PluginFurnitureCatalog", "CC-BY 3.0"),
    "furniture/KatorLegaz.sh3f": ("PluginFurnitureCatalog", "CC-BY 3.0 US"),
    "furniture/Scopia.sh3f": ("PluginFurnitureCatalog", "CC-BY 3.0"),
    "sweethome3d.jar": ("com/eteks/sweethome3d/io/DefaultFurnitureCatalog", "CC-BY 3.0"),
}
TEXTURE_CATALOGUE = ("sweethome3d.jar", "com/eteks/sweethome3d/io/DefaultTexturesCatalog.properties", "CC-BY 3.0")
TEXTURE_KINDS = {  # what each texture shows; the others (skies, grass, hedge) are outdoors
    "wood": "woodenFloor oldWoodenFloor",
    "tile": "greyTile blueTiles redTiles blackAndWhiteTiles beigeTile lightBlueTile darkBlueTile wallBeigeTile",
    "stone": "stoneTiles stoneWall stone2Wall stone3Wall marbleWall pebbles pavingStone",
    "brick": "smallBricks smallRedBricks smallWhiteBricks",
    "plaster": "roughcast",
}
HELD = 0.2  # share of the models of a class that is held out


@dataclass(frozen=True)
class Model:
    """A piece of furniture. Frame and units: head of this file."""

    name: str  # "scopia/bed1"
    title: str  # "Bed"
    cls: str  # a key of classes.json
    category: str  # the catalog's
    split: str  # "train" or "held"
    size: tuple  # width (x), height (y), depth (z)
    elevation: float  # where its lowest point hangs above the floor
    top: float  # height of the surface on which things stand, above its own lowest point
    lights: list  # [{"position": [3], "colour": [3] linear Rec.709, "diameter"}]
    author: str
    licence: str
    materials: list  # names, by `group`
    vertices: np.ndarray  # [n,3]
    normals: np.ndarray  # [n,3] unit; vertices are doubled at creases
    faces: np.ndarray  # [m,3]
    albedo: np.ndarray  # [m,3] linear Rec.709
    rough: np.ndarray  # [m] 0..1, GGX alpha = rough^2; 1 matte
    group: np.ndarray  # [m] which of `materials`


@dataclass(frozen=True)
class Texture:
    """A picture that tiles a floor or a wall."""

    name: str
    kind: str  # a key of TEXTURE_KINDS
    place: str  # "floor" or "wall", the catalog's category
    size: tuple  # meters: width, height of one tile
    author: str
    licence: str
    path: Path

    def albedo(self):
        """Linear Rec.709 [h,w,3] float32."""
        return linear(np.asarray(Image.open(self.path).convert("RGB"), np.float32) / 255)


class Library:
    """The models and textures of a folder that this script wrote."""

    def __init__(self, models, textures):
        self.all, self.textures = models, textures

    @staticmethod
    def load(folder=FOLDER):
        folder = Path(folder)
        for name in ("models.npz", "models.json", "textures.json"):
            if not (folder / name).is_file():
                raise FileNotFoundError(f"furniture library: {folder / name} is missing; make it with training/rooms/assets.py --out {folder}")
        with np.load(folder / "models.npz") as store:
            data = {key: store[key] for key in store.files}
        models = []
        for record in json.loads((folder / "models.json").read_text()):
            (v, v_end), (f, f_end) = record.pop("vertex_range"), record.pop("face_range")
            record["size"] = tuple(record["size"])
            mesh = {key: a[f:f_end] if key in ("faces", "albedo", "rough", "group") else a[v:v_end] for key, a in data.items()}
            models.append(Model(**record, **mesh))
        textures = []
        for record in json.loads((folder / "textures.json").read_text()):
            textures.append(Texture(**{**record, "size": tuple(record["size"]), "path": folder / record["path"]}))
        return Library(models, textures)

    def models(self, cls=None, split=None):
        """Those of one class and one split ("train", "held"); None takes all. Sorted by name."""
        return [m for m in self.all if cls in (None, m.cls) and split in (None, m.split)]

    def only(self, split):
        """With the models of one split."""
        return Library(self.models(split=split), self.textures)


def read_catalogue(text):
    """{number: {key: value}} of the lines key#number=value of a Java properties file."""
    out = {}
    for key, number, value in re.findall(r"^(\w+)#(\d+)\s*=[ \t]*(.*?)\s*$", text, re.M):
        value = re.sub(r"\\u([0-9a-fA-F]{4})", lambda m: chr(int(m[1], 16)), value)
        out.setdefault(int(number), {})[key] = value
    return out


def model_name(path):
    """ "/scopia/bed1/bed1.obj" -> "scopia/bed1"; the program's own models have no folder each: ".../resources/bed.obj" -> "eteks/bed"."""
    parts = path.strip("/").split("/")
    return "eteks/" + Path(parts[-1]).stem if parts[0] == "com" else "/".join(parts[:2])


def own_materials(program):
    """The materials that Sweet Home 3D knows without a file; an OBJ may name them. They are one string in its loader's class file."""
    start = program.find(b"newmtl amber")
    end = re.search(rb"[^\t\n\r -~]", program[start:]) if start >= 0 else None
    return read_mtl(program[start : start + end.start()].decode("ascii")) if end else {}


def lights_of(record):
    """The catalog's light sources: x from the left side, y from the front, z up, in cm; colors sRGB."""
    lists = [record.get(f"lightSource{key}", "").split() for key in ("X", "Y", "Z", "Color")]
    diameters = record.get("lightSourceDiameter", "").split() or ["5"] * len(lists[0])
    half = [float(record["width"]) / 2, float(record["depth"]) / 2]
    out = []
    for x, y, z, color, diameter in zip(*lists, diameters):
        rgb = linear([int(color[i : i + 2], 16) / 255 for i in (1, 3, 5)])
        position = [(float(x) - half[0]) / 100, float(z) / 100, (half[1] - float(y)) / 100]
        out.append({"position": [round(p, 4) for p in position], "colour": [round(float(c), 5) for c in rgb], "diameter": float(diameter) / 100})
    return out


def held_out(names):
    """The names that are held: the first HELD of them by hash, at least one of two or more."""
    ranked = sorted(names, key=lambda name: hashlib.sha256(name.encode()).hexdigest())
    return set(ranked[: max(round(HELD * len(names)), len(names) >= 2)])


def fetch(out):
    """Downloads and unpacks the packages under `out`; the folder that stands for /."""
    root = out / "packages" / "root"
    root.mkdir(parents=True, exist_ok=True)
    for package in PACKAGES:
        done = root / f".{package}"
        if done.exists():
            continue
        if not list(root.parent.glob(package + "_*.deb")):
            run(["apt-get", "download", package], root.parent)
        run(["dpkg", "-x", str(sorted(root.parent.glob(package + "_*.deb"))[-1]), str(root)], root.parent)
        done.touch()
    return root / SHARE


def run(command, folder):
    try:
        got = subprocess.run(command, cwd=folder, capture_output=True, text=True)
    except FileNotFoundError:
        sys.exit(f"assets.py: {command[0]} is missing; the furniture comes from Debian packages and needs apt-get and dpkg")
    if got.returncode:
        sys.exit(f"assets.py: `{' '.join(command)}` failed (does /etc/apt name Debian's main archive? is `apt-get update` due?):\n{got.stderr}")


def make_models(share, out):
    classes = {name: cls for cls, names in json.loads((HERE / "classes.json").read_text()).items() for name in names}
    held = set().union(*(held_out([n for n in classes if classes[n] == cls]) for cls in set(classes.values())))
    builtin = own_materials(zipfile.ZipFile(share / "sweethome3d.jar").read("com/eteks/sweethome3d/j3d/OBJLoader.class"))
    parts = out / "parts" / hashlib.sha256(b"".join((HERE / f).read_bytes() for f in ("meshes.py", "assets.py", "classes.json"))).hexdigest()[:12]
    parts.mkdir(parents=True, exist_ok=True)
    records, meshes, empty = [], [], []
    for file, (catalogue, licence) in MODEL_CATALOGUES.items():
        archive = zipfile.ZipFile(share / file)
        inside = set(archive.namelist())
        read = lambda path: archive.read(path.strip("/")) if path.strip("/") in inside else None
        pictures = {}
        for path in sorted(inside):
            if path.lower().endswith((".jpg", ".jpeg", ".png")):
                pictures.setdefault(path.rsplit("/", 1)[0], []).append(path)
        # One material names its picture by a path of the author's machine: then the folder's only picture is meant.
        there = lambda folder: pictures.get(folder.strip("/"), [])
        find = lambda folder, file: read(f"{folder}/{file}") or (read(there(folder)[0]) if len(there(folder)) == 1 else None)
        for record in read_catalogue(archive.read(catalogue + ".properties").decode("latin1")).values():
            name = model_name(record["model"])
            if name not in classes or any(r["name"] == name for r in records):
                continue
            part = parts / (name.replace("/", "--") + ".npz")
            if not part.exists():
                mesh = make_mesh(read, find, record, classes[name], builtin) or {}
                np.savez(part.with_suffix(".tmp.npz"), **mesh)
                part.with_suffix(".tmp.npz").rename(part)
            with np.load(part) as store:
                mesh = dict(store)
            if not mesh:
                empty.append(name)
                continue
            cm = lambda key, other: round(float(record.get(key, other)) / 100, 5)
            meshes.append(mesh)
            records.append(dict(
                name=name, title=record.get("name", name), cls=classes[name], category=record["category"],
                split="held" if name in held else "train",
                size=[cm("width", 0), cm("height", 0), cm("depth", 0)], elevation=cm("elevation", 0), top=cm("dropOnTopElevation", record["height"]),
                lights=lights_of(record), author=record.get("creator", ""), licence=licence, materials=mesh.pop("materials").tolist()))
    missing = sorted(set(classes) - {r["name"] for r in records} - set(empty))
    if missing:
        sys.exit(f"assets.py: classes.json names models that the packages do not have (another version?): {' '.join(missing)}")
    if empty:
        print("nothing but glass, left out:", *empty, file=sys.stderr)
    order = sorted(range(len(records)), key=lambda i: records[i]["name"])
    records, meshes = [records[i] for i in order], [meshes[i] for i in order]
    for key, of in (("vertex_range", "vertices"), ("face_range", "faces")):
        ends = np.cumsum([len(m[of]) for m in meshes])
        for r, m, end in zip(records, meshes, ends):
            r[key] = [int(end) - len(m[of]), int(end)]
    np.savez(out / "models.npz", **{key: np.concatenate([m[key] for m in meshes]) for key in meshes[0]})
    (out / "models.json").write_text("[\n" + ",\n".join(json.dumps(r) for r in records) + "\n]\n")
    return records


def make_textures(share, out):
    kinds = {name: kind for kind, names in TEXTURE_KINDS.items() for name in names.split()}
    file, catalogue, licence = TEXTURE_CATALOGUE
    archive = zipfile.ZipFile(share / file)
    (out / "textures").mkdir(exist_ok=True)
    records = []
    for record in read_catalogue(archive.read(catalogue).decode("latin1")).values():
        name = Path(record["image"]).stem
        if name in kinds:
            path = f"textures/{name}.png"
            Image.open(io.BytesIO(archive.read(record["image"].strip("/")))).convert("RGB").save(out / path)
            records.append(dict(
                name=name, kind=kinds[name], place=record["category"].lower(), size=[float(record["width"]) / 100, float(record["height"]) / 100],
                author=record["creator"], licence=licence, path=path))
    records.sort(key=lambda r: r["name"])
    (out / "textures.json").write_text("[\n" + ",\n".join(json.dumps(r) for r in records) + "\n]\n")
    return records


def licences(share, models, textures):
    """The text of LICENCES.md."""
    lines = ["# Who made what", ""]
    lines += ["From the Debian packages `sweethome3d-furniture` and `sweethome3d`, under the licenses that each catalog states."]
    lines += ["The models and textures of eTeks are offered under GNU GPL or CC-BY 3.0; they are used here under the latter."]
    lines += ["Changed: meshes are rotated, scaled and simplified, their colors averaged.", ""]
    for licence in sorted({r["licence"] for r in models + textures}):
        lines += [f"## {licence}", ""]
        for author in sorted({r["author"] for r in models + textures if r["licence"] == licence}):
            mine = [r["name"] for r in models + textures if (r["licence"], r["author"]) == (licence, author)]
            lines.append(f"- {author}: {', '.join(mine)}")
        lines.append("")
    for file in MODEL_CATALOGUES:
        if file.endswith(".sh3f"):
            text = zipfile.ZipFile(share / file).read("LICENSE.TXT").decode("latin1")
            lines += [f"## LICENSE.TXT of {Path(file).name}", "", *("    " + line.strip() for line in text.strip().splitlines()), ""]
    return "\n".join(lines)


def main():
    options = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    options.add_argument("--out", type=Path, default=FOLDER, help="the library's folder")
    args = options.parse_args()
    out = args.out.resolve()
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as e:
        sys.exit(f"assets.py: cannot make the folder {out}: {e.strerror}")
    if not os.access(out, os.W_OK):
        sys.exit(f"assets.py: the folder {out} is not writable")
    share = fetch(out)
    models, textures = make_models(share, out), make_textures(share, out)
    (out / "LICENCES.md").write_text(licences(share, models, textures))
    shutil.rmtree(out / "parts")
    print(f"{len(models)} models, {len(textures)} textures in {out}")


if __name__ == "__main__":
    main()
