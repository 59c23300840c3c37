"""Takes a photo of a linear picture.

usage: photograph.py IN.exr OUT.png|OUT.jpg [--seed N] [--exposure GAIN]

The camera is drawn from the fitted distribution by the seed. The exposure is automatic unless
given: 98 % of the pixels below 0.95 of white."""

import argparse
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import OpenEXR
from PIL import Image

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from camera import model  # noqa: E402


def read(path):
    """Returns the linear picture [h, w, 3] of an OpenEXR file."""
    with OpenEXR.File(str(path), separate_channels=True) as file:
        channels = file.channels()
        return np.stack([np.asarray(channels[k].pixels, np.float64) for k in "RGB"], -1)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("input", metavar="IN.exr")
    parser.add_argument("output", metavar="OUT.png|OUT.jpg")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--exposure", type=float)
    a = parser.parse_args()
    picture, rng = read(a.input), np.random.default_rng(a.seed)
    gain = a.exposure or model.auto_exposure(picture, np.ones(picture.shape[:2], bool))
    camera = replace(model.sample(rng), exposure=float(gain))
    print(camera)
    Image.fromarray(model.photograph(picture, camera, rng).stored).save(a.output, **({"quality": 100} if a.output.endswith(".jpg") else {}))
