"""A room of relight in Blender, and the lights that were changed there as an edit file.

relight's space is the camera's: x right, y up, looking along -z, in meters. Blender has z up: (x, y, z) of relight is (x, -z, y) here.
Radiances are linear Rec.709 in units of the photo: 1 is the photo's white.
"""

import json
import math
import os
import re

import bpy
from mathutils import Vector

# Custom property of a light: JSON of its name in relight, and of what it was when it was imported.
LIGHT = "relight_light"
# Custom property of the scene: the names of all imported lights, for those that are deleted.
LIGHTS = "relight_lights"
NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*\Z")
RESERVED = {"inv_lamp", "inv_window", "rest"}
# Changes below these are those of rounding.
LEAST_MOVE = 1e-3  # meters
LEAST_CHANGE = 2e-3  # of the radiance


class RoomError(Exception):
    """A file or a scene that cannot be used; the text says what to do."""


def luminance(color):
    return 0.2126 * color[0] + 0.7152 * color[1] + 0.0722 * color[2]


def usd_lights(text):
    """The light prims of a room.usda by their names: the light that each is of, whether that is a window, and the numbers of its inputs."""
    lights = {}
    for prim, body in re.findall(r'def \w+Light "(\w+)"\s*\{(.*?)\n        \}', text, re.S):
        name = re.search(r'relight:light = "(\w+)"', body)
        numbers = dict(re.findall(r"float inputs:(\w+) = (\S+)", body))
        inputs = {key: float(value) for key, value in numbers.items()}
        lights[prim] = (name.group(1) if name else prim, "relight:bandwidth" in body, inputs)
    return lights


def energy_of(data, radiance):
    """Blender's `energy` of a light of this radiance: its power in watts, or the irradiance of a sun."""
    if data.type == "POINT":
        return radiance * 4 * math.pi**2 * data.shadow_soft_size**2
    if data.type == "AREA":
        return radiance * math.pi * area_of(data)
    return radiance


def area_of(data):
    height = data.size_y if data.shape in {"RECTANGLE", "ELLIPSE"} else data.size
    return data.size * height * (math.pi / 4 if data.shape in {"DISK", "ELLIPSE"} else 1)


def radiance_of(data):
    """Red, green and blue of the radiance of an emitter, or of the irradiance of a sun."""
    return [data.energy / energy_of(data, 1.0) * channel for channel in data.color]


def import_room(context, path, photo=""):
    """Imports `relight export --out NAME.usda`: camera, visible surface and lights; returns the new objects.

    The surface shows its albedo, which Cycles lights. The picture `photo`, or else picture.png or photo.* beside the file, is projected
    onto it as well: the node `Photo` of the material blends from 0, albedo, to 1, the photo as it is.
    """
    try:
        with open(path, encoding="utf-8") as file:
            text = file.read()
    except (OSError, UnicodeDecodeError) as error:
        raise RoomError(f"{path}: wanted a NAME.usda that `relight export` wrote: {error}") from error
    if 'doc = "made by relight' not in text:
        raise RoomError(f"{path}: wanted a NAME.usda that `relight export` wrote, got another file")
    before = set(context.scene.objects)
    bpy.ops.wm.usd_import(filepath=path)
    objects = [o for o in context.scene.objects if o not in before]
    described = usd_lights(text)
    names = set()
    for light in (o for o in objects if o.type == "LIGHT"):
        prim = light.name.split(".")[0]
        name, is_window, inputs = described.get(prim, (prim, False, {}))
        adjust(light.data, inputs)
        base = {"name": name, "object": light.name, "radiance": radiance_of(light.data), "place": list(light.matrix_world.translation), "window": is_window}
        light[LIGHT] = json.dumps(base)
        names.add(name)
    context.scene[LIGHTS] = json.dumps(sorted(names))
    set_camera(context.scene, objects)
    for surface in (o for o in objects if o.type == "MESH" and o.name.split(".")[0] == "Surface"):
        image = picture_beside(path, photo)
        if image:
            project(surface.data.materials[0], image)
            context.scene.render.resolution_x, context.scene.render.resolution_y = image.size
    return objects


def adjust(data, inputs):
    """Sets strength and size as USD has them: importers differ, Blender 4.5 takes a distant light four times as strong and twice as wide."""
    if data.type == "POINT":
        data.shadow_soft_size = inputs.get("radius", data.shadow_soft_size)
        data.use_soft_falloff = False
    elif data.type == "AREA":
        data.shape = "RECTANGLE"
        data.size, data.size_y = inputs.get("width", data.size), inputs.get("height", data.size_y)
    elif data.type == "SUN":
        data.angle = math.radians(inputs.get("angle", 0.0))
    if "intensity" in inputs:
        data.energy = energy_of(data, inputs["intensity"])


def set_camera(scene, objects):
    for camera in (o for o in objects if o.type == "CAMERA"):
        scene.camera = camera
    scene.render.engine = "CYCLES"
    scene.render.resolution_percentage = 100
    # The photo's own curve: relight's pictures are display-referred by sRGB alone.
    scene.view_settings.view_transform = "Standard"
    scene.view_settings.look = "None"


def picture_beside(path, photo):
    folder = os.path.dirname(os.path.abspath(path))
    for name in [photo] if photo else ["picture.png", "photo.png", "photo.jpg"]:
        file = os.path.join(folder, name)
        if os.path.isfile(file):
            return bpy.data.images.load(file, check_existing=True)
    if photo:
        raise RoomError(f"{photo}: wanted a picture to project, got no such file")
    return None


