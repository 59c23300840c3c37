"""Held-out rooms again, as two renderers can agree on them: without gloss (their gloss models differ) and without sun (Cycles cannot aim at a lobe behind
a pane, and would need a million samples)."""

import argparse
import json
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "demo"))
import layout  # noqa: E402
from assets import Library  # noqa: E402
from make import SPLITS  # noqa: E402


def rooms(about):
    """(folder, room.json, room, samples a pixel) of each folder on the command line; `about` is the script's help."""
    ask = argparse.ArgumentParser(description=about)
    ask.add_argument("folders", type=Path, nargs="+")
    ask.add_argument("--assets", type=Path, default=Path(".cache/assets"))
    ask.add_argument("--spp", type=int, default=256)
    args = ask.parse_args()
    library = Library.load(args.assets)
    for folder in args.folders:
        facts = json.loads((folder / "room.json").read_text())
        room, _ = layout.make(facts["seed"], library.only(SPLITS[folder.parent.name][1]))
        room.patterns = {}
        room.parts = [(*part[:4], np.full(len(part[4]), layout.MATTE)) for part in room.parts]
        for window in room.windows:
            window.lobes = [lobe for lobe in window.lobes if lobe[0] != "sun"]
        yield folder, facts, room, args.spp
