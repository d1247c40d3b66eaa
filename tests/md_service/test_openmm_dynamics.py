"""OpenMM against LAMMPS, and Lennard-Jones solids against lattice sums."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import brentq

from md_service.atom_system import AtomSystem
from md_service.atoms import Atoms, Box
from md_service.crystals import fcc, hexagonal
from md_service.epoxy_monomers import joined, monomer
from md_service.epoxy_typing import typed
from md_service.errors import EngineError
from md_service.force_fields import force_field
from md_service.lennard_jones import lennard_jones_parameters
from md_service.openmm_dynamics import OPENMM, OpenmmForces

pytest.importorskip("openmm")


def lammps_forces(
    folder: Path, name: str, atoms: Atoms, position: NDArray[np.float64]
) -> tuple[NDArray[np.float64], float, NDArray[np.float64]]:
    """Forces, energy and the virial tensor's xx, yy, zz, xy, xz, yz, J."""
    system = AtomSystem(folder, force_field(name), atoms, 1e-16)
    try:
        system.build(position)
        system.session.commands(["compute still all pressure NULL virial", "thermo_style custom step pe c_still[*]"])
        system.run(0, True, 0)
        force = system.gather(np.array(system.local("f"))) * system.units.force
        unit = system.units
        volume = float(np.prod(system.box().high - system.box().low))
        pressure = np.array(system.session.lmp.extract_compute("still", 0, 1)[:6])
        return force, system.potential_energy(), -pressure * unit.pressure * volume
    finally:
        system.session.close()


def shaken(atoms: Atoms, way: float) -> NDArray[np.float64]:
    return atoms.position + np.random.default_rng(5).normal(0.0, way, atoms.position.shape)


def resin(periodic: bool) -> Atoms:
    """One molecule of each monomer."""
    resin, hardener = monomer("DGEBF"), monomer("DETDA")
    above = resin.position.mean(axis=0) + np.array([0.0, 0.0, 7e-10])
    both = joined([resin, hardener.at(hardener.position - hardener.position.mean(axis=0) + above)])
    middle = both.position.mean(axis=0)
    return typed(both, Box(middle - 14e-10, middle + 14e-10, (periodic,) * 3))


@pytest.mark.parametrize("platform", ["Reference", "CPU"])
@pytest.mark.parametrize("periodic", [False, True], ids=["free", "periodic"])
def test_opls_is_that_of_lammps(tmp_path: Path, platform: str, periodic: bool) -> None:
    atoms = resin(periodic)
    position = shaken(atoms, 0.03e-10)
    force, energy = OpenmmForces(atoms, "opls-aa", platform).forces(position)
    reference, reference_energy, _ = lammps_forces(tmp_path, "opls-aa", atoms, position)
    np.testing.assert_allclose(force, reference, rtol=0.0, atol=1e-5 * np.abs(reference).max())
    if periodic:  # of a free sample LAMMPS adds the dispersion beyond the cut-off as well, for the box it has made
        assert energy == pytest.approx(reference_energy, rel=1e-5)


@pytest.mark.parametrize("periodic", [(True, True, True), (True, True, False), (False, False, False)])
def test_lennard_jones_is_that_of_lammps(tmp_path: Path, periodic: tuple[bool, bool, bool]) -> None:
    crystal = fcc("Ar", 3.72e-10, (5, 5, 5), periodic)
    position = shaken(crystal, 0.1e-10)
    # Whole boxes away, as atoms of a long run may be.
    position += crystal.box.edges[0] * crystal.box.periodic[0]
    forces = OpenmmForces(crystal, "lennard-jones")
    force, energy = forces.forces(position)
    reference, reference_energy, reference_virial = lammps_forces(tmp_path, "lennard-jones", crystal, position)
    np.testing.assert_allclose(force, reference, rtol=0.0, atol=5e-5 * np.abs(reference).max())
    assert energy == pytest.approx(reference_energy, rel=1e-5)
    virial, energies = forces.virial_and_energy(position)
    assert energies.sum() == pytest.approx(reference_energy, rel=1e-9)
    np.testing.assert_allclose(virial.sum(axis=0), reference_virial, rtol=0.0, atol=1e-6 * np.abs(virial).sum())


