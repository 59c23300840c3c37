"""A second opinion on held-out rooms, by Blender's Cycles: rooms/second.py FOLDER... [--assets .cache/assets] [--spp 256]

Runs in an environment with PyPI `bpy`; the furniture is read by our own code, all else is Blender's. Both renderers see the rooms as plain.py gives them;
`matte.py` makes Mitsuba's picture first. Writes FOLDER/cycles.npz and prints the ratio of 8 x 8 block medians."""

import bpy
import numpy as np
import plain  # (its import of layout.py makes that of shapes.py possible)
import shapes
from mathutils import Matrix

WIDTH, HEIGHT, BOUNCES = 320, 240, 6


def material(name, build):
    m = bpy.data.materials.new(name)
    m.use_nodes = True
    m.node_tree.nodes.clear()
    out = m.node_tree.nodes.new("ShaderNodeOutputMaterial")
    m.node_tree.links.new(build(m.node_tree), out.inputs["Surface"])
    return m


def add_mesh(name, points, faces, matter, colors=None, normals=None):
    data = bpy.data.meshes.new(name)
    data.vertices.add(len(points))
    data.vertices.foreach_set("co", np.ascontiguousarray(points, np.float32).ravel())
    data.loops.add(3 * len(faces))
    data.loops.foreach_set("vertex_index", np.ascontiguousarray(faces, np.int32).ravel())
    data.polygons.add(len(faces))
    data.polygons.foreach_set("loop_start", np.arange(0, 3 * len(faces), 3, dtype=np.int32))
    if colors is not None:
        layer = data.attributes.new("albedo", "FLOAT_COLOR", "CORNER")
        layer.data.foreach_set("color", np.repeat(np.concatenate([colors, np.ones((len(faces), 1))], 1), 3, 0).astype(np.float32).ravel())
    data.update()
    if normals is not None:
        data.shade_smooth()
        data.normals_split_custom_set_from_vertices(np.asarray(normals, float).tolist())
    data.materials.append(matter)
    bpy.context.scene.collection.objects.link(bpy.data.objects.new(name, data))


def painted(tree):
    node, color = tree.nodes.new("ShaderNodeBsdfDiffuse"), tree.nodes.new("ShaderNodeAttribute")
    color.attribute_name = "albedo"
    tree.links.new(color.outputs["Color"], node.inputs["Color"])
    return node.outputs[0]


def emission(radiance, albedo):
    """Front side: emits and reflects."""

    def build(tree):
        new = lambda kind: tree.nodes.new("ShaderNode" + kind)
        shine, diffuse, both, side, mix = new("Emission"), new("BsdfDiffuse"), new("AddShader"), new("NewGeometry"), new("MixShader")
        scale = float(max(radiance)) or 1.0
        shine.inputs["Color"].default_value = (*(float(c) / scale for c in radiance), 1.0)
        shine.inputs["Strength"].default_value = scale
        diffuse.inputs["Color"].default_value = (*albedo, 1.0)
        tree.links.new(shine.outputs[0], both.inputs[0])
        tree.links.new(diffuse.outputs[0], both.inputs[1])
        tree.links.new(side.outputs["Backfacing"], mix.inputs[0])
        tree.links.new(both.outputs[0], mix.inputs[1])
        tree.links.new(diffuse.outputs[0], mix.inputs[2])
        return mix.outputs[0]

    return build


def surroundings(lobes):
    """Sum of w exp(-bandwidth |d - l|^2 / 2), l from the eye through the pane; 4 % of diffuse glass besides."""

    def build(tree):
        new = lambda kind: tree.nodes.new("ShaderNode" + kind)
        diffuse, place, total = new("BsdfDiffuse"), new("NewGeometry"), None
        diffuse.inputs["Color"].default_value = (0.04, 0.04, 0.04, 1.0)
        total = diffuse.outputs[0]
        for _, direction, bandwidth, radiance in lobes:
            # Incoming points to the eye: d - l = d + incoming.
            difference, square, times, power, scale, shine, both = (
                new(k) for k in ("VectorMath", "VectorMath", "Math", "Math", "Math", "Emission", "AddShader")
            )
            difference.operation, square.operation, times.operation, power.operation, scale.operation = (
                "ADD",
                "DOT_PRODUCT",
                "MULTIPLY",
                "EXPONENT",
                "MULTIPLY",
            )
            d = np.asarray(direction, float) / np.linalg.norm(direction)
            difference.inputs[1].default_value = tuple(d)
            times.inputs[1].default_value = -0.5 * float(bandwidth)
            top = float(max(radiance)) or 1.0
            scale.inputs[1].default_value = top
            shine.inputs["Color"].default_value = (*(float(c) / top for c in radiance), 1.0)
            for a, b in (
                (place.outputs["Incoming"], difference.inputs[0]),
                (difference.outputs["Vector"], square.inputs[0]),
                (difference.outputs["Vector"], square.inputs[1]),
                (square.outputs["Value"], times.inputs[0]),
                (times.outputs[0], power.inputs[0]),
                (power.outputs[0], scale.inputs[0]),
                (scale.outputs[0], shine.inputs["Strength"]),
                (shine.outputs[0], both.inputs[0]),
                (total, both.inputs[1]),
            ):
                tree.links.new(a, b)
            total = both.outputs[0]
        return total

    return build


