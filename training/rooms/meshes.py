"""Meshes out of Wavefront files: read, put into a frame, made small, colored face by face, smoothed. Lengths in meters once placed."""
import io
import re
from dataclasses import dataclass

import numpy as np
from PIL import Image

from color import linear

TRIANGLES = 1500  # most triangles of a model
CREASE = 40.0  # degrees between faces up to which they shade as one
PATCH = 0.04  # meters; textured faces with longer edges are split while there are triangles left
CLOTH = ("bed", "sofa", "armchair", "rug", "curtain", "plant")  # authors left Blender's glossy default on these; roughness is at least CLOTH_ROUGH
CLOTH_ROUGH = 0.7
FROSTED = ("table", "coffee_table", "desk")  # glass is opaque on these, so that things can stand on it; elsewhere it is left out
ALBEDO = (0.02, 0.9)  # paints of real things; the files also have 0 and 1


def read_obj(text):
    """A Wavefront OBJ: vertices [n,3], uvs [k,2], corners int [m,3,2] (vertex, uv or -1; polygons as fans), material [m] (index), material names."""
    vertices, uvs, corners, material, names = [], [], [], [], {}
    now = names.setdefault("", 0)
    for line in text.splitlines():
        word = line.split(None, 1)
        if len(word) < 2:
            continue
        if word[0] == "v":
            vertices.append(word[1].split()[:3])
        elif word[0] == "vt":
            uvs.append(word[1].split()[:2])
        elif word[0] == "usemtl":
            now = names.setdefault(word[1].strip(), len(names))
        elif word[0] == "f":
            polygon = []
            for corner in word[1].split():
                v, t = (corner.split("/") + [""])[:2]
                v, t = int(v), int(t) if t else 0
                polygon.append((v - 1 if v > 0 else len(vertices) + v, t - 1 if t >= 0 else len(uvs) + t))
            for i in range(1, len(polygon) - 1):
                corners.append((polygon[0], polygon[i], polygon[i + 1]))
                material.append(now)
    shape = lambda rows, n: np.array(rows, np.float64).reshape(-1, n)
    return shape(vertices, 3), shape(uvs, 2), np.array(corners, np.int64).reshape(-1, 3, 2), np.array(material, np.int64), list(names)


def read_mtl(text):
    """{material: {"Kd": [3], "Ks": [3], "Ns": float, "d": float, "map_Kd": file name}}; what a material does not say is left out."""
    out, now = {}, {}
    for line in text.splitlines():
        key, _, value = line.strip().partition(" ")
        value = value.strip()
        if key == "newmtl":
            now = out.setdefault(value, {})
        elif key in ("Kd", "Ks"):
            now[key] = [float(x) for x in value.split()[:3]]
        elif key in ("Ns", "d", "illum"):
            now[key] = float(value.split()[-1])
        elif key == "map_Kd":
            now[key] = value.replace("\\", "/")
    return out


def roughness(material):
    """Roughness r with GGX alpha = r^2. A Phong lobe of exponent Ns is about as wide as GGX with alpha^2 = 2 / (Ns + 2) (Walter et al. 2007);
    a weak one is taken nearer to matte: r = 1 + s ((2 / (Ns + 2))^(1/4) - 1), s = max Ks / 0.5, at most 1 (0.5 is Blender's default)."""
    if material.get("illum") == 1 or "Ns" not in material:
        return 1.0
    strength = min(1.0, max(material.get("Ks", [0.0])) / 0.5)
    return float(1 + strength * ((2 / (max(material["Ns"], 0) + 2)) ** 0.25 - 1))


def place(vertices, rotation, size):
    """Turned by the catalog's matrix (nine numbers, rows first), scaled to `size`, stood on the floor."""
    if rotation:
        vertices = vertices @ np.array(rotation, np.float64).reshape(3, 3).T
    low, high = vertices.min(0), vertices.max(0)
    extent = np.where(high - low > 1e-9, high - low, 1)
    vertices = (vertices - low) / extent * np.asarray(size)
    return vertices - np.array([size[0] / 2, 0, size[2] / 2])


