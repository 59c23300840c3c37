"""python -m unittest discover training/rooms: the manifest and the making of rooms in the background, without a renderer."""

import argparse
import itertools
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
import unittest
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "demo"))
import farm
import manifest


class Crash(Exception):
    pass


class Farms(unittest.TestCase):
    def setUp(self):
        place = tempfile.TemporaryDirectory()
        self.addCleanup(place.cleanup)
        self.out = Path(place.name)
        self.made = []

    def render(self, seed, scene, folder, maps):
        self.made.append(farm.name(seed, scene))
        if seed == 3:
            return None  # nothing is seen
        (folder / "room.json").write_text(json.dumps(dict(seed=seed, scene=scene or "generated")))
        (folder / "truth.npz").write_bytes(b"truth %d" % seed)
        return folder

    @staticmethod
    def pack(folder):
        (folder / "sample.npz").write_bytes(b"sample")

    def farm(self, **other):
        return farm.Farm(self.out, "train", **dict(render=self.render, pack=self.pack, free=lambda path: 1e12) | other)

    def queue(self):
        return farm.jobs({"generated": 1}, [])

    def test_a_run_goes_on_where_it_stopped_and_deletes_nothing(self):
        self.assertEqual(self.farm().run(self.queue(), count=2), farm.STOP)
        kept = self.out / "train/000000/truth.npz"
        kept.write_bytes(b"touched")
        (self.out / "train/.000002").mkdir()
        (self.out / "train/.000002/rest").write_text("of a crash")
        self.farm().run(self.queue(), count=3)
        self.assertEqual(self.made, ["000000", "000001", "000002", "000003", "000004"])
        self.assertEqual(kept.read_bytes(), b"touched")
        self.assertFalse((self.out / "train/000002/rest").exists())
        self.assertTrue((self.out / "train/000003/skipped").exists())
        self.farm().run(self.queue(), count=1)
        self.assertEqual(self.made[5:], ["000005"])

    def test_a_room_without_its_sample_is_packed_and_not_rendered_again(self):
        def fails(folder):
            raise Crash

        with self.assertRaises(Crash):
            self.farm(pack=fails).run(self.queue())
        self.farm().run(self.queue(), count=1)
        self.assertEqual(self.made, ["000000"])
        self.assertTrue((self.out / "train/000000/sample.npz").exists())

    def test_a_room_that_always_fails_is_passed_over(self):
        def fails(seed, scene, folder, maps):
            if seed == 0:
                raise Crash
            return self.render(seed, scene, folder, maps)

        for _ in range(farm.TRIES):
            with self.assertRaises(Crash):
                self.farm(render=fails).run(self.queue())
        self.farm(render=fails).run(self.queue(), count=1)
        self.assertEqual(self.made, ["000001"])

    def test_a_stop_file_and_a_full_disk_end_a_run(self):
        self.assertEqual(self.farm(free=lambda path: farm.FLOOR - 1).run(self.queue()), farm.FULL)
        (self.out / "farm.stop").touch()
        self.assertEqual(self.farm().run(self.queue()), farm.STOP)
        self.assertEqual(self.made, [])

    def test_the_mix(self):
        some = list(itertools.islice(farm.jobs({"generated": 2, "people": 1}, ["hall", "attic"]), 6))
        self.assertEqual(some, [(0, None), (1, None), (0, "hall"), (2, None), (3, None), (1, "attic")])
        self.assertEqual(next(farm.jobs({"people": 1}, [])), (0, None))
        self.assertEqual(farm.name(7, "hall"), "hall_000007")
        self.assertEqual(sum(farm.has_maps(seed, 0.1) for seed in range(1000)), 100)

    def test_scenes_are_those_that_there_are(self):
        self.assertEqual(farm.parse_scenes("staircase2,bathroom2"), ["staircase2", "bathroom2"])
        self.assertEqual(farm.parse_scenes(""), [])
        with self.assertRaisesRegex(argparse.ArgumentTypeError, "'attic'"):
            farm.parse_scenes("bathroom2,attic")

    def test_the_manifest_verifies_digests_and_outlives_torn_lines(self):
        self.farm().run(self.queue(), count=2)
        with open(self.out / "manifest.jsonl", "a") as log:
            log.write('{"room": "train/0000')
        self.farm().run(self.queue(), count=1)
        lines = manifest.read(self.out)
        self.assertEqual(len(lines), 6)
        self.assertEqual(lines["train/000002", "truth.npz"]["seed"], 2)
        self.assertEqual(manifest.verify(self.out), [])
        (self.out / "train/000001/truth.npz").write_bytes(b"other")
        self.assertEqual(manifest.verify(self.out), ["train/000001/truth.npz"])

    def test_one_process_at_a_time_holds_a_folder(self):
        held = farm.lock(self.out)
        self.assertIsNone(farm.lock(self.out))
        self.assertEqual(farm.running(self.out), os.getpid())
        held.close()
        self.assertIsNone(farm.running(self.out))

    def test_a_signal_stops_a_farm_whose_workers_crash(self):
        assets = self.out / "no assets"  # each worker fails at once
        command = [sys.executable, farm.__file__, "run", "--out", self.out, "--assets", assets]
        process = subprocess.Popen([str(c) for c in command], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
        for _ in range(300):
            if farm.running(self.out):
                break
            time.sleep(0.1)
        time.sleep(0.3)
        process.send_signal(signal.SIGTERM)
        told, _ = process.communicate(timeout=60)
        self.assertEqual(process.returncode, 0)
        self.assertIn("stopped", told)


if __name__ == "__main__":
    unittest.main()
