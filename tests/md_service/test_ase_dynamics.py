"""ASE calculators against LAMMPS and against each other."""

from __future__ import annotations

import sys
from importlib.metadata import EntryPoint
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from md_service import ase_dynamics
from md_service.ase_dynamics import ASE, CalculatorForces
from md_service.atom_system import AtomSystem
from md_service.atoms import Atoms
from md_service.crystals import fcc
from md_service.errors import EngineError
from md_service.force_fields import force_field
from md_service.graphene import graphene

pytest.importorskip("ase")


def lammps_forces(
    folder: Path, name: str, atoms: Atoms, position: NDArray[np.float64]
) -> tuple[NDArray[np.float64], float]:
    system = AtomSystem(folder, force_field(name), atoms, 1e-16)
    try:
        system.build(position)
        system.run(0, True, 0)
        return system.gather(np.array(system.local("f"))) * system.units.force, system.potential_energy()
    finally:
        system.session.close()


def shaken(atoms: Atoms, way: float) -> NDArray[np.float64]:
    return atoms.position + np.random.default_rng(5).normal(0.0, way, atoms.position.shape)


@pytest.mark.parametrize("periodic", [False, True], ids=["free", "periodic"])
def test_tersoff_of_matscipy_is_that_of_lammps(tmp_path: Path, periodic: bool) -> None:
    pytest.importorskip("matscipy")
    sheet = graphene(12e-10, 12e-10, spacing=1.44e-10, periodic=periodic)
    position = shaken(sheet, 0.05e-10)
    force, energy = ASE.forces("tersoff", sheet).forces(position)
    reference, reference_energy = lammps_forces(tmp_path, "tersoff", sheet, position)
    np.testing.assert_allclose(force, reference, rtol=0.0, atol=1e-6 * np.abs(reference).max())
    assert energy == pytest.approx(reference_energy, rel=1e-9)


def test_lennard_jones_of_ase_is_that_of_lammps(tmp_path: Path) -> None:
    crystal = fcc("Ar", 3.72e-10, (3, 3, 3), (True, True, False))
    position = shaken(crystal, 0.1e-10)
    forces = ASE.forces("lennard-jones", crystal)
    force, energy = forces.forces(position)
    reference, _ = lammps_forces(tmp_path, "lennard-jones", crystal, position)
    np.testing.assert_allclose(force, reference, rtol=0.0, atol=1e-6 * np.abs(reference).max())
    _, energies = forces.virial_and_energy(position)
    assert energies.sum() == pytest.approx(energy, rel=1e-10)


def test_emt_spacing_of_copper_is_that_without_stress(tmp_path: Path) -> None:
    measured = ASE.properties(tmp_path, "emt", "copper", 0.0, 1, lambda done, total: None)
    assert ASE.spacing("emt", "copper") == pytest.approx(measured.lattice_constant, rel=1e-5)
    assert 0.2 < measured.poisson < 0.45


def test_calculator_of_another_package_is_found_by_its_entry_point(monkeypatch: pytest.MonkeyPatch) -> None:
    point = EntryPoint("soft", "ase.calculators.lj:LennardJones", ase_dynamics.CALCULATORS)
    monkeypatch.setattr(ase_dynamics, "entry_points", lambda group: [point])
    assert "soft" in ASE.force_fields()
    assert ASE.materials("soft") == []
    assert ASE.force_field("soft") is None
    with pytest.raises(ValueError, match="material"):
        ASE.spacing("soft", "copper")


def test_calculator_without_energies_of_atoms_says_so() -> None:
    crystal = fcc("Cu", 2.54e-10, (2, 2, 2))
    forces = ASE.forces("emt", crystal)
    with pytest.raises(EngineError, match=r"EMT has no stresses.*positions and velocities"):
        forces.virial_and_energy(crystal.position)


def test_error_of_a_calculator_is_an_error_of_the_engine() -> None:
    def broken(atoms: object) -> object:
        raise RuntimeError("no licence")

    with pytest.raises(EngineError, match="RuntimeError: no licence"):
        CalculatorForces(fcc("Cu", 2.54e-10, (2, 2, 2)), broken)


def test_unknown_names_and_elements_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"force_field is 'reaxff'.*emt"):
        ASE.time_step("reaxff")
    with pytest.raises(ValueError, match="the sample has Ar"):
        ASE.forces("emt", fcc("Ar", 3.7e-10, (2, 2, 2)))
    with pytest.raises(ValueError, match="temperature"):
        ASE.properties(tmp_path, "emt", "copper", 300.0, 1, lambda done, total: None)


def test_missing_package_names_the_cure(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ase", None)
    with pytest.raises(EngineError, match=r"pip install 'scalebridge\[ase\]'"):
        ASE.forces("emt", fcc("Cu", 2.54e-10, (2, 2, 2)))
