"""Closed forms of the camera, and NumPy beside torch: python -m unittest discover training/camera"""

import sys
import unittest
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from camera import batched, depth, model  # noqa: E402

H, W = 48, 64


def picture(seed, h=H, w=W):
    """A linear picture with bright spots."""
    rng = np.random.default_rng(seed)
    x = rng.random((h, w, 3)) ** 2
    x[h // 3 : h // 2, w // 4 : w // 3] = 30
    return x


def scene_depth(seed, h=H, w=W):
    """A wall at 3 m with near boxes."""
    rng = np.random.default_rng(seed)
    z = np.full((h, w), 3.0) + 0.01 * rng.random((h, w))
    z[h // 4 : h // 2, w // 4 : w // 2] = 1.2
    z[h // 2 :, w // 2 :] = 2.1
    return z


def batch(arrays):
    """[h, w, c] or [h, w] to [B, C, h, w], in double precision."""
    return torch.stack([torch.from_numpy(np.moveaxis(a, -1, 0) if a.ndim == 3 else a[None]) for a in arrays])


class Alike(unittest.TestCase):
    """The torch version of each stage against NumPy's, on two items with parameters of their own."""

    def setUp(self):
        rng = np.random.default_rng(5)
        self.cameras = [replace(model.sample(rng), exposure=0.7), replace(model.sample(rng), exposure=1.3)]
        self.pictures = [picture(1), picture(2)]
        self.noises = [rng.standard_normal((H, W, 3)) for _ in range(2)]
        self.stacked = batched.stack(self.cameras, torch.float64)

    def same(self, want, got):
        self.assertLess((batch(want) - got).abs().max().item(), 1e-4)

    def test_each_stage_of_the_camera(self):
        stages = {
            "glare": ("glare", "glare_slope"),
            "vignette": ("vignetting",),
            "expose": ("exposure",),
            "balance": ("white_balance",),
            "clip": ("saturation",),
            "blur_chroma": ("chroma_blur",),
            "sharpen": ("sharpening",),
            "tone": ("saturation",),
            "jpeg": ("jpeg_quality",),
        }
        for stage, names in stages.items():
            with self.subTest(stage=stage):
                x = [model.encode(p) if stage == "jpeg" else p for p in self.pictures]
                want = [getattr(model, stage)(p, *(getattr(c, n) for n in names)) for p, c in zip(x, self.cameras)]
                self.same(want, getattr(batched, stage)(batch(x), *(getattr(self.stacked, n) for n in names)))
        soft = [model.soften(p, c.softness) for p, c in zip(self.pictures, self.cameras)]
        self.same(soft, batched.blurred(batch(self.pictures), self.stacked.softness))
        self.same([model.encode(p) for p in self.pictures], batched.encode(batch(self.pictures)))
        self.same([model.decode(p / 30) for p in self.pictures], batched.decode(batch(self.pictures) / 30))

    def test_jpeg_of_pictures_whose_pixels_share_chroma(self):
        x = [model.encode(picture(k, 40, 330)) for k in range(2)]
        self.same([model.jpeg(p, c.jpeg_quality) for p, c in zip(x, self.cameras)], batched.jpeg(batch(x), self.stacked.jpeg_quality))

    def test_noise(self):
        want = [
            model.add_noise(p, model.correlate(n, c.grain), c.shot_noise, c.read_noise, c.white_balance)
            for p, n, c in zip(self.pictures, self.noises, self.cameras)
        ]
        c = self.stacked
        grain = batched.correlate(batch(self.noises), c.grain)
        self.same(want, batched.add_noise(batch(self.pictures), grain, c.shot_noise, c.read_noise, c.white_balance))

    def test_the_whole_camera(self):
        received = [model.incident(p, c) for p, c in zip(self.pictures, self.cameras)]
        self.same(received, batched.incident(batch(self.pictures), self.stacked))
        stored = [model.develop(r, c, n) for r, n, c in zip(received, self.noises, self.cameras)]
        self.same(stored, batched.develop(batch(received), self.stacked, batch(self.noises)))

    def test_depth_of_a_sensor(self):
        rng = np.random.default_rng(7)
        for width in (640, 32):
            sensors = [replace(depth.DepthSensor(), width=width), replace(depth.DepthSensor(), width=width, noise=0.6, bleeding=0.02, shadow=0.4)]
            z = [scene_depth(1), scene_depth(2)]
            noises = [depth.sensor_noise(rng, H, W, s) for s in sensors]
            surface = [rng.random((H, W)) for _ in z]
            want = [depth.sensor_depth(*item, albedo=a, roughness=a, cosine=a) for *item, a in zip(z, sensors, noises, surface)]
            noise = depth.SensorNoise(
                torch.stack([torch.from_numpy(n.shift) for n in noises]), batch([n.disparity for n in noises]), batch([n.patches for n in noises])
            )
            a = batch(surface)
            got = batched.sensor_depth(batch(z), batched.stack(sensors, torch.float64), noise, a, a, a)
            self.assertTrue(torch.equal(batch(want).isnan(), got.isnan()))
            self.same([np.nan_to_num(w) for w in want], got.nan_to_num())

    def test_depth_of_a_network_and_ragged_masks(self):
        rng = np.random.default_rng(8)
        z, networks = [scene_depth(1), scene_depth(2)], [depth.sample_network(rng) for _ in range(2)]
        slow = [depth.network_noise(rng) for _ in range(2)]
        want = [depth.network_depth(*item) for item in zip(z, networks, slow)]
        self.same(want, batched.network_depth(batch(z), batched.stack(networks, torch.float64), batch(slow)))
        masks, flaws = [(x < 2).astype(float) for x in z], [replace(depth.sample_mask(rng), raggedness=0.03, spill=s) for s in (0.0, 0.05)]
        noises = [depth.mask_noise(rng) for _ in range(2)]
        noise = depth.MaskNoise(
            *(torch.stack([torch.from_numpy(getattr(n, name)) for n in noises]) for name in ("shift", "outline")), batch([n.parts for n in noises])
        )
        want = [depth.ragged_mask(*item) for item in zip(masks, flaws, noises)]
        self.assertTrue(torch.equal(batch(want), batched.ragged_mask(batch(masks), batched.stack(flaws, torch.float64), noise)))


class Camera(unittest.TestCase):
    def test_a_camera_without_flaws_stores_the_picture(self):
        x = np.random.default_rng(0).random((H, W, 3))
        stored = model.photograph(0.8 * x, model.Camera(), np.random.default_rng(0)).stored
        self.assertTrue(np.array_equal(stored, np.round(255 * model.encode(0.8 * x))))

    def test_exposure_is_linear_below_the_knee(self):
        x = 0.4 * np.random.default_rng(0).random((H, W, 3))
        camera = replace(model.sample(np.random.default_rng(1)), shot_noise=0.0, read_noise=0.0, sharpening=0.0, chroma_blur=0.0)
        linear = lambda gain: model.decode(model.develop(model.incident(x, replace(camera, exposure=gain)), camera, np.zeros_like(x)))
        self.assertLess(np.abs(2 * linear(0.5) - linear(1.0)).max(), 1e-9)

    def test_incident_light_is_the_sum_of_the_lights(self):
        camera = model.sample(np.random.default_rng(1))
        a, b = picture(1), picture(2)
        self.assertTrue(np.allclose(model.incident(a, camera) + model.incident(b, camera), model.incident(a + b, camera)))

    def test_glare_keeps_the_energy_and_a_uniform_picture(self):
        x = picture(3)
        self.assertAlmostEqual(model.glare(x, 0.1, 0.5).sum() / x.sum(), 1, places=9)
        self.assertTrue(np.allclose(model.glare(np.ones((H, W, 3)), 0.1, 0.5), 1))
        self.assertGreaterEqual(model.glare(x, 0.1, 0.5).min(), 0)

    def test_glare_of_a_point_falls_with_its_power(self):
        x = np.zeros((401, 801, 3))
        x[200, 400] = 1
        slope = 0.5
        row = model.glare(x, 0.1, slope)[200, 400:, 0]
        fall = np.log(row[200] / row[20]) / np.log(10)
        self.assertLess(abs(fall + 2 + slope), 0.3)

    def test_a_room_looks_alike_at_any_resolution(self):
        camera = replace(model.sample(np.random.default_rng(4)), shot_noise=0.0, read_noise=0.0)
        small = np.kron(picture(1, 15, 20), np.ones((4, 4, 1)))
        large = np.kron(small, np.ones((4, 4, 1)))
        down = lambda x: x.reshape(60, 4, 80, 4, 3).mean((1, 3))
        # The blur of small pixels inside large ones is the blur of large ones but for the order of two averages.
        got, want = down(model.incident(large, camera)), model.incident(small, camera)
        self.assertLess(np.abs(got - want).mean() / want.mean(), 0.03)

    def test_variance_of_shot_noise_is_proportional_to_the_signal(self):
        noise = np.random.default_rng(0).standard_normal((480, 640, 3))
        grain = model.correlate(noise, 0.0012)
        self.assertLess(abs(grain.var() - 1), 0.02)
        levels = [(model.add_noise(np.full_like(noise, s), grain, 1e-4, 0.0, (1, 1, 1)) - s)[..., 1].var() / s for s in (0.01, 0.1, 0.5)]
        self.assertTrue(np.allclose(levels, 1e-4, rtol=0.02), levels)

    def test_noise_of_a_half_sized_picture_is_that_of_the_picture_reduced(self):
        noise = lambda h, w: model.correlate(np.random.default_rng(0).standard_normal((h, w, 3)), 0.0012)
        reduced = noise(480, 640).reshape(240, 2, 320, 2, 3).mean((1, 3))
        self.assertLess(abs(reduced.std() / noise(240, 320).std() - 1), 0.15)

    def test_clipping_saturates_and_white_is_white(self):
        for saturation in (1.0, 1.4, 2.5):
            x = np.array([saturation - 1e-3, saturation, saturation + 1, 1e4])
            stored = model.tone(model.clip(x, saturation), saturation)
            self.assertTrue((stored[1:] == 1).all())
            self.assertGreaterEqual(round(255 * stored[0]), 254)

    def test_the_tone_curve_rises_and_is_the_identity_below_the_knee(self):
        x = np.linspace(0, 3, 3001)
        for saturation in (1.0, 1.4, 2.5):
            y = model.tone(x, saturation)
            self.assertTrue((np.diff(y) >= 0).all())
            self.assertTrue(np.allclose(y[x <= model.KNEE], x[x <= model.KNEE]))
            self.assertLess(abs(np.diff(y).max() - 1e-3), 1e-6)  # never steeper than the identity

    def test_the_model_of_jpeg_is_near_to_libjpeg(self):
        y, x = np.mgrid[0:480, 0:640] / 640
        stored = np.stack([0.5 + 0.3 * np.sin(20 * x + 9 * y), 0.4 + 0.2 * np.cos(31 * y), 0.5 + 0.2 * np.sin(40 * x * y)], -1)
        stored = np.round(255 * np.clip(stored + 0.03 * np.random.default_rng(0).standard_normal(stored.shape), 0, 1))
        real = model.decoded(stored.astype(np.uint8), replace(model.Camera(), jpeg_quality=75)).astype(float)
        modeled = 255 * model.jpeg(stored / 255, 75)
        self.assertLess(np.sqrt(((modeled - real) ** 2).mean()), 0.3 * np.sqrt(((real - stored) ** 2).mean()))

    def test_gradients_reach_the_radiance(self):
        x = batch([picture(1)]).requires_grad_()
        camera = batched.stack([model.sample(np.random.default_rng(0))], torch.float64)
        batched.photograph(x, camera, torch.zeros_like(x)).sum().backward()
        self.assertTrue(x.grad.isfinite().all() and (x.grad != 0).any())

    def test_a_seed_gives_the_same_photo_with_any_number_of_threads(self):
        threads, photos = torch.get_num_threads(), []
        for count in (1, 2):
            torch.set_num_threads(count)
            g = torch.Generator().manual_seed(3)
            x = batch([picture(1), picture(2)]).float()
            photos.append(batched.photograph(x, batched.sampled(g, 2), torch.randn(x.shape, generator=g)))
        torch.set_num_threads(threads)
        self.assertTrue(torch.equal(*photos))
        take = lambda: model.photograph(picture(1), model.sample(np.random.default_rng(1)), np.random.default_rng(2)).stored
        self.assertTrue(np.array_equal(take(), take()))


class Depth(unittest.TestCase):
    def test_steps_grow_with_the_square_of_the_distance(self):
        sensor = replace(depth.DepthSensor(), noise=0.0)
        for z in (1.0, 2.0, 4.0):
            got = np.unique(depth.steps(np.linspace(0.95 * z, 1.05 * z, 20000), 0.0, sensor))
            self.assertLess(abs(np.median(np.diff(got)) / (z * z * sensor.step / sensor.base) - 1), 0.03)

    def test_the_shadow_of_a_near_thing_is_as_wide_as_the_disparities_differ(self):
        z = np.full((4, 640), 3.0)
        z[:, 100:200] = 1.0
        shadow = depth.occluded(z, 0.068)
        self.assertEqual(shadow[:, :200].sum(), 0)
        self.assertLessEqual(abs(shadow[0].sum() - 640 * 0.068 * (1 - 1 / 3)), 2)

    def test_holes_lie_beside_edges_and_on_dark_things(self):
        sensor, rng = depth.DepthSensor(), np.random.default_rng(0)
        wall = np.full((H, W), 2.5)
        self.assertFalse(np.isnan(depth.sensor_depth(wall, sensor, depth.sensor_noise(rng, H, W, sensor))).any())
        albedo = np.where(np.arange(W) < 20, 0.001, 0.5) * np.ones((H, 1))
        hole = np.isnan(depth.sensor_depth(wall, sensor, depth.sensor_noise(rng, H, W, sensor), albedo=albedo))
        self.assertTrue(hole[:, :20].all() and not hole[:, 20:].any())

    def test_a_network_without_flaws_gives_the_depth(self):
        network = depth.DepthNetwork(0.0, 0.0, 0.0)
        self.assertTrue(np.allclose(depth.network_depth(scene_depth(0), network, np.ones(depth.SLOW)), scene_depth(0)))

    def test_smooth_noise_has_unit_variance(self):
        rng = np.random.default_rng(0)
        self.assertLess(abs(np.var([depth.smooth(rng.standard_normal(depth.SLOW), 12, 16) for _ in range(400)]) - 1), 0.1)

    def test_a_mask_without_flaws_is_the_mask(self):
        mask = (scene_depth(0) < 2).astype(float)
        self.assertTrue(np.array_equal(depth.ragged_mask(mask, depth.MaskFlaws(0.0, 0.0, 9.0), depth.mask_noise(np.random.default_rng(0))), mask))


    def test_a_mask_that_spills_is_wider_by_that_much(self):
        mask = np.zeros((H, 200))
        mask[:, 100:] = 1
        drawn = depth.ragged_mask(mask, depth.MaskFlaws(0.0, 0.0, 9.0, 0.03), depth.mask_noise(np.random.default_rng(0)))
        self.assertLessEqual(abs((drawn - mask)[H // 2].sum() - 0.03 * 200), 1)


if __name__ == "__main__":
    unittest.main()
