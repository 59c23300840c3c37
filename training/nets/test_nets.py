"""Closed forms of the maths that training rests on: python -m unittest discover training/nets"""

import os
import tempfile
import unittest

import numpy as np
import torch

import augment
import flux
import hemisphere
import place
import synthetic
from data import Rooms, rooms_of
from indirectnet import IndirectNet
from lightnet import LightNet
from mnet import MNet
from shadownet import ShadowNet, combine, evidence, ways


class Hemisphere(unittest.TestCase):
    def test_solid_angles_fill_the_hemisphere(self):
        d, angle = hemisphere.texels()
        self.assertAlmostEqual(angle.sum().item(), 2 * np.pi, places=5)
        self.assertTrue(torch.allclose(d.norm(dim=1), torch.ones(128)))

    def test_a_constant_environment_has_its_radiance_as_shading(self):
        self.assertTrue(torch.allclose(hemisphere.shading(torch.full((5, 128, 3), 0.7)), torch.full((5, 3), 0.7), atol=1e-6))

    def test_frames_are_right_handed_and_orthonormal(self):
        n = torch.nn.functional.normalize(torch.cat([torch.randn(50, 3), torch.tensor([[0.0, 1, 0], [0, -1, 0], [0.01, 1, 0]])]), dim=1)
        f = hemisphere.frame(n)
        self.assertTrue(torch.allclose(f @ f.mT, torch.eye(3).expand(53, 3, 3), atol=1e-5))
        self.assertTrue(torch.allclose(torch.linalg.det(f), torch.ones(53), atol=1e-5))
        self.assertTrue((f[n[:, 1].abs() <= 0.99, 1, 1] > 0).all())

    def test_a_gaussian_shows_its_weight_along_its_axis_and_the_closed_form_elsewhere(self):
        d, _ = hemisphere.texels()
        got = hemisphere.draw(d[None, 37:38], torch.tensor([[20.0]]), torch.tensor([[[1.0, 2.0, 3.0]]]))[0]
        self.assertTrue(torch.allclose(got[37], torch.tensor([1.0, 2.0, 3.0])))
        self.assertTrue(torch.allclose(got[60], torch.exp(20 * (d[37] @ d[60] - 1)) * torch.tensor([1.0, 2.0, 3.0])))

    def test_the_integral_of_a_gaussian_is_the_closed_form(self):
        d, angle = hemisphere.texels()
        got = (hemisphere.draw(torch.tensor([[[0.0, 0.0, 1.0]]]), torch.tensor([[9.0]]), torch.ones(1, 1, 3))[0, :, 0] * angle).sum()
        want = 2 * np.pi / 9 * (1 - np.exp(-9))  # over the hemisphere about its axis
        self.assertLess(abs(got.item() - want), 0.02 * want)  # the midpoint rule on texels of 11 degrees


class Flux(unittest.TestCase):
    def test_lamps_are_pi_times_their_area(self):
        box = {"kind": "Box", "half_axes": [[0.5, 0, 0], [0, 0.5, 0], [0, 0, 0.5]]}
        rect = {"kind": "Rect", "half_x": [0.5, 0, 0], "half_y": [0, 0.5, 0]}
        mesh = {"kind": "Mesh", "triangles": [[[0, 0, 0], [1, 0, 0], [0, 1, 0]]]}
        for light, area in (box, 6), (rect, 1), (mesh, 0.5), ({"kind": "Sphere", "radius": 1}, 4 * np.pi):
            self.assertAlmostEqual(flux.flux({"x": light}, "x"), np.pi * area, places=5)

    def test_lobes_of_a_window(self):
        """A uniform sky gives pi S; a sharp lobe along -n its integral 2 pi / lambda, at 60 degrees half of it."""
        for direction, bandwidth, want in (
            ([0, 0, -1], 1e-4, np.pi),
            ([0, 0, -1], 1e5, 2 * np.pi / 1e5),
            ([0, 0.75**0.5, -0.5], 1e5, np.pi / 1e5),
            ([0, 0, 1], 1e5, 0),
        ):
            pane = {
                "kind": "Window",
                "half_x": [0.5, 0, 0],
                "half_y": [0, 0.5, 0],
                "lobes": [{"name": "sky", "direction": direction, "bandwidth": bandwidth}],
            }
            self.assertLess(abs(flux.flux({"w": pane}, "w.sky") - want), 2e-3 * want + 1e-12)


