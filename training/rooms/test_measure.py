"""python -m unittest discover training/rooms: measures of measure.py on synthetic arrays with known answers."""

import sys
import unittest
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "demo"))
import measure


class Measures(unittest.TestCase):
    def test_shares_of_lights(self):
        dark, bright = np.full((4, 4, 3), 0.1), np.full((4, 4, 3), 0.3)
        lights = np.zeros((4, 4), bool)
        lights[0] = True
        dark[0] = 99  # a pixel of the light itself does not count
        got = measure.shares({"lamp_0": dark, "inv_window": bright}, lights)
        self.assertAlmostEqual(got["lamp_0"], 0.25)
        self.assertAlmostEqual(sum(got.values()), 1)

    def test_share_that_arrives(self):
        direct = np.ones((2, 4, 4))
        shadow = np.stack([np.full((4, 4), 0.5), np.ones((4, 4))])
        self.assertAlmostEqual(measure.arrived_share(direct, shadow, [3.0, 1.0]), (3 * 0.5 + 1) / 4)

    def test_chroma_and_edges(self):
        self.assertAlmostEqual(measure.chroma(np.array([[[0.8, 0.4, 0.2]]]))[0, 0], 0.75)
        self.assertEqual(measure.edges(np.full((5, 5), 0.4)), 0)
        step = np.where(np.arange(8) < 4, 0.09, 0.19) * np.ones((6, 1))  # one step of log 2 among seven
        self.assertAlmostEqual(measure.edges(step), np.log(2) / 7)

    def test_unseen_before_a_wall_and_in_a_corner(self):
        wall = np.full((240, 320), 3.0)
        self.assertGreater(measure.unseen(wall, 60, rays=16), 0.99)  # a wall sees nothing of itself
        # Two walls at right angles that both fill half of the picture and meet far away at the middle.
        x = (np.arange(320) + 0.5 - 160) / (160 / np.tan(np.radians(30)))
        corner = np.broadcast_to(3 / (1 + np.abs(x)), (240, 320))
        self.assertLess(measure.unseen(corner, 60, rays=64), 0.97)

    def test_the_figures_of_relight_eval(self):
        edits = {"lamp_0 off": (32.0, 0.125), "window_1 off": (26.7, 0.5), "invisible lights off": (31.5, 0.25), "insert_lamp": (30.0, 0.3)}
        figures = [dict(subject=s, measure=m, value=v) for s, both in edits.items() for m, v in zip(("PSNR", "change error"), both)]
        self.assertEqual(measure.errors_of(figures), {"lamp": [0.125], "window": [0.5], "invisible": [0.25]})

    def test_the_table(self):
        text = measure.table({"a": [{"x": [1.0]}, {"x": [3.0]}], "b": [{"y": [2.0]}]})
        self.assertIn("| | a (2) | b (1) |", text)
        self.assertIn("| x | 2 (1.2 .. 2.8) | - |", text)


if __name__ == "__main__":
    unittest.main()
