"""Elastic constants of graphene at 0 K, by force field."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from md_service.atom_system import AtomSystem
from md_service.elastic_constants import measure_graphene
from md_service.force_fields import force_field
from md_service.graphene import GRAPHENE_THICKNESS, graphene
from protocol.verification import Case, Check

#: Carbon-carbon distance in angstrom, E in GPa (thickness 3.35 angstrom) and Poisson's ratio.
FIGURES: Final = {
    "tersoff": (1.4388, 1054.0, 0.064),
    "airebo": (1.398, 827.0, 0.357),
    "rebo": (1.4204, 728.0, 0.388),
    "lcbop": (1.4199, 933.0, 0.221),
}
TOLERANCE: Final = 0.01
_SOURCE: Final = "tension of a periodic sheet with the bare potential, by another script"
_STRAIN: Final = 1e-3


def graphene_elastic(folder: Path) -> list[Check]:
    """Pull a periodic sheet by stress, and swell it by energy."""
    checks = []
    for name, (length, young, poisson) in FIGURES.items():
        measured = measure_graphene(name, 0.0, folder / name)
        checks += [
            Check(f"{name}: carbon-carbon distance", measured.lattice_constant, length * 1e-10, 3e-4, _SOURCE, "m"),
            Check(f"{name}: E", measured.young, young * 1e9, TOLERANCE, _SOURCE, "Pa"),
            Check(f"{name}: Poisson's ratio", measured.poisson, poisson, TOLERANCE, _SOURCE),
            Check(
                f"{name}: E / (1 - nu)",
                measured.young / (1.0 - measured.poisson),
                swelling_modulus(name, folder / f"{name}-energy"),
                TOLERANCE,
                f"energies at 0 and +-{_STRAIN:g} strain along both axes, no stress used",
                "Pa",
            ),
        ]
    return checks


def swelling_modulus(name: str, folder: Path) -> float:
    """E / (1 - nu) of a sheet, Pa: half of the second derivative of the energy by equal strain along both axes."""
    field = force_field(name)
    volume, energies = 0.0, []
    for strain in (-_STRAIN, 0.0, _STRAIN):
        atoms = graphene(20e-10, 20e-10, spacing=field.lattice_constant * (1.0 + strain), periodic=True)
        system = AtomSystem(folder, field, atoms, field.time_step)
        system.build(atoms.position)
        system.run(0, True, 0)
        energies.append(system.potential_energy())
        system.session.close()
        if strain == 0.0:
            width, height, _ = atoms.box.high - atoms.box.low
            volume = width * height * GRAPHENE_THICKNESS
    return float((energies[0] - 2.0 * energies[1] + energies[2]) / (2.0 * _STRAIN**2 * volume))


CASES = [Case("md", "graphene-elastic", "elastic constants of graphene at 0 K, by force field", graphene_elastic)]
