"""Writes a trained network as models/NAME.onnx with its card models/NAME.md, and its arrays for one held-out room in tests/parity/.

usage: export.py NAME --rooms DIR [--out runs/NAME] [--models models] [--parity tests/parity]

Opset 17, static shapes, weights of 16 bits that a Cast widens. Names of initializers are those of the parameters, so that train.py --start can read
them.
Run evaluate.py first: the card shows its table. Fails where ONNX Runtime is further than 1e-4 of the largest output from torch."""

import argparse
import hashlib
import inspect
import json
import os
import warnings

import numpy as np
import onnx
import onnxruntime
import torch

from data import rooms_of
from networks import NETWORKS, run_folder, trained

OPSET = 17
LIMIT = 1e-4
SPARSE = 4

CARD = """# {kind}

{head}

{doc}

| | |
| --- | --- |
| file | `{name}.onnx`, opset {opset}, {bytes} bytes, {parameters} parameters in 16 bits |
| SHA-256 | `{digest}` |
| inputs | {inputs} |
| outputs | {outputs} |
| data | {rooms} rooms of `training/rooms`, path-traced with furniture of Sweet Home 3D (CC-BY 3.0, CC0: NOTICE.md){scenes}; nothing else |
| training | `training/nets/train.py {name} --seed {seed}`: {steps} steps of {batch} items, those of step {kept} kept, {seconds} s on {machine}, torch {torch} |
| parity | ONNX Runtime differs from torch by {parity:.1e} of the largest output, on {checked} rooms |
| license | MIT OR Apache-2.0 |

Held-out error, {held_out} rooms of the split `{split}`:

{table}
"""


def halved(model):
    """Float initializers become float16, each followed by a Cast to float."""
    casts = []
    for tensor in model.graph.initializer:
        if tensor.data_type == onnx.TensorProto.FLOAT:
            name, wide = tensor.name, tensor.name + ".float"
            for node in model.graph.node:
                node.input[:] = [wide if x == name else x for x in node.input]
            tensor.CopyFrom(onnx.numpy_helper.from_array(onnx.numpy_helper.to_array(tensor).astype(np.float16), name))
            casts.append(onnx.helper.make_node("Cast", [name], [wide], to=onnx.TensorProto.FLOAT))
    nodes = casts + list(model.graph.node)
    del model.graph.node[:]
    model.graph.node.extend(nodes)
    return model


def first(inputs):
    """The first item of a room's inputs: batch size 1, as the product calls the network. Rounded to 16 bits, as the parity file keeps them."""
    return {k: v[:1].half().float() for k, v in inputs.items()}


def keep(folder, name, inputs, outputs):
    """Writes arrays for tests: NAME.ARRAY.npy, or ARRAY.npy for an input that networks share; of pictures that come out each SPARSE-th row and column."""
    os.makedirs(folder, exist_ok=True)
    for k, v in inputs.items():
        shared, own = os.path.join(folder, f"{k}.npy"), os.path.join(folder, f"{name}.{k}.npy")
        if not os.path.exists(shared):
            np.save(shared, v)
        if np.array_equal(np.load(shared), v):
            if os.path.exists(own):
                os.remove(own)
        else:
            np.save(own, v)
    for k, v in outputs.items():
        np.save(os.path.join(folder, f"{name}.{k}.npy"), v[..., ::SPARSE, ::SPARSE] if v.ndim == 4 else v)


def third_party(scenes):
    """Returns the text of a card about `scenes`, {name of a third-party scene: number of its rooms}."""
    named = [f"{name} ({count})" for name, count in sorted(scenes.items()) if name]
    return f", and views of the third-party scenes {', '.join(named)} among them" if named else ""


@torch.no_grad()
def export(name, rooms, run, models, arrays):
    net, about = trained(name, run)
    evaluation = json.load(open(os.path.join(run, "evaluation.json")))
    held_out = rooms_of(net, os.path.join(rooms, evaluation["split"]))
    os.makedirs(models, exist_ok=True)
    path = os.path.join(models, f"{name}.onnx")
    shown = next((room for room in range(len(held_out)) if not hasattr(net, "chosen") or net.chosen(held_out, room)), 0)
    example = first(net.inputs(held_out, shown))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # tracing keeps shapes as constants, as it should
        torch.onnx.export(
            net,
            tuple(example.values()),
            path,
            opset_version=OPSET,
            dynamo=False,
            do_constant_folding=False,
            input_names=list(example),
            output_names=net.outputs,
        )
    model = halved(onnx.load(path))
    onnx.checker.check_model(model, full_check=True)
    onnx.save(model, path)

    session = onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])
    worst, checked = 0.0, min(len(held_out), max(8, shown + 1))
    for room in range(checked):
        inputs = first(net.inputs(held_out, room))
        want = net(**inputs)
        want = [w.numpy() for w in (want if isinstance(want, tuple) else (want,))]
        got = session.run(net.outputs, {k: v.numpy() for k, v in inputs.items()})
        worst = max([worst] + [float(np.abs(g - w).max() / np.abs(w).max()) for g, w in zip(got, want)])
        if room == shown:
            keep(arrays, name, {k: v.numpy().astype(np.float16) for k, v in inputs.items()}, dict(zip(net.outputs, want)))
    if worst > LIMIT:
        raise SystemExit(f"{name}: wanted ONNX Runtime within {LIMIT} of torch, got {worst:.1e}")

    shapes = lambda values: ", ".join(f"{v.name} [{', '.join(str(d.dim_value) for d in v.type.tensor_type.shape.dim)}]" for v in values)
    text = CARD.format(
        kind=type(net).__name__,
        head=inspect.getdoc(inspect.getmodule(type(net))),
        doc=" ".join(inspect.getdoc(type(net)).split()),
        name=name,
        opset=OPSET,
        bytes=os.path.getsize(path),
        digest=hashlib.sha256(open(path, "rb").read()).hexdigest(),
        inputs=shapes(model.graph.input),
        outputs=shapes(model.graph.output),
        parity=worst,
        checked=checked,
        held_out=evaluation["rooms"],
        split=evaluation["split"],
        table=open(os.path.join(run, "evaluation.md")).read().strip(),
        **about | {"scenes": third_party(about.get("scenes", {}))},
    )
    open(os.path.join(models, f"{name}.md"), "w").write(text)
    print(f"{path}: {os.path.getsize(path)} bytes, parity {worst:.1e}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("name", choices=NETWORKS)
    parser.add_argument("--rooms", required=True)
    parser.add_argument("--out")
    parser.add_argument("--models", default="models")
    parser.add_argument("--parity", default="tests/parity")
    a = parser.parse_args()
    export(a.name, a.rooms, run_folder(a.name, a.out), a.models, a.parity)
