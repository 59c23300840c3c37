"""Names in scene.ron what truth.npz knows of a made room, for `relight eval`: normals, roughness, each light's direct light, per-pixel lighting.

usage: known.py ROOM .."""

import sys
from pathlib import Path

import numpy as np

from folder import exr


def direct_shading(truth):
    """Returns {light: its direct light, shadows included, irradiance / pi [h, w, 3]} of the content of a truth.npz."""
    shading = {}
    for source, radiance, direct, shadow in zip(*(truth[k] for k in ("sources", "source_radiance", "direct", "shadow"))):
        light = str(source).split(".")[0]
        shading[light] = shading.get(light, 0) + (direct.astype(np.float32) * shadow)[..., None] * radiance
    return shading


def main(room):
    truth, text = np.load(room / "truth.npz"), (room / "scene.ron").read_text()
    if "direct:" in text:
        return
    exr(room / "normal.exr", RGB=truth["normal"])
    exr(room / "roughness.exr", Y=truth["rough"])
    shading = direct_shading(truth)
    for light, picture in shading.items():
        exr(room / f"direct_{light}.exr", RGB=picture)
    lighting = ""
    if "maps" in truth:
        maps = truth["maps"].astype(np.float32)
        maps[truth["maps_valid"] == 0] = np.nan
        np.save(room / "maps.npy", maps)
        lighting = 'lighting: "maps.npy", '
    direct = ", ".join(f'"{light}": "direct_{light}.exr"' for light in shading)
    more = f'normal: "normal.exr", roughness: "roughness.exr", {lighting}direct: {{ {direct} }}'
    (room / "scene.ron").write_text(text.replace('albedo: "albedo.exr"', f'albedo: "albedo.exr", {more}'))


if __name__ == "__main__":
    if len(sys.argv) < 2:
        sys.exit(__doc__)
    for name in sys.argv[1:]:
        main(Path(name))
