"""Strain, stress and the stress of each subcell in a few bricks of a laminate."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fem_service.equilibrium import Equilibrium
from fem_service.hexahedron import POINTS
from fem_service.ply_axes import strain_to_ply
from fem_service.point_material import PointState
from fem_service.quasi_static import QuasiStatic

#: Stress of each subcell, shape (points, subcells, 6), from strains and the state of points.
Localise = Callable[[NDArray[np.float64], PointState], NDArray[np.float64]]


@dataclass(frozen=True, eq=False)
class Watched:
    """Means over the points of each brick, in the axes of its ply.

    Each point is localised in its own strain and state, then the mean is taken: so the mean of the subcells by area is
    the macroscopic stress also where some points of a brick have failed and others not.

    Attributes
    ----------
    strain, stress : ndarray of float, shape (bricks, 6)
        Stress in Pa.
    subcells : ndarray of float, shape (bricks, subcells, 6)
        Pa.
    """

    strain: NDArray[np.float64]
    stress: NDArray[np.float64]
    subcells: NDArray[np.float64]


def watch(laminate: QuasiStatic, at: Equilibrium, bricks: NDArray[np.int64], localise: Localise) -> Watched:
    """Look into bricks of a laminate in equilibrium.

    Parameters
    ----------
    laminate : QuasiStatic
    at : Equilibrium
    bricks : ndarray of int64, shape (watched,)
    localise : callable
        Asks the microstructure.
    """
    mesh = laminate.mesh
    angles = mesh.angles[mesh.ply[bricks]]
    strain = laminate.ply_strains(at.displacement).reshape(-1, POINTS, 6)[bricks]
    # Work is the same in both axes, so stress turns by the transpose of the way back.
    back = np.array([strain_to_ply(-angle) for angle in angles])
    stress = np.einsum("eji,ej->ei", back, at.stress[bricks].mean(axis=1))
    points = (POINTS * bricks[:, None] + np.arange(POINTS)).reshape(-1)
    state = PointState(at.points.failed[points], at.points.history[points])
    subcells = localise(np.ascontiguousarray(strain.reshape(-1, 6)), state)
    mean = subcells.reshape(len(bricks), POINTS, -1, 6).mean(axis=1)
    return Watched(np.ascontiguousarray(strain.mean(axis=1)), stress, mean)
