"""Relaxing a sample with another force field: density, temperature, what is kept, bad input."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from md_service.atoms import Box
from md_service.crystals import fcc
from md_service.force_fields import force_field
from md_service.sample_relaxation import relaxed

ARGON = fcc("Ar", 3.78e-10, (4, 4, 4), (True, True, True))


def test_density_and_order(tmp_path: Path) -> None:
    field = force_field("lennard-jones")
    said: list[str] = []
    after = relaxed(ARGON, field, 4e-12, temperature=20.0, density=1.03 * ARGON.density, work_dir=tmp_path,
                    progress=said.append)  # fmt: skip
    assert_allclose(after.density, 1.03 * ARGON.density, rtol=1e-6)
    assert after.species == ARGON.species and len(said) == 3
    # the crystal shrinks as a whole: each atom stays at its site, within some thermal displacements
    factor = 1.03 ** (-1.0 / 3.0)
    middle = 0.5 * (ARGON.box.low + ARGON.box.high)
    site = middle + factor * (ARGON.position - middle)
    way = after.position - site
    assert np.abs(way - way.mean(axis=0)).max() < 1e-10
    assert np.ptp(way, axis=0).max() > 1e-12


def test_box_stays_without_density(tmp_path: Path) -> None:
    after = relaxed(ARGON, force_field("lennard-jones"), 1e-12, temperature=20.0, work_dir=tmp_path)
    assert_allclose(after.box.high - after.box.low, ARGON.box.high - ARGON.box.low, rtol=1e-12)


@pytest.mark.parametrize(("name", "value"), [("time", 0.0), ("temperature", -1.0), ("density", -2.0)])
def test_numbers_out_of_range(tmp_path: Path, name: str, value: float) -> None:
    given = {"time": 1e-12, "temperature": 20.0, "density": 1500.0, name: value}
    with pytest.raises(ValueError, match=f"{name} is {value}"):
        relaxed(ARGON, force_field("lennard-jones"), given.pop("time"), work_dir=tmp_path, **given)


def test_open_samples_are_refused(tmp_path: Path) -> None:
    flat = replace(ARGON, box=Box(ARGON.box.low, ARGON.box.high, (True, True, False)))
    with pytest.raises(ValueError, match="repeat along x, y and z"):
        relaxed(flat, force_field("lennard-jones"), 1e-12, work_dir=tmp_path)
