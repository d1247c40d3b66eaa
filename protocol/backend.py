"""How a package announces a backend: an entry point of the group `scalebridge.backends`."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any

from protocol.service import Service

if TYPE_CHECKING:
    from protocol.arrays import FloatArray, IntArray
    from protocol.micromechanics import CellProperties, RegisterCell
    from protocol.structure import StructureConfigure

GROUP = "scalebridge.backends"


class BackendError(Exception):
    """No such backend, or one that cannot be loaded."""


@dataclass(frozen=True)
class Backend:
    """What an entry point of the group names; importing it must be cheap.

    Parameters
    ----------
    name, role, summary : str
    factory : str
        `module:callable`; called with the working folder of the service, returns a `Service`.
    launcher : str, optional
        `module:callable`; called with the number of ranks, returns the words that go before the command
        of a service of several ranks, such as ``["mpiexec", "-n", "2"]``. None: one process only.
    front : str, optional
        `module:callable`; makes a service that answers by workers of this backend, see `make_front`. None: there
        is none, as for every solver that holds a state.
    cell_reader : str, optional
        `module:callable`; given the path of a cell file, returns the message that registers the cell. None: this
        backend reads none.
    plane_reader : str, optional
        `module:callable`; given the path of a mesh file and the metres of its unit of length, returns a plane mesh of
        quadrilaterals with `nodes`, shape (nodes, 2), and `elements`, shape (elements, 4). None: this backend reads
        none.
    deck_writer : str, optional
        `module:callable`; given the `StructureConfigure` of a laminate, the `CellProperties` of its cell and lines of
        comment, returns the text of a deck for other codes. None: this backend writes none.
    seconds_per_unit_step : dict of str to float
        Seconds per step and atom or material point on one core, by force field (``""`` where the role has
        none); for estimates before a run.
    default : bool
        Whether it is taken for its role where none is named.
    """

    name: str
    role: str
    summary: str
    factory: str
    launcher: str | None = None
    front: str | None = None
    cell_reader: str | None = None
    plane_reader: str | None = None
    deck_writer: str | None = None
    seconds_per_unit_step: dict[str, float] = field(default_factory=dict)
    default: bool = False

    def make(self, folder: Path) -> Service:
        """Load the backend and return a new service that works in `folder`."""
        service: Service = _load(self.factory)(folder)
        return service

    def read_cell(self, path: Path) -> RegisterCell:
        """Return the definition of the cell in a file.

        Raises
        ------
        BackendError
            Where this backend reads no cell files.
        ValueError
            Where the file is no cell file; the message has one line per mistake.
        """
        if self.cell_reader is None:
            raise BackendError(f"backend {self.name} reads no cell files")
        cell: RegisterCell = _load(self.cell_reader)(path)
        return cell

    def read_plane(self, path: Path, unit: float) -> tuple[FloatArray, IntArray]:
        """Return nodes, m, and elements of the plane mesh in a file whose unit of length is `unit` metres.

        Raises
        ------
        BackendError
            Where this backend reads no plane meshes.
        ValueError
            Where the file is no such mesh.
        """
        if self.plane_reader is None:
            raise BackendError(f"backend {self.name} reads no mesh files")
        mesh = _load(self.plane_reader)(path, unit)
        return mesh.nodes, mesh.elements

    def write_deck(self, request: StructureConfigure, properties: CellProperties, comments: Sequence[str]) -> str:
        """Return a laminate as a deck that other codes run.

        Raises
        ------
        BackendError
            Where this backend writes no decks.
        ProtocolError
            Where the request cannot be written.
        """
        if self.deck_writer is None:
            raise BackendError(f"backend {self.name} writes no decks")
        text: str = _load(self.deck_writer)(request, properties, comments)
        return text

    def make_front(self, folder: Path, command: list[str], workers: int | None, executor: str | None) -> Service:
        """Return a new service that splits each query over workers of this backend.

        Parameters
        ----------
        folder : Path
            Working folder; workers have their own below it.
        command : list of str
            Words of the command that serves this backend in one process; `--bind` and the like follow.
        workers : int or None
            Processes to start.
        executor : str or None
            Address of a cluster that does the work in their place, such as ``dask://HOST:PORT``.

        Raises
        ------
        BackendError
            Where the backend is of a kind that cannot be split, or the front cannot start.
        """
        if self.front is None:
            raise BackendError(f"backend {self.name} holds a state in one process: it has no workers and no executor")
        service: Service = _load(self.front)(self.name, folder, command, workers, executor)
        return service

    def launch_words(self, ranks: int) -> list[str]:
        """Return the words before the command of a service with `ranks` ranks.

        Raises
        ------
        BackendError
            Where the backend runs as one process only.
        """
        if ranks == 1:
            return []
        if self.launcher is None:
            raise BackendError(f"backend {self.name} runs as one process, not as {ranks} ranks")
        words: list[str] = _load(self.launcher)(ranks)
        return words


def _load(path: str) -> Callable[..., Any]:
    module, _, name = path.partition(":")
    loaded: Callable[..., Any] = getattr(importlib.import_module(module), name)
    return loaded


def installed() -> dict[str, Backend]:
    """Return the installed backends by name."""
    found = {}
    for entry in metadata.entry_points(group=GROUP):
        backend = entry.load()
        if not isinstance(backend, Backend):
            raise BackendError(f"entry point {entry.name} of {GROUP} is a {type(backend).__name__}, not a Backend")
        found[backend.name] = backend
    return found


def find(role: str, name: str | None) -> Backend:
    """Return the backend `name` of a role; without a name the default of that role, else the first by name.

    Raises
    ------
    BackendError
        Where there is none; the message lists what is installed.
    """
    candidates = {key: backend for key, backend in installed().items() if backend.role == role}
    if name is None and candidates:
        return min(candidates.values(), key=lambda backend: (not backend.default, backend.name))
    if name is not None and name in candidates:
        return candidates[name]
    have = ", ".join(sorted(candidates)) or "none"
    raise BackendError(f"no backend {name or ''!r} for the role {role!r}; installed for it: {have}")
