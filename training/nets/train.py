"""Trains a network.

usage: train.py NAME --rooms DIR (--minutes M | --steps N) [--seed S] [--out runs/NAME] [--start models/NAME.onnx] [--batch 8] [--rate 2e-3]
[--threads 2] [--device cpu] [--every 1] [--without SCENE,..]

DIR holds train/ and val/, folders of rooms. Goes on where a run stopped: a checkpoint is written every minute and at the end; the batch of a step
depends on seed and step only. With --minutes or --steps raised, a finished run goes on too. --start begins from shipped weights. export.py takes
the averaged weights of the best validation, by the measure that the network is judged by; the confidence of a network that tells one is calibrated on
val at the end. Writes checkpoint.pt, run.json and log.csv (step, seconds, loss, measures of val) into the run's folder."""

import argparse
import csv
import json
import math
import os
import platform
import time
from collections import Counter

os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")  # before torch: threads that spin for each other cost a shared machine ten times the time

import torch

from data import rooms_of
from evaluate import measure
from layers import count
from networks import NETWORKS, run_folder

WARM_UP = 200  # steps
SAVE_EVERY = 60  # seconds
LOG_EVERY, VALIDATIONS = 50, 20  # steps; validations in a run
VALIDATION_ROOMS = 72


def rate(base, step, progress):
    """Linear warm-up, constant to 40 % of the run, then a cosine to a hundredth. A function of where the run stands, so that a longer run may
    follow."""
    fall = min(max((progress - 0.4) / 0.6, 0), 1)
    return base * min((step + 1) / WARM_UP, 1) * (0.01 + 0.99 * (1 + math.cos(math.pi * fall)) / 2)


def shipped(net, path):
    """Loads the weights of an exported network, whose initializers have the names of the parameters; those whose shape has changed since start anew."""
    import onnx

    arrays = {t.name: torch.tensor(onnx.numpy_helper.to_array(t)).float() for t in onnx.load(path).graph.initializer}
    fits = lambda k, v: k in arrays and arrays[k].shape == v.shape
    net.load_state_dict({k: arrays[k] if fits(k, v) else v for k, v in net.state_dict().items()})