class Place(unittest.TestCase):
    pane = {"kind": "Window", "center": [1, 2, 3], "half_x": [-1, 0, 0], "half_y": [0, 2, 0], "lobes": [{"name": "sun", "direction": [0, 3, 4]}]}

    def test_centres_axes_and_suns(self):
        lights = {"lamp_0": {"kind": "Mesh", "triangles": [[[0, 0, 0], [3, 0, 0], [0, 3, 0]]]}, "window_0": self.pane}
        for name, want in (
            ("lamp_0", [1, 1, 0] + 9 * [0]),
            ("window_0.sky", [1, 2, 3, -1, 0, 0, 0, 2, 0, 0, 0, 0]),
            ("window_0.sun", [1, 2, 3, -1, 0, 0, 0, 2, 0, 0, 0.6, 0.8]),
        ):
            np.testing.assert_allclose(place.place(lights, name), want, rtol=1e-6)

    def test_what_a_pixel_sees_of_a_window(self):
        """A pixel straight before a pane's upper edge, by sun along the pane's normal; the pane looks along -z."""
        pane = self.pane | {"lobes": [{"name": "sun", "direction": [0, 0, 1]}]}
        where = torch.from_numpy(place.place({"w": pane}, "w.sun")).view(1, 12, 1, 1)
        geometry = torch.tensor([0.0, 0, 1, 1, 4, -1]).view(1, 6, 1, 1)
        got = ways(geometry, where)[0, :, 0, 0]
        want = [0, 0, 1, 1, (1 / 3) / 20**0.5 / (1 + (1 / 3) / 20**0.5), 0, 0, -1, 0, 1, 1 / 20**0.5, 2 / 20**0.5]
        np.testing.assert_allclose(got, want, atol=2e-3)

    def test_a_mirrored_room_is_seen_mirrored(self):
        where = torch.from_numpy(place.place({"w": self.pane}, "w.sun")).view(1, 12, 1, 1) + 0.1
        geometry = torch.tensor([0.6, 0, 0.8, 0.5, 1, -1]).view(1, 6, 1, 1)
        flip = torch.tensor([-1.0, 1, 1])
        other = geometry * torch.cat([flip, flip]).view(1, 6, 1, 1)
        want = ways(geometry, where) * torch.tensor([-1.0, 1, 1, 1, 1, -1, 1, 1, -1, 1, 1, 1]).view(1, 12, 1, 1)
        np.testing.assert_allclose(ways(other, place.mirrored(where)), want, atol=1e-5)