def project(material, image):
    """Blends the picture over the material; the surface's coordinates `st` are those of the photo."""
    nodes, links = material.node_tree.nodes, material.node_tree.links
    end = next(node for node in nodes if node.type == "OUTPUT_MATERIAL")
    lit = end.inputs["Surface"].links[0].from_socket
    place = nodes.new("ShaderNodeUVMap")
    place.uv_map = "st"
    picture = nodes.new("ShaderNodeTexImage")
    picture.image, picture.extension = image, "EXTEND"
    glow = nodes.new("ShaderNodeEmission")
    share = nodes.new("ShaderNodeValue")
    share.name = share.label = "Photo"
    share.outputs[0].default_value = 0.0
    blend = nodes.new("ShaderNodeMixShader")
    links.new(place.outputs[0], picture.inputs["Vector"])
    links.new(picture.outputs["Color"], glow.inputs["Color"])
    links.new(share.outputs[0], blend.inputs[0])
    links.new(lit, blend.inputs[1])
    links.new(glow.outputs[0], blend.inputs[2])
    links.new(blend.outputs[0], end.inputs["Surface"])


def relight_place(vector):
    return (vector.x, vector.z, -vector.y)


def number(value):
    return f"{round(value, 9) + 0.0:.6g}"


def triple(values):
    return "(" + ", ".join(number(value) for value in values) + ")"


def edit_text(scene):
    """The text of an edit file with the changes of the scene's lights since they were imported, and warnings of what it leaves out."""
    known = json.loads(scene.get(LIGHTS, "[]"))
    if not known:
        raise RoomError("wanted a scene with an imported room, got none: File > Import > relight room")
    warnings, parts = [], {name: [] for name in known}
    entries = []
    for light in (o for o in scene.objects if o.type == "LIGHT"):
        base = json.loads(light[LIGHT]) if LIGHT in light else None
        # A copy of an imported light has its property, too: it is a new light.
        if base and base["name"] in parts and base["object"] == light.name:
            parts[base["name"]].append((light, base))
        else:
            entries.append((light.name, inserted(light, warnings)))
    changes = [(name, changed(name, lights, warnings)) for name, lights in parts.items()]
    used = set(known) | RESERVED
    lines = [f'        "{name}": {change},' for name, change in changes if change]
    for name, change in entries:
        if change:
            name = unused(name, used)
            lines.append(f'        "{name}": {change},')
    body = "\n".join(lines)
    return f"Edit(\n    version: 1,\n    lights: {{\n{body}\n    }},\n)\n" if lines else "Edit(version: 1)\n", warnings


def unused(name, used):
    name = re.sub(r"[^A-Za-z0-9_]", "_", name)
    name = name if NAME.match(name) else "light_" + name
    free = name
    count = 2
    while free in used:
        free, count = f"{name}_{count}", count + 1
    used.add(free)
    return free


def changed(name, lights, warnings):
    """The change of an imported light, of which a box has six parts and a window may have a sun; None where nothing changed."""
    shown = [(light, base) for light, base in lights if not light.hide_render]
    if not shown:
        return "Off"
    before = [sum(base["radiance"][k] for _, base in lights) for k in range(3)]
    after = [sum(radiance_of(light.data)[k] for light, _ in shown) for k in range(3)]
    if luminance(after) <= 0:
        return "Off"
    found = []
    scale = luminance(after) / luminance(before)
    if abs(scale - 1) > LEAST_CHANGE:
        found.append(f"Scale({number(scale)})")
    if any(abs(a - scale * b) > LEAST_CHANGE * luminance(after) for a, b in zip(after, before)):
        found.append(f"Color{triple(channel / max(after) for channel in after)}")
    light, base = lights[0]
    moved = Vector(light.matrix_world.translation) - Vector(base["place"])
    if light.data.type != "SUN" and moved.length > LEAST_MOVE:
        if base["window"]:
            warnings.append(f"{name}: a window does not move; its move is left out")
        else:
            found.append(f"Move(by: {triple(relight_place(moved))})")
    if not found:
        return None
    return found[0] if len(found) == 1 else "[" + ", ".join(found) + "]"


def inserted(light, warnings):
    """A new light as a lamp; None for one that relight does not have."""
    data = light.data
    if light.hide_render or data.energy <= 0:
        return None
    at = f"at: Point{triple(relight_place(light.matrix_world.translation))}"
    if data.type == "POINT" and data.shadow_soft_size > 0:
        shape = f"Sphere(radius: {number(data.shadow_soft_size)})"
    elif data.type == "AREA":
        height = data.size_y if data.shape in {"RECTANGLE", "ELLIPSE"} else data.size
        turn = light.matrix_world.to_3x3().normalized()
        normal = relight_place(turn @ Vector((0, 0, -1)))
        shape = f"Rect(half: ({number(data.size / 2)}, {number(height / 2)}), normal: {triple(normal)})"
        if data.shape in {"DISK", "ELLIPSE"}:
            warnings.append(f"{light.name}: a round area light becomes a rectangle of its size")
    else:
        warnings.append(f"{light.name}: wanted a point light with a radius or an area light, got {data.type}; it is left out")
        return None
    return f"Lamp(shape: {shape}, {at}, radiance: {triple(radiance_of(data))})"
