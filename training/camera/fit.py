"""Statistics of photos beside those of clean pictures before and after the camera.

usage: fit.py PHOTOS TRUTH [--draws 4] [--sheet sheet.png]

PHOTOS holds folders with photo.png, depth.exr and masks; TRUTH holds third-party rooms, of which
only these statistics are used. The room of tests/scenes/small is measured too. All pictures are reduced to
320 pixels of width, but for blocks of JPEG, which are those of a picture 600 or more wide. Each row
has the median over the pictures, then the smallest and the largest; a row is left blank where no
picture has what it measures. The constants chosen stand in `model.FITTED` and `depth.py`."""

import argparse
import sys
from dataclasses import asdict
from pathlib import Path

import numpy as np
import OpenEXR
from PIL import Image

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from camera import depth, model  # noqa: E402
from camera.photograph import read  # noqa: E402

LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
SMALL_ROOM = Path(__file__).resolve().parents[2] / "tests/scenes/small"
SIGNALS = ((0.01, 0.05), (0.05, 0.15), (0.15, 0.35), (0.35, 0.7))  # bins of luminance for noise


def reduced(stored, width=320):
    """Returns 8-bit sRGB [h, w, 3] of `width` pixels."""
    picture = Image.fromarray(stored)
    return np.asarray(picture.resize((width, round(picture.height * width / picture.width)), Image.Resampling.BOX))


