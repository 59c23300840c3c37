"""python -m unittest discover training/rooms: what needs no renderer."""

import json
import sys
import tempfile
import unittest
from pathlib import Path

import numpy as np
from PIL import Image

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "demo"))
import folder
import foreign
import layout
import make
from color import blackbody, hsv, luminance, srgb


class White:
    """A texture."""

    size = (1, 1)

    def __init__(self, place):
        self.place = place

    @staticmethod
    def albedo():
        return np.ones((2, 2, 3))


class Bare:
    """A library without furniture."""

    textures = [White("floor"), White("wall")]

    @staticmethod
    def models(cls):
        return []


def room(footprint):
    return layout.Room("living", np.array(footprint, float), 2.5, False)


class Rooms(unittest.TestCase):
    def test_colors_of_black_bodies(self):
        for kelvin in (2000, 6500, 12000):
            self.assertAlmostEqual(luminance(blackbody(kelvin)), 1.0, delta=0.01)
        self.assertLess(np.ptp(blackbody(6504)), 0.1)  # near white
        red, _, blue = blackbody(2700)
        self.assertGreater(red, 4 * blue)
        np.testing.assert_allclose(hsv(0.0, 1.0, 0.5), [0.5, 0, 0])

    def test_inside_an_l(self):
        l = room([[0, 0], [0, 4], [4, 4], [4, 2], [2, 2], [2, 0]])
        np.testing.assert_array_equal(l.inside([1, 3, 3, 1, -1], [1, 3, 1, 3.9, 1]), [True, True, False, True, False])
        self.assertFalse(l.inside(1, 3.9, 0.3))
        # Walls run around the room, their inward sides inside.
        for start, along, inward, length in l.walls():
            x, z = start + length / 2 * along + 0.01 * inward
            self.assertTrue(l.inside(x, z))
        self.assertAlmostEqual(sum(w[3] for w in l.walls()), 16)

    def test_every_wall_faces_the_room_and_closes_it(self):
        rng = np.random.default_rng(1)
        r = room([[0, 0], [0, 4], [3, 4], [3, 0]])
        r.openings.append((0, 1.0, 2.0, 1.0, 2.0))
        layout.shell(r, rng, Bare)
        corners = np.concatenate([p[f] for p, _, f, _, _ in r.parts])
        cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        middle = np.array([1.5, 1.25, 2.0])
        self.assertTrue(((middle - corners[:, 0]) * cross).sum(1).min() > 0)
        # The divergence theorem: six times the volume, were there no hole of 1 m2 in the wall x = 0.
        volume = ((middle - corners[:, 0]) * cross).sum() / 6
        self.assertAlmostEqual(volume, 3 * 4 * 2.5 - 1.0 * 1.5 / 3, places=5)

    def test_a_shade_is_closed_and_faces_outwards(self):
        corners = layout.triangles(layout.frustum(0.2, 0.1, 0.3, (1, 2, 3), around=200))
        volume = (corners[:, 0] * np.cross(corners[:, 1], corners[:, 2])).sum() / 6
        self.assertAlmostEqual(volume, np.pi * 0.3 / 3 * (0.04 + 0.02 + 0.01), delta=1e-4)

    def test_flux(self):
        """The flux of a sphere, pi times radiance times area, is the one wanted."""
        rng = np.random.default_rng(0)
        r = room([[0, 0], [0, 4], [4, 4], [4, 0]])
        layout.emitter(r, rng, {"center": np.array([2.0, 1, 2]), "radius": 0.1}, "Sphere", 800.0)
        self.assertAlmostEqual(luminance(r.lamps[0].radiance) * np.pi * 4 * np.pi * 0.01, 800, delta=8)

    def test_the_same_seed_is_the_same_room(self):
        for seed in range(5):
            a, b = (layout.make(seed, Bare)[0] for _ in range(2))
            self.assertEqual(len(a.parts), len(b.parts))
            for p, q in zip(a.parts, b.parts):
                for x, y in zip(p, q):
                    np.testing.assert_array_equal(x, y)

    def test_the_paths_share_out_all_that_burns(self):
        lobes = [("sun", 0, 0, 0), ("sky", 0, 0, 0), ("ground", 0, 0, 0)]
        windows = {f"window{k}": type("Window", (), {"lobes": lobes}) for k in range(3)}
        lit = type("Lit", (), {"lamps": {"lamp0": None}, "windows": windows})
        for count in range(1, 4):
            names = {"lamp0": "lamp_0"} | {f"window{k}": f"window_{k}" for k in range(count)}
            parts = make.groups(lit, names)
            self.assertLessEqual(len(parts), make.PATHS)
            burns = sorted((name, lobe) for part in parts.values() for name, some in part.items() for lobe in some or [""])
            self.assertEqual(burns, sorted([("lamp0", "")] + [(f"window{k}", lobe[0]) for k in range(count) for lobe in lobes]))

    def test_the_height_of_a_table(self):
        points = np.array([[0, 0.7, 0], [1, 0.7, 0], [0, 0.7, 1], [0, 0.2, 0], [1, 0.2, 0], [0, 0.2, 1]], float)
        faces = np.array([[0, 1, 2], [3, 4, 5]])
        self.assertAlmostEqual(layout.top_at(points, faces, 0.2, 0.2), 0.7)
        self.assertIsNone(layout.top_at(points, faces, 0.8, 0.8))

    def test_a_room_by_others_becomes_a_scene_with_its_truth(self):
        gray = lambda value: np.full((6, 8, 3), value, np.float32)
        ball = {"kind": "sphere", "center": [0, 0, -2], "radius": 0.1, "radiance": [3, 2, 1]}
        panel = {"kind": "rect", "center": [0, 2, 0], "half": [0.5, 0.25], "normal": [0, -1, 0], "radiance": [5, 5, 5]}
        pane = {"kind": "rect", "center": [3, 0, -2], "half": [0.5, 1], "normal": [-1, 0, 0], "radiance": [1, 1, 2]}
        meta = {"fov_x": 60, "lights": ["lamp_0", "inv_lamp", "window_0"], "visible": ["lamp_0"], "edits": {"paint": {"albedo": [1, 0.5, 0]}}}
        meta["lamps"] = {"lamp_0": ball, "inv_lamp": panel, "window_0": pane}
        with tempfile.TemporaryDirectory() as place:
            source, dark = Path(place, "source"), Path(place, "dark")
            source.mkdir()
            (source / "meta.json").write_text(json.dumps(meta))
            values = {"olat_lamp_0": 0.1, "olat_inv_lamp": 0.2, "olat_window_0": 0.3, "albedo": 0.5, "normal": 0.6, "depth": 3, "paint": 0.4}
            for name, value in values.items():
                folder.exr(source / f"{name}.exr", RGB=gray(value))
            for name in ("mask_lamp_0", "mask_paint"):
                Image.fromarray(np.eye(6, 8, dtype=np.uint8) * 255).save(source / f"{name}.png")
            foreign.main(source, Path(place, "all"), None)
            foreign.main(source, dark, "lamp_0")
            text = Path(place, "all", "scene.ron").read_text()
            self.assertIn('"inv_window": "truth/light_inv_window.exr"', text)
            self.assertIn('"edits/paint.ron": "truth/paint.exr"', text)
            self.assertEqual(set(json.loads(Path(place, "all", "lights.json").read_text())), {"lamp_0", "inv_lamp", "inv_window"})
            self.assertIn('Mask("../paint.png")', Path(place, "all", "edits", "paint.ron").read_text())
            self.assertNotIn("lamp_0", (dark / "scene.ron").read_text())
            self.assertIn("Sphere(radius: 0.1), at: Point(0, 0, -2), radiance: (3, 2, 1)", (dark / "edits" / "insert_lamp.ron").read_text())
            np.testing.assert_allclose(foreign.picture(dark / "truth" / "insert_lamp.exr"), 0.6, rtol=1e-6)
            self.assertEqual(np.asarray(Image.open(dark / "photo.png"))[0, 0, 0], int(srgb(0.5) * 255 + 0.5))


if __name__ == "__main__":
    unittest.main()
