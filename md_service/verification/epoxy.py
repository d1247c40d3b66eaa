"""The cross-linked epoxy: a small one built on the spot, and the one that is shipped."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np

from md_service.atoms import Atoms
from md_service.epoxy import SHIPPED, SHIPPED_UNITS, UNIT_ATOMS, build_epoxy, shipped_epoxy
from md_service.epoxy_curing import cross_links, epoxide_groups
from md_service.epoxy_relaxation import ATMOSPHERE, STEP, ResinRun
from md_service.epoxy_rings import speared_rings
from md_service.epoxy_typing import graph_of
from md_service.statistics import estimate
from md_service.stiffness import Sampling, thermal_stiffness
from protocol.verification import CannotRun, Case, Check

UNITS: Final = 8
SEED: Final = 1
CONVERSION: Final = 0.76
TEMPERATURE: Final = 300.0  # K
DENSITY: Final = 1200.0  # kg/m^3
DENSITY_TOLERANCE: Final = 0.03
VALENCE: Final = {"C": (3, 4), "N": (3,), "O": (2,), "H": (1,)}
#: Young's modulus of simulations and tests, Pa, and Poisson's ratio.
YOUNG: Final = (2.3e9, 3.5e9)
POISSON: Final = 0.36
#: Of the modulus: 1 % of strain, 1 ps to settle and 1 ps of average, four replicas.
SAMPLING: Final = Sampling(strain=1e-2, settling=1e-12, sampling=1e-12, replicas=4, damping_time=0.05e-12)
HOLDING: Final = 4e-12  # s, to measure the density of the shipped sample


def _structure(atoms: Atoms, units: int, name: str) -> list[Check]:
    """What bonds alone tell."""
    graph = graph_of(atoms)
    links, groups = cross_links(graph), len(epoxide_groups(graph))
    wrong = sum(len(graph.neighbours[i]) not in VALENCE[element] for i, element in enumerate(graph.elements))
    charge = abs(float(np.sum(atoms.charge))) if atoms.charge is not None else np.nan
    build = "bonds of the sample"
    return [
        Check(f"atoms, {name}", len(atoms), units * UNIT_ATOMS, 0.0, "units of two DGEBF and one DETDA"),
        Check(f"epoxide groups, reacted and not, {name}", links + groups, 4 * units, 0.0, "two on each DGEBF"),
        Check(f"reacted groups, {name}", links, round(CONVERSION * 4 * units), 0.0, "76 % to the nearest group"),
        Check(f"atoms of a wrong valence, {name}", wrong, 0.0, 0.0, build),
        Check(f"bonds through aromatic rings, {name}", len(speared_rings(atoms)), 0.0, 0.0, build),
        Check(f"net charge, {name}", charge, 0.0, 1e-9, "neutral monomers", "e"),
    ]


def _density(value: float, name: str) -> Check:
    return Check(
        f"density at {TEMPERATURE:g} K, {name}",
        value,
        DENSITY,
        DENSITY_TOLERANCE,
        "measured EPON 862/DETDA, 1.2 g/cc",
        "kg/m3",
    )


def small_epoxy(folder: Path) -> list[Check]:
    """Build a small resin and look at its bonds and its density."""
    atoms = build_epoxy(UNITS, CONVERSION, TEMPERATURE, SEED, folder)
    scatter = float(atoms.notes["density_scatter"])
    return [
        *_structure(atoms, UNITS, f"{UNITS} units"),
        _density(atoms.density, f"{UNITS} units, scatter {scatter:.0f}"),
    ]


def full_epoxy(folder: Path) -> list[Check]:
    """Read the shipped resin, and hold it at atmospheric pressure to see whether its density is at rest."""
    if not SHIPPED.exists():
        raise CannotRun(f"the sample {SHIPPED.name} is not in this installation")
    atoms = shipped_epoxy()
    run = ResinRun(folder, atoms, TEMPERATURE, SEED)
    try:
        density = run.hold(round(HOLDING / STEP), TEMPERATURE, TEMPERATURE, ATMOSPHERE)
    finally:
        run.close()
    settled = estimate(density[len(density) // 2 :], HOLDING / len(density))
    name = f"{SHIPPED_UNITS} units"
    return [
        *_structure(atoms, SHIPPED_UNITS, name),
        _density(float(settled.mean), f"{name}, standard error {float(settled.standard_error):.1f}"),
    ]


def epoxy_modulus(folder: Path) -> list[Check]:
    """Strain a small resin both ways along each axis, at 300 K."""
    atoms = build_epoxy(UNITS, CONVERSION, TEMPERATURE, SEED, folder / "build")
    stiffness = thermal_stiffness(
        atoms, "opls-aa", TEMPERATURE, folder / "strain", sampling=SAMPLING, isotropic=True, time_step=1e-15
    )
    value, error = stiffness.isotropic()
    middle, half = 0.5 * (YOUNG[1] + YOUNG[0]), 0.5 * (YOUNG[1] - YOUNG[0])
    at = f"{UNITS} units, {stiffness.strain:g} of strain at {stiffness.rate:.1e} 1/s"
    return [
        Check(
            f"Young's modulus, {at}, standard error {error.young / 1e9:.2f} GPa",
            value.young,
            middle,
            # Within the range of other work by two standard errors.
            (half + 2.0 * error.young) / middle,
            "2.3 to 3.5 GPa, other simulations and tests",
            "Pa",
        ),
        Check(
            f"Poisson's ratio, {at}, standard error {error.poisson:.3f}",
            value.poisson,
            POISSON,
            2.0 * error.poisson / POISSON + 0.05,
            "0.36, other simulations",
        ),
    ]


CASES = [
    Case("md", "epoxy", "a small epoxy built whole: conversion, valences, rings, density", small_epoxy),
    Case("md", "epoxy-full", "the shipped epoxy: conversion, valences, rings, density held", full_epoxy, slow=True),
    Case("md", "epoxy-modulus", "Young's modulus and Poisson's ratio of a small epoxy", epoxy_modulus, slow=True),
]
