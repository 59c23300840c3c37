"""Tests of the module `relight` on the demo scene, small."""

import os
import pickle
import signal
import threading
import time

import numpy as np
import pytest

import relight
from relight.ron import Scale, Grow, Off, Paint, Srgb, dumps

SMALL = {"scene.long_side": 96}


@pytest.fixture(scope="module")
def scene():
    return relight.Scene(relight.DEMO)


@pytest.fixture(scope="module")
def dark(scene):
    return scene.run({"lights": {"lamp_0": Off}}, settings=SMALL)


def test_layers_sum_to_the_picture(dark):
    assert dark.picture.shape == (960, 1280, 3) and dark.picture.dtype == np.float32
    layers = dark.layers
    assert {"lamp_0", "window_0", "rest"} <= set(layers)
    assert layers["lamp_0"].max() == 0 and layers["window_0"].max() > 0.1
    assert np.abs(relight.mix(layers) - dark.picture).max() < 2e-3


def test_arrays_are_read_only_and_not_copied(dark):
    first, second = dark.picture, dark.picture
    assert not first.flags.writeable and not first.flags.owndata
    assert np.shares_memory(first, second)
    address = first.__array_interface__["data"][0]
    del first, second
    assert dark["compose.picture"].__array_interface__["data"][0] == address


def test_an_array_outlives_its_run_and_scene():
    scene = relight.Scene(relight.DEMO)
    depth = scene.run(graph="physics", outputs=["scene.depth"], settings=SMALL)["scene.depth"]
    before = depth.copy()
    del scene
    assert depth.shape == (72, 96) and np.array_equal(depth, before) and depth.min() > 0


def test_an_edit_is_the_same_as_text_as_file_and_as_dictionary(scene, dark, tmp_path):
    text = 'Edit(version: 1, lights: {"lamp_0": Off})'
    file = tmp_path / "off.ron"
    file.write_text(text)
    for edit in (text, file):
        assert np.array_equal(scene.run(edit, settings=SMALL).picture, dark.picture)


def test_another_edit_runs_few_nodes(scene, dark):
    run = scene.run({"lights": {"window_0": Scale(0.5)}}, settings=SMALL)
    ran = [node["name"] for node in run.nodes if node["status"] == "ran"]
    assert 0 < len(ran) < len(run.nodes) / 2, ran
    assert run.picture.mean() != dark.picture.mean()


def test_planes_of_lights_and_plain_values(scene):
    wanted = ["direct", "fit.radiance", "scene.camera", "write.files"]
    run = scene.run(outputs=wanted, graph="physics", settings=SMALL)
    assert run.outputs == wanted
    assert run["direct"]["lamp_0"]["lobes"][0].shape == (72, 96)
    assert len(run["fit.radiance"]["window_0"][0]) == 3
    assert run["scene.camera"]["width"] > 0
    assert run["write.files"]["picture.png"].startswith(b"\x89PNG")


def test_a_fault_has_its_place():
    scene = relight.Scene(relight.DEMO)
    with pytest.raises(relight.RelightError) as caught:
        scene.run({"lights": {"lamp_9": Off}})
    (fault,) = caught.value.faults
    assert (fault.file, fault.line) == ("<edit>", 3)
    assert fault.column == 14 and "lamp_9" in fault.message and "lamp_0" in fault.help
    assert "<edit>:3:14" in str(caught.value)


def test_a_failed_stage_is_named(scene):
    edit = {"materials": [Paint(region=Grow(99999, 5), albedo=Srgb("#ff0000"))]}
    with pytest.raises(relight.RelightError):
        scene.run(edit, settings=SMALL)
    with pytest.raises(relight.RelightError, match="long_sid"):
        scene.run(settings={"scene.long_sid": 96})
    with pytest.raises(relight.RelightError, match="cannot be read"):
        relight.Scene("/nowhere")


def test_progress_counts_to_the_end_and_its_exception_ends_the_run(scene):
    calls = []
    scene.run(settings=SMALL, progress=lambda *call: calls.append(call))
    done, total, _, status = calls[-1]
    assert done == total == len(calls) and status in ("ran", "hit")

    def fail(*_):
        raise LookupError("enough")

    with pytest.raises(LookupError, match="enough"):
        scene.run(settings={"scene.long_side": 90}, progress=fail)


def test_ctrl_c_ends_a_run():
    # Python ignores Ctrl-C where the shell that started it in the background does.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    scene = relight.Scene(relight.DEMO)
    threading.Timer(0.5, os.kill, (os.getpid(), signal.SIGINT)).start()
    began = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        scene.run(graph="physics", settings={"direct.samples": 65536, "scene.long_side": 640})
    assert time.monotonic() - began < 3
    # The scene is of use still.
    assert scene.run(graph="physics", outputs=["scene.depth"])["scene.depth"].size > 0


def test_ron_of_python():
    assert dumps({"a": [1, 2.5, True, None, "x\"\\\n"]}) == '{"a": [1, 2.5, true, None, "x\\"\\\\\\n"]}'
    assert dumps((Off, Scale(np.float32(0.5)), Paint(roughness=0.9))) == "(Off, Scale(0.5), Paint(roughness: 0.9))"
    assert dumps(np.array([[1.0, 2.0]])) == "[[1.0, 2.0]]"
    with pytest.raises(ValueError):
        dumps(float("nan"))
    with pytest.raises(TypeError):
        dumps(object())
    assert pickle.loads(pickle.dumps(Scale(1))) == Scale(1)


def test_srgb_is_the_curve():
    assert relight.srgb(np.array([0.0, 0.0031308, 0.2140411, 1.0, 9.0])).tolist() == [0, 10, 127, 255, 255]
