"""Samples of any outline."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from md_service import service as services
from md_service.atoms import Topology
from md_service.crystals import hexagonal
from md_service.data_file import write_data_file
from md_service.graphene import graphene
from md_service.kept_atoms import kept_atoms
from protocol import atomistic as a
from protocol.errors import ProtocolError

A = 1e-10
DIAMOND = [(20 * A, 0.0), (0.0, 20 * A), (-20 * A, 0.0), (0.0, -20 * A)]


def test_atoms_of_a_diamond_are_those_whose_coordinates_sum_to_less() -> None:
    sheet = graphene(60 * A, 60 * A, spacing=1.42 * A)
    kept = kept_atoms(sheet, DIAMOND)
    wanted = np.abs(sheet.position[:, :2]).sum(axis=1) <= 20 * A
    np.testing.assert_array_equal(kept.position, sheet.position[wanted])
    assert kept.atom_volume == sheet.atom_volume and len(kept.kind) == len(kept)
    # Half of the square around it, to the atoms along the border.
    assert len(kept) * sheet.atom_volume == pytest.approx(800 * A**2 * 3.35 * A, rel=0.03)


def test_border_belongs_to_the_polygon_and_may_turn_inwards() -> None:
    sheet = hexagonal(4.0 * A, 40 * A, 40 * A)
    x, y = sheet.position[:, :2].T
    low = y.min()
    bent = [(-1e-8, low), (1e-8, low), (1e-8, 1e-8), (0.0, 0.0), (-1e-8, 1e-8)]
    wanted = (y < np.abs(x)) | (np.abs(y) < 1e-20) & (np.abs(x) < 1e-20)
    np.testing.assert_array_equal(kept_atoms(sheet, bent).position, sheet.position[wanted])
    assert (y == low).any()


@pytest.mark.parametrize(
    ("corners", "said"),
    [
        ([(0.0, 0.0), (1e-9, 0.0)], "2 corners"),
        ([(0.0, 0.0), (1e-9, 1e-9), (1e-9, 0.0), (0.0, 1e-9)], "Self-intersection"),
        ([(0.0, 0.0), (1e-9, 0.0), (2e-9, 0.0)], "no simple polygon"),
        ([(1e-7, 0.0), (2e-7, 0.0), (2e-7, 1e-7)], "no atom"),
    ],
)
def test_what_is_no_outline_is_refused(corners: list[tuple[float, float]], said: str, tmp_path: Path) -> None:
    service = services.make_lattice(tmp_path)
    request = a.AtomisticConfigure(
        force_field="harmonic", sample=a.Sample(material="hexagonal", width=60 * A, height=60 * A), temperature=0.0,
        time_step=1e-15, seed=1, keep=corners,
    )  # fmt: skip
    with pytest.raises(ProtocolError, match=said) as caught:
        service.configure(request)
    assert (caught.value.report.code, caught.value.report.field) == ("bad_field", "keep")


def test_molecules_are_in_or_out_as_a_whole() -> None:
    position = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [10, 0, 0], [11, 0, 0], [12, 0, 0]]) * A
    box = replace(hexagonal(4 * A, 40 * A, 40 * A).box)
    none = np.zeros((0, 5), dtype=np.int64)
    lists = Topology(
        bonds=np.array([[0, 0, 1], [0, 1, 2], [0, 3, 4], [0, 4, 5]]), angles=np.array([[0, 0, 1, 2], [0, 3, 4, 5]]),
        dihedrals=none, impropers=none, bond_names=("a",), angle_names=("b",), dihedral_names=(), improper_names=(),
    )  # fmt: skip
    water = replace(
        hexagonal(4 * A, 40 * A, 40 * A), position=position, kind=np.zeros(6, dtype=np.int64), box=box, spacing=None,
        molecule=np.array([1, 1, 1, 2, 2, 2]), charge=np.arange(6.0), topology=lists, site_volume=None,
    )  # fmt: skip
    second = kept_atoms(water, [(5 * A, -A), (20 * A, -A), (20 * A, A), (5 * A, A)])
    assert second.topology is not None and second.charge is not None and second.molecule is not None
    np.testing.assert_array_equal(second.topology.bonds, [[0, 0, 1], [0, 1, 2]])
    np.testing.assert_array_equal(second.topology.angles, [[0, 0, 1, 2]])
    np.testing.assert_array_equal(second.charge, [3.0, 4.0, 5.0])
    np.testing.assert_array_equal(second.molecule, 2)
    assert second.atom_volume == water.atom_volume
    with pytest.raises(ValueError, match="keep cuts 1 bonds of molecules"):
        kept_atoms(water, [(1.5 * A, -A), (20 * A, -A), (20 * A, A), (1.5 * A, A)])


def test_a_file_is_kept_like_a_built_sample(tmp_path: Path) -> None:
    service = services.make_service(tmp_path)
    sample = a.Sample(material="graphene", width=50 * A, height=50 * A)
    request = a.AtomisticConfigure(
        force_field="tersoff", sample=sample, temperature=0.0, time_step=5e-16, seed=1, keep=DIAMOND
    )
    built = service.configure(request)
    assert np.abs(built.position[:, :2]).sum(axis=1).max() <= 20 * A
    whole = service.configure(request.model_copy(update={"keep": []}))
    assert len(whole.atom_id) > 2 * len(built.atom_id)
    write_data_file(tmp_path / "sheet.data", service._configured().atoms, "metal", "atomic")
    data = np.frombuffer((tmp_path / "sheet.data").read_bytes(), np.uint8)
    from_file = {"sample": None, "sample_file": a.SampleFile(), "sample_data": data}
    again = service.configure(request.model_copy(update=from_file))
    np.testing.assert_allclose(again.position, built.position, rtol=0.0, atol=1e-22)
