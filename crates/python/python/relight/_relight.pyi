from collections.abc import Callable
from pathlib import Path
from typing import Any, final

__version__: str

class RelightError(Exception):
    """Files or arguments that cannot be used."""

    faults: list[Fault]

class StageError(RelightError):
    """A stage gave no result."""

@final
class Fault:
    file: str
    line: int | None
    column: int | None
    message: str
    help: str | None

@final
class Buffer:
    @property
    def __array_interface__(self) -> dict[str, Any]: ...

@final
class Scene:
    def __new__(
        cls,
        folder: Path,
        models: Path,
        threads: int | None = None,
        memory_bytes: int | None = None,
    ) -> Scene: ...
    def run(
        self,
        graph: Path,
        edit: str | Path,
        settings: list[tuple[str, str]],
        outputs: list[str] | None = None,
        frame: int = 0,
        progress: Callable[[int, int, str, str], object] | None = None,
    ) -> Run: ...

@final
class Run:
    @property
    def outputs(self) -> list[str]: ...
    def __getitem__(self, name: str) -> Any: ...
    @property
    def seconds(self) -> float: ...
    @property
    def nodes_json(self) -> str: ...