def lamp_mesh(lamp):
    """Points, faces, normals or None."""
    place = lamp.place
    if lamp.kind == "Sphere":
        points, normals, _, faces = shapes.ball((0, 0, 0), 1.0, 96)
        return np.asarray(place["center"]) + place["radius"] * points, faces, normals
    if lamp.kind == "Rect":
        c, x, y = (np.asarray(place[k], float) for k in ("center", "half_x", "half_y"))
        return np.array([c - x - y, c + x - y, c + x + y, c - x + y]), np.array([[0, 1, 2], [0, 2, 3]]), None
    return *lamp.mesh(), None


def render(folder, facts, room, spp):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    c = scene.cycles
    c.device, c.max_bounces, c.diffuse_bounces, c.glossy_bounces = "CPU", BOUNCES, BOUNCES, BOUNCES
    c.light_sampling_threshold, c.sample_clamp_direct, c.sample_clamp_indirect, c.use_adaptive_sampling, c.use_denoising = 0.0, 0.0, 0.0, False, False
    c.samples, c.pixel_filter_type = spp, "BOX"
    scene.render.threads_mode, scene.render.threads = "FIXED", 2
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = WIDTH, HEIGHT, 100
    scene.world = bpy.data.worlds.new("dark")
    scene.world.use_nodes = True
    scene.world.node_tree.nodes["Background"].inputs["Strength"].default_value = 0.0

    paint = material("paint", painted)
    points, normals, faces, albedo, _ = room.merged()
    corners = points[faces]
    facing = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    # Cycles takes no light where the winding contradicts the normals, Mitsuba's two-sided materials do not mind; and faces without area spoil the normals
    # that Blender gives to their neighbors.
    contrary, solid = (facing * normals[faces].sum(1)).sum(1) < 0, np.linalg.norm(facing, axis=1) > 1e-9
    faces, albedo = np.where(contrary[:, None], faces[:, ::-1], faces)[solid], albedo[solid]
    add_mesh("room", points, faces, paint, albedo, normals)
    names = facts["names"]
    for k, lamp in enumerate(room.lamps):
        p, f, n = lamp_mesh(lamp)
        add_mesh(f"lamp{k}", p, f, material(f"lamp{k}", emission(lamp.radiance if f"lamp{k}" in names else (0, 0, 0), (0.7, 0.66, 0.58))), None, n)
    for k, w in enumerate(room.windows):
        corners = [w.center - w.half_x - w.half_y, w.center + w.half_x - w.half_y, w.center + w.half_x + w.half_y, w.center - w.half_x + w.half_y]
        add_mesh(
            f"window{k}",
            np.array(corners),
            np.array([[0, 1, 2], [0, 2, 3]]),
            material(f"window{k}", surroundings(w.lobes if f"window{k}" in names else [])),
        )

    camera = bpy.data.cameras.new("camera")
    camera.sensor_fit, camera.angle, camera.clip_start = "HORIZONTAL", np.radians(facts["view"]["fov_x"]), 0.01
    body = bpy.data.objects.new("camera", camera)
    frame = np.eye(4)
    frame[:3, :3], frame[:3, 3] = np.array(facts["view"]["turn"]).T, facts["view"]["origin"]
    body.matrix_world = Matrix(frame.tolist())
    scene.collection.objects.link(body)
    scene.camera = body
    scene.render.image_settings.file_format, scene.render.image_settings.color_depth = "OPEN_EXR", "32"
    scene.view_settings.view_transform = "Raw"
    scene.render.filepath = str(folder / "cycles.exr")
    bpy.ops.render.render(write_still=True)
    image = bpy.data.images.load(str(folder / "cycles.exr"))
    pixels = np.empty(WIDTH * HEIGHT * 4, np.float32)
    image.pixels.foreach_get(pixels)
    (folder / "cycles.exr").unlink()
    return pixels.reshape(HEIGHT, WIDTH, 4)[::-1, :, :3] * np.array(facts["gain"])


def blocks(x):
    """Medians of 8 x 8 blocks of a picture."""
    return np.median(x.reshape(HEIGHT // 8, 8, WIDTH // 8, 8, 3).transpose(0, 2, 1, 3, 4).reshape(HEIGHT // 8, WIDTH // 8, 64, 3), 2)


if __name__ == "__main__":
    for folder, facts, room, spp in plain.rooms(__doc__):
        picture = render(folder, facts, room, spp)
        np.savez_compressed(folder / "cycles.npz", matte=picture.astype(np.float32))
        a, b = blocks(picture), blocks(np.load(folder / "matte.npz")["matte"])
        bright = b > 0.02 * b.mean()
        ratio = a[bright] / b[bright]
        low, middle, high = np.percentile(ratio, (25, 50, 75))
        print(f"{folder}: Cycles / Mitsuba {middle:.4f}, middle half {low:.4f} to {high:.4f}, sum {a.sum() / b.sum():.4f}", flush=True)
