"""The networks that estimate: closed forms, and the twin of the program's stage Direct held against the program."""

import math
import sys
import tempfile
import unittest
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F

import augment
import emit
import form
import lights
import synthetic
from data import Rooms
from lights import InvLampNet, InvWinNet, VisLampNet, VisWinNet
from mnet import MNet

ROOT = Path(__file__).resolve().parents[2]
RELIGHT = ROOT / "target/release/relight"


def random_light(rng, window):
    """A lamp or window of lights.json beside the camera."""
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    centre = np.array([rng.uniform(-1.5, 1.5), rng.uniform(-1, 1.2), rng.uniform(0, 0.8)])
    if not window:
        return {"kind": "Box", "center": centre.tolist(), "half_axes": (turn * rng.uniform(0.05, 0.4, (3, 1))).tolist(), "radiance": [1, 1, 1]}
    x, y = turn[0] * rng.uniform(0.3, 0.9), turn[1] * rng.uniform(0.3, 0.9)
    if np.cross(x, y)[2] > 0:
        x = -x
    lobes = [
        {"name": name, "direction": rng.normal(size=3).tolist(), "bandwidth": float(b), "radiance": [1, 1, 1]}
        for name, b in zip(form.LOBES, (rng.uniform(20, 60), rng.uniform(0.5, 4), rng.uniform(0, 2)))
    ]
    return {"kind": "Window", "center": centre.tolist(), "half_x": x.tolist(), "half_y": y.tolist(), "lobes": lobes}


class Emit(unittest.TestCase):
    def test_a_box_is_its_faces_even_where_the_horizon_cuts_it(self):
        """Against sums over 40 x 40 places a face, for points outside."""
        torch.manual_seed(0)
        centre = torch.tensor([[0.3, 0.2, -2.0], [0.0, -0.4, -1.0]])
        axes = torch.linalg.qr(torch.randn(2, 3, 3))[0] * torch.tensor([0.1, 0.3, 0.5]).view(1, 3, 1)
        points, normals = 1.5 * torch.randn(2, 200, 3), F.normalize(torch.randn(2, 200, 3), dim=2)
        k = (torch.arange(40) + 0.5) / 40 * 2 - 1
        u, v = (t.reshape(1, -1, 1) for t in torch.meshgrid(k, k, indexing="ij"))
        want = 0
        for i in range(3):
            for side in (1, -1):
                x, y, out = axes[:, (i + 1) % 3], axes[:, (i + 2) % 3], axes[:, i] * side
                to = (centre + out)[:, None] + u * x[:, None] + v * y[:, None]
                to = to[:, None] - points[:, :, None]
                square = (to * to).sum(3)
                l = to / square.sqrt()[..., None]
                cosines = (l * normals[:, :, None]).sum(3).clamp(min=0) * -(l * F.normalize(out, dim=1)[:, None, None]).sum(3).clamp(max=0)
                want = want + (cosines / square).mean(2) * 4 * torch.linalg.cross(x, y, dim=1).norm(dim=1)[:, None] / torch.pi
        away = torch.linalg.solve(axes.mT, (points - centre[:, None]).mT).abs().amax(1) > 1.5
        got = emit.box(centre, axes, points, normals)
        self.assertLess(((got - want).abs() * away).max().item(), 1e-3 * want.max().item())

    def test_gradients_are_finite_and_right(self):
        torch.manual_seed(1)
        points, normals = torch.randn(1, 5, 3).double(), F.normalize(torch.randn(1, 5, 3).double(), dim=2)
        centre, x, y = (torch.tensor([v], dtype=torch.float64, requires_grad=True) for v in ([0.2, 0.1, 3.0], [0.5, 0.0, 0.0], [0.0, -0.4, 0.1]))
        way, width = (
            F.normalize(torch.tensor([[[0.1, 0.3, 1.0]]], dtype=torch.float64), dim=2),
            torch.tensor([[5.0]], dtype=torch.float64, requires_grad=True),
        )
        axes = torch.diag_embed(torch.tensor([[0.2, 0.3, 0.1]], dtype=torch.float64)).requires_grad_()
        self.assertTrue(torch.autograd.gradcheck(lambda c, a, b, w: emit.window(c, a, b, way, w, points, normals), (centre, x, y, width)))
        self.assertTrue(torch.autograd.gradcheck(lambda c, a: emit.box(c, a, points, normals), (centre, axes)))

    @unittest.skipUnless(RELIGHT.exists(), f"{RELIGHT} is not built")
    def test_random_lights_cast_what_the_program_casts(self):
        """Closed form against closed form for boxes; windows by 12 x 12 places against the program's closed form."""
        sys.path.insert(0, str(ROOT / "training/rooms"))
        import folder as scene_folder
        from pack import planes

        rng, worst = np.random.default_rng(0), {}
        room = synthetic.sample(5)
        full = lambda x: x.astype(np.float32)
        for _ in range(3):
            some = {"inv_lamp": random_light(rng, False), "inv_window": random_light(rng, True)}
            with tempfile.TemporaryDirectory() as place:
                scene_folder.write(Path(place), float(room["fov_x"]), full(room["photo"]), full(room["depth"]), full(room["albedo"]), {}, some)
                got = planes(Path(place), RELIGHT)
            grid = (slice(6, None, 12), slice(6, None, 12))
            normals = torch.from_numpy(np.stack([got[f"normal.{c}"][grid] for c in "XYZ"], -1)).float().reshape(1, -1, 3)
            depth = torch.from_numpy(np.ascontiguousarray(got["depth.Z"]))[None, None].float()
            points = augment.xyz(depth, torch.tensor([float(room["fov_x"])]))[0, :, grid[0], grid[1]].flatten(1).T[None]
            for name, light in some.items():
                numbers = torch.from_numpy(form.form(light))[None]
                centre, axes, lobes = numbers[:, :3], numbers[:, 3:12].unflatten(1, (3, 3)), numbers[:, 12:33].unflatten(1, (3, 7))
                if name == "inv_lamp":
                    mine = emit.box(centre, axes, points, normals)[:, None]
                else:
                    mine = emit.window(centre, axes[:, 0], axes[:, 1], lobes[..., :3], lobes[..., 3], points, normals)
                for k in range(mine.shape[1]):
                    want = torch.from_numpy(np.ascontiguousarray(got[f"direct_{name}_{k}.Y"][grid])).flatten()
                    error = ((mine[0, k] - want).abs().sum() / want.sum().clamp(min=1e-3)).item()
                    worst[name] = max(worst.get(name, 0.0), error)
        print("twin against the program, L1 relative:", {k: f"{v:.1e}" for k, v in worst.items()})
        self.assertLess(worst["inv_lamp"], 1e-3)
        self.assertLess(worst["inv_window"], 0.03)


