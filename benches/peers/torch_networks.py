"""PyTorch's side of benches/networks.rs: the networks of training/nets with the weights of models/, in 32 bits, on the room of tests/parity.

Requests on standard input, a line each: `NAME THREADS` runs that network once and answers with milliseconds. Before its first run each network must give
what tests/parity says, which it runs twice for, so that nothing is timed cold."""

import sys
import time
from pathlib import Path

import numpy as np
import torch

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "training/nets"))
from networks import NETWORKS  # noqa: E402
from train import shipped  # noqa: E402

# As tests/networks.rs: of pictures that come out the files hold each fourth row and column.
SPARSE, LIMIT = 4, 1e-4


def array(network, name):
    own = ROOT / f"tests/parity/{network}.{name}.npy"
    return torch.tensor(np.load(own if own.exists() else ROOT / f"tests/parity/{name}.npy").astype(np.float32))


def ready(name):
    import onnx

    net = NETWORKS[name]().eval()
    path = str(ROOT / f"models/{name}.onnx")
    shipped(net, path)
    inputs = [array(name, value.name) for value in onnx.load(path).graph.input]
    for _ in range(2):
        outputs = net(*inputs)
    for output, value in zip(outputs if isinstance(outputs, tuple) else (outputs,), net.outputs):
        got = output[..., ::SPARSE, ::SPARSE] if output.ndim == 4 else output
        want = array(name, value)
        off = float((got - want).abs().max() / want.abs().max())
        if off > LIMIT:
            raise SystemExit(f"{name}: {value} is off by {off:.1e} of the largest")
    return net, inputs


def main():
    nets = {}
    for line in sys.stdin:
        name, threads = line.split()
        torch.set_num_threads(int(threads))
        if name not in nets:
            nets[name] = ready(name)
        net, inputs = nets[name]
        began = time.perf_counter()
        net(*inputs)
        print(1e3 * (time.perf_counter() - began), flush=True)


if __name__ == "__main__":
    with torch.inference_mode():
        main()
