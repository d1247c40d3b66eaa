"""Opening a periodic network: an infinite chain becomes an alkane, and a resin keeps every valence."""

from __future__ import annotations

import gzip
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from md_service.atoms import Atoms, Box, CrackCut, Topology
from md_service.data_file import read_data_file
from md_service.epoxy import SHIPPED
from md_service.epoxy_opening import APART, SLIT_HALF_HEIGHT, opened, repeats_in_plane
from md_service.neighbour_pairs import neighbour_pairs
from md_service.sample_source import sample_from_bytes

#: Bonds to hydrogen and other bonds of the resin at 300 K are shorter than these; the next distances are longer, m.
LONGEST = {True: 1.3e-10, False: 1.75e-10}
VALENCES = {"H": {1}, "C": {3, 4}, "N": {3}, "O": {2}}


def polyethylene(units: int) -> Atoms:
    """An infinite zigzag chain of CH2 along x, in a box that repeats on all sides."""
    pitch = 1.27e-10
    place, bonds = [], []
    for unit in range(units):
        x, y = (unit + 0.5) * pitch, 0.42e-10 * (-1) ** unit
        carbon = 3 * unit
        for dy, dz in ((0.0, 0.0), (0.63e-10 * (-1) ** unit, 0.89e-10), (0.63e-10 * (-1) ** unit, -0.89e-10)):
            place.append((x, 10e-10 + y + dy, 10e-10 + dz))
        bonds += [(carbon, carbon + 1), (carbon, carbon + 2), (carbon, 3 * ((unit + 1) % units))]
    rows = np.array([(0, *bond) for bond in bonds], dtype=np.int64)
    none = [np.zeros((0, width), dtype=np.int64) for width in (4, 5, 5)]
    return Atoms(
        position=np.array(place),
        kind=np.tile([0, 1, 1], units),
        species=("C", "H"),
        elements=("C", "H"),
        mass=np.array([1.9945e-26, 1.6738e-27]),
        box=Box(np.zeros(3), np.array([units * pitch, 20e-10, 20e-10]), (True, True, True)),
        topology=Topology(rows, *none, ("any",), (), (), ()),
    )


def symbols(atoms: Atoms) -> np.ndarray:
    return np.array(atoms.elements)[atoms.kind]


def valences(atoms: Atoms) -> dict[str, set[int]]:
    """Numbers of neighbours within the length of a bond, by element."""
    element = symbols(atoms)
    first, second, shift = neighbour_pairs(atoms, max(LONGEST.values()))
    length = np.linalg.norm(atoms.position[second] + shift - atoms.position[first], axis=1)
    hydrogens = (element[first] == "H").astype(int) + (element[second] == "H")
    bonded = (length < np.where(hydrogens > 0, LONGEST[True], LONGEST[False])) & (hydrogens < 2)
    count = np.bincount(np.concatenate([first[bonded], second[bonded]]), minlength=len(atoms))
    return {name: set(count[element == name].tolist()) for name in VALENCES}


@pytest.fixture(scope="module")
def resin() -> Atoms:
    return read_data_file(SHIPPED)[0]


def test_infinite_chain_becomes_an_alkane() -> None:
    chain = polyethylene(12)
    alkane = opened(chain)
    element = symbols(alkane)
    assert (np.sum(element == "C"), np.sum(element == "H")) == (12, 26)  # C_n H_(2n+2)
    assert alkane.box.periodic == (False, False, True)
    carbon = alkane.position[element == "C"]
    assert_allclose(carbon[:, 0].max() - carbon[:, 0].min(), 11 * 1.27e-10)
    assert_allclose(carbon[:, :2].mean(axis=0), 0.0, atol=1e-15)
    # the hydrogens of the ends lie 1.09 A from them, along the bond that was cut
    ends = alkane.position[-2:]
    away = np.linalg.norm(ends[:, None] - carbon[None], axis=2).min(axis=1)
    assert_allclose(away, 1.09e-10)
    assert alkane.notes["cut_bonds"] == 1


def test_closed_ends_do_not_crowd() -> None:
    # A slit that would take out one CH2 alone would put two hydrogens 0.7 A apart in its place: it stays.
    chain = polyethylene(12)
    middle = 0.5 * 12 * 1.27e-10
    tip = 6.5 * 1.27e-10 - middle + 0.1e-10
    assert len(opened(chain, CrackCut(tip, 0.0, tip - 0.2e-10))) == len(opened(chain))


def test_resin_keeps_its_valences(resin: Atoms) -> None:
    assert repeats_in_plane(resin)
    free = opened(resin)
    assert len(free) == len(resin) + 2 * int(free.notes["cut_bonds"])
    for name, found in valences(free).items():
        assert found <= VALENCES[name], name
    assert_allclose(free.atom_volume, resin.atom_volume)
    assert free.box.periodic == (False, False, True)
    # groups reach over the faces of the box by no more than a ring does
    half = 0.5 * (resin.box.high - resin.box.low)[:2]
    assert np.all(np.abs(free.position[:, :2]) < half + 4e-10)


def test_slit_in_the_resin(resin: Atoms) -> None:
    whole, cut = opened(resin), opened(resin, CrackCut(0.0, 5e-10))
    assert cut.crack == CrackCut(0.0, 5e-10)
    for name, found in valences(cut).items():
        assert found <= VALENCES[name], name
    behind = whole.position[:, 0] < -4e-10
    band = np.abs(whole.position[:, 1] - 5e-10) < 1e-10
    left = (cut.position[:, 0] < -4e-10) & (np.abs(cut.position[:, 1] - 5e-10) < 1e-10)
    # groups are taken out by their centres, so some atoms and the new hydrogens reach into the band
    assert np.sum(left) < 0.25 * np.sum(behind & band)
    ahead = whole.position[:, 0] > 7e-10
    kept = {tuple(place) for place in cut.position.tolist()}
    gone = [row for row in np.flatnonzero(ahead) if tuple(whole.position[row].tolist()) not in kept]
    # Ahead of the tip only a hydrogen may be missing that closed a bond to a partner, beyond the right face of the box,
    # which lay in the slit's left end.
    caps = len(whole.position) - int(whole.notes["caps"])
    for row in gone:
        x, y = whole.position[row, :2]
        assert row >= caps and whole.position[:, 0].max() - x < 5e-10 and abs(y - 5e-10) < SLIT_HALF_HEIGHT
    hydrogen = cut.position[-int(cut.notes["caps"]) :]
    apart = np.linalg.norm(hydrogen[:, None] - hydrogen[None], axis=2) + np.eye(len(hydrogen))
    assert apart.min() > APART
    assert SLIT_HALF_HEIGHT < 5e-10


def test_samples_of_the_service_are_opened(resin: Atoms) -> None:
    data = gzip.decompress(SHIPPED.read_bytes())
    atoms = sample_from_bytes(data, crack=CrackCut(0.0, 0.0))
    assert atoms.topology is None and atoms.notes["slit_atoms"] > 500
    assert_array_equal(atoms.position, opened(resin, CrackCut(0.0, 0.0)).position)
    with pytest.raises(ValueError, match="leave periodic_z out"):
        sample_from_bytes(data, periodic_z=False)


def test_bad_samples(resin: Atoms) -> None:
    with pytest.raises(ValueError, match="no bonds"):
        opened(replace(resin, topology=None))
    sheared = replace(resin.box, tilt=np.array([1e-10, 0.0, 0.0]))
    with pytest.raises(ValueError, match="sheared"):
        opened(replace(resin, box=sheared))
