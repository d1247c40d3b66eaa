"""One engine over all ranks: calls that rank 0 announces, and the loop of the ranks that follow it.

Every rank makes the same engine and calls the same methods with the same arguments. Under
``mpiexec -n N python ...`` rank 0 uses `ParallelEngine`, which announces each call before it makes it, and all
other ranks sit in `follow`.
"""

import inspect
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from md_service.engine import LammpsEngine
from md_service.errors import EngineError
from md_service.force_fields import force_field
from md_service.graphene import CrackCut
from md_service.ranks import MpiRanks

FOLLOWED_METHODS: Final = (
    "register_anchors",
    "equilibrate",
    "measure_reference",
    "advance",
    "broken_bonds",
    "collect_fields",
    "fields",
    "state",
    "restore",
    "close",
)


class ParallelEngine:
    """`LammpsEngine` spread over all ranks, for use on rank 0 while the others are in `follow`.

    The methods are those of `md_service.engine.LammpsEngine`, named in `FOLLOWED_METHODS`, with arguments by
    keyword or in order.

    Parameters
    ----------
    ranks : MpiRanks
        The ranks; this one must be rank 0.
    work_dir : Path
        Folder of the LAMMPS log, reachable by all ranks.
    force_field : str
        Name of a profile.
    position : ndarray, shape (n, 3)
        Atom positions, m.
    crack : CrackCut, optional
        Initial slit.
    **settings
        The engine's other arguments, numbers.
    """

    def __init__(
        self,
        ranks: MpiRanks,
        work_dir: Path,
        force_field: str,
        position: NDArray[np.float64],
        crack: CrackCut | None = None,
        **settings: Any,
    ) -> None:
        if ranks.rank != 0:
            raise ValueError(f"ParallelEngine was made on rank {ranks.rank}; it is for rank 0, others call follow")
        description: dict[str, Any] = {
            "work_dir": str(work_dir),
            "force_field": force_field,
            "position": np.ascontiguousarray(position, dtype=np.float64),
            "crack": None if crack is None else [crack.tip_x, crack.y],
            **settings,
        }
        self._ranks = ranks
        ranks.broadcast_call("make", description)
        self._engine = _make(ranks, description)

    @property
    def step(self) -> int:
        """MD steps done so far."""
        return int(self._engine.step)

    @property
    def n_atoms(self) -> int:
        """Number of atoms."""
        return int(self._engine.n_atoms)

    def __getattr__(self, name: str) -> Callable[..., Any]:
        if name not in FOLLOWED_METHODS:
            raise AttributeError(f"the parallel engine has no attribute {name!r}")
        method = getattr(self._engine, name)

        def call(*arguments: Any, **named: Any) -> Any:
            by_name = dict(inspect.signature(method).bind(*arguments, **named).arguments)
            progress = by_name.pop("progress", None)
            for key, value in by_name.items():
                if isinstance(value, (list, tuple)) and not all(isinstance(entry, str) for entry in value):
                    by_name[key] = np.asarray(value)
            self._ranks.broadcast_call(name, by_name)
            if progress is not None:
                by_name["progress"] = progress
            return method(**by_name)

        return call

    def stop(self) -> None:
        """End the loop of the other ranks; the engine is closed first."""
        self.close()
        self._ranks.release()


def follow(ranks: MpiRanks) -> None:
    """Loop of the ranks other than 0: make every call that rank 0 announces, until it says stop.

    An error that a call raises is raised on rank 0 as well, which reports it; this rank goes on listening.
    """
    engine: Any = None
    while True:
        method, arguments = ranks.receive_call()
        if method == "stop":
            return
        try:
            if method == "make":
                engine = _make(ranks, arguments)
            elif method in FOLLOWED_METHODS:
                getattr(engine, method)(**arguments)
            else:
                raise EngineError(f"rank 0 announced the unknown method {method!r}")
        except (EngineError, ValueError):
            continue
        except Exception:
            # Unforeseen and perhaps on this rank alone: rank 0 would wait for this rank without end.
            traceback.print_exc()
            ranks.abort()


def _make(ranks: MpiRanks, description: dict[str, Any]) -> Any:
    settings = dict(description)
    crack = settings.pop("crack")
    return LammpsEngine(
        work_dir=Path(settings.pop("work_dir")),
        force_field=force_field(settings.pop("force_field")),
        position=settings.pop("position"),
        crack=None if crack is None else CrackCut(*crack),
        ranks=ranks,
        **settings,
    )
