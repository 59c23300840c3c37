"""The add-on in Blender without a window; `RELIGHT` names the program, built by `cargo build --release`.

python -m pytest blender
"""

import os
import pathlib
import re
import subprocess
import sys

import bpy
import pytest

HERE = pathlib.Path(__file__).resolve().parent
ROOT = HERE.parent
RELIGHT = os.environ.get("RELIGHT", str(ROOT / "target/release/relight"))
sys.path.insert(0, str(HERE))
import relight_room  # noqa: E402
from relight_room import room  # noqa: E402

GRAPH = str(ROOT / "graphs/demo.ron")


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    folder = tmp_path_factory.mktemp("room")
    subprocess.run([RELIGHT, "run", GRAPH, "--out", str(folder)], check=True, capture_output=True)
    subprocess.run([RELIGHT, "export", GRAPH, "--out", str(folder / "room.usda")], check=True, capture_output=True)
    return folder


@pytest.fixture
def scene(exported):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    relight_room.register()
    bpy.ops.import_scene.relight_room(filepath=str(exported / "room.usda"))
    yield bpy.context.scene
    relight_room.unregister()


def edit(scene, tmp_path):
    """The exported edit, which relight must accept."""
    path = tmp_path / "edit.ron"
    assert bpy.ops.export_scene.relight_edit(filepath=str(path)) == {"FINISHED"}
    done = subprocess.run([RELIGHT, "check", GRAPH, str(path)], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    bpy.context.view_layer.update()
    return path.read_text()


def test_lights_have_the_radiance_of_the_file(scene, exported):
    described = room.usd_lights((exported / "room.usda").read_text())
    lights = {o.name: o.data for o in scene.objects if o.type == "LIGHT"}
    assert set(lights) == set(described) and {"lamp_0", "window_0"} <= set(lights)
    for name, (_, _, inputs) in described.items():
        assert max(room.radiance_of(lights[name])) == pytest.approx(inputs["intensity"], rel=1e-3), name
    assert scene.camera and scene.render.engine == "CYCLES"
    width, height = scene.render.resolution_x, scene.render.resolution_y
    assert (width, height) == tuple(bpy.data.images["picture.png"].size)


def test_nothing_changed_is_an_edit_without_changes(scene, tmp_path):
    assert edit(scene, tmp_path) == "Edit(version: 1)\n"


def test_changes_of_lights_come_back(scene, tmp_path):
    objects = bpy.data.objects
    objects["lamp_0"].data.energy *= 0.5
    for name in ("window_0", "window_0_sun"):
        if name in objects:
            objects[name].hide_render = True
    objects["inv_lamp"].data.color = (1, 0.5, 0.25)
    objects["inv_lamp"].location.x += 0.25
    new = bpy.data.lights.new("desk lamp", "POINT")
    new.shadow_soft_size = 0.06
    new.energy = room.energy_of(new, 40)
    lamp = objects.new("desk lamp", new)
    lamp.location = (0.2, 2.9, -0.5)
    scene.collection.objects.link(lamp)
    bpy.context.view_layer.update()
    text = edit(scene, tmp_path)
    assert '"lamp_0": Scale(0.5),' in text
    assert '"window_0": Off,' in text
    assert re.search(r'"inv_lamp": \[Scale\(.*\), Color\(1, 0.5, 0.25\), Move\(by: \(0.25, 0, 0\)\)\],', text), text
    assert '"desk_lamp": Lamp(shape: Sphere(radius: 0.06), at: Point(0.2, -0.5, -2.9), radiance: (40, 40, 40)),' in text


def test_a_window_does_not_move_and_a_spot_is_left_out(scene, tmp_path):
    bpy.data.objects["window_0"].location.x += 1
    spot = bpy.data.objects.new("spot", bpy.data.lights.new("spot", "SPOT"))
    scene.collection.objects.link(spot)
    bpy.context.view_layer.update()
    text, warnings = room.edit_text(scene)
    assert text == "Edit(version: 1)\n"
    assert sorted(warning.split(":")[0] for warning in warnings) == ["spot", "window_0"]


def test_other_files_are_refused(tmp_path):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    other = tmp_path / "other.usda"
    other.write_text("#usda 1.0\n")
    for path in (other, tmp_path / "nowhere.usda"):
        with pytest.raises(room.RoomError, match="relight export"):
            room.import_room(bpy.context, str(path))
    with pytest.raises(room.RoomError, match="imported room"):
        room.edit_text(bpy.context.scene)