def weld(points, step=1e-5):
    """Equal points (to `step` meters) made one: points [k,3], index of each old one [n]."""
    _, first, index = np.unique(np.round(points / step).astype(np.int64), axis=0, return_index=True, return_inverse=True)
    return points[first], index.reshape(-1)


def areas(triangles):
    """Areas of triangles [m,3,3]."""
    return np.linalg.norm(np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]), axis=1) / 2


def shares(counts, most):
    """How many of `most` triangles each group may keep: all of the small ones, the others in proportion to the root of their number."""
    counts = np.asarray(counts, np.float64)
    low, high = 0.0, float(most)
    for _ in range(60):
        scale = (low + high) / 2
        low, high = (scale, high) if np.minimum(counts, scale * np.sqrt(counts)).sum() <= most else (low, scale)
    return np.maximum(4, np.minimum(counts, low * np.sqrt(counts))).astype(int)


def split_faces(triangles, uv, most):
    """Halves the longest edges above PATCH meters while there are fewer than `most` faces, so that a picture on large faces is resolved."""
    while len(triangles) < most:
        edge = np.linalg.norm(triangles - np.roll(triangles, -1, 1), axis=2)
        longest = edge.max(1)
        pick = np.argsort(-longest, kind="stable")[: most - len(triangles)]
        pick = pick[longest[pick] > max(PATCH, longest.max() / 2)]
        if not len(pick):
            break
        order = (edge[pick].argmax(1)[:, None] + np.arange(3)) % 3
        halves = []
        for a in (triangles, uv):
            p = np.take_along_axis(a[pick], order[..., None], 1)
            middle = (p[:, 0] + p[:, 1]) / 2
            halves.append((np.stack([p[:, 0], middle, p[:, 2]], 1), np.stack([middle, p[:, 1], p[:, 2]], 1)))
        keep = np.ones(len(triangles), bool)
        keep[pick] = False
        triangles, uv = (np.concatenate([a[keep], *h]) for a, h in zip((triangles, uv), halves))
    return triangles, uv


def simplify(points, faces, most):
    """At most `most` of faces [m,3] over the same points."""
    import meshoptimizer  # here, so that a library that stands can be loaded without it

    out = np.zeros(faces.size, np.uint32)
    scaled = (points / max(float(np.ptp(points, axis=0).max()), 1e-9)).astype(np.float32)
    n = meshoptimizer.simplify(out, faces.reshape(-1).astype(np.uint32), scaled, target_index_count=3 * most, target_error=1.0)
    return out[:n].reshape(-1, 3).astype(np.int64)


def pieces(faces, count):
    """Which connected piece each face belongs to: numbers from 0, in the order of their lowest vertex."""
    label = np.arange(count)
    while True:
        low = label[faces].min(1)
        new = label.copy()
        for corner in range(3):
            np.minimum.at(new, faces[:, corner], low)
        new = new[new]
        if (new == label).all():
            return np.unique(label[faces[:, 0]], return_inverse=True)[1]
        label = new


def thin(triangles, color, share):
    """Leaves some pieces (leaves of a plant) out and enlarges the others about their middles to the same total area, by at most 2.5."""
    points, index = weld(triangles.reshape(-1, 3))
    piece = pieces(index.reshape(-1, 3), len(points))
    chosen = np.random.default_rng(0).random(piece.max() + 1) < share
    keep = chosen[piece]
    piece = piece[keep]
    centroid = np.stack([np.bincount(piece, triangles[keep].mean(1)[:, k]) / np.maximum(np.bincount(piece), 1) for k in range(3)], 1)[piece][:, None]
    return centroid + (triangles[keep] - centroid) * min(2.5, share**-0.5), color[keep]


