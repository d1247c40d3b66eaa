"""Epoxy filled with a graphene platelet (chapter 6): the platelet, its share of resin, and the cured sample."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from md_service.atoms import Atoms
from md_service.epoxy import UNIT_MASS, build_epoxy
from md_service.epoxy_monomers import Molecule
from md_service.epoxy_relaxation import Schedule
from md_service.graphene import bonds_of, graphene

CARBON_HYDROGEN: Final = 1.08e-10  # m, as in benzene
CLEARANCE: Final = 6.8e-10  # m of resin between a platelet and its periodic image: two layers of contact
RESIN_DENSITY: Final = 1200.0  # kg/m^3, for the size of the box before it is made


def platelet(width: float, height: float, spacing: float = 1.40e-10) -> Molecule:
    """A flat piece of graphene whose edge is closed by hydrogen.

    Parameters
    ----------
    width, height : float
        Size along x (zigzag direction) and y, m; the nearest whole cells are built.
    spacing : float
        Carbon-carbon distance, m; by default that of OPLS-AA's aromatic bond.

    Returns
    -------
    Molecule
        Carbon atoms first, then one hydrogen for each carbon atom of the edge, in the plane z = 0.

    Raises
    ------
    ValueError
        If it is smaller than three cells either way.
    """
    carbon = graphene(width, height, spacing=spacing).position
    bonds = bonds_of(carbon, spacing)
    ends = np.concatenate([bonds, bonds[:, ::-1]])
    inward = np.zeros_like(carbon)
    np.add.at(inward, ends[:, 0], carbon[ends[:, 1]] - carbon[ends[:, 0]])
    edge = np.flatnonzero(np.bincount(bonds.ravel(), minlength=len(carbon)) == 2)
    outward = -inward[edge] / np.linalg.norm(inward[edge], axis=1)[:, None]
    hydrogen = carbon[edge] + CARBON_HYDROGEN * outward
    closing = np.column_stack([edge, len(carbon) + np.arange(len(edge))])
    return Molecule(
        ("C",) * len(carbon) + ("H",) * len(edge), np.concatenate([carbon, hydrogen]), np.concatenate([bonds, closing])
    )


def units_for(weight_fraction: float, filler: Molecule) -> int:
    """Number of resin units (two DGEBF and one DETDA) that brings a filler nearest to a weight fraction.

    Parameters
    ----------
    weight_fraction : float
        Mass of the filler over that of all.
    filler : Molecule
        The platelet.

    Raises
    ------
    ValueError
        If the fraction is not between 0 and 1, or asks for less than one unit.
    """
    if not 0.0 < weight_fraction < 1.0:
        raise ValueError(f"weight_fraction is {weight_fraction}; it must be greater than 0 and less than 1")
    wanted = filler.mass * (1.0 / weight_fraction - 1.0) / UNIT_MASS
    if wanted < 0.5:
        raise ValueError(
            f"weight_fraction is {weight_fraction}; with one unit of resin this platelet already is "
            f"{filler.mass / (filler.mass + UNIT_MASS):.3f} of the mass"
        )
    below, above = max(1, int(wanted)), int(wanted) + 1
    return min((below, above), key=lambda n: abs(filler.mass / (filler.mass + n * UNIT_MASS) - weight_fraction))


def build_nanocomposite(
    width: float,
    height: float,
    weight_fraction: float = 0.02,
    conversion: float = 0.76,
    temperature: float = 300.0,
    seed: int = 1,
    *,
    work_dir: Path,
    schedule: Schedule | None = None,
    progress: Callable[[str], None] | None = None,
) -> Atoms:
    """Build cross-linked epoxy around a graphene platelet.

    The monomers are packed around the platelet, compressed, cured and relaxed with it, by `md_service.epoxy`.

    Parameters
    ----------
    width, height : float
        Size of the platelet, m.
    weight_fraction : float
        Wanted mass of the platelet over the mass of all; met by the nearest whole number of resin units.
    conversion : float
        Wanted share of epoxide groups that have reacted.
    temperature : float
        At which the sample is relaxed, K.
    seed : int
        Of everything random.
    work_dir : Path
        Folder for LAMMPS' files.
    schedule : Schedule, optional
        Times of the relaxation.
    progress : callable, optional
        Told what is being done, in a few words.

    Returns
    -------
    Atoms
        The platelet's atoms come first; ``notes`` holds their number, ``platelet_atoms``, and the ``weight_fraction``
        reached besides what `md_service.epoxy.build_epoxy` notes.

    Raises
    ------
    ValueError
        If the platelet would touch its own periodic image, or an argument is out of range.
    """
    filler = platelet(width, height)
    units = units_for(weight_fraction, filler)
    reached = filler.mass / (filler.mass + units * UNIT_MASS)
    edge = ((filler.mass + units * UNIT_MASS) / RESIN_DENSITY) ** (1.0 / 3.0)
    longest = float(np.ptp(filler.position, axis=0).max())
    if longest + CLEARANCE > edge:
        raise ValueError(
            f"a platelet of {longest * 1e10:.1f} angstrom does not fit into the box of {edge * 1e10:.1f} angstrom that "
            f"holds {units} units of resin: choose a smaller platelet or weight_fraction (now {weight_fraction})"
        )
    built = build_epoxy(
        units,
        conversion=conversion,
        temperature=temperature,
        seed=seed,
        work_dir=work_dir,
        platelet=filler,
        schedule=schedule,
        progress=progress,
    )
    return replace(built, notes={**built.notes, "platelet_atoms": len(filler), "weight_fraction": reached})
