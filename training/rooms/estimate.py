"""Adds to rooms what the program without networks takes them for, a floor for the networks that estimate:
rooms/estimate.py FOLDER [--relight target/release/relight].

For each FOLDER/*/sample.npz that has no estimates.npz beside it: graphs/estimate.ron, then graphs/planes.ron on the lights that it found.
estimates.npz: albedo [240, 320, 3]; lights (names), direct [L, 120, 160, 3] (unshadowed shading of each light), surface [L, 64, 3] (points on it, m),
radiance [L, 3] (of a lamp, or of sky and ground together)."""

import argparse
import json
import os
import sys
import tempfile
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "training/nets"))
import form  # noqa: E402
from pack import half, planes, run  # noqa: E402


def estimate(folder, relight):
    import OpenEXR

    with tempfile.TemporaryDirectory() as out:
        run(relight, "estimate.ron", folder, out, "--only", "estimates")
        lights = json.loads(Path(out, "lights.json").read_text())
        with OpenEXR.File(str(Path(out, "albedo.exr"))) as file:
            albedo = file.channels()["RGB"].pixels
        got = planes(folder, relight, "--set", f'known.path="{out}/lights.json"')
        (folder / "planes.exr").unlink()
    direct, radiance = [], []
    for name, light in lights.items():
        lobes = [lobe["radiance"] for lobe in light["lobes"]] if "lobes" in light else [light["radiance"]]
        direct.append(sum(half(got[f"direct_{name}_{k}.Y"])[..., None] * np.array(w, np.float32) for k, w in enumerate(lobes)))
        radiance.append(np.sum(lobes[-2:], 0))
    unfinished = folder / ".estimates.npz"
    np.savez_compressed(
        unfinished,
        albedo=albedo.astype(np.float16),
        lights=np.array(list(lights)),
        direct=np.clip(direct, 0, 60000).astype(np.float16).reshape(-1, 120, 160, 3),
        surface=np.array([form.surface(light) for light in lights.values()], np.float32).reshape(-1, form.POINTS, 3),
        radiance=np.array(radiance, np.float32).reshape(-1, 3),
    )
    os.replace(unfinished, folder / "estimates.npz")


def main():
    ask = argparse.ArgumentParser(description=__doc__)
    ask.add_argument("folder", type=Path)
    ask.add_argument("--relight", type=Path, default=ROOT / "target/release/relight")
    args = ask.parse_args()
    for folder in sorted(f.parent for f in args.folder.glob("[!.]*/sample.npz")):
        if not (folder / "estimates.npz").exists():
            estimate(folder, args.relight)
            print(folder / "estimates.npz", flush=True)


if __name__ == "__main__":
    main()