def train(name, rooms, every, minutes, steps, seed, out, start, size, base, without):
    os.makedirs(out, exist_ok=True)
    torch.manual_seed(seed)
    device = torch.get_default_device()
    net, average = NETWORKS[name](), NETWORKS[name]().eval()
    data, val = rooms_of(net, os.path.join(rooms, "train"), every, without), rooms_of(net, os.path.join(rooms, "val"))
    if start:
        shipped(net, start)
    average.load_state_dict(net.state_dict())
    optimizer = torch.optim.AdamW(net.parameters(), base, weight_decay=1e-3)
    checkpoint = os.path.join(out, "checkpoint.pt")
    step, seconds, best = 0, 0.0, {}
    if os.path.exists(checkpoint):
        state = torch.load(checkpoint, weights_only=True, map_location=device)
        net.load_state_dict(state["net"]), average.load_state_dict(state["average"]), optimizer.load_state_dict(state["optimizer"])
        step, seconds, best = state["step"], state["seconds"], state["best"]
        print(f"{name}: goes on at step {step}, {seconds:.0f} s")
    print(f"{name}: {count(net)} parameters, {len(data)} rooms to train, {len(val)} to validate")

    def save():
        state = {
            "net": net.state_dict(),
            "average": average.state_dict(),
            "optimizer": optimizer.state_dict(),
            "step": step,
            "seconds": seconds,
            "best": best,
        }
        torch.save(state, checkpoint + ".new")
        os.replace(checkpoint + ".new", checkpoint)
        about = {
            "network": name,
            "parameters": count(net),
            "rooms": len(data),
            "scenes": dict(Counter(name.rpartition("_")[0] for name in data.names)),
            "without": without,
            "seed": seed,
            "steps": step,
            "kept": best.get("step"),
            "seconds": round(seconds),
            "batch": size,
            "rate": base,
            "start": start,
            "machine": torch.cuda.get_device_name() if device.type == "cuda" else f"{torch.get_num_threads()} threads, {platform.machine()}",
            "torch": torch.__version__,
        }
        json.dump(about, open(os.path.join(out, "run.json"), "w"), indent=1)

    progress = lambda: max(step / steps if steps else 0, seconds / (60 * minutes) if minutes else 0)
    log = os.path.join(out, "log.csv")
    validate = lambda: measure(average, val, range(min(len(val), VALIDATION_ROOMS)))["network"]
    keys = ["step", "seconds", "loss"] + sorted(validate())
    rows = [r for r in csv.DictReader(open(log)) if int(r["step"]) <= step] if os.path.exists(log) and step else []
    saved, losses, begun = time.monotonic(), [], time.monotonic() - seconds
    checked = math.floor(progress() * VALIDATIONS)
    while progress() < 1:
        batch = NETWORKS[name].batch(data, torch.Generator(device).manual_seed(seed * 1_000_003 + step), size)
        for group in optimizer.param_groups:
            group["lr"] = rate(base, step, progress())
        with torch.autocast(device.type, torch.bfloat16):
            loss = net.loss(batch)
        optimizer.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(net.parameters(), 1.0)
        optimizer.step()
        keep = min(0.999, (1 + step) / (10 + step))
        with torch.no_grad():
            torch._foreach_lerp_(list(average.parameters()), list(net.parameters()), 1 - keep)
        losses.append(loss.detach())
        step, seconds = step + 1, time.monotonic() - begun
        last = progress() >= 1
        if step % LOG_EVERY == 0 or last:
            row = {"step": step, "seconds": round(seconds, 1), "loss": round(torch.stack(losses).mean().item(), 6)}
            if math.floor(progress() * VALIDATIONS) > checked or last:
                checked = math.floor(progress() * VALIDATIONS)
                row |= {k: round(v, 7) for k, v in validate().items()}
                judged = row[net.judged_by]
                if not best or judged < best["judged"]:
                    best = {"judged": judged, "step": step, "weights": {k: v.clone() for k, v in average.state_dict().items()}}
                if last and hasattr(net, "calibrate"):
                    kept = NETWORKS[name]().eval()
                    kept.load_state_dict(best["weights"])
                    kept.calibrate(val)
                    best["weights"] = kept.state_dict()
                print("  ".join(f"{k} {v}" for k, v in row.items()), flush=True)
            rows.append(row)
            losses = []
        if last or time.monotonic() - saved > SAVE_EVERY:
            save()
            with open(log, "w", newline="") as file:
                writer = csv.DictWriter(file, keys)
                writer.writeheader()
                writer.writerows(rows)
            saved = time.monotonic()


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("name", choices=NETWORKS)
    parser.add_argument("--rooms", required=True)
    parser.add_argument("--every", type=int, default=1, help="take each N-th room only, to see what more rooms buy")
    parser.add_argument("--without", default=[], type=lambda text: text.split(","), help="third-party scenes that are left out, to be measured on")
    parser.add_argument("--minutes", type=float)
    parser.add_argument("--steps", type=int)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out")
    parser.add_argument("--start")
    parser.add_argument("--batch", type=int, default=8)
    parser.add_argument("--rate", type=float, default=2e-3)
    parser.add_argument("--threads", type=int, default=2, help="on a machine with other work, fewer are faster")
    parser.add_argument("--device", default="cpu", help="cuda: a GPU, which holds the rooms in its memory")
    a = parser.parse_args()
    torch.set_num_threads(a.threads)
    torch.set_default_device(a.device)
    if not (a.minutes or a.steps):
        parser.error("wanted --minutes or --steps")
    train(a.name, a.rooms, a.every, a.minutes, a.steps, a.seed, run_folder(a.name, a.out), a.start, a.batch, a.rate, a.without)
