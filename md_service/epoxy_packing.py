"""Placing molecules in a box with room between them, as in a gas, so that no bond starts out inside a ring."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from md_service.atoms import Atoms, Box
from md_service.epoxy_monomers import Molecule, joined
from md_service.epoxy_typing import typed

GAP = 2.5e-10  # m between the spheres around molecules


def pack(molecules: Sequence[Molecule], seed: int, obstacle: Molecule | None = None) -> Atoms:
    """Put molecules at random on the sites of a cubic lattice, each turned at random.

    Parameters
    ----------
    molecules : sequence of Molecule
    seed : int
        Of the random places and orientations.
    obstacle : Molecule, optional
        Sits in the middle of the box, as it is turned; no molecule comes near it.

    Returns
    -------
    Atoms
        In a periodic cube, typed with OPLS-AA; the obstacle's atoms come first.
    """
    random = np.random.default_rng(seed)
    radius = max(float(np.linalg.norm(m.position - m.position.mean(axis=0), axis=1).max()) for m in molecules)
    spacing = 2.0 * radius + GAP
    sites, edge = _free_sites(len(molecules), spacing, radius + GAP, obstacle)
    chosen = random.permutation(len(sites))[: len(molecules)]
    turns = Rotation.random(len(molecules), random_state=random)
    placed = [] if obstacle is None else [obstacle.at(_centred(obstacle) + 0.5 * edge)]
    for molecule, site, turn in zip(molecules, sites[chosen], turns, strict=True):
        placed.append(molecule.at(turn.apply(_centred(molecule)) + site))
    return typed(joined(placed), Box(np.zeros(3), np.full(3, edge), (True, True, True)))


def _free_sites(
    count: int, spacing: float, clearance: float, obstacle: Molecule | None
) -> tuple[NDArray[np.float64], float]:
    """Sites (m, 3) of the smallest cube with room for so many molecules, and its edge, m."""
    per_edge = max(2, int(np.ceil(count ** (1.0 / 3.0))))
    while True:
        edge = per_edge * spacing
        axis = (np.arange(per_edge) + 0.5) * spacing
        sites = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
        fits = True
        if obstacle is not None:
            inside = _centred(obstacle) + 0.5 * edge
            fits = bool(inside.min() > GAP and inside.max() < edge - GAP)
            sites = sites[cKDTree(inside).query(sites)[0] > clearance]
        if fits and len(sites) >= count:
            return sites, edge
        per_edge += 1


def _centred(molecule: Molecule) -> NDArray[np.float64]:
    lowest, highest = molecule.position.min(axis=0), molecule.position.max(axis=0)
    return molecule.position - 0.5 * (lowest + highest)
