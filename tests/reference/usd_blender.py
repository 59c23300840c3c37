"""An exported room in Blender against ours: the direct light of one lamp, shadows and all.

python usd_blender.py ROOM.usda PICTURE.exr LIGHT [SAMPLES [PAIR.png]]

ROOM.usda is what `relight export` wrote, PICTURE.exr what `relight run` wrote for the same graph, edit and scene. Every surface is made white and every light but
one dark, so that without bounces the camera sees irradiance / pi times radiance: the layer `direct_LIGHT`.
"""

import os
import sys
import tempfile

import bpy
import numpy as np
import OpenEXR

room, picture, light = sys.argv[1:4]
samples = int(sys.argv[4]) if len(sys.argv) > 4 else 256

layers = OpenEXR.File(picture, separate_channels=True).channels()
ours = np.stack([layers[f"direct_{light}.{c}"].pixels for c in "RGB"], -1).astype(float)
height, width = ours.shape[:2]

bpy.ops.wm.read_factory_settings(use_empty=True)
bpy.ops.wm.usd_import(filepath=room)
scene = bpy.context.scene
scene.camera = next(o for o in scene.objects if o.type == "CAMERA")
lights = [o for o in scene.objects if o.type == "LIGHT"]
for other in lights:
    other.hide_render = not (other.name == light or other.name.startswith(light + "_"))
print("burning:", [(o.name, o.data.type) for o in lights if not o.hide_render], file=sys.stderr)
for data in (o.data for o in lights):
    # What UsdLux says; Blender 4.5 takes a DistantLight in four times as strong and twice as wide, and softens spheres nearby.
    if data.type == "SUN":
        data.energy /= 4
        data.angle /= 2
    if data.type == "POINT":
        data.use_soft_falloff = False
white = bpy.data.materials.new("white")
white.use_nodes = True
white.node_tree.nodes.clear()
diffuse = white.node_tree.nodes.new("ShaderNodeBsdfDiffuse")
diffuse.inputs["Color"].default_value = (1, 1, 1, 1)
end = white.node_tree.nodes.new("ShaderNodeOutputMaterial")
white.node_tree.links.new(diffuse.outputs[0], end.inputs[0])
scene.view_layers[0].material_override = white
scene.render.engine = "CYCLES"
scene.cycles.samples, scene.cycles.max_bounces = samples, 0
scene.cycles.use_denoising, scene.cycles.use_adaptive_sampling, scene.cycles.pixel_filter_type = False, False, "BOX"
scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = width, height, 100
scene.view_settings.view_transform = "Raw"
scene.render.film_transparent = True
scene.render.image_settings.file_format, scene.render.image_settings.color_depth = "OPEN_EXR", "32"
scene.render.filepath = os.path.join(tempfile.mkdtemp(), "blender.exr")
bpy.ops.render.render(write_still=True)
seen = OpenEXR.File(scene.render.filepath, separate_channels=True).channels()
theirs = np.stack([seen[c].pixels for c in "RGB"], -1).astype(float)
surface = np.asarray(seen["A"].pixels) > 0.999

# Where both see a surface; the light's own pixels show other things.
mask = surface & (ours.max(-1) > 0)
glow = theirs.max(-1) > 20 * np.median(theirs.max(-1)[mask])
mask &= ~glow
a, b = ours[mask].mean(-1), theirs[mask].mean(-1)
off = np.abs(a - b) / a.mean()
both = (a > 0.1 * a.mean()) & (b > 0.1 * a.mean())
quarter, half, three = np.percentile(b[both] / a[both], (25, 50, 75))
print(f"{light}: {mask.sum()} pixels, ours {a.mean():.4f}, Blender's {b.mean():.4f}: bias {b.mean() / a.mean() - 1:+.2%}, "
      f"mean difference {off.mean():.2%} of the mean, median {np.median(off):.2%}; where both are lit, ratio {half:.4f}, "
      f"quartiles {quarter:.3f} and {three:.3f}", file=sys.stderr)
if len(sys.argv) > 5:
    from PIL import Image

    pair = np.concatenate([ours, np.where(np.isfinite(theirs), theirs, 0)], 1)
    Image.fromarray((255 * np.clip(pair / (3 * a.mean()), 0, 1) ** (1 / 2.2)).astype(np.uint8)).save(sys.argv[5])