def decimate(triangles, color, most):
    """At most `most` triangles that look alike, with their colors [m,4]. Where merging edges eats the surface, as it does with foliage, pieces
    are left out first (after Cook et al., Stochastic Simplification of Aggregate Detail, 2007)."""
    area, low, high = areas(triangles).sum(), triangles.min((0, 1)), triangles.max((0, 1))
    best = None
    for share in (1, 0.5, 0.25, 0.12, 0.06, 0.03):
        less, tint = thin(triangles, color, share) if share < 1 else (triangles, color)
        if not len(less):
            break
        less = np.clip(less, low, high)
        points, index = weld(less.reshape(-1, 3))
        faces = index.reshape(-1, 3)
        faces, tint = (a[(faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])] for a in (faces, tint))
        total = np.zeros((len(points), 4))
        weight = areas(points[faces])[:, None] + 1e-12
        for corner in range(3):
            np.add.at(total, faces[:, corner], np.concatenate([tint[:, :3] * weight, weight], 1))
        colors = total[:, :3] / np.maximum(total[:, 3:], 1e-12)
        kept = simplify(points, faces, most) if len(faces) > most else faces
        got = areas(points[kept]).sum()
        if best is None or (len(kept) <= most * 1.1, got) > (best[0] <= most * 1.1, best[1]):
            best = (len(kept), got, points[kept], np.concatenate([colors[kept].mean(1), np.ones((len(kept), 1))], 1))
        if got > 0.7 * area and len(kept) <= most * 1.1:
            break
    return best[2], best[3]