class Forms(unittest.TestCase):
    def test_points_of_a_light_lie_on_it(self):
        ball = {"kind": "Sphere", "center": [1, 2, -3], "radius": 0.5}
        self.assertTrue(np.allclose(np.linalg.norm(form.surface(ball) - [1, 2, -3], axis=1), 0.5))
        pane = {"kind": "Window", "center": [0, 0, 1], "half_x": [-1, 0, 0], "half_y": [0, 0.5, 0], "lobes": []}
        points = form.surface(pane)
        self.assertTrue((abs(points) <= [1, 0.5, 1]).all() and np.allclose(points[:, 2], 1))
        self.assertLess(np.abs(points.mean(0) - [0, 0, 1]).max(), 0.1)
        box = {"kind": "Box", "center": [0, 0, 0], "half_axes": [[1, 0, 0], [0, 2, 0], [0, 0, 3]]}
        self.assertTrue(np.allclose((abs(form.surface(box)) / [1, 2, 3]).max(1), 1))

    def test_a_mesh_has_the_box_around_it(self):
        corners = np.array([[0, 0, 0], [2, 0, 0], [2, 1, 0], [0, 0, 0], [2, 1, 0], [0, 1, 0]], float).reshape(2, 3, 3) + 5
        centre, axes = form.body({"kind": "Mesh", "triangles": corners.tolist()})
        self.assertTrue(np.allclose(centre, [6, 5.5, 5]))
        self.assertTrue(np.allclose(sorted(np.linalg.norm(axes, axis=1)), [0, 0.5, 1], atol=1e-6))

    def test_a_mirrored_window_shines_on_the_mirrored_room(self):
        light = random_light(np.random.default_rng(3), True)
        numbers = torch.from_numpy(form.form(light))[None]
        points, normals = torch.randn(1, 50, 3), F.normalize(torch.randn(1, 50, 3), dim=2)

        def cast(n, p, m):
            lobes = n[:, 12:33].unflatten(1, (3, 7))
            return emit.window(n[:, :3], n[:, 3:6], n[:, 6:9], lobes[..., :3], lobes[..., 3], p, m)

        flip = torch.tensor([-1.0, 1, 1])
        want, got = cast(numbers, points, normals), cast(lights.mirrored_form(numbers), points * flip, normals * flip)
        self.assertTrue(torch.allclose(got, want, rtol=1e-3, atol=1e-6))


