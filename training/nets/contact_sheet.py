"""Inputs, prediction and truth of held-out rooms on one sheet.

usage: contact_sheet.py NAME --rooms DIR [--split val] [--count 6] [--out runs/NAME]       writes sheet.png into the run's folder"""

import argparse
import os

import matplotlib
import numpy as np
import torch

from data import rooms_of
from networks import NETWORKS, run_folder, trained

matplotlib.use("Agg")
import matplotlib.pyplot as plt


@torch.no_grad()
def sheet(name, rooms, split, count, run):
    net, _ = trained(name, run)
    held_out = rooms_of(net, os.path.join(rooms, split))
    rows = [net.pictures(held_out, room) for room in range(min(count, len(held_out)))]
    width = len(rows[0][1])
    figure, panels = plt.subplots(len(rows), width, figsize=(2.6 * width, 2.1 * len(rows)), layout="constrained", squeeze=False)
    for line, (title, planes) in zip(panels, rows):
        for panel, (caption, x) in zip(line, planes.items()):
            x = np.clip(x if x.ndim == 2 else np.moveaxis(x, 0, -1), 0, 1) ** (1 / 2.2)
            panel.imshow(x, cmap="gray", vmin=0, vmax=1)
            panel.set_title(caption, fontsize=8)
            panel.axis("off")
        line[0].set_title(f"{title}: {next(iter(planes))}", fontsize=8)
    figure.savefig(os.path.join(run, "sheet.png"), dpi=110)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("name", choices=NETWORKS)
    parser.add_argument("--rooms", required=True)
    parser.add_argument("--split", default="val")
    parser.add_argument("--count", type=int, default=6)
    parser.add_argument("--out")
    a = parser.parse_args()
    sheet(a.name, a.rooms, a.split, a.count, run_folder(a.name, a.out))
