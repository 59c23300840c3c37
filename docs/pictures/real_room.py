"""Cuts a photograph with depth and masks from a panorama of a real room: real_room.py lebombo_1k.hdr FOLDER

The panorama is Greg Zaal's "Lebombo" (https://polyhaven.com/a/lebombo, CC0), 1024 x 512. The cut is
exposed as a camera would expose it: white clips. The room is nearly empty, so that its depth is that
of five planes, fitted to the lines where floor and walls meet; the camera stands 1.5 m high.
"""
import sys
from pathlib import Path

import mitsuba as mi
import numpy as np
import OpenEXR
from PIL import Image, ImageDraw

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "training/rooms"))
from color import srgb  # noqa: E402

WIDTH, HEIGHT = 512, 384
FOV, YAW, PITCH = np.radians([90.0, 9.0, -9.0])
CAMERA_HEIGHT = 1.5  # m, assumed
EXPOSURE = 0.85
# Walls: azimuth of the outward normal in degrees, distance in meters.
WINDOW_WALL, ALCOVE = (26.66, 2.142), (-81.69, 2.563)
CURTAIN_GAP = 0.1  # m from the wall, assumed
# Outlines in pixels of the cut.
HEADER_OUTLINE = [(0, 0), (65.7, 0), (71.8, 83.8), (0, 65.3)]
GLOBES = [(215.3, 65.3, 11.5), (250.7, 60.9, 11.5)]
CURTAIN_OUTLINE = [(282, 14), (365, 0), (512, 0), (512, 332), (494, 341), (460, 316), (292, 304), (279, 285)]
WINDOW_OUTLINE = [(321, 45), (512, 25), (512, 322), (462, 314), (385, 302), (313, 297)]


def rays():
    """Directions in the panorama's frame (y up, -z ahead) with z = -1 in the camera's; [H, W, 3]."""
    focal = WIDTH / 2 / np.tan(FOV / 2)
    x, y = np.meshgrid(np.arange(WIDTH) + 0.5 - WIDTH / 2, np.arange(HEIGHT) + 0.5 - HEIGHT / 2)
    local = np.stack([x / focal, -y / focal, -np.ones_like(x)], -1)
    c, s = np.cos(PITCH), np.sin(PITCH)
    pitched = local @ np.array([[1, 0, 0], [0, c, -s], [0, s, c]]).T
    c, s = np.cos(YAW), np.sin(YAW)
    return pitched @ np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]]).T


def catmull_rom(position):
    """The four pixels around each position with their weights; [4, ...] each."""
    first = np.floor(position).astype(int)
    t = position - first
    weights = [-t + 2 * t**2 - t**3, 2 - 5 * t**2 + 3 * t**3, t + 4 * t**2 - 3 * t**3, t**3 - t**2]
    return np.stack([first + k for k in (-1, 0, 1, 2)]), np.stack(weights) / 2


def photo(panorama, directions):
    """The photograph, 8 bits in sRGB; [H, W, 3]."""
    unit = directions / np.linalg.norm(directions, axis=-1, keepdims=True)
    height, width, _ = panorama.shape
    column = (np.arctan2(unit[..., 0], -unit[..., 2]) / (2 * np.pi) + 0.5) * width - 0.5
    row = (0.5 - np.arcsin(unit[..., 1]) / np.pi) * height - 0.5
    rows, row_weights = catmull_rom(row)
    columns, column_weights = catmull_rom(column)
    taps = panorama[np.clip(rows, 0, height - 1)[:, None], columns[None] % width]
    linear = np.einsum("rhw,chw,rchwk->hwk", row_weights, column_weights, taps)
    return (srgb(linear * EXPOSURE) * 255 + 0.5).astype(np.uint8)


def mask(draw):
    """A mask of the cut, drawn at four times its size; [H, W], 0 to 255."""
    large = Image.new("L", (WIDTH * 4, HEIGHT * 4))
    draw(ImageDraw.Draw(large))
    return np.array(large.resize((WIDTH, HEIGHT), Image.BOX))


def polygon(outline):
    return mask(lambda pen: pen.polygon([(x * 4, y * 4) for x, y in outline], fill=255))


def depth(directions):
    """Planar z in meters; [H, W]. Since camera rays have z = -1, it is the ray's parameter."""

    def wall(azimuth, distance):
        azimuth = np.radians(azimuth)
        toward = directions[..., 0] * np.sin(azimuth) - directions[..., 2] * np.cos(azimuth)
        return np.where(toward > 1e-6, distance / np.maximum(toward, 1e-6), np.inf)

    floor = np.where(directions[..., 1] < -1e-6, CAMERA_HEIGHT / np.maximum(-directions[..., 1], 1e-6), np.inf)
    azimuth, distance = WINDOW_WALL
    window_wall = wall(azimuth, distance)
    curtain = np.where(polygon(CURTAIN_OUTLINE) > 127, wall(azimuth, distance - CURTAIN_GAP), np.inf)
    z = np.minimum.reduce([window_wall, wall(*ALCOVE), floor, curtain])
    # The wall above the alcove is at right angles to the window's, and meets it in this pixel.
    column, row = map(int, HEADER_OUTLINE[2])
    side = np.radians(azimuth - 90)
    edge = directions[row, column] * window_wall[row, column]
    header = wall(azimuth - 90, edge[0] * np.sin(side) - edge[2] * np.cos(side))
    return np.where(polygon(HEADER_OUTLINE) > 127, header, z).astype(np.float32)


def main():
    source, folder = sys.argv[1], Path(sys.argv[2])
    (folder / "masks").mkdir(parents=True, exist_ok=True)
    mi.set_variant("scalar_rgb")
    panorama = np.array(mi.Bitmap(source).convert(mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.Float32, False))
    directions = rays()
    Image.fromarray(photo(panorama, directions)).save(folder / "photo.png")
    header = {"compression": OpenEXR.ZIPS_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, {"Y": depth(directions)}).write(str(folder / "depth.exr"))
    globes = mask(lambda pen: [pen.ellipse([(x - r) * 4, (y - r) * 4, (x + r) * 4, (y + r) * 4], fill=255) for x, y, r in GLOBES])
    Image.fromarray(globes).save(folder / "masks" / "lamp_0.png")
    Image.fromarray(polygon(WINDOW_OUTLINE)).save(folder / "masks" / "window_0.png")


if __name__ == "__main__":
    main()
