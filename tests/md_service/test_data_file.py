"""Samples on disk: written and read back exactly, and shared with LAMMPS in both directions."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from md_service import units
from md_service.atoms import Atoms, Box, CrackCut, Topology
from md_service.data_file import read_data_file, write_data_file
from md_service.lammps_library import LammpsSession


def molecules(tilt: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Atoms:
    """Three bent chains of four atoms, one of them across the faces of a periodic box."""
    chain = np.array([[0.0, 0.0, 0.0], [1.1, 0.9, 0.1], [2.4, 0.2, 0.0], [3.5, 1.1, 0.3]])
    starts = np.array([[1.0 / 3.0, 2.0, 3.0], [8.85, 9.1, 9.7], [4.0, 6.0, 0.7]])
    position = (starts[:, None] + chain).reshape(-1, 3) * 1e-10
    first = np.array([0, 4, 8])
    return Atoms(
        position=position,
        kind=np.tile([0, 1, 1, 0], 3),
        species=("HA", "CA"),
        elements=("H", "C"),
        mass=np.array([1.008, 12.011]) * units.MASS,
        box=Box(np.zeros(3), np.array([10.0, 11.0, 12.0]) * 1e-10, (True, True, True), np.array(tilt) * 1e-10),
        charge=np.tile([0.115, -0.115, -0.115, 0.115], 3),
        molecule=np.repeat([1, 2, 3], 4),
        topology=Topology(
            bonds=np.concatenate([np.column_stack([np.full(3, k % 2), first + k, first + k + 1]) for k in range(3)]),
            angles=np.array([[0, i + k, i + k + 1, i + k + 2] for k in (0, 1) for i in first]),
            dihedrals=np.array([[0, i, i + 1, i + 2, i + 3] for i in first]),
            impropers=np.zeros((0, 5), dtype=np.int64),
            bond_names=("CA-HA", "CA-CA"),
            angle_names=("CA-CA-HA",),
            dihedral_names=("HA-CA-CA-HA",),
            improper_names=(),
        ),
        notes={"command": "three chains, 100 % by hand", "seed": 7, "density": 1.0 / 3.0},
    )  # fmt: skip


def cracked_sheet() -> Atoms:
    rng = np.random.default_rng(3)
    position = np.ascontiguousarray(rng.uniform(-5e-9, 5e-9, (200, 3)) * np.array([1.0, 1.0, 0.01]))
    return Atoms(
        position=position,
        kind=np.zeros(200, dtype=np.int64),
        species=("C",),
        elements=("C",),
        mass=np.array([12.011 * units.MASS]),
        box=Box(np.array([-5e-9, -5e-9, -1e-9]), np.array([5e-9, 5e-9, 1e-9])),
        spacing=1.439e-10,
        thickness=3.35e-10,
        site_volume=0.9e-29 / 7.0,
        crack=CrackCut(1e-9 / 3.0, 2e-10, left_x=-1e-9),
    )


def assert_same(read: Atoms, written: Atoms, position_tolerance: float = 0.0) -> None:
    for one in fields(Atoms):
        if one.name in ("position", "box", "topology"):
            continue
        a, b = getattr(read, one.name), getattr(written, one.name)
        assert np.array_equal(a, b) if isinstance(b, np.ndarray) else a == b, one.name
    for name in ("low", "high", "tilt"):
        assert np.array_equal(getattr(read.box, name), getattr(written.box, name)), name
    assert read.box.periodic == written.box.periodic
    np.testing.assert_allclose(read.position, written.position, rtol=0.0, atol=position_tolerance)
    assert (read.topology is None) == (written.topology is None)
    if read.topology is not None and written.topology is not None:
        for one in fields(Topology):
            a, b = getattr(read.topology, one.name), getattr(written.topology, one.name)
            assert np.array_equal(a, b) if isinstance(b, np.ndarray) else a == b, one.name


@pytest.mark.parametrize("suffix", [".data", ".data.gz"])
def test_a_sheet_is_read_back_to_the_last_bit(tmp_path: Path, suffix: str) -> None:
    written = cracked_sheet()
    path = tmp_path / f"sheet{suffix}"
    write_data_file(path, written, "metal", "atomic")
    read, unit_style = read_data_file(path)
    assert unit_style == "metal"
    assert_same(read, written)


@pytest.mark.parametrize("tilt", [(0.0, 0.0, 0.0), (1.5, -0.7, 2.0)])
def test_molecules_are_read_back_whole(tmp_path: Path, tilt: tuple[float, float, float]) -> None:
    written = molecules(tilt)
    write_data_file(tmp_path / "chains.data.gz", written, "real", "full")
    read, unit_style = read_data_file(tmp_path / "chains.data.gz")
    assert unit_style == "real"
    assert_same(read, written, position_tolerance=5e-25)  # round-off of one image, 5e-15 Angstrom
    _, images = written.box.wrapped(written.position)
    assert images.any()
    np.testing.assert_array_equal(read.position[~images.any(axis=1)], written.position[~images.any(axis=1)])


def test_the_same_sample_gives_the_same_packed_file(tmp_path: Path) -> None:
    for name in ("a.data.gz", "b.data.gz"):
        write_data_file(tmp_path / name, molecules(), "real", "full")
    assert (tmp_path / "a.data.gz").read_bytes() == (tmp_path / "b.data.gz").read_bytes()


@pytest.mark.parametrize(
    ("style", "left"), [("atomic", set()), ("charge", {"charge"}), ("full", {"charge", "molecule", "topology"})]
)
def test_a_style_keeps_what_it_has_a_place_for(tmp_path: Path, style: str, left: set[str]) -> None:
    write_data_file(tmp_path / "chains.data", molecules(), "metal", style)
    read, _ = read_data_file(tmp_path / "chains.data")
    parts = {"charge", "molecule", "topology"}
    assert {name for name in parts if getattr(read, name) is not None} == left
    plain = replace(molecules(), **dict.fromkeys(parts))
    write_data_file(tmp_path / "plain.data", plain, "metal", style)
    assert_same(read_data_file(tmp_path / "plain.data")[0], plain, position_tolerance=5e-25)


def lammps(tmp_path: Path, style: str, unit_style: str) -> LammpsSession:
    session = LammpsSession(tmp_path / "log.lammps")
    session.commands([f"units {unit_style}", f"atom_style {style}", "boundary p p p"])
    return session


@pytest.mark.parametrize("tilt", [(0.0, 0.0, 0.0), (1.5, -0.7, 2.0)])
def test_lammps_reads_ours_with_labels_and_topology(tmp_path: Path, tilt: tuple[float, float, float]) -> None:
    written = molecules(tilt)
    velocity = np.random.default_rng(1).normal(size=(12, 3)) * 500.0
    write_data_file(tmp_path / "chains.data.gz", written, "real", "full", velocity)
    session = lammps(tmp_path, "full", "real")
    try:
        session.commands(
            [
                "bond_style harmonic", "angle_style harmonic", "dihedral_style opls", "pair_style zero 5.0",
                f"read_data {tmp_path / 'chains.data.gz'}", "pair_coeff * *", "bond_coeff CA-HA 340 1.08",
                "bond_coeff CA-CA 469 1.4", "angle_coeff CA-CA-HA 35 120", "dihedral_coeff HA-CA-CA-HA 0 7.25 0 0",
                "thermo_style custom step ebond eangle edihed", "run 0",
            ]
        )  # fmt: skip
        lmp = session.lmp
        n = lmp.extract_global("nlocal")
        order = np.argsort(lmp.numpy.extract_atom("id")[:n])
        unwrapped = written.position / 1e-10
        images = written.box.wrapped(written.position)[1]
        inside = unwrapped - images @ written.box.edges / 1e-10
        np.testing.assert_allclose(lmp.numpy.extract_atom("x")[order], inside, atol=1e-13)
        np.testing.assert_allclose(lmp.numpy.extract_atom("v")[order], velocity / 1e5, rtol=1e-15)
        np.testing.assert_array_equal(lmp.numpy.extract_atom("q")[order], written.charge)
        # Independent: the energy of harmonic bonds from the unwrapped coordinates, U = K (r - r0)^2 (kcal/mol).
        assert written.topology is not None
        k, r0 = np.array([[340.0, 1.08], [469.0, 1.4]])[written.topology.bonds[:, 0]].T
        bond = unwrapped[written.topology.bonds[:, 2]] - unwrapped[written.topology.bonds[:, 1]]
        energy = np.sum(k * (np.linalg.norm(bond, axis=1) - r0) ** 2)
        assert lmp.get_thermo("ebond") == pytest.approx(energy, rel=1e-12)
    finally:
        session.close()


def test_a_file_written_by_lammps_is_read(tmp_path: Path) -> None:
    written = molecules()
    write_data_file(tmp_path / "ours.data", written, "real", "full")
    session = lammps(tmp_path, "full", "real")
    try:
        session.commands(
            [
                "bond_style harmonic", "angle_style harmonic", "dihedral_style opls", "pair_style lj/cut 5.0",
                f"read_data {tmp_path / 'ours.data'}", "pair_coeff * * 0.07 3.55", "bond_coeff * 340 1.08",
                "angle_coeff * 35 120", "dihedral_coeff * 0 7.25 0 0", "velocity all create 300 1 loop geom",
                f"write_data {tmp_path / 'theirs.data'}", f"write_data {tmp_path / 'labels.data'} types labels",
            ]
        )  # fmt: skip
    finally:
        session.close()
    for name in ("theirs.data", "labels.data"):
        read, unit_style = read_data_file(tmp_path / name)
        assert unit_style == "real"
        assert read.species == written.species and read.elements == ("H", "C")
        # LAMMPS writes and wraps in its own arithmetic.
        np.testing.assert_allclose(read.position, written.position, rtol=0.0, atol=1e-23)
        np.testing.assert_array_equal(read.kind, written.kind)
        np.testing.assert_array_equal(read.charge, written.charge)
        np.testing.assert_array_equal(read.molecule, written.molecule)
        np.testing.assert_allclose(read.mass, written.mass, rtol=1e-12)
        assert read.box.periodic == (True, True, True)
        assert read.topology is not None and written.topology is not None
        for part in ("bonds", "angles", "dihedrals"):
            ours, theirs = getattr(written.topology, part), getattr(read.topology, part)
            assert sorted(map(tuple, ours)) == sorted(map(tuple, theirs))
            names = part[:-1] + "_names"
            assert getattr(written.topology, names) == getattr(read.topology, names)


FOREIGN = """made by hand

