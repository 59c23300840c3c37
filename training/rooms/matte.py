"""Mitsuba's picture of rooms without gloss and sun, not denoised, for second.py: rooms/matte.py FOLDER... [--assets .cache/assets] [--spp 256]"""

import argparse
import json
import sys
from pathlib import Path

import mitsuba as mi
import numpy as np

mi.set_variant("llvm_ad_rgb")
HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent / "demo"))
import layout  # noqa: E402
import scene as scenes  # noqa: E402
import truth  # noqa: E402
from assets import Library  # noqa: E402
from make import SPLITS  # noqa: E402


def main():
    ask = argparse.ArgumentParser(description=__doc__)
    ask.add_argument("folders", type=Path, nargs="+")
    ask.add_argument("--assets", type=Path, default=Path(".cache/assets"))
    ask.add_argument("--spp", type=int, default=256)
    args = ask.parse_args()
    library = Library.load(args.assets)
    for folder in args.folders:
        part = library.only(SPLITS[folder.parent.name][1])
        facts = json.loads((folder / "room.json").read_text())
        room, _ = layout.make(facts["seed"], part)
        room.parts = [(*part[:4], np.ones(len(part[4]))) for part in room.parts]
        for window in room.windows:
            window.lobes = [lobe for lobe in window.lobes if lobe[0] != "sun"]
        lit = scenes.Lit(room)
        view = truth.View.of(facts["view"])
        scene = lit.scene(list(facts["names"]))
        passes = [truth.raw_photo(scene, view, 64, seed, 8) for seed in range(args.spp // 64)]
        np.savez_compressed(folder / "matte.npz", matte=(np.mean(passes, 0) * np.array(facts["gain"])).astype(np.float32))


if __name__ == "__main__":
    main()
