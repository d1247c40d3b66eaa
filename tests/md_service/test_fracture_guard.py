import numpy as np
import pytest

from md_service.atoms import Atoms, CrackCut
from md_service.force_fields import force_field
from md_service.fracture_guard import FractureGuard
from md_service.graphene import graphene


def cracked(name: str) -> Atoms:
    return graphene(40e-10, 40e-10, spacing=force_field(name).lattice_constant, crack=CrackCut(0.0))


def stretched(atoms: Atoms, guard: FractureGuard, bond: int, length: float) -> np.ndarray:
    """Positions in which one bond has the given length, m."""
    first, second = guard.bonds.pairs[bond]
    new = atoms.position.copy()
    direction = atoms.position[second] - atoms.position[first]
    new[second] = atoms.position[first] + direction * (length / np.linalg.norm(direction))
    return new


def test_nothing_is_warned_of_while_bonds_are_short() -> None:
    atoms = cracked("airebo")
    guard = FractureGuard(force_field("airebo"), atoms)
    assert guard.report(atoms.position).warning == ""
    assert guard.report(stretched(atoms, guard, 100, 1.60e-10)).warning == ""
    assert guard.released_energy == 0.0


@pytest.mark.parametrize(("name", "start"), [("airebo", 1.70), ("rebo", 1.70), ("tersoff", 1.80), ("lcbop", 1.70)])
def test_a_sticking_bond_is_named_with_length_place_reason_and_cure(name: str, start: float) -> None:
    atoms = cracked(name)
    guard = FractureGuard(force_field(name), atoms)
    position = stretched(atoms, guard, 100, 1.01 * start * 1e-10)
    first, second = guard.bonds.pairs[100]
    place = 0.5e10 * (position[first] + position[second])
    warning = guard.report(position).warning
    assert f"atoms {first} and {second} at ({place[0]:.1f}, {place[1]:.1f}, {place[2]:.1f}) A" in warning
    assert f"{1.01 * start:.3f} A" in warning
    assert f"stick at {start:.2f} A" in warning
    assert "-sharp" in warning
    # While any bond sticks the text is that of the first one, so that a run shows it once; then it ends.
    assert guard.report(stretched(atoms, guard, 200, 1.01 * start * 1e-10)).warning == warning
    assert guard.report(atoms.position).warning == ""


@pytest.mark.parametrize("name", ["airebo-sharp", "rebo-sharp"])
def test_a_cut_bond_is_named_with_what_the_cut_gives_away(name: str) -> None:
    field = force_field(name)
    atoms = cracked(name)
    guard = FractureGuard(field, atoms)
    assert field.cut_energy is not None
    assert guard.report(stretched(atoms, guard, 100, 1.99e-10)).warning == ""
    first, second = guard.bonds.pairs[100]
    report = guard.report(stretched(atoms, guard, 100, 2.01e-10))
    assert f"atoms {first} and {second}" in report.warning
    assert f"{field.cut_energy / 1.602176634e-19:.2f} eV" in report.warning
    assert report.broken >= 1
    assert guard.released_energy == report.broken * field.cut_energy
    # A bond that closes again takes its energy back.
    guard.report(atoms.position)
    assert guard.released_energy == 0.0


def test_without_a_force_field_bonds_are_counted_and_nothing_is_said() -> None:
    atoms = cracked("airebo")
    guard = FractureGuard(None, atoms)
    report = guard.report(stretched(atoms, guard, 100, 2.5e-10))
    assert (report.broken >= 1, report.warning, guard.released_energy) == (True, "", 0.0)
