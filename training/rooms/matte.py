"""Mitsuba's picture of the rooms of plain.py, not denoised, for second.py: rooms/matte.py FOLDER... [--assets .cache/assets] [--spp 256]"""

import mitsuba as mi
import numpy as np

import plain
import scene as scenes  # sets Mitsuba's variant
import truth

if __name__ == "__main__":
    for folder, facts, room, spp in plain.rooms(__doc__):
        scene, view = scenes.Lit(room).scene(dict.fromkeys(facts["names"])), truth.View.of(facts["view"])
        passes = [truth.raw_photo(scene, view, 64, seed, 8) for seed in range(spp // 64)]
        np.savez_compressed(folder / "matte.npz", matte=(np.mean(passes, 0) * np.array(facts["gain"])).astype(np.float32))
