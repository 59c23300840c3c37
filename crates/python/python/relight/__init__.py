"""Relighting of an indoor photograph: scenes, edits and layers of light as NumPy arrays.

>>> import relight
>>> from relight.ron import Off
>>> run = relight.Scene(relight.DEMO).run({"lights": {"lamp_0": Off}})
>>> run.picture.shape
(960, 1280, 3)
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import ron
from ._relight import Fault, RelightError, StageError, __version__
from ._relight import Run as _Run
from ._relight import Scene as _Scene

__all__ = [
    "DEMO",
    "Fault",
    "RelightError",
    "Run",
    "Scene",
    "StageError",
    "__version__",
    "graphs",
    "mix",
    "ron",
    "srgb",
]

_DATA = Path(__file__).parent / "data"

DEMO = _DATA / "scenes" / "demo"
"""The scene that ships: a path-traced living room."""

Progress = Callable[[int, int, str, str], object]
"""Called with nodes done, nodes in all, the name of the node and its status."""


def graphs() -> list[str]:
    """Names of the graphs that ship."""
    return sorted(path.stem for path in (_DATA / "graphs").glob("*.ron"))


class Run:
    """The outputs of a run; arrays are read-only and share the memory of the engine."""

    def __init__(self, run: _Run) -> None:
        self._run = run

    def __getitem__(self, output: str) -> Any:
        """The output `node.port`: an array, a dictionary by light, or a plain value."""
        return self._run[output]

    @property
    def outputs(self) -> list[str]:
        """Names of the outputs."""
        return self._run.outputs

    @property
    def picture(self) -> NDArray[np.float32]:
        """The picture, (height, width, 3), linear Rec. 709 in units of the photo."""
        picture: NDArray[np.float32] = self["compose.picture"]
        return picture

    @property
    def layers(self) -> dict[str, NDArray[np.floating[Any]]]:
        """The contribution of each light, and `rest`, which no light explains; their sum is the
        picture. Half precision, where it holds the layer."""
        return {**self["compose.layer"], "rest": self["compose.residual"]}

    @property
    def seconds(self) -> float:
        """Wall time of the run."""
        return self._run.seconds

    @property
    def nodes(self) -> list[dict[str, Any]]:
        """The nodes as in report.json: name, status, seconds, warnings."""
        nodes: list[dict[str, Any]] = json.loads(self._run.nodes_json)
        return nodes


class Scene:
    """A scene folder with its scene.ron. Runs keep their results in memory, so that another edit
    computes only the nodes that it affects."""

    def __init__(
        self,
        folder: str | os.PathLike[str],
        *,
        models: str | os.PathLike[str] | None = None,
        threads: int | None = None,
        memory_bytes: int | None = None,
    ) -> None:
        """`models` is the folder of the networks, by default of those that ship; `memory_bytes` the
        most memory for results that no run needs, by default 1 GiB."""
        models = Path(models or _DATA / "models")
        self._scene = _Scene(Path(folder), models, threads, memory_bytes)

    def __repr__(self) -> str:
        return repr(self._scene)

    def run(
        self,
        edit: str | os.PathLike[str] | Mapping[str, Any] | None = None,
        *,
        graph: str | os.PathLike[str] = "indoor",
        outputs: Sequence[str] | None = None,
        settings: Mapping[str, Any] | None = None,
        frame: int = 0,
        progress: Progress | None = None,
    ) -> Run:
        """Runs a graph.

        `edit` is the text of an edit file, the path of one as a `Path`, or a dictionary of its
        fields; `graph` the name of a graph that ships, or a file. `outputs` are names such as
        `compose.picture`; by default, the picture and its layers. `settings` sets parameters of
        nodes, as `{"scene.long_side": 320}`.

        Raises `RelightError` for files and arguments that cannot be used, `StageError` where a
        stage fails, `KeyboardInterrupt` after Ctrl-C.
        """
        if edit is None:
            edit = {}
        if isinstance(edit, Mapping):
            edit = ron.edit(edit)
        elif not isinstance(edit, str):
            edit = Path(edit)
        if isinstance(graph, str) and graph in graphs():
            graph = _DATA / "graphs" / f"{graph}.ron"
        values = [(name, ron.dumps(value)) for name, value in (settings or {}).items()]
        wanted = None if outputs is None else list(outputs)
        return Run(self._scene.run(Path(graph), edit, values, wanted, frame, progress))


def mix(
    layers: Mapping[str, NDArray[np.floating[Any]]],
    weights: Mapping[str, float | Sequence[float]] | None = None,
) -> NDArray[np.float32]:
    """The sum of layers; `weights` has a factor, or one for red, green and blue, of a light."""
    weights = weights or {}
    unknown = sorted(set(weights) - set(layers))
    if unknown:
        raise KeyError(f"{', '.join(unknown)}: wanted lights of {', '.join(layers)}")
    if not layers:
        raise ValueError("wanted at least one layer, got none")
    total = np.zeros(next(iter(layers.values())).shape, np.float32)
    for light, layer in layers.items():
        total += layer * np.asarray(weights.get(light, 1.0), np.float32)
    return total


def srgb(picture: NDArray[np.floating[Any]]) -> NDArray[np.uint8]:
    """A linear picture as sRGB of 8 bits, clamped, for plots and files."""
    linear = np.clip(np.asarray(picture, np.float32), 0.0, 1.0)
    curve = 1.055 * linear ** np.float32(1 / 2.4) - 0.055
    encoded = np.where(linear <= 0.0031308, 12.92 * linear, curve)
    return (255.0 * encoded + 0.5).astype(np.uint8)
