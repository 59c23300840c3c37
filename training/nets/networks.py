"""The list of networks, and how a trained one is read back."""

import json
import os

import torch

from indirectnet import IndirectNet, SquashedIndirectNet
from lightnet import LightNet
from lights import InvLampNet, InvWinNet, VisLampNet, VisWinNet
from mnet import MNet
from shadownet import ShadowNet

NETWORKS = {"shadownet": ShadowNet, "indirectnet": IndirectNet, "squashedindirectnet": SquashedIndirectNet, "lightnet": LightNet} | {
    net.__name__.lower(): net for net in (MNet, VisLampNet, VisWinNet, InvLampNet, InvWinNet)
}


def run_folder(name, out):
    """Where a run of a network lies; `runs/NAME` unless told."""
    return out or os.path.join("runs", name)


def trained(name, run):
    """The network of a run as it is shipped: averaged weights of the best validation, rounded to 16 bits. And what is known of its training."""
    state = torch.load(os.path.join(run, "checkpoint.pt"), weights_only=True, map_location="cpu")
    net = NETWORKS[name]()
    net.load_state_dict({k: v.half().float() for k, v in state["best"]["weights"].items()})
    return net.eval(), json.load(open(os.path.join(run, "run.json")))
