"""Irradiance / pi at the receivers by Blender's Cycles: its lights, its sampling, Embree's rays. Writes cycles.npy and cycles.json.

Each receiver is a white square of 0.2 mm whose texture is one pixel; "bake diffuse, direct light only" then gives irradiance / pi
there. Squares cast no shadow. A sphere is a `POINT` light with a radius, a rectangle an `AREA` light, boxes and meshes are
emitting triangles. A window's lobe is a world of shader nodes, exp(-bandwidth |direction - lobe|^2 / 2), behind the hole of a
closed box, with a portal in the hole.
"""

import bpy
import numpy as np

import common

BATCHES, SPP = 8, 512
HALF = 1e-4


def clear():
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    c = scene.cycles
    c.device, c.max_bounces, c.diffuse_bounces = "CPU", 0, 0
    # What would bias: small lights dropped, bright samples clamped, early stop, blurred light.
    c.light_sampling_threshold, c.sample_clamp_direct, c.use_adaptive_sampling, c.use_denoising = 0.0, 0.0, False, False
    c.samples = SPP
    scene.render.threads_mode, scene.render.threads = "FIXED", 2
    scene.render.bake.margin = 0
    return scene


def material(name, build):
    m = bpy.data.materials.new(name)
    m.use_nodes = True
    m.node_tree.nodes.clear()
    out = m.node_tree.nodes.new("ShaderNodeOutputMaterial")
    m.node_tree.links.new(build(m.node_tree), out.inputs["Surface"])
    return m


def diffuse(value):
    def build(tree):
        node = tree.nodes.new("ShaderNodeBsdfDiffuse")
        node.inputs["Color"].default_value = (value, value, value, 1.0)
        return node.outputs[0]

    return build


def front_emission(tree):
    """Radiance 1 from the side of the normal."""
    emission, geometry, front = (tree.nodes.new("ShaderNode" + n) for n in ("Emission", "NewGeometry", "Math"))
    front.operation = "SUBTRACT"
    front.inputs[0].default_value = 1.0
    tree.links.new(geometry.outputs["Backfacing"], front.inputs[1])
    tree.links.new(front.outputs[0], emission.inputs["Strength"])
    return emission.outputs[0]


def add(scene, name, data):
    o = bpy.data.objects.new(name, data)
    scene.collection.objects.link(o)
    return o


def add_mesh(scene, name, corners, faces, build):
    data = bpy.data.meshes.new(name)
    data.from_pydata([tuple(map(float, c)) for c in corners], [], [tuple(map(int, f)) for f in faces])
    data.materials.append(material(name, build))
    return add(scene, name, data)


def add_area(scene, v):
    """A one-sided rectangular light; it shines along its own -z. Radiance = power / (pi area)."""
    from mathutils import Matrix

    center, x, y = (np.array(v[k], float) for k in ("center", "x", "y"))
    light = bpy.data.lights.new("area", "AREA")
    light.shape, light.size, light.size_y = "RECTANGLE", 2 * np.linalg.norm(x), 2 * np.linalg.norm(y)
    light.energy = np.pi * light.size * light.size_y
    o = add(scene, "area", light)
    ex, ey = common.unit(x), common.unit(y)
    # Its -z is x cross y: mirror one edge.
    frame = np.eye(4)
    frame[:3] = np.stack([ex, -ey, np.cross(ex, -ey), center], 1)
    o.matrix_world = Matrix(frame.tolist())
    return o


