"""Small anchored sheets for the tests of the engine."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import ArrayLike, NDArray

from md_service.atoms import CrackCut
from md_service.engine import Engine
from md_service.force_fields import force_field
from md_service.graphene import graphene
from md_service.lammps_dynamics import LammpsDynamics


@dataclass
class Sample:
    """An engine with a frame of anchors and four volume cells, one per quadrant."""

    engine: Engine
    position: NDArray[np.float64]
    atom_id: NDArray[np.int64]
    ivc: NDArray[np.int64]
    stiffness: NDArray[np.float64]
    damping: NDArray[np.float64]

    @property
    def anchor(self) -> NDArray[np.float64]:
        return self.position[self.atom_id]


MakeSample = Callable[..., Sample]


@pytest.fixture
def make_sample(tmp_path: Path) -> Iterator[MakeSample]:
    engines: list[Engine] = []

    def make(
        name: str = "tersoff",
        *,
        size: float = 24e-10,
        frame: float = 6e-10,
        damping_time: float | None = 5e-14,
        stiffness: float = 30.0,
        temperature: float = 300.0,
        seed: int = 1,
        time_step: float | None = None,
        crack: CrackCut | None = None,
        kind: Callable[[NDArray[np.float64]], ArrayLike] | None = None,
        moving: bool = False,
    ) -> Sample:
        profile = force_field(name)
        atoms = graphene(size, size, spacing=profile.lattice_constant, crack=crack)
        position = atoms.position
        half = np.abs(position[:, :2]).max(axis=0)
        depth = (half - np.abs(position[:, :2])).min(axis=1)
        atom_id = np.flatnonzero(depth < frame)
        ivc = (position[atom_id, 0] > 0.0).astype(np.int64) + 2 * (position[atom_id, 1] > 0.0)
        k = np.full(len(atom_id), stiffness) * np.linspace(0.8, 1.2, len(atom_id))
        dynamics = LammpsDynamics(
            tmp_path / f"engine{len(engines)}", profile, atoms, temperature=temperature, seed=seed, time_step=time_step
        )
        engine = Engine(dynamics, temperature=temperature, force_field=profile)
        engines.append(engine)
        kinds = None if kind is None else kind(depth[atom_id])
        engine.register_anchors(atom_id, position[atom_id], k, ivc, damping_time, kinds, moving)
        assert engine.anchors is not None
        return Sample(engine, position, atom_id, ivc, k, engine.anchors.damping)

    yield make
    for engine in engines:
        engine.close()