class Augment(unittest.TestCase):
    def test_a_paint_is_the_same_wherever_it_is(self):
        albedo = torch.tensor([0.2, 0.7]).repeat(60, 80).expand(8, 3, -1, -1)
        painted = augment.repainted(torch.Generator().manual_seed(0), albedo)
        self.assertTrue(torch.equal(painted[..., 2:], painted[..., :-2]))
        changed = (painted != albedo).flatten(1).any(1)
        self.assertTrue(0 < changed.sum() < 8 and (painted <= 0.95).all())

    def test_mirrored_maps_are_maps_of_the_mirrored_room(self):
        """An environment L(d) about one normal, against L mirrored about the mirrored normal."""
        d, _ = hemisphere.texels()
        radiance = lambda world: torch.exp(world @ torch.tensor([0.8, 0.5, -0.3]))
        flip = torch.tensor([-1.0, 1.0, 1.0])
        for n in torch.nn.functional.normalize(torch.tensor([[0.3, 0.2, 0.9], [-0.9, -0.1, 0.2], [0.0, 1.0, 0.0]]), dim=1):
            here = radiance(d @ hemisphere.frame(n)).view(1, 1, 8, 16, 1)
            want = radiance(d @ hemisphere.frame(n * flip) * flip).view(1, 1, 8, 16, 1)
            self.assertTrue(torch.allclose(augment.mirrored_maps(here), want, atol=1e-5))

    def test_points_of_a_mirrored_depth_are_mirrored_points(self):
        depth, fov = 2 + torch.rand(1, 1, 120, 160), torch.tensor([57.0])
        self.assertTrue(torch.allclose(augment.xyz(depth.flip(-1), fov), augment.mirrored(augment.xyz(depth, fov), vector=True), atol=1e-5))

    def test_normals_of_a_plane(self):
        n = torch.nn.functional.normalize(torch.tensor([0.2, 0.5, 0.8]), dim=0)
        ray = augment.xyz(torch.ones(1, 1, 120, 160), torch.tensor([57.0]))
        points = ray * (-2.0 / (ray * n.view(1, 3, 1, 1)).sum(1, keepdim=True))
        got = augment.normals_of(points)[0, :, 2:-2, 2:-2]
        self.assertTrue(torch.allclose(got, n.view(3, 1, 1).expand_as(got), atol=1e-3))

    def test_worse_inputs_stay_inputs(self):
        g = torch.Generator().manual_seed(1)
        depth, albedo = 1 + torch.rand(4, 1, 120, 160), torch.rand(4, 3, 120, 160)
        self.assertTrue((augment.worse_depth(g, depth) > 0.3).all())
        self.assertTrue(((augment.worse_albedo(g, albedo) > 0) & (augment.worse_albedo(g, albedo) < 1)).all())

    def test_recolored_photos_keep_their_shading(self):
        g = torch.Generator().manual_seed(1)
        albedo = 0.1 + 0.6 * torch.rand(8, 3, 1, 4).repeat_interleave(8, 2).repeat_interleave(10, 3)
        shading = 0.2 + torch.rand(8, 1, 8, 40)
        photo, new = augment.recolored(g, albedo * shading, albedo)
        self.assertTrue(torch.allclose(photo / new, shading.expand(-1, 3, -1, -1), rtol=1e-4))
        self.assertTrue(((new >= 0.02) & (new <= 0.92)).all())
        # Pixels of one paint keep one paint, to rounding.
        stripes = new.view(8, 3, 8, 4, 10)
        self.assertTrue(torch.allclose(stripes, stripes[:, :, :1, :, :1].expand_as(stripes), rtol=1e-5))
        changed = (new != albedo).flatten(1).any(1)
        self.assertTrue(changed.any() and not changed.all())


