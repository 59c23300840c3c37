"""Measures a trained network on held-out rooms, beside floors that need no training.

usage: evaluate.py NAME --rooms DIR [--split val] [--out runs/NAME]

Prints a table and the targets, and writes evaluation.json and evaluation.md into the run's folder. Floors that need a mean are taken from DIR/train.
indirectnet is also held against squashedindirectnet where the evaluation of that lies beside it. Exit status 1 when a target is missed."""

import argparse
import json
import math
import os
import sys

import torch


@torch.no_grad()
def measure(net, rooms, chosen, floors=None):
    """{estimate: {measure: mean over items}} of the rooms `chosen`; what an item cannot tell does not count."""
    values = {}
    for room in chosen:
        for item in net.score(rooms, room, floors):
            for estimate, measures in item.items():
                for k, v in measures.items():
                    values.setdefault(estimate, {}).setdefault(k, []).append(v)
    if not values:
        raise SystemExit(f"{type(net).__name__}: wanted rooms with what it estimates, got none among {len(chosen)}")
    known = lambda v: [x for x in v if not math.isnan(x)]
    return {e: {k: sum(known(v)) / len(known(v)) if known(v) else math.nan for k, v in measures.items()} for e, measures in values.items()}


def table(result):
    columns = list(dict.fromkeys(k for measures in result.values() for k in measures))
    lines = ["| | " + " | ".join(columns) + " |", "| --- " * (len(columns) + 1) + "|"]
    return "\n".join(lines + [f"| {e} | " + " | ".join(f"{m[k]:.3g}" if k in m else "" for k in columns) + " |" for e, m in result.items()])


def targets(net, result):
    """Lines (text, value, limit); a target whose numbers are not there is left out."""
    lines = []
    for text, value, limit in net.targets:
        try:
            lines.append((text, value(result), limit))
        except KeyError:
            pass
    return lines


def evaluate(name, rooms, split, run):
    from data import rooms_of
    from networks import trained

    net, about = trained(name, run)
    held_out, train = (rooms_of(net, os.path.join(rooms, s)) for s in (split, "train"))
    result = measure(net, held_out, range(len(held_out)), net.floors(train))
    yardstick = os.path.join(os.path.dirname(os.path.normpath(run)), "squashedindirectnet", "evaluation.json")
    if name == "indirectnet" and os.path.exists(yardstick):
        result["squashedindirectnet"] = json.load(open(yardstick))["result"]["network"]
    lines = targets(net, result)
    trust = net.reliability(held_out) if hasattr(net, "reliability") else {}
    text = (
        table(result)
        + ("\n\n" + table({"confidence": trust}) if trust else "")
        + "\n\n| target | got | limit |\n| --- | --- | --- |\n"
        + "\n".join(f"| {t} | {v:.3g} | {limit:g} |" for t, v, limit in lines)
        + "\n"
    )
    json.dump(
        {"run": about, "split": split, "rooms": len(held_out), "result": result, "confidence": trust, "targets": lines},
        open(os.path.join(run, "evaluation.json"), "w"),
        indent=1,
    )
    open(os.path.join(run, "evaluation.md"), "w").write(text)
    print(f"{name}, {len(held_out)} rooms of {split}\n\n{text}")
    return all(v <= limit for _, v, limit in lines)


if __name__ == "__main__":
    from networks import NETWORKS, run_folder

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("name", choices=NETWORKS)
    parser.add_argument("--rooms", required=True)
    parser.add_argument("--split", default="val")
    parser.add_argument("--out")
    a = parser.parse_args()
    sys.exit(0 if evaluate(a.name, a.rooms, a.split, run_folder(a.name, a.out)) else 1)
