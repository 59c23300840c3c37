"""python -m unittest discover training/rooms: third-party rooms. What needs ../shared/data/rooms is ignored where it is not there."""

import os
import sys
import unittest
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent / "demo"))
sys.path.insert(0, str(HERE))
import layout
import people_scenes

try:
    import variant  # noqa: F401  (sets Mitsuba's variant)

    RENDERER = True
except (ImportError, AttributeError, RuntimeError):
    RENDERER = False

THERE = people_scenes.ARCHIVES.is_dir() or all((people_scenes.CACHE / name / "scene.xml").exists() for name in people_scenes.SCENES)


class Plain:
    """A texture."""

    size = (1.0, 1.0)

    def __init__(self, place):
        self.place = place

    @staticmethod
    def albedo():
        return np.full((2, 2, 3), 0.5)


class Bare:
    """A library without furniture."""

    textures = [Plain("floor"), Plain("wall")]

    @staticmethod
    def models(cls):
        return []


class Layouts(unittest.TestCase):
    """Needs neither the scenes nor a renderer."""

    def test_rooms_have_the_size_of_rooms(self):
        for name, spec in people_scenes.SCENES.items():
            x0, z0, x1, z1 = spec.walls
            self.assertTrue(2.2 < spec.ceiling < 4.5, name)
            self.assertTrue(1.2 < min(x1 - x0, z1 - z0) and max(x1 - x0, z1 - z0) < 15, name)
            for center, half_width, half_height, inward, _ in spec.windows:
                self.assertTrue(0 < center[1] - half_height and center[1] + half_height < spec.ceiling, name)
                self.assertAlmostEqual(np.hypot(*inward), 1, delta=0.01)
                self.assertTrue(all(a < c < b for a, c, b in zip(spec.low, center, spec.high)), name)

    def test_roughness_and_reflectance_of_materials(self):
        import xml.etree.ElementTree as ET

        read = lambda text: people_scenes.finish(ET.fromstring(text), None)
        plastic = read('<bsdf type="twosided"><bsdf type="roughplastic"><float name="alpha" value="0.25"/>'
                       '<rgb name="diffuseReflectance" value="1, 0, 0.5"/></bsdf></bsdf>')
        self.assertAlmostEqual(plastic.rough, 0.5)
        np.testing.assert_allclose(plastic.albedo, [0.92, 0.01, 0.5], rtol=1e-6)
        gold = read('<bsdf type="roughconductor"><float name="alpha" value="0.1"/><rgb name="eta" value="0.143119, 0.374957, 1.44248"/>'
                    '<rgb name="k" value="3.98316, 2.38572, 1.60322"/></bsdf>')
        self.assertTrue(gold.metal and gold.albedo[0] > 0.9 > gold.albedo[2])
        self.assertEqual(read('<bsdf type="diffuse"><rgb name="reflectance" value="0.3"/></bsdf>').rough, 1.0)