class Nets(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.folder = tempfile.TemporaryDirectory()
        cls.addClassCleanup(cls.folder.cleanup)
        synthetic.write(cls.folder.name, 3)
        cls.rooms = Rooms(f"{cls.folder.name}/train")
        torch.manual_seed(3)

    def test_every_second_room_is_the_same_room(self):
        some = Rooms(self.rooms.split, every=2)
        self.assertEqual(some.names, self.rooms.names[::2])
        self.assertTrue(torch.equal(some.get("photo", 1), self.rooms.get("photo", 2)))
        self.assertTrue(torch.equal(some.get("direct", 1), self.rooms.get("direct", 2)))

    def test_a_scene_that_is_left_out_is_not_trained_on(self):
        with tempfile.TemporaryDirectory() as folder:
            synthetic.write(folder, 3)
            os.rename(f"{folder}/train/000001", f"{folder}/train/hall_000001")
            some = Rooms(f"{folder}/train", without=["hall"])
            self.assertEqual(some.names, ["000000", "000002"])
            self.assertTrue(torch.equal(some.get("direct", 1), self.rooms.get("direct", 2)))
            with self.assertRaisesRegex(SystemExit, "'attic'"):
                Rooms(f"{folder}/train", without=["attic"])

    def test_rooms_without_light_are_for_mnet_alone(self):
        with tempfile.TemporaryDirectory() as folder:
            synthetic.write(folder, 3)
            dark = f"{folder}/train/000001/sample.npz"
            with np.load(dark) as whole:
                sample = dict(whole)
            none = {k: sample[k][:0] for k in ["sources", "source_radiance", "direct", "shadow", "traced_direct", "traced", "unknown", "traced_indirect"]}
            none |= {"paths": sample["paths"][:0], "path_weights": sample["path_weights"][:0, :0], "indirect": sample["indirect"][:0]}
            np.savez(dark, **sample | none)
            self.assertEqual(len(rooms_of(MNet, f"{folder}/train")), 3)
            some = rooms_of(ShadowNet, f"{folder}/train")
            self.assertEqual(some.names, ["000000", "000002"])
            self.assertTrue(torch.equal(some.get("direct", 1), self.rooms.get("direct", 2)))

    def test_batches_follow_from_the_seed(self):
        for net in ShadowNet, IndirectNet, LightNet, MNet:
            one, other = (net.batch(self.rooms, torch.Generator().manual_seed(5), 2)["inputs"] for _ in range(2))
            self.assertTrue(all(torch.equal(a, b) for a, b in zip(one, other)))

    def test_where_all_is_known_and_trusted_the_traced_shadow_stands(self):
        x = ShadowNet.inputs(self.rooms, 0)["visibility"]
        x[:, 1] = 0
        shares = torch.rand(len(x), 3, 120, 160) * torch.tensor([1.0, 1, 0]).view(1, 3, 1, 1)
        self.assertTrue(torch.equal(combine(x, shares), x[:, :1]))

    def test_a_photo_leaves_each_light_its_own_shadow(self):
        """With all else known, what is left of the photo over the light's direct shading is its true visibility; of white pixels nothing."""
        shape = (1, 1, 120, 160)
        direct, shadow, traced, other = (torch.rand(shape) for _ in range(4))
        albedo, radiance = 0.1 + 0.8 * torch.rand(1, 3, 120, 160), torch.tensor([0.5, 0.4, 0.3]).view(1, 3, 1, 1)
        photo = albedo * (radiance * direct * shadow + other)
        x = {"photo": photo, "albedo": albedo, "radiance": radiance, "traced_direct": direct, "traced": traced}
        left, share = evidence(x, radiance * direct * traced + other).split(1, 1)
        known = photo.amax(1, keepdim=True) < 0.99
        self.assertTrue(torch.allclose(left, direct * shadow * known, atol=1e-4))
        self.assertTrue(((share > 0) == known).float().mean() > 0.999)

    @torch.no_grad()
    def test_exposure_of_the_photo_does_not_change_indirect_light(self):
        net, x = IndirectNet().eval(), IndirectNet.inputs(self.rooms, 0)
        brighter = {k: 8 * x[k] for k in ("left", "burning")}
        one, other = net(**x), net(**x | brighter)
        self.assertLess((one - other).abs().max() / one.max(), 1e-2)
        self.assertTrue(all(v.isfinite().all() for v in (one, net(**x | {k: 0 * x[k] for k in brighter}))))

    @torch.no_grad()
    def test_indirect_light_is_linear_and_not_negative(self):
        net, x = IndirectNet().eval(), IndirectNet.inputs(self.rooms, 0)
        other = {k: x[k].roll(1, 0) for k in ("direct", "flux")}
        apart, other_apart = net(**x), net(**x | other)
        both = net(**x | {k: 0.3 * x[k] + 200 * other[k] for k in other})
        self.assertLess((both - 0.3 * apart - 200 * other_apart).abs().max() / both.max(), 1e-5)
        self.assertTrue((apart >= 0).all())
        self.assertEqual(net(**x | {k: 0 * x[k] for k in other}).abs().max(), 0)

    @torch.no_grad()
    def test_one_color_of_light_does_not_touch_another(self):
        net, x = IndirectNet().eval(), IndirectNet.inputs(self.rooms, 0)
        red = {k: x[k] * torch.tensor([1.0, 0.0, 0.0]).view(1, 3, 1, 1) for k in ("direct", "flux")}
        self.assertTrue(torch.equal(net(**x | red)[:, 0], net(**x)[:, 0]))

    @torch.no_grad()
    def test_maps_scale_with_the_light(self):
        net, x = LightNet().eval(), LightNet.inputs(self.rooms, 0)
        one, ten = net.maps(*net(**x)), net.maps(*net(**x | {"shading": 10 * x["shading"]}))
        self.assertTrue(torch.allclose(ten, 10 * one, rtol=1e-3))


if __name__ == "__main__":
    unittest.main()