def test_hexagonal_layer_has_the_constants_of_its_lattice_sums(tmp_path: Path) -> None:
    measured = OPENMM.properties(tmp_path, "lennard-jones", "hexagonal", 0.0, 1, lambda done, total: None)
    epsilon, sigma, cutoff = lennard_jones_parameters()
    i, j = np.meshgrid(np.arange(-9, 10), np.arange(-9, 10))
    unit = np.column_stack([(i + 0.5 * j).ravel(), (0.5 * np.sqrt(3.0) * j).ravel()])
    unit = unit[(np.linalg.norm(unit, axis=1) > 0.0) & (np.linalg.norm(unit, axis=1) * 3.78e-10 < cutoff)]

    def slope_of(far: NDArray[np.float64]) -> NDArray[np.float64]:
        s6 = (sigma / far) ** 6
        return np.asarray(-24.0 * epsilon * (2.0 * s6**2 - s6) / far)

    def tension(spacing: float) -> float:
        far = np.linalg.norm(unit, axis=1) * spacing
        return float(np.sum(slope_of(far) * far) / epsilon)

    a = brentq(tension, 3.6e-10, 3.9e-10, xtol=1e-18)
    assert measured.lattice_constant == pytest.approx(a, rel=2e-6)
    way, far = unit * a, np.linalg.norm(unit, axis=1) * a
    s6, slope = (sigma / far) ** 6, slope_of(far)
    curve = 24.0 * epsilon * (26.0 * s6**2 - 7.0 * s6) / far**2
    area = 0.5 * np.sqrt(3.0) * a**2 * measured.thickness
    direct = 0.5 / area * np.sum((curve - slope / far) * way[:, 0] ** 4 / far**2)
    cross = 0.5 / area * np.sum((curve - slope / far) * (way[:, 0] * way[:, 1]) ** 2 / far**2)
    assert measured.young == pytest.approx(direct - cross**2 / direct, rel=1e-4)
    assert measured.poisson == pytest.approx(cross / direct, rel=1e-4)


def test_argon_crystal_keeps_its_spacing(tmp_path: Path) -> None:
    measured = OPENMM.properties(tmp_path, "lennard-jones", "argon", 0.0, 1, lambda done, total: None)
    assert OPENMM.spacing("lennard-jones", "argon") == pytest.approx(measured.lattice_constant, rel=1e-4)


def test_energy_of_the_resin_is_kept(tmp_path: Path) -> None:
    atoms = resin(True)
    drawn = OPENMM.make(tmp_path, "opls-aa", atoms, temperature=300.0, seed=1, time_step=0.25e-15)
    drawn.minimise(200)
    drawn.draw_velocities(300.0)
    energies = []
    from md_service.anchors import checked_anchors

    anchors = checked_anchors([0], atoms.position[:1], [1.0], [0], None, atoms.atom_mass)
    drawn.adopt(anchors)
    for _ in range(60):
        window = drawn.run_window(4)
        kinetic = window.kinetic_handshake + window.kinetic_inner
        energies.append(kinetic + window.potential_energy + anchors.spring_energy(window.position, anchors.position))
    assert np.ptp(energies) < 0.01 * kinetic


def test_what_openmm_cannot_do_is_refused() -> None:
    with pytest.raises(ValueError, match=r"box is .* along x.*twice the cut-off"):
        OPENMM.forces("lennard-jones", fcc("Ar", 3.72e-10, (3, 3, 3)))
    with pytest.raises(ValueError, match="the sample has Cu"):
        OPENMM.forces("lennard-jones", fcc("Cu", 2.55e-10, (9, 9, 9)))
    with pytest.raises(ValueError, match=r"force_field is 'tersoff'"):
        OPENMM.time_step("tersoff")
    with pytest.raises(EngineError, match="OpenMM has no virial"):
        OpenmmForces(resin(False), "opls-aa").virial_and_energy(resin(False).position)
    with pytest.raises(ValueError, match="bonds and charges"):
        OPENMM.forces("opls-aa", hexagonal(1.42e-10, 9e-10, 9e-10, element="C"))


def test_missing_package_names_the_cure(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "openmm", None)
    with pytest.raises(EngineError, match=r"pip install 'scalebridge\[openmm\]'"):
        OPENMM.forces("lennard-jones", hexagonal(3.78e-10, 20e-10, 20e-10))