def distances(points, targets, limit=2000):
    """Returns the distance of each point [n, 2] to the nearest target."""
    targets = targets[:: max(1, len(targets) // limit)].astype(np.float32)
    parts = np.array_split(points.astype(np.float32), max(1, len(points) // 500))
    return np.concatenate([np.sqrt(((p[:, None] - targets) ** 2).sum(-1).min(1)) for p in parts])


def exposure(stored):
    """Returns percentiles of luminance, the balance of colors and the level of the corners."""
    linear = model.decode(stored / 255)
    y, mean = linear @ LUMINANCE, linear.mean((0, 1))
    at = model.corner_distance(*y.shape)
    corners = np.log(np.median(y[at > 0.6]) / np.median(y[at < 0.1]))
    rows = {f"luminance, {p} %": np.percentile(y, p) for p in (10, 50, 90)}
    return rows | {"log red / green": np.log(mean[0] / mean[1]), "log blue / green": np.log(mean[2] / mean[1]), "log corners / middle": corners}


def white(stored):
    """Returns the clipped share, the softness of clipping, and the excess of luminance around white
    over that a fifth of the width away."""
    h, w = stored.shape[:2]
    top, core = stored.max(-1), stored.min(-1) >= 250
    rows = {"one channel clipped, share": (top >= 250).mean(), "all channels clipped, share": core.mean()}
    rows["just below white / all bright"] = ((stored.min(-1) >= 230) & ~core).sum() / max((stored.min(-1) >= 230).sum(), 1)
    if core.sum() > 20:
        grid = np.stack(np.mgrid[0:h:2, 0:w:2], -1)
        away = distances(grid.reshape(-1, 2), np.argwhere(core)).reshape(grid.shape[:2]) / w
        y = (model.decode(stored / 255) @ LUMINANCE)[::2, ::2]
        ring = lambda low, high: y[(away > low) & (away <= high)].mean()
        far = ring(0.15, 0.25)
        for low, high in ((0.003, 0.01), (0.01, 0.02), (0.02, 0.04), (0.04, 0.08)):
            rows[f"excess {low} to {high} from white"] = ring(low, high) - far
    return rows


def noise(stored, block=8):
    """Returns the noise floor by signal: what a plane leaves of the flattest fifth of the blocks,
    in linear units of white."""
    linear = model.decode(stored / 255)
    h, w = (n - n % block for n in linear.shape[:2])
    blocks = linear[:h, :w].reshape(h // block, block, w // block, block, 3).swapaxes(1, 2).reshape(-1, block * block, 3)
    y, x = np.mgrid[0:block, 0:block].reshape(2, -1)
    plane = np.stack([np.ones_like(x), x, y], 1)
    rest = (np.eye(block * block) - plane @ np.linalg.pinv(plane)) @ blocks
    signal, luma = blocks.mean(1) @ LUMINANCE, rest @ LUMINANCE
    spread = np.sqrt((luma**2).sum(1) / (block * block - 3))
    rows = {}
    for low, high in SIGNALS:
        here = (signal > low) & (signal < high)
        if here.sum() >= 60:
            flat = here & (spread <= np.quantile(spread[here], 0.2))
            rows[f"noise at {low} to {high}"] = np.median(spread[flat])
            rows[f"noise of red - green at {low} to {high}"] = np.median(np.std(rest[flat, :, 0] - rest[flat, :, 1], 1))
            grain = luma[flat].reshape(-1, block, block)
            rows[f"its correlation at one pixel, {low} to {high}"] = (grain[:, :, 1:] * grain[:, :, :-1]).mean() / (grain**2).mean()
    return rows


def sharpness(stored):
    """Returns the median profile's width and overshoot of strong edges between flat sides, and
    bandwidths: differences at one pixel over those at four."""
    gray, profiles = stored @ model.LUMA / 255, []
    for plane in (gray, gray.T):
        step = np.abs(plane[:, 2:] - plane[:, :-2])
        for row, d in zip(plane, step):
            for x in np.nonzero(d > 0.12)[0] + 1:
                if 10 <= x < len(row) - 10 and d[x - 1] == d[x - 4 : x + 3].max():
                    near, far = row[x - 9 : x - 4], row[x + 5 : x + 10]
                    height = far.mean() - near.mean()
                    if abs(height) > 0.15 and max(near.std(), far.std()) < 0.05 * abs(height) and row[x - 9 : x + 10].max() < 0.96:
                        profiles.append((row[x - 9 : x + 10] - near.mean()) / height)
    rows = {}
    if len(profiles) >= 20:
        p = np.median(profiles, 0)
        rows["edge, one pixel before and after"] = (p[10] - p[8]) / 2 + 0.5
        rows["overshoot"] = max(p[10:14].max() - 1, -p[5:9].min(), 0)
    s, known = stored / 255, stored.max(-1) < 247
    luma = s @ model.LUMA
    ratio = lambda x: np.divide(*(((x[:, d:] - x[:, :-d]) ** 2)[known[:, d:] & known[:, :-d]].mean() for d in (1, 4)))
    return rows | {"bandwidth of luma": ratio(luma), "bandwidth of chroma": ratio(s[..., [2, 0]] - luma[..., None])}


def blocks(stored):
    """Returns the ratio of third differences across the borders of JPEG's blocks to those elsewhere."""
    luma = stored @ model.LUMA
    third = np.abs(luma[:, 3:] - 3 * luma[:, 2:-1] + 3 * luma[:, 1:-2] - luma[:, :-3])
    flat = third < 12
    columns = (third * flat).sum(0) / flat.sum(0)
    phases = np.array([columns[k::8].mean() for k in range(8)])
    like = phases.reshape(4, 2)  # even and odd columns apart: enlarging makes them differ
    return {"across borders of JPEG blocks / elsewhere": (like.max(0) / np.median(like, 0)).max()}


def edge_points(stored):
    """Returns the pixels [n, 2] of strong edges, a tenth of all."""
    gray = np.asarray(Image.fromarray(stored).convert("L"), float)
    slope = np.hypot(*np.gradient(model.blurred(gray[..., None], 0.003)[..., 0]))
    return np.argwhere(slope > np.quantile(slope, 0.9))


def depth_rows(z, stored):
    """Returns holes, steps and edges of a depth plane."""
    known = np.isfinite(z) & (z > 0)
    rows = {"holes, share": 1 - known.mean()}
    levels = np.unique(np.round(z[known], 5))
    for low, high in ((1, 1.5), (1.5, 2.2), (2.2, 3.3)):
        here = levels[(levels > low) & (levels < high)]
        if 20 < len(here) < 2000:
            rows[f"steps / z^2 at {low} to {high} m, mm"] = 1e3 * np.median(np.diff(here) / here[1:] ** 2)
    widths, h, w = [], *z.shape
    for row in np.where(known, z, np.nan)[::2]:
        jump = row[6:] - row[:-6]
        for x in np.nonzero(np.abs(jump) > 0.25)[0]:
            part = (row[x : x + 7] - row[x]) / jump[x]
            if np.isfinite(part).all() and abs(row[x] - row[max(x - 3, 0)]) < 0.03 and abs(row[x + 6] - row[min(x + 9, w - 1)]) < 0.03:
                widths.append(((part > 0.1) & (part < 0.9)).sum())
    if len(widths) > 20:
        rows["pixels between the sides of a step of depth"] = np.mean(widths)
    filled = np.where(known, z, 0)
    steep = (np.abs(np.diff(filled, axis=1)) > 0.1) & known[:, 1:] & known[:, :-1]
    if steep.sum() > 50:
        away = distances(np.argwhere(steep), edge_points(stored)) / w
        rows["step of depth to edge of photo, 90 %"] = np.percentile(away, 90)
    return rows


def mask_rows(mask, stored):
    """Returns how far a mask's outline is from edges of the photo, in shares of the width, and by
    how much it is shifted against them."""
    h, w = mask.shape
    outline = mask & ~(np.roll(mask, 1, 0) & np.roll(mask, -1, 0) & np.roll(mask, 1, 1) & np.roll(mask, -1, 1))
    points, edges = np.argwhere(outline), edge_points(stored)
    if len(points) < 20:
        return {}
    away = distances(points, edges) / w
    plane = np.zeros((h, w))
    plane[tuple(edges.T)] = 1
    plane = model.blurred(plane[..., None], 0.002)[..., 0]
    moves = [(i, j) for i in range(-6, 7) for j in range(-6, 7)]
    on_edges = [plane[np.clip(points[:, 0] + i, 0, h - 1), np.clip(points[:, 1] + j, 0, w - 1)].mean() for i, j in moves]
    rows = {f"outline to edge of photo, {p} %": np.percentile(away, p) for p in (50, 90)}
    return rows | {"shift of the mask": np.hypot(*moves[int(np.argmax(on_edges))]) / w}


def photo_rows(stored):
    """Returns all rows of a stored picture."""
    small = reduced(stored)
    return exposure(small) | white(small) | noise(small) | sharpness(small) | (blocks(stored) if stored.shape[1] >= 600 else {})


def plane(path):
    """Returns the first channel of an OpenEXR file."""
    with OpenEXR.File(str(path), separate_channels=True) as file:
        return np.asarray(next(iter(file.channels().values())).pixels, float)


def shrunk(x, width=320):
    """Returns the nearest pixels of a plane on a grid `width` wide."""
    h = round(x.shape[0] * width / x.shape[1])
    return x[np.ix_(depth.nearest_rows(h, x.shape[0]), depth.nearest_rows(width, x.shape[1]))]


def load_mask(path):
    return np.asarray(Image.open(path).convert("L")) > 0


def photographs(folder):
    """Yields stored photo, depth and masks."""
    for f in sorted(p for p in folder.iterdir() if (p / "photo.png").exists()):
        yield np.asarray(Image.open(f / "photo.png").convert("RGB")), plane(f / "depth.exr"), [load_mask(m) for m in sorted(f.glob("masks/*.png"))]


def clean(truth):
    """Yields linear picture, depth, masks and albedo of rooms that are known."""
    for f in sorted(p for p in truth.iterdir() if p.is_dir()):
        masks = [load_mask(m) for m in sorted(f.glob("mask_*_[0-9].png"))]
        yield sum(read(p) for p in sorted(f.glob("olat_*.exr"))), plane(f / "depth.exr"), masks, read(f / "albedo.exr")
    masks = [load_mask(m) for m in sorted((SMALL_ROOM / "masks").glob("*.png"))]
    lights = sorted((SMALL_ROOM / "truth").glob("light_*.exr"))
    yield sum(read(p) for p in lights), plane(SMALL_ROOM / "depth.exr"), masks, read(SMALL_ROOM / "truth/albedo.exr")


def enlarged(linear):
    """Returns the picture at twice its size, so that JPEG's blocks are as large as in the photos."""
    h, w = linear.shape[:2]
    channels = (Image.fromarray(c.astype(np.float32)) for c in np.moveaxis(linear, -1, 0))
    return np.stack([np.asarray(c.resize((2 * w, 2 * h), Image.Resampling.BILINEAR)) for c in channels], -1)


def table(sides):
    """Prints the medians, smallest and largest values of each row on each side."""
    names = list(dict.fromkeys(name for side in sides.values() for rows in side for name in rows))
    print(f"{'':46s}" + "".join(f"{name:>30s}" for name in sides))
    for name in names:
        line = ""
        for side in sides.values():
            values = [rows[name] for rows in side if name in rows]
            line += f"{np.median(values):10.4f} ({min(values):8.4f}, {max(values):8.4f})" if values else " " * 30
        print(f"{name:46s}{line}")


def main(photos, truth, draws, sheet):
    photos, rooms = list(photographs(photos)), list(clean(truth))
    plain = [np.round(255 * model.encode(room[0])).astype(np.uint8) for room in rooms]
    taken = []
    for k, (linear, *_) in enumerate(rooms):
        rng = np.random.default_rng(k)
        taken += [model.photograph(linear, model.sample(rng), rng).stored for _ in range(draws)]
    large = [enlarged(linear) for linear, *_ in rooms]
    rng = np.random.default_rng(99)
    with_blocks = [blocks(model.photograph(x, model.sample(rng), rng).stored) for x in large]
    table(
        {
            "photos": [photo_rows(stored) for stored, *_ in photos],
            "clean": [photo_rows(p) | blocks(np.round(255 * model.encode(x)).astype(np.uint8)) for p, x in zip(plain, large)],
            "through the camera": [photo_rows(p) for p in taken] + with_blocks,
        }
    )
    print()
    sensor, networks, masks = [], [], []
    for (_, z, drawn, albedo), stored in zip(rooms, plain):
        for _ in range(draws):
            kind = depth.sample_sensor(rng)
            sensor.append(depth_rows(depth.sensor_depth(z, kind, depth.sensor_noise(rng, *z.shape, kind), albedo=albedo.mean(-1)), stored))
            networks.append(depth_rows(depth.network_depth(z, depth.sample_network(rng), depth.network_noise(rng)), stored))
            masks += [mask_rows(depth.ragged_mask(m.astype(float), depth.sample_mask(rng), depth.mask_noise(rng)) > 0, stored) for m in drawn]
    table(
        {
            "photos": [depth_rows(shrunk(z), reduced(stored)) for stored, z, _ in photos],
            "clean": [depth_rows(z, p) for (_, z, *_), p in zip(rooms, plain)],
            "sensors": sensor,
            "networks": networks,
        }
    )
    print()
    table(
        {
            "photos": [mask_rows(shrunk(m), reduced(stored)) for stored, _, drawn in photos for m in drawn],
            "clean": [mask_rows(m, p) for room, p in zip(rooms, plain) for m in room[2]],
            "ragged": masks,
        }
    )
    print("\nmodel.FITTED: median, standard deviation of the logarithm, range")
    for name, constants in model.FITTED.items():
        print(f"{name:46s}" + "".join(f"{c:10.5f}" for c in constants))
    for thing in (depth.DepthSensor(), depth.DepthNetwork(), depth.MaskFlaws()):
        print(type(thing).__name__, asdict(thing))
    if sheet:
        shown = Image.new("RGB", (320 * len(photos), 240 * 4))
        for row, pictures in enumerate(([stored for stored, *_ in photos], plain, taken[::draws], taken[1::draws])):
            for column, picture in enumerate(pictures):
                shown.paste(Image.fromarray(picture).resize((320, 240)), (320 * column, 240 * row))
        shown.save(sheet)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("photos", type=Path)
    parser.add_argument("truth", type=Path)
    parser.add_argument("--draws", type=int, default=4)
    parser.add_argument("--sheet")
    a = parser.parse_args()
    main(a.photos, a.truth, a.draws, a.sheet)