def add_world(scene, lobe):
    world = bpy.data.worlds.new("lobe")
    scene.world = world
    world.use_nodes = True
    tree = world.node_tree
    tree.nodes.clear()
    new = lambda kind: tree.nodes.new("ShaderNode" + kind)
    place, difference, square, times, power = new("TexCoord"), new("VectorMath"), new("VectorMath"), new("Math"), new("Math")
    background, out = new("Background"), new("OutputWorld")
    difference.operation, square.operation, times.operation, power.operation = "SUBTRACT", "DOT_PRODUCT", "MULTIPLY", "EXPONENT"
    difference.inputs[1].default_value = tuple(common.unit(lobe["direction"]))
    times.inputs[1].default_value = -0.5 * lobe["bandwidth"]
    for a, b in (
        (place.outputs["Generated"], difference.inputs[0]),
        (difference.outputs["Vector"], square.inputs[0]),
        (difference.outputs["Vector"], square.inputs[1]),
        (square.outputs["Value"], times.inputs[0]),
        (times.outputs[0], power.inputs[0]),
        (power.outputs[0], background.inputs["Strength"]),
        (background.outputs[0], out.inputs["Surface"]),
    ):
        tree.links.new(a, b)
    background.inputs["Color"].default_value = (1.0, 1.0, 1.0, 1.0)
    world.cycles.sampling_method = "MANUAL"
    world.cycles.sample_map_resolution = 4096 if lobe["bandwidth"] > 2e3 else 1024


def add_receivers(scene, s):
    """One square per receiver, its texture coordinates around the center of its pixel."""
    count = len(s.receivers)
    corners, uv = [], []
    for i, (p, n) in enumerate(zip(s.receivers.astype(float), s.normals.astype(float))):
        a = common.unit(np.cross(n, [0.2, 0.9, 0.1])) * HALF
        b = np.cross(n, a)
        corners += [p - a - b, p + a - b, p + a + b, p - a + b]
        uv += [(i / count, 0.0), ((i + 1) / count, 0.0), ((i + 1) / count, 1.0), (i / count, 1.0)]
    o = add_mesh(scene, "receivers", corners, np.arange(4 * count).reshape(-1, 4), diffuse(1.0))
    o.data.uv_layers.new(name="uv").data.foreach_set("uv", np.ravel(uv))
    o.visible_shadow = False
    image = bpy.data.images.new("baked", count, 1, alpha=False, float_buffer=True)
    image.colorspace_settings.name = "Non-Color"
    nodes = o.data.materials[0].node_tree.nodes
    node = nodes.new("ShaderNodeTexImage")
    node.image = image
    nodes.active = node
    bpy.context.view_layer.objects.active = o
    o.select_set(True)
    return image


def build(s, light, lobe, blocked):
    scene = clear()
    if lobe is None:
        lamp = light["shape"]["Lamp"]
        if "Sphere" in lamp:
            v = lamp["Sphere"]
            point = bpy.data.lights.new("sphere", "POINT")
            point.shadow_soft_size, point.use_soft_falloff = v["radius"], False
            point.energy = 4.0 * np.pi ** 2 * v["radius"] ** 2
            add(scene, "sphere", point).location = v["center"]
        elif "Rect" in lamp:
            add_area(scene, lamp["Rect"])
        else:
            add_mesh(scene, "lamp", *common.lamp_mesh(lamp), front_emission)
    else:
        window = light["shape"]["Window"]
        add_world(scene, lobe)
        add_mesh(scene, "walls", *common.opening(window), diffuse(0.0))
        add_area(scene, window).data.cycles.is_portal = True
    if blocked:
        add_mesh(scene, "room", s.corners, s.triangles, diffuse(0.0))
    return scene, add_receivers(scene, s)


def irradiance(s, light, lobe, blocked):
    scene, image = build(s, light, lobe, blocked)
    values = np.empty(4 * len(s.receivers), np.float32)
    batches = []
    for seed in range(BATCHES):
        scene.cycles.seed = 1000 + seed
        bpy.ops.object.bake(type="DIFFUSE", pass_filter={"DIRECT"}, target="IMAGE_TEXTURES", use_clear=True)
        image.pixels.foreach_get(values)
        batches.append(values[::4].astype(float))
    return np.array(batches)


how = f"bake of diffuse direct light, {BATCHES} seeds of {SPP} samples a receiver"
common.run("cycles", f"Blender {bpy.app.version_string}, Cycles", how, irradiance)