def smooth(triangles, crease=CREASE):
    """Vertices, normals [n,3], faces [m,3]: normals are area-weighted means over the faces around a vertex that lie within `crease` degrees."""
    points, index = weld(triangles.reshape(-1, 3))
    cross = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    unit = cross / np.maximum(np.linalg.norm(cross, axis=1, keepdims=True), 1e-20)
    order = np.argsort(index, kind="stable")
    count = np.bincount(index, minlength=len(points))
    start = np.cumsum(count) - count
    # All pairs (corner, corner at the same vertex), corner by corner in their old order.
    fan = count[index]
    first = np.repeat(np.arange(len(index)), fan)
    second = order[np.repeat(start[index], fan) + np.arange(fan.sum()) - np.repeat(np.cumsum(fan) - fan, fan)]
    near = (unit[first // 3] * unit[second // 3]).sum(1) >= np.cos(np.radians(crease)) - 1e-9
    normal = np.zeros((len(index), 3))
    np.add.at(normal, first[near], cross[second[near] // 3])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-20)
    key = np.column_stack([index, np.round(normal * 500).astype(np.int64)])
    _, one, inverse = np.unique(key, axis=0, return_index=True, return_inverse=True)
    return points[index[one]].astype(np.float32), normal[one].astype(np.float32), inverse.reshape(-1, 3).astype(np.int32)


def picture(data):
    """Linear RGBA [h,w,4] of an image file's bytes, at most 256 pixels wide or high; None where there is none."""
    if data is None:
        return None
    image = Image.open(io.BytesIO(data)).convert("RGBA")
    rgba = np.asarray(image, np.float32) / 255
    rgba = np.concatenate([linear(rgba[..., :3]), rgba[..., 3:]], 2)
    k = max(1, max(rgba.shape[:2]) // 256)
    h, w = rgba.shape[0] // k, rgba.shape[1] // k
    return rgba if k == 1 or not h or not w else rgba[: h * k, : w * k].reshape(h, k, w, k, 4).mean((1, 3))


def picture_means(image, uv):
    """Mean color and opacity [m,4] of a picture (linear RGBA [h,w,4], repeated) over uv triangles [m,3,2]: 28 even samples each."""
    n = 7
    bary = np.array([((i + 1 / 3) / n, (j + 1 / 3) / n) for i in range(n) for j in range(n - i)])
    bary = np.column_stack([bary, 1 - bary.sum(1)])
    at = np.einsum("sk,mkc->msc", bary, uv) % 1.0
    h, w = image.shape[:2]
    texel = image[((1 - at[..., 1]) * h).astype(int) % h, (at[..., 0] * w).astype(int) % w]
    opacity = texel[..., 3:].mean(1)
    return np.concatenate([(texel[..., :3] * texel[..., 3:]).mean(1) / np.maximum(opacity, 1e-3), opacity], 1)


@dataclass
class Group:
    """The faces of one material."""

    name: str
    rough: float
    triangles: np.ndarray  # [m,3,3]
    color: np.ndarray  # [m,4] linear, opacity
    uv: np.ndarray  # [m,3,2]; None without a picture
    image: np.ndarray  # linear RGBA [h,w,4], or None; None as well once the uvs no longer belong to the faces


def read_groups(read, find, record, cls, builtin):
    """The model's faces by material, in their place, without doubles and without glass."""
    folder = record["model"].rsplit("/", 1)[0]
    text = read(record["model"]).decode("latin1")
    vertices, uvs, corners, material, names = read_obj(text)
    library = dict(builtin)
    for file in re.findall(r"^mtllib\s+(.*?)\s*$", text, re.M):
        library.update(read_mtl((read(f"{folder}/{file}") or b"").decode("latin1")))
    used, back = np.unique(corners[..., 0], return_inverse=True)
    size = [float(record[key]) / 100 for key in ("width", "height", "depth")]
    placed = place(vertices[used], [float(x) for x in record.get("modelRotation", "").split()], size)[back.reshape(-1, 3)]
    groups = []
    for i, name in enumerate(names):
        m = library.get(name, {})
        if not (material == i).any() or (m.get("d", 1) < 0.5 and cls not in FROSTED):
            continue
        triangles, uv = placed[material == i], corners[material == i][..., 1]
        # Each triangle once: some are there for either side.
        ids = np.sort(weld(triangles.reshape(-1, 3))[1].reshape(-1, 3), 1)
        once = np.zeros(len(ids), bool)
        once[np.unique(ids, axis=0, return_index=True)[1]] = True
        once &= (ids[:, 0] < ids[:, 1]) & (ids[:, 1] < ids[:, 2])
        image = picture(find(folder, m["map_Kd"])) if "map_Kd" in m and (uv >= 0).all() else None
        if image is not None:
            uv = uvs[uv]
            color = picture_means(image, uv)
        else:
            color = np.tile(np.append(linear(np.clip(m.get("Kd", [0.6] * 3), 0, 1)), 1.0), (len(triangles), 1))
        keep = once & (color[:, 3] > 0.3)
        if keep.any():
            groups.append(Group(name, roughness(m), triangles[keep], color[keep], None if image is None else uv[keep], image))
    return groups


def make_mesh(read, find, record, cls, builtin):
    """The arrays of the model that a catalog's `record` describes (fields of assets.Model), or None if nothing of it is opaque. `read(path)`
    and, for pictures, `find(folder, file)` give the bytes of a file of the archive, or None; `builtin` holds materials that need no file."""
    groups = read_groups(read, find, record, cls, builtin)
    if not groups:
        return None
    for g, most in zip(groups, shares([len(g.triangles) for g in groups], TRIANGLES)):
        if len(g.triangles) > most:
            g.triangles, g.color = decimate(g.triangles, g.color, most)
            g.image = None
    pictured = [g for g in groups if g.image is not None]
    spare = max(0, TRIANGLES - sum(len(g.triangles) for g in groups)) / max(sum(areas(g.triangles).sum() for g in pictured), 1e-9)
    for g in pictured:
        g.triangles, g.uv = split_faces(g.triangles, g.uv, len(g.triangles) + int(spare * areas(g.triangles).sum()))
        g.color = picture_means(g.image, g.uv)
    for g in groups:
        solid = areas(g.triangles) > 1e-10
        g.triangles, g.color = g.triangles[solid], g.color[solid]
    vertices, normals, faces = smooth(np.concatenate([g.triangles for g in groups]))
    each = lambda values, kind: np.repeat(np.array(values, kind), [len(g.triangles) for g in groups])
    rough = each([g.rough for g in groups], np.float32)
    return dict(
        vertices=vertices, normals=normals, faces=faces,
        albedo=np.clip(np.concatenate([g.color[:, :3] for g in groups]), *ALBEDO).astype(np.float32),
        rough=np.maximum(rough, CLOTH_ROUGH) if cls in CLOTH else rough,
        group=each(range(len(groups)), np.int16), materials=np.array([g.name for g in groups]))
