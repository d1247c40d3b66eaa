"""Small anchored sheets for the tests of the engine."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from md_service.engine import LammpsEngine
from md_service.force_fields import force_field
from md_service.graphene import CrackCut, sheet


@dataclass
class Sample:
    """An engine with a frame of anchors and four volume cells, one per quadrant."""

    engine: LammpsEngine
    position: NDArray[np.float64]
    atom_id: NDArray[np.int64]
    ivc: NDArray[np.int64]
    stiffness: NDArray[np.float64]
    damping: float

    @property
    def anchor(self) -> NDArray[np.float64]:
        return self.position[self.atom_id]


MakeSample = Callable[..., Sample]


@pytest.fixture
def make_sample(tmp_path: Path) -> Iterator[MakeSample]:
    engines: list[LammpsEngine] = []

    def make(
        name: str = "tersoff",
        *,
        size: float = 24e-10,
        frame: float = 6e-10,
        damping: float = 4e-13,
        stiffness: float = 30.0,
        temperature: float = 300.0,
        seed: int = 1,
        time_step: float | None = None,
        crack: CrackCut | None = None,
    ) -> Sample:
        position = sheet(size, size, force_field(name).lattice_constant, crack).position
        half = np.abs(position[:, :2]).max(axis=0)
        atom_id = np.flatnonzero((np.abs(position[:, :2]) > half - frame).any(axis=1))
        ivc = (position[atom_id, 0] > 0.0).astype(np.int64) + 2 * (position[atom_id, 1] > 0.0)
        k = np.full(len(atom_id), stiffness) * np.linspace(0.8, 1.2, len(atom_id))
        engine = LammpsEngine(
            tmp_path / f"engine{len(engines)}",
            name,
            position,
            temperature=temperature,
            seed=seed,
            time_step=time_step,
            crack=crack,
        )
        engines.append(engine)
        engine.register_anchors(atom_id, position[atom_id], k, ivc, damping)
        return Sample(engine, position, atom_id, ivc, k, damping)

    yield make
    for engine in engines:
        engine.close()
