"""The folder of a scene whose truth is known, as the program reads it."""

import json

import numpy as np

from color import srgb


def exr(path, **channels):
    """A picture of 32-bit floats."""
    import OpenEXR

    header = {"type": OpenEXR.scanlineimage, "compression": OpenEXR.ZIP_COMPRESSION}
    OpenEXR.File(header, {k: np.ascontiguousarray(v, np.float32) for k, v in channels.items()}).write(str(path))


def save_mask(path, mask):
    """255 where `mask` [h, w] is not zero."""
    from PIL import Image

    Image.fromarray((mask != 0).astype(np.uint8) * 255).save(path)


def stored(linear):
    """8-bit sRGB of a linear picture, clipped at 1."""
    return (srgb(linear) * 255 + 0.5).astype(np.uint8)


def write(folder, fov_x, photo, depth, albedo, masks, lights, normal=None, pictures={}, edits={}, true_depth=None):
    """photo.exr, depth.exr, albedo.exr, masks/ID.png, lights.json, scene.ron. Pictures are [h, w, 3], depth [h, w]; masks {id: [h, w]}, not zero where a
    light is seen, windows by their name; lights as in docs/planes.md, None when not all are known. More truth, for `relight eval`: `normal`, pictures
    {id: linear picture by this light alone}, edits {name: (text of the edit file, linear true picture)}, `true_depth` where `depth` is a sensor's. A photo of
    bytes is a PNG in sRGB, as cameras give it; one of floats is linear."""
    from PIL import Image

    exr(folder / "depth.exr", Z=depth)
    exr(folder / "albedo.exr", RGB=albedo)
    truth = ['albedo: "albedo.exr"']
    encoded = photo.dtype == np.uint8
    if encoded:
        Image.fromarray(photo).save(folder / "photo.png")
    else:
        exr(folder / "photo.exr", RGB=photo)
    (folder / "masks").mkdir(exist_ok=True)
    entries = []
    for name, mask in masks.items():
        save_mask(folder / "masks" / f"{name}.png", mask)
        entries.append(f'"{name}": {"Window" if name.startswith("window") else "Lamp"}(mask: "masks/{name}.png")')
    if lights is not None:
        (folder / "lights.json").write_text(json.dumps(lights))
        truth.append('lights: "lights.json"')
    if normal is not None:
        exr(folder / "normal.exr", RGB=normal)
        truth.append('normal: "normal.exr"')
    if true_depth is not None:
        exr(folder / "true_depth.exr", Z=true_depth)
        truth.append('depth: "true_depth.exr"')
    for name, there in {"truth": pictures or edits, "edits": edits}.items():
        if there:
            (folder / name).mkdir(exist_ok=True)
    for name, picture in pictures.items():
        exr(folder / f"truth/light_{name}.exr", RGB=picture)
    for name, (text, picture) in edits.items():
        (folder / "edits" / f"{name}.ron").write_text(text)
        exr(folder / f"truth/{name}.exr", RGB=picture)
    listed = lambda files: "{ " + ", ".join(f'"{name}": "{file}"' for name, file in files.items()) + " }"
    if pictures:
        truth.append("pictures: " + listed({name: f"truth/light_{name}.exr" for name in pictures}))
    if edits:
        truth.append("edits: " + listed({f"edits/{name}.ron": f"truth/{name}.exr" for name in edits}))
    photo_file = '"photo.png", transfer: Srgb' if encoded else '"photo.exr", transfer: Linear'
    (folder / "scene.ron").write_text(
        f"Scene(version: 1, photo: {photo_file}, camera: FovX({fov_x}),\n"
        f'    depth: (path: "depth.exr", kind: PlanarZ, scale: 1.0), lights: {{ {", ".join(entries)} }},\n'
        f"    truth: ({', '.join(truth)}))\n"
    )
