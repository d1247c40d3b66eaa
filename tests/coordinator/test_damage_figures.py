"""Bonds of a network in the report: which there are, and how many are told to be broken."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from coordinator.damage_figures import damage_pictures, network_bonds

# Ethane, staggered: C-C 1.535 A, C-H 1.094 A, angle H-C-C 111.2 degrees.
_TURN = np.radians([0.0, 120.0, 240.0])
_OUT, _UP = 1.094 * np.sin(np.radians(111.2)), -1.094 * np.cos(np.radians(111.2))
PLACE = 1e-10 * np.concatenate([
    [[0.0, 0.0, 0.0], [0.0, 0.0, 1.535]],
    np.column_stack([_OUT * np.cos(_TURN), _OUT * np.sin(_TURN), np.full(3, -_UP)]),
    np.column_stack([-_OUT * np.cos(_TURN), _OUT * np.sin(_TURN), np.full(3, 1.535 + _UP)]),
])  # fmt: skip
NUMBER = np.array([6, 6, 1, 1, 1, 1, 1, 1])


class TwoFrames:
    """Ethane at rest, then with its halves drawn apart."""

    reference, species = PLACE, NUMBER
    step, time = np.array([0, 10]), np.array([0.0, 1e-12])

    def __init__(self, apart: float) -> None:
        self._apart = apart

    def __len__(self) -> int:
        return 2

    def position(self, frame: int) -> Any:
        upper = PLACE[:, 2] > 1e-10
        return PLACE + frame * self._apart * upper[:, None] * np.array([0.0, 0.0, 1.535e-10])


def told(apart: float) -> list[str]:
    results: Any = SimpleNamespace(atoms=TwoFrames(apart))
    scene: Any = SimpleNamespace(crack=SimpleNamespace(tip_x=0.0, y=0.0))
    return [picture.caption for picture in damage_pictures(results, scene)]


def test_ethane_has_seven_bonds() -> None:
    pairs, length = network_bonds(PLACE, NUMBER)
    assert sorted(map(tuple, np.sort(pairs, axis=1).tolist())) == [
        (0, 1), (0, 2), (0, 3), (0, 4), (1, 5), (1, 6), (1, 7),
    ]  # fmt: skip
    np.testing.assert_allclose(np.sort(length), [1.094e-10] * 6 + [1.535e-10], rtol=1e-3)


def test_atoms_of_no_known_element_have_no_bonds() -> None:
    assert len(network_bonds(PLACE, np.zeros_like(NUMBER))[0]) == 0


@pytest.mark.parametrize(("apart", "broken"), [(0.39, 0), (0.41, 1)])
def test_a_bond_is_broken_at_1_4_times_its_length(apart: float, broken: int) -> None:
    first, last = told(apart)
    assert "0 of 7 bonds" in first and f"{broken} of 7 bonds" in last
