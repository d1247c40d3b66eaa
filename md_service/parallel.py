"""One engine over all ranks: calls that rank 0 announces, and the loop of the ranks that follow it.

Every rank makes the same engine and calls the same methods with the same arguments. Under
``mpiexec -n N python ...`` rank 0 uses `ParallelEngine`, which announces each call before it makes it, and all
other ranks sit in `follow`.
"""

from __future__ import annotations

import inspect
import traceback
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from md_service.atoms import Atoms, Box, CrackCut, Topology
from md_service.cuts import Cut
from md_service.engine import Engine
from md_service.ensembles import Ensemble
from md_service.errors import EngineError
from md_service.force_fields import FORCE_FIELDS, ForceField, force_field
from md_service.lammps_dynamics import LammpsDynamics
from md_service.ranks import MpiRanks

FOLLOWED_METHODS: Final = (
    "register_anchors",
    "equilibrate",
    "measure_reference",
    "advance",
    "displace",
    "sever",
    "broken_bonds",
    "collect_fields",
    "fields",
    "state",
    "restore",
    "close",
)


class ParallelEngine:
    """`Engine` on LAMMPS spread over all ranks, for use on rank 0 while the others are in `follow`.

    The methods are those of `md_service.engine.Engine`, named in `FOLLOWED_METHODS`, with arguments by keyword or in
    order.

    Parameters
    ----------
    ranks : MpiRanks
        The ranks; this one must be rank 0.
    work_dir : Path
        Folder of the LAMMPS log, reachable by all ranks.
    force_field : ForceField
        Interatomic potential.
    atoms : Atoms
        The sample.
    temperature, seed, time_step
        As in `LammpsDynamics`.
    """

    def __init__(
        self,
        ranks: MpiRanks,
        work_dir: Path,
        force_field: ForceField,
        atoms: Atoms,
        *,
        temperature: float,
        seed: int,
        time_step: float,
    ) -> None:
        if ranks.rank != 0:
            raise ValueError(f"ParallelEngine was made on rank {ranks.rank}; it is for rank 0, others call follow")
        description: dict[str, Any] = {
            "work_dir": str(work_dir),
            "force_field": _packed_force_field(force_field),
            "atoms": asdict(atoms),
            "temperature": float(temperature),
            "seed": int(seed),
            "time_step": float(time_step),
        }
        self._ranks = ranks
        ranks.broadcast_call("make", description)
        self._engine = _make(ranks, description)

    @property
    def step(self) -> int:
        """MD steps done so far."""
        return self._engine.step

    @property
    def temperature(self) -> float:
        """Of the run, K."""
        return self._engine.temperature

    @property
    def n_atoms(self) -> int:
        """Number of atoms."""
        return self._engine.n_atoms

    @property
    def atoms(self) -> Atoms:
        """The sample."""
        return self._engine.atoms

    @property
    def crack(self) -> CrackCut | None:
        """As `Engine.crack`."""
        return self._engine.crack

    @property
    def cuts(self) -> tuple[Cut, ...]:
        """As `Engine.cuts`."""
        return self._engine.cuts

    @property
    def samples(self) -> int:
        """As `Engine.samples`."""
        return self._engine.samples

    def reference_fields(self) -> dict[str, NDArray[np.float64]]:
        """As `Engine.reference_fields`; every rank holds them."""
        return self._engine.reference_fields()

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
            sent = {key: asdict(value) if isinstance(value, Ensemble) else value for key, value in by_name.items()}
            self._ranks.broadcast_call(name, sent)
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
                if isinstance(arguments.get("ensemble"), dict):
                    arguments["ensemble"] = Ensemble(**arguments["ensemble"])
                getattr(engine, method)(**arguments)
            else:
                raise EngineError(f"rank 0 announced the unknown method {method!r}")
        except (EngineError, ValueError):
            continue
        except Exception:
            # Unforeseen and perhaps on this rank alone: rank 0 would wait for this rank without end.
            traceback.print_exc()
            ranks.abort()


def _make(ranks: MpiRanks, description: dict[str, Any]) -> Engine:
    profile = _force_field(description["force_field"])
    temperature = description["temperature"]
    dynamics = LammpsDynamics(
        Path(description["work_dir"]),
        profile,
        _atoms(description["atoms"]),
        temperature=temperature,
        seed=description["seed"],
        time_step=description["time_step"],
        ranks=ranks,
    )
    return Engine(dynamics, temperature=temperature, force_field=profile, ranks=ranks)


def _packed_force_field(profile: ForceField) -> dict[str, Any]:
    """A name where there is a profile of that name, all but its lattices for a user's own."""
    if FORCE_FIELDS.get(profile.name) == profile:
        return {"name": profile.name}
    return {key: value for key, value in asdict(profile).items() if not key.startswith("lattice")}


def _force_field(packed: dict[str, Any]) -> ForceField:
    if len(packed) == 1:
        return force_field(packed["name"])
    tuples = {key: tuple(value) for key, value in packed.items() if isinstance(value, (list, tuple))}
    return ForceField(**{**packed, **tuples})


def _atoms(packed: dict[str, Any]) -> Atoms:
    values = dict(packed)
    box = dict(values.pop("box"))
    box["periodic"] = tuple(box["periodic"])
    topology, crack = values.pop("topology"), values.pop("crack")
    for name in ("species", "elements"):
        values[name] = tuple(values[name])
    if topology is not None:
        topology = {key: value if isinstance(value, np.ndarray) else tuple(value) for key, value in topology.items()}
    return Atoms(
        **values,
        box=Box(**box),
        topology=None if topology is None else Topology(**topology),
        crack=None if crack is None else CrackCut(**crack),
    )