@unittest.skipUnless(THERE, "ignored: ../shared/data/rooms is not there")
@unittest.skipUnless(RENDERER, "ignored: Mitsuba is not there")
class Views(unittest.TestCase):
    """One small scene, few samples."""

    NAME = "staircase2"

    @classmethod
    def setUpClass(cls):
        import drjit as dr

        dr.set_thread_count(int(os.environ.get("THREADS", 1)))
        import people
        import truth

        cls.people, cls.truth = people, truth
        for seed in range(4, 50):
            cls.lit, cls.space, cls.rng = people.room(cls.NAME, seed, Bare())
            if len(cls.lit.lamps) + len(cls.lit.windows) >= 2:
                cls.seed, cls.model = seed, people.loaded(cls.NAME)[0]
                cls.scene = cls.lit.scene({})
                found = people.look(cls.lit, cls.scene, cls.model, cls.rng)
                if found:
                    cls.view, cls.planes, cls.seen, cls.hidden = found
                    return
        raise AssertionError("no room with a view")

    def test_the_same_seed_gives_the_same_room(self):
        lit, _, _ = self.people.room(self.NAME, self.seed, Bare())
        self.assertEqual(list(lit.lamps), list(self.lit.lamps))
        for a, b in zip(lit.surfaces, self.lit.surfaces):
            np.testing.assert_array_equal(a.albedo, b.albedo)
        for a, b in zip(lit.lamps.values(), self.lit.lamps.values()):
            np.testing.assert_array_equal(a.radiance, b.radiance)

    def test_the_room_is_closed_and_the_camera_stands_free(self):
        around = self.people.sphere(200)
        far = self.people.cast(self.scene, np.broadcast_to(self.view.origin, around.shape), around)
        self.assertTrue(np.isfinite(far).all())
        self.assertGreater(far.min(), 0.25)
        self.assertTrue(0.9 <= self.view.origin[1] <= 1.7)

    def test_materials_are_within_range(self):
        self.assertTrue((self.planes["albedo"] > 0.009).all() and (self.planes["albedo"] < 0.95).all())
        self.assertTrue((self.planes["rough"] >= 0.1).all() and (self.planes["rough"] <= 1).all())

    def small(self, lit, burning, extra=None):
        """Radiance of a picture of 40 x 30, 64 samples a pixel, not denoised."""
        scene = lit.scene(dict.fromkeys(burning), extra)
        ray, _ = self.truth.places(self.view, 40, 64, 5)
        return np.array(self.truth.radiance(scene, ray, 5, 4)).reshape(3, 1200, 64)

    def test_pictures_of_lights_add_up(self):
        names = [*self.lit.lamps, *self.lit.windows]
        together = np.minimum(self.small(self.lit, names), 1e6)
        apart = sum(np.minimum(self.small(self.lit, [n]), 1e6) for n in names)
        a, b = np.median(together.mean(-1).mean(0)), np.median(apart.mean(-1).mean(0))
        self.assertAlmostEqual(a / b, 1, delta=0.08)

    def test_a_repainted_surface_alone_changes(self):
        si, _ = self.truth.hits(self.scene, self.view, 40, 1, 1)
        keys = np.array(self.lit.key(self.scene, si))
        key = int(np.bincount(keys[keys >= 0]).argmax())
        lit = self.lit.repainted(key, [0.1, 0.7, 0.2])
        scene = lit.scene({})
        si, _ = self.truth.hits(scene, self.view, 40, 1, 1)
        np.testing.assert_array_equal(np.array(lit.key(scene, si)), keys)
        after = np.array(lit.materials(scene, si)[0])
        si, _ = self.truth.hits(self.scene, self.view, 40, 1, 1)
        before = np.array(self.lit.materials(self.scene, si)[0])
        np.testing.assert_allclose(after[:, keys == key].T, np.broadcast_to([0.1, 0.7, 0.2], ((keys == key).sum(), 3)), atol=1e-6)
        np.testing.assert_array_equal(after[:, keys != key], before[:, keys != key])

    def test_an_extra_shape_is_seen(self):
        at = self.view.origin - 1.0 * self.view.turn[2]
        ball = {"type": "sphere", "center": [float(c) for c in at], "radius": 0.1, "bsdf": {"type": "diffuse"}}
        scene = self.lit.scene({}, {"ball": ball})
        si, _ = self.truth.hits(scene, self.view, 40, 1, 1)
        keys, t = np.array(self.lit.key(scene, si)).reshape(30, 40), np.array(si.t).reshape(30, 40)
        self.assertEqual(keys[15, 20], -1)
        self.assertAlmostEqual(t[15, 20], 0.9, delta=0.02)


@unittest.skipUnless(RENDERER, "ignored: Mitsuba is not there")
class Generated(unittest.TestCase):
    """The same of rooms of layout.py."""

    def test_a_wall_is_repainted(self):
        import drjit as dr

        dr.set_thread_count(int(os.environ.get("THREADS", 1)))
        import scene as scenes
        import truth

        room, _ = layout.make(3, Bare())
        lit = scenes.Lit(room)
        scene = lit.scene({})
        low, high = room.footprint.min(0), room.footprint.max(0)
        view = truth.View([low[0] + 0.5, 1.5, low[1] + 0.5], 2.3, -0.1, 70)
        si, _ = truth.hits(scene, view, 40, 1, 1)
        keys = np.array(lit.key(scene, si))
        key = int(np.bincount(keys[keys >= 0]).argmax())
        other = lit.repainted(key, [0.1, 0.7, 0.2])
        scene2 = other.scene({})
        si2, _ = truth.hits(scene2, view, 40, 1, 1)
        after, before = np.array(other.materials(scene2, si2)[0]), np.array(lit.materials(scene, truth.hits(scene, view, 40, 1, 1)[0])[0])
        np.testing.assert_allclose(after[:, keys == key].T, np.broadcast_to([0.1, 0.7, 0.2], ((keys == key).sum(), 3)), atol=1e-6)
        np.testing.assert_array_equal(after[:, keys != key], before[:, keys != key])


if __name__ == "__main__":
    unittest.main()
