"""Draws the logs of runs.

usage: plot.py FILE.svg|png RUN ...

Left the training loss, then one panel per measure of val; all over minutes of training."""

import csv
import os
import sys

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt


def plot(file, runs):
    logs = {os.path.basename(os.path.normpath(run)): list(csv.DictReader(open(os.path.join(run, "log.csv")))) for run in runs}
    columns = list(dict.fromkeys(k for rows in logs.values() for k in rows[0] if k not in ("step", "seconds")))
    figure, panels = plt.subplots(1, len(columns), figsize=(3 * len(columns), 3), layout="constrained", squeeze=False)
    for panel, column in zip(panels[0], columns):
        for name, rows in logs.items():
            points = [(float(r["seconds"]) / 60, float(r[column])) for r in rows if r.get(column)]
            if points:
                panel.semilogy(*zip(*points), label=name)
        panel.set(title=column, xlabel="minutes")
        panel.legend()
    figure.savefig(file)


if __name__ == "__main__":
    if len(sys.argv) < 3:
        sys.exit(__doc__)
    plot(sys.argv[1], sys.argv[2:])