3 atoms
2 atom types
0.0 20.0 xlo xhi
0.0 20.0 ylo yhi
-5.0 5.0 zlo zhi

Masses

1 63.55
2 15.9994  # oxygen

Pair Coeffs # lj/cut

1 0.1 2.5
2 0.1 3.0

Atoms

30 2 1.0 2.0 3.0 1 0 0
10 1 19.5 0.25 -4.5
20 1 1e1 1.0 1.0
"""


def test_ids_with_gaps_numbered_types_and_coefficients_of_a_foreign_file(tmp_path: Path) -> None:
    path = tmp_path / "foreign.data"
    path.write_text(FOREIGN.replace(" 1 0 0\n", "\n"))
    read, unit_style = read_data_file(path)
    assert unit_style is None
    assert read.species == ("1", "2") and read.elements == ("Cu", "O")
    np.testing.assert_array_equal(read.kind, [0, 0, 1])
    np.testing.assert_allclose(read.position[0], [19.5e-10, 0.25e-10, -4.5e-10], rtol=1e-15)
    assert read.charge is None and read.topology is None and read.molecule is None
    write_data_file(tmp_path / "again.data", read, "metal", "atomic")
    assert_same(read_data_file(tmp_path / "again.data")[0], read)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("3 atoms", "4 atoms", "4 atoms"),
        ("1 63.55\n", "", "mass of atom type '1'"),
        ("10 1 19.5", "10 5 19.5", "atom type '5'"),
        ("19.5", "nan", "finite"),
        (" 1 0 0\n", "\n\nVelocities # atomic\n\n", "announces|words"),
        ("Atoms\n", "Atoms # sphere\n", "sphere"),
        ("made by hand", "made by hand, units = lj", "'lj'"),
        ("2 atom types", "", "atom types"),
        ("2 atom types", "2000000000 atom types", "2000000000"),
        ("19.5", "1e999999999", "Overflow"),
        ("Masses", "Weights", "Weights"),
        ("0.0 20.0 xlo xhi", "20 0 0 avec", "avec"),
    ],
)
def test_a_broken_file_is_refused_with_its_name_and_the_fault(tmp_path: Path, old: str, new: str, said: str) -> None:
    path = tmp_path / "broken.data"
    whole = FOREIGN if "1 0 0" in old else FOREIGN.replace(" 1 0 0\n", "\n")
    assert old in whole
    path.write_text(whole.replace(old, new))
    if "Velocities" in new:
        path.write_text(whole)  # one line has images and the others have none
    with pytest.raises(ValueError, match=said) as caught:
        read_data_file(path)
    assert "broken.data" in str(caught.value)


def test_a_first_line_that_was_changed_by_hand_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "sheet.data"
    write_data_file(path, cracked_sheet(), "metal", "atomic")
    whole = path.read_text()
    for old, new in (('["C"]', '["C", "H"]'), ('"crack": {', '"crack": {"depth": 1, '), ("[false, false, false]", "3")):
        assert old in whole
        path.write_text(whole.replace(old, new))
        with pytest.raises(ValueError, match=r"sheet\.data"):
            read_data_file(path)


def test_a_file_that_is_not_there_is_told_as_such(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="absent"):
        read_data_file(tmp_path / "absent.data")


def test_bytes_that_are_no_data_file_are_refused(tmp_path: Path) -> None:
    (tmp_path / "noise.data.gz").write_bytes(b"nothing packed")
    (tmp_path / "noise.data").write_bytes(np.random.default_rng(0).bytes(500))
    (tmp_path / "empty.data").write_bytes(b"")
    write_data_file(tmp_path / "whole.data.gz", cracked_sheet(), "metal", "atomic")
    packed = (tmp_path / "whole.data.gz").read_bytes()
    (tmp_path / "short.data.gz").write_bytes(packed[:-100])
    (tmp_path / "bent.data.gz").write_bytes(packed[:1000] + bytes(64) + packed[1064:])
    for name in ("noise.data.gz", "noise.data", "empty.data", "short.data.gz", "bent.data.gz"):
        with pytest.raises(ValueError, match=name):
            read_data_file(tmp_path / name)


@pytest.mark.parametrize(
    ("change", "style", "said"),
    [
        ({}, "sphere", "atom_style"),
        ({"position": np.full((12, 3), np.nan)}, "full", "finite"),
        ({"species": ("HA", "1x")}, "full", "'1x'"),
        ({"species": ("CA", "CA")}, "full", "differ"),
        ({"box": Box(np.zeros(3), np.full(3, 1e-9))}, "full", "atom 6 .* along x"),
        ({"box": Box(np.zeros(3), np.array([1e-9, 1e-9, 0.0]))}, "full", "longer than zero"),
    ],
)
def test_what_lammps_could_not_read_is_not_written(
    tmp_path: Path, change: dict[str, object], style: str, said: str
) -> None:
    with pytest.raises(ValueError, match=said):
        write_data_file(tmp_path / "never.data", replace(molecules(), **change), "real", style)  # type: ignore[arg-type]
    assert not (tmp_path / "never.data").exists()