class Camera(unittest.TestCase):
    def test_exposure_brings_what_is_no_light_below_one(self):
        g = torch.Generator().manual_seed(0)
        photo, light = 7 * torch.rand(2, 3, 120, 160, generator=g), torch.zeros(2, 1, 120, 160)
        out, gain = augment.exposed(g, photo, light)
        self.assertTrue(torch.allclose(out, photo * gain))
        self.assertTrue(((out.mean(1) < 1.001).float().mean((1, 2)) > 0.975).all())


class Networks(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.folder = tempfile.TemporaryDirectory()
        synthetic.write(cls.folder.name, 3)
        cls.rooms = Rooms(f"{cls.folder.name}/train")

    @classmethod
    def tearDownClass(cls):
        cls.folder.cleanup()

    def test_lights_are_sound_wherever_the_head_points(self):
        """Any numbers of the head give unit directions, windows that look away from the room, lengths above zero."""
        for kind in (VisLampNet, VisWinNet, InvLampNet, InvWinNet):
            net = kind()
            y = 10 * torch.randn(200, net.head[-1].out_features)
            seen = lights.Seen(torch.rand(200, 1) + 0.5, torch.rand(200, 3), torch.randn(200, 3), torch.rand(200, 3))
            start = torch.cat([torch.randn(200, 2), -1 - torch.rand(200, 1), torch.rand(200, 2)], 1)
            guess = net.decode(y, seen, start)
            self.assertTrue(all(v.isfinite().all() and (k not in ("radiance", "bandwidths") or (v >= 0).all()) for k, v in guess.items()))
            if kind in (VisWinNet, InvWinNet):
                self.assertTrue(torch.allclose(guess["directions"].norm(dim=2), torch.ones(200, 3), atol=1e-3))
                self.assertLess((guess["half_x"] * guess["half_y"]).sum(1).abs().max().item(), 1e-3)

    def test_faces_tell_what_is_lit_from_where(self):
        """A floor, and a wall of another albedo before it: place and shading of each, whatever its albedo."""
        photo, albedo, geometry = torch.zeros(1, 3, 120, 160), torch.full((1, 3, 120, 160), 0.4), torch.zeros(1, 6, 120, 160)
        geometry[:, 1, 60:], geometry[:, 2, :60] = 1.0, 1.0
        geometry[:, 4, 60:], geometry[:, 5, :60] = -1.5, -4.0
        albedo[:, :, :60] = 0.8
        photo[:, :, 60:], photo[:, :, :60] = 0.4 * 0.5, 0.8 * 0.1
        light = torch.zeros(1, 1, 120, 160)
        share, place, shading = lights.faces(geometry, photo / albedo, 1 - light).view(7, 6, 4).split([1, 3, 3])
        up, towards = 1, 2
        self.assertTrue(
            torch.allclose(share[0, up], torch.tensor([0.0, 0, 1, 1])) and torch.allclose(share[0, towards], torch.tensor([1.0, 1, 0, 0]))
        )
        self.assertTrue(
            torch.allclose(place[1, up, 2:], torch.tensor(-1.5), rtol=2e-3) and torch.allclose(place[2, towards, :2], torch.tensor(-4.0), rtol=2e-3)
        )
        self.assertTrue(torch.allclose(shading[:, up, 2:].exp(), torch.tensor(0.52), rtol=2e-3))
        self.assertTrue(torch.allclose(shading[:, towards, :2].exp(), torch.tensor(0.12), rtol=2e-3))

    def test_a_lamp_alone_is_told_at_its_level(self):
        """A wall lit by a small lamp, as the closed form has it: the head starts from the level that the lamp has."""
        net, level = VisLampNet(), torch.tensor([0.2, 0.4, 0.8])
        y, x = torch.meshgrid(torch.linspace(1.2, -1.2, 120), torch.linspace(-1.6, 1.6, 160), indexing="ij")
        wall = torch.stack([0 * x, 0 * x, 0 * x + 1, x, y, 0 * x - 3])[None]
        start = torch.tensor([0.3, 0.2, -2.2, 0.02, 0.02]).view(1, 5, 1, 1)
        lamp = {"centre": start[:, :3, 0, 0], "axes": 0.02 * torch.eye(3)[None], "radiance": torch.ones(1, 1, 3)}
        plain = net.shading(lamp, wall[:, 3:].flatten(2).mT, wall[:, :3].flatten(2).mT).mT.unflatten(2, (120, 160))
        unit = lights.spread(lamp["centre"], torch.ones(1, 1)) / 0.02**2 / 6
        albedo, none = torch.full((1, 3, 120, 160), 0.5), torch.zeros(1, 2, 120, 160)
        _, seen = net.numbers(0.5 * plain * unit * level.view(1, 3, 1, 1), wall, albedo, none, start)
        self.assertTrue(torch.allclose(seen.alone[0] / level, (seen.alone[0] / level).mean().expand(3), rtol=1e-3))
        self.assertAlmostEqual((seen.alone[0] / level).mean().item(), 1 / math.pi, delta=0.02)
        self.assertTrue(torch.allclose(seen.spot[0], torch.tensor([0.3, 0.2, -3.0]), atol=0.2), seen.spot)

    def test_calibration_finds_the_share_that_burns_and_the_error_to_expect(self):
        """Of a head that says 2 too much with logits thrice too sure, and whose error is half of what it expects."""
        g = torch.Generator().manual_seed(0)
        logit = 6 * torch.randn(4000, generator=g)
        there = (torch.rand(4000, generator=g) < torch.sigmoid(logit / 3 - 2)).float()
        guess = torch.randn(4000, generator=g)
        net = InvLampNet()
        net.confidences = lambda rooms: (logit, there, guess, guess + math.log(0.5))
        net.calibrate(None)
        a, b, c, d = net.calibration.tolist()
        self.assertTrue(abs(a - 1 / 3) < 0.05 and abs(b + 2) < 0.2 and abs(c - 1) < 0.02 and abs(d - math.log(0.5)) < 0.02, net.calibration)
        told = net.reliability(None)
        self.assertLess(told["burns, Brier"], told["burns, Brier before calibration"])
        self.assertLess(told["error, trusted half"], told["error, other half"])
        for half in ("trusted half", "other half"):
            self.assertAlmostEqual(told[f"expected error, {half}"], told[f"error, {half}"], delta=0.05 * told[f"error, {half}"])

    def test_relighting_by_one_changes_nothing_and_by_nothing_darkens(self):
        rooms = self.rooms
        plain = lights.relight(rooms, 0, 0, {})
        same = lights.relight(rooms, 0, 0, {p: 1.0 for p in range(len(rooms.paths[0]))})
        surface = (1 - plain["lights"][:1]) > 0
        self.assertTrue(torch.allclose(torch.where(surface, same["photo"], 0), torch.where(surface, plain["photo"], 0), rtol=1e-3))
        path = lights.parts(rooms.paths[0])
        dark = lights.relight(rooms, 0, 0, {path["lamp_0"]: 0.0})
        self.assertEqual(dark["shading"].max().item(), 0.0)
        self.assertEqual(dark["there"].item(), 0.0)
        self.assertTrue((torch.where(surface, dark["photo"] - plain["photo"], 0) <= 1e-6).all())

    def test_paths_name_their_sources(self):
        names = ["lamp_0", "window_0.sun", "window_0.sky+ground+lamp_1"]
        self.assertEqual(
            lights.parts(names),
            {"lamp_0": 0, "window_0.sun": 1, "window_0.sky": 2, "window_0.ground": 2, "lamp_1": 2},
        )

    def test_steps_lower_the_loss_of_a_batch(self):
        for kind in (MNet, VisLampNet, InvLampNet, InvWinNet):
            torch.manual_seed(0)
            net = kind()
            batch = kind.batch(self.rooms, torch.Generator().manual_seed(4), 2)
            optimizer = torch.optim.Adam(net.parameters(), 1e-3)
            losses = []
            for _ in range(6):
                optimizer.zero_grad()
                loss = net.loss(batch)
                loss.backward()
                optimizer.step()
                losses.append(loss.item())
            self.assertLess(losses[-1], losses[0], kind.__name__)


if __name__ == "__main__":
    unittest.main()
