"""Parameters of OPLS-AA: lookup, completeness for the resin, and the energy that LAMMPS makes of them."""

from pathlib import Path

import numpy as np
import pytest

from md_service.atoms import Atoms, Box
from md_service.data_file import write_data_file
from md_service.epoxy_monomers import Molecule, monomer
from md_service.epoxy_typing import typed
from md_service.lammps_library import LammpsSession
from md_service.opls import STYLES, canonical, coefficient_commands, coefficients, opls_table
from md_service.units import LENGTH

_BOX = Box(np.zeros(3), np.full(3, 40e-10), (True, True, True))


def _energies(atoms: Atoms, folder: Path) -> dict[str, float]:
    """Bonded energies by LAMMPS, kcal/mol."""
    write_data_file(folder / "sample.data", atoms, "real", "full")
    session = LammpsSession(folder / "log.lammps")
    session.commands(
        [
            "units real",
            "atom_style full",
            f"read_data {folder / 'sample.data'}",
            *STYLES,
            *coefficient_commands(atoms),
            "thermo_style custom ebond eangle edihed eimp",
            "run 0",
        ]
    )
    found = {name: float(session.lmp.get_thermo(name)) for name in ("ebond", "eangle", "edihed", "eimp")}
    session.close()
    return found


def _angle(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.arccos(a @ b / (np.linalg.norm(a) * np.linalg.norm(b))))


def _dihedral(p: np.ndarray) -> float:
    b1, b2, b3 = np.diff(p, axis=0)
    n1, n2 = np.cross(b1, b2), np.cross(b2, b3)
    return float(np.arctan2(np.cross(n1, n2) @ b2 / np.linalg.norm(b2), n1 @ n2))


@pytest.mark.parametrize("name", ["DGEBF", "DETDA"])
def test_bonded_energies_are_those_of_the_functions_of_the_force_field(name: str, tmp_path: Path) -> None:
    atoms = typed(monomer(name), _BOX)
    topology, table = atoms.topology, opls_table()
    assert topology is not None
    x = atoms.position / LENGTH
    expected = dict.fromkeys(("ebond", "eangle", "edihed", "eimp"), 0.0)
    for kind, a, b in topology.bonds:
        k, r0 = coefficients(table.bonds, topology.bond_names[kind].split("-"))
        expected["ebond"] += k * (np.linalg.norm(x[a] - x[b]) - r0) ** 2
    for kind, a, b, c in topology.angles:
        k, theta0 = coefficients(table.angles, topology.angle_names[kind].split("-"))
        expected["eangle"] += k * (_angle(x[a] - x[b], x[c] - x[b]) - np.radians(theta0)) ** 2
    for kind, *rows in topology.dihedrals:
        v = coefficients(table.dihedrals, topology.dihedral_names[kind].split("-"))
        phi = _dihedral(x[rows])
        signs = (1.0, -1.0, 1.0, -1.0)
        expected["edihed"] += sum(0.5 * v[n - 1] * (1.0 + signs[n - 1] * np.cos(n * phi)) for n in (1, 2, 3, 4))
    for _, *rows in topology.impropers:
        expected["eimp"] += 2.5 * (1.0 - np.cos(2.0 * _dihedral(x[rows])))
    assert _energies(atoms, tmp_path) == pytest.approx(expected, rel=1e-5, abs=1e-6)


def test_a_term_reads_the_same_from_both_ends() -> None:
    table = opls_table()
    assert coefficients(table.angles, ["HC", "CT", "OS"]) == coefficients(table.angles, ["OS", "CT", "HC"])
    assert canonical(["OS", "CT", "CA"]) == canonical(["CA", "CT", "OS"]) == ("CA", "CT", "OS")


def test_an_exact_term_goes_before_one_with_a_wildcard() -> None:
    terms = {("X", "CA", "CA", "X"): (1.0,), ("HA", "CA", "CA", "HA"): (2.0,)}
    assert coefficients(terms, ["HA", "CA", "CA", "HA"]) == (2.0,)
    assert coefficients(terms, ["HA", "CA", "CA", "CT"]) == (1.0,)


def test_a_term_that_is_not_tabulated_is_named() -> None:
    with pytest.raises(ValueError, match="OH-CT-OH"):
        coefficients(opls_table().angles, ["OH", "CT", "OH"])


def test_a_sample_without_bonds_is_refused() -> None:
    carbon = Atoms(np.zeros((1, 3)), np.zeros(1, dtype=np.int64), ("C",), ("C",), np.array([2e-26]), _BOX)
    with pytest.raises(ValueError, match="bonds and charges"):
        coefficient_commands(carbon)


def test_graphene_with_hydrogen_edges_has_all_its_terms() -> None:
    """Naphthalene, which has two fused carbons of no charge."""
    rings = [(0, 1, 2, 3, 4, 5), (4, 5, 6, 7, 8, 9)]
    carbon = sorted({tuple(sorted((r[i], r[(i + 1) % 6]))) for r in rings for i in range(6)})
    hydrogen = [(c, 10 + i) for i, c in enumerate((0, 1, 2, 3, 6, 7, 8, 9))]
    molecule = Molecule(("C",) * 10 + ("H",) * 8, np.zeros((18, 3)), np.array(carbon + hydrogen, dtype=np.int64))
    atoms = typed(molecule, _BOX)
    assert [atoms.species[k] for k in atoms.kind[[4, 5]]] == ["CA_147", "CA_147"]
    assert atoms.charge is not None and abs(atoms.charge.sum()) < 1e-12
    assert len(coefficient_commands(atoms)) == 3 + 2 + 2 + 3 + 1
