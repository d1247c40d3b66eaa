"""Strength of a plate with a hole against its size: none where subcells fail at once, some where cracks take energy."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from fem_service.verification.oht_size import CELL, embedded, sudden
from fem_service.verification.pulled_laminates import Pull, cells, pull, shipped_cell
from protocol import structure as s
from protocol.micromechanics import RegisterCell


@pytest.fixture(scope="module")
def endpoint() -> Iterator[str]:
    with cells() as found:
        yield found


def plate(endpoint: str, scale: float, *, softens: bool) -> Pull:
    """An eighth of a cross-ply with a hole, 24 bricks, all its lengths times a scale."""
    cell = embedded(shipped_cell(CELL), 0.125e-3)  # of one strength, whatever the scale
    cell = cell if softens else sudden(cell)
    request = s.StructureConfigure(
        **{name: getattr(cell, name) for name in RegisterCell.model_fields},
        length=scale * 8e-3, width=scale * 8e-3, hole_diameter=scale * 3e-3, ply_thickness=scale * 2.5e-4,
        angles=[0.0, 0.5 * np.pi], quarter=True, lower_half=True, mesh=s.PlateMesh(around=4, radial=3, growth=3.0),
        temperature=300.0, final_strain=2e-2, increments=s.Increments(first=0.04, most=0.04, tolerance=1e-5),
        micromechanics=endpoint,
    )  # fmt: skip
    return pull(request, stop_below=0.5)


def test_sudden_failure_knows_no_length(endpoint: str) -> None:
    """A plate eight times as large, with a mesh eight times as large, does the same: no equation has a length."""
    small, large = (plate(endpoint, scale, softens=False) for scale in (1.0, 8.0))
    assert small.passed_its_peak and small.failures()[:, :, 0].sum() > 0  # fibres have failed
    assert large.strain == pytest.approx(small.strain, rel=1e-12)
    assert large.stress == pytest.approx(small.stress, rel=1e-9)
    assert np.array_equal(large.failures(), small.failures())


def test_energy_of_cracks_makes_small_plates_strong(endpoint: str) -> None:
    """The zone that softens has a length of its own, E G / strength^2; against it the small plate's hole is small."""
    small, large = (plate(endpoint, scale, softens=True) for scale in (0.5, 4.0))
    at_once = plate(endpoint, 1.0, softens=False)
    assert small.passed_its_peak and large.passed_its_peak
    assert small.peak > 1.2 * large.peak > 1.2 * at_once.peak


def test_matrix_in_thin_plies_is_stronger() -> None:
    """Strength in situ across the fibres: Camanho 2007 has 160.2 MPa (from memory); thick, 1.12 sqrt(2) of 62.3."""
    alone = shipped_cell(CELL).materials[1].failures[0]
    thin, thick = (embedded(shipped_cell(CELL), ply).materials[1].failures[0] for ply in (0.125e-3, 0.5e-3))
    assert alone.tension[1] and thin.tension[1] and thick.tension[1]  # they have an allowable
    assert 62.3 * thin.tension[1] / alone.tension[1] == pytest.approx(160.2, rel=0.01)
    assert 62.3 * thick.tension[1] / alone.tension[1] == pytest.approx(98.7, rel=0.01)
    assert thin.compression == alone.compression
    fibres = [embedded(shipped_cell(CELL), 0.5e-3).materials[0], shipped_cell(CELL).materials[0]]
    assert fibres[0] == fibres[1]
