"""The folder of a scene whose truth is known, as the program reads it."""

import json

import numpy as np


def write(folder, fov_x, photo, depth, albedo, masks, lights):
    """photo.exr, depth.exr, albedo.exr, masks/ID.png, lights.json, scene.ron. Pictures are [h, w, 3], depth [h, w]; masks {id: [h, w]}, not zero where a
    light is seen; lights as in docs/planes.md."""
    import OpenEXR
    from PIL import Image

    exr = lambda name, **channels: OpenEXR.File(
        {"type": OpenEXR.scanlineimage, "compression": OpenEXR.ZIP_COMPRESSION}, {k: np.ascontiguousarray(v, np.float32) for k, v in channels.items()}
    ).write(str(folder / name))
    exr("photo.exr", RGB=photo)
    exr("depth.exr", Z=depth)
    exr("albedo.exr", RGB=albedo)
    (folder / "masks").mkdir(exist_ok=True)
    entries = []
    for name, mask in masks.items():
        Image.fromarray((mask != 0).astype(np.uint8) * 255).save(folder / "masks" / f"{name}.png")
        entries.append(f'"{name}": {"Window" if lights[name]["kind"] == "Window" else "Lamp"}(mask: "masks/{name}.png")')
    (folder / "scene.ron").write_text(
        f'Scene(version: 1, photo: "photo.exr", transfer: Linear, camera: FovX({fov_x}),\n'
        f'    depth: (path: "depth.exr", kind: PlanarZ, scale: 1.0), lights: {{ {", ".join(entries)} }},\n'
        f'    truth: (lights: "lights.json", albedo: "albedo.exr"))\n'
    )
    (folder / "lights.json").write_text(json.dumps(lights))
