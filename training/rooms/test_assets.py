"""Tests of what reads and shapes the furniture; no network. Run: python -m pytest training/rooms, or this file by itself."""
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
import assets  # noqa: E402
import meshes  # noqa: E402


def box(n=1):
    """The surface of a unit cube, each side cut into 2 n^2 triangles: [m,3,3]."""
    g = np.arange(n + 1) / n
    a, b = (x.ravel() for x in np.meshgrid(g[:-1], g[:-1], indexing="ij"))
    h = 1 / n
    quad = [np.stack([np.stack([a + i * h, b + j * h], 1) for i, j in t], 1) for t in (((0, 0), (1, 0), (1, 1)), ((0, 0), (1, 1), (0, 1)))]
    flat = np.concatenate(quad)
    sides = []
    for axis in range(3):
        for at in (0.0, 1.0):
            t = np.insert(flat, axis, at, axis=2)
            sides.append(t if (at == 1) != (axis == 1) else t[:, ::-1])
    return np.concatenate(sides)


def test_catalogue():
    got = assets.read_catalogue("# c\nid=x\nname#2=Caf\\u00e9 chair \nwidth#2 = 49.5\ncreator#10=A\n")
    assert got == {2: {"name": "Café chair", "width": "49.5"}, 10: {"creator": "A"}}


def test_model_name():
    assert assets.model_name("/scopia/bed1/bed1.obj") == "scopia/bed1"
    assert assets.model_name("/com/eteks/sweethome3d/io/resources/frame/frame.obj") == "eteks/frame"


def test_lights_are_measured_from_the_left_and_the_front():
    record = {"width": "40", "depth": "20", "lightSourceX": "10 40", "lightSourceY": "0 20", "lightSourceZ": "50 60"}
    record["lightSourceColor"] = "#ffffff #000000"
    left, right = assets.lights_of(record)
    assert left == {"position": [-0.1, 0.5, 0.1], "colour": [1.0, 1.0, 1.0], "diameter": 0.05}
    assert right["position"] == [0.2, 0.6, -0.1] and right["colour"] == [0, 0, 0]


def test_held_out():
    names = [f"m{i}" for i in range(20)]
    held = assets.held_out(names)
    assert len(held) == 4 and held == assets.held_out(names[::-1])
    assert len(assets.held_out(names[:2])) == 1 and not assets.held_out(names[:1])


def test_obj():
    text = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0.5 0.25\nusemtl red wood\nf 1/1/7 2/1 3/1 4/1\nusemtl b\nf -4 -3 -2\nl 1 2\n"
    v, uv, corners, material, names = meshes.read_obj(text)
    assert v.shape == (4, 3) and uv.tolist() == [[0.5, 0.25]]
    assert corners[..., 0].tolist() == [[0, 1, 2], [0, 2, 3], [0, 1, 2]]
    assert corners[..., 1].tolist() == [[0, 0, 0], [0, 0, 0], [-1, -1, -1]]
    assert [names[i] for i in material] == ["red wood", "red wood", "b"]


def test_mtl():
    got = meshes.read_mtl("newmtl a b\n Kd 0.1 0.2 0.3\nNs 10\nd 0.4\nmap_Kd sub\\pic one.jpg\n\nnewmtl c\nillum 1\n")
    assert got == {"a b": {"Kd": [0.1, 0.2, 0.3], "Ns": 10.0, "d": 0.4, "map_Kd": "sub/pic one.jpg"}, "c": {"illum": 1.0}}


def test_own_materials():
    got = assets.own_materials(b"\x00\x01junk\x05<newmtl amber\nKd 0.5 0.25 0\nnewmtl red\nKd 1 0 0\n\x01\x00newmtl no")
    assert got == {"amber": {"Kd": [0.5, 0.25, 0]}, "red": {"Kd": [1, 0, 0]}}


def test_roughness():
    assert meshes.roughness({}) == 1 and meshes.roughness({"illum": 1, "Ns": 90.0, "Ks": [1, 1, 1]}) == 1
    assert meshes.roughness({"Ns": 90.0, "Ks": [0, 0, 0]}) == 1
    # GGX alpha^2 = 2 / (30 + 2) = 1/16, alpha = 1/4, r = 1/2.
    assert abs(meshes.roughness({"Ns": 30.0, "Ks": [0.5, 0.5, 0.5]}) - 0.5) < 1e-12


def test_place():
    # A quarter turn about x puts z up; then each axis is scaled.
    got = meshes.place(np.array([[0, 0, 0], [1, 2, 4.0]]), [1, 0, 0, 0, 0, 1, 0, -1, 0], [2, 8, 6])
    assert np.allclose(got, [[-1, 0, 3], [1, 8, -3]])


def test_picture_means():
    image = np.ones((8, 8, 4), np.float32)
    image[:, 4:, :3] = 0  # right half black
    uv = np.array([[[0, 0], [0.45, 0], [0, 1.0]], [[0.55, 0], [1, 0], [0.55, 1]], [[2, 0], [2.45, 0], [2, 1]]])
    assert np.allclose(meshes.picture_means(image, uv)[:, 0], [1, 0, 1])


def test_split_keeps_the_surface():
    t = np.array([[[0, 0, 0], [1, 0, 0], [0, 1, 0.0]]])
    got, uv = meshes.split_faces(t, t[..., :2], 200)
    assert 100 < len(got) <= 200 and abs(meshes.areas(got).sum() - 0.5) < 1e-12 and np.allclose(uv, got[..., :2])


def test_decimate_keeps_a_box():
    cube = box(12)
    assert abs(meshes.areas(cube).sum() - 6) < 1e-9
    got, color = meshes.decimate(cube, np.tile([0.1, 0.2, 0.3, 1], (len(cube), 1)), 100)
    assert len(got) <= 100 and abs(meshes.areas(got).sum() - 6) < 0.05 and np.allclose(color[:, :3], [0.1, 0.2, 0.3])


def test_pieces():
    assert meshes.pieces(np.array([[3, 4, 5], [0, 1, 2], [2, 6, 7], [5, 8, 9]]), 10).tolist() == [1, 0, 0, 1]


def test_smooth():
    v, n, f = meshes.smooth(box(3))
    # Square edges stay sharp: every normal is an axis, and the corner of the cube has three of them.
    assert np.allclose(np.abs(n).max(1), 1) and (np.abs(v - 1).max(1) < 1e-6).sum() == 3
    turn = np.linspace(0, 2 * np.pi, 13)
    ring = np.stack([np.cos(turn), 0 * turn, np.sin(turn)], 1)
    up = ring + [0, 1, 0]
    _, n, _ = meshes.smooth(np.concatenate([np.stack([ring[:-1], up[:-1], ring[1:]], 1), np.stack([ring[1:], up[:-1], up[1:]], 1)]))
    assert np.abs(n[:, 1]).max() < 1e-6 and len(n) == 24  # a 12-sided tube (30 degrees between sides) shades as round


def test_shares():
    got = meshes.shares([10, 400, 40000], 1500)
    assert got.sum() <= 1500 and got[0] == 10 and got[1] < got[2]


def test_linear():
    assert np.allclose(meshes.linear([0, 0.04045, 0.5, 1]), [0, 0.0031308, 0.2140411, 1], atol=1e-6)


if __name__ == "__main__":
    for name, test in list(globals().items()):
        if name.startswith("test_"):
            test()
            print(name)
