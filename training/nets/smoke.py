"""The whole way of every network on a few rooms, two networks at a time: train, go on, evaluate, sheet, plot, export, begin from what was exported.

usage: smoke.py --rooms DIR [NAME ...]

Nothing is kept. The rooms must have lights of every kind."""

import argparse
import multiprocessing
import os
import runpy
import sys
import tempfile
import threading
from concurrent.futures import ThreadPoolExecutor
from multiprocessing.connection import wait

from data import Rooms
from networks import NETWORKS

HERE = os.path.dirname(os.path.abspath(__file__))


# Each script has a process of its own, forked from one that has imported what takes seconds.
FORKS = multiprocessing.get_context("forkserver")
FORKS.set_forkserver_preload(["torch", "onnxruntime", "matplotlib.pyplot", "networks"])
# To start a process, multiprocessing reads the exit status of each that has ended. Two threads that read one status at once make it 255.
STATUS = threading.Lock()


def execute(script, arguments):
    sys.argv = [script, *arguments]
    runpy.run_path(script, run_name="__main__")


def run(script, *arguments, fails=False):
    process = FORKS.Process(target=execute, args=(os.path.join(HERE, script), [*map(str, arguments)]))
    with STATUS:
        process.start()
    wait([process.sentinel])
    with STATUS:
        process.join()
    if process.exitcode and not fails:
        sys.exit(f"{script} {' '.join(map(str, arguments))}: exit status {process.exitcode}")


def smoke(names, rooms):
    with tempfile.TemporaryDirectory() as folder:
        at = lambda *parts: os.path.join(folder, *parts)

        def whole_way(name):
            out = ("--out", at("runs", name))
            train = ("train.py", name, "--rooms", rooms, "--batch", 2, "--threads", 1)
            run(*train, *out, "--steps", 6)
            run(*train, *out, "--steps", 10)
            run("evaluate.py", name, "--rooms", rooms, *out, fails=True)  # ten steps meet no target
            run("contact_sheet.py", name, "--rooms", rooms, "--count", 1, *out)
            run("export.py", name, "--rooms", rooms, "--models", at("models"), "--parity", at("parity"), *out)
            run(*train, "--out", at("again", name), "--steps", 1, "--start", at("models", f"{name}.onnx"))

        for split in ("train", "val"):
            Rooms(os.path.join(rooms, split))  # packs them, once for all
        with ThreadPoolExecutor(2) as pool:
            for _ in pool.map(whole_way, names):
                pass
        run("plot.py", at("log.svg"), *(at("runs", name) for name in names))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME")
    parser.add_argument("--rooms", required=True)
    a = parser.parse_args()
    smoke(a.names or list(NETWORKS), a.rooms)
