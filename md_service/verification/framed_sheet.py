"""A graphene sheet held in a frame of anchors, as the cases of the anchors use it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from md_service.engine import Engine
from md_service.force_fields import force_field
from md_service.graphene import graphene
from md_service.lammps_dynamics import LammpsDynamics


@dataclass
class FramedSheet:
    """An engine with a square sheet, free edges and a frame of anchors.

    Attributes
    ----------
    engine : Engine
    dynamics : LammpsDynamics
        The same atoms, for what the engine does not offer.
    anchor : ndarray, shape (k, 3)
        Where the anchors are at rest, m.
    """

    engine: Engine
    dynamics: LammpsDynamics
    anchor: NDArray[np.float64]

    @property
    def atom_id(self) -> NDArray[np.int64]:
        """Rows of the anchored atoms."""
        assert self.engine.anchors is not None
        return self.engine.anchors.atom_id

    def pulled(self, strain: float) -> NDArray[np.float64]:
        """Where the anchors are at a strain along x, m."""
        return self.anchor * [1.0 + strain, 1.0, 1.0]


def framed_sheet(
    folder: Path,
    *,
    size: float = 24e-10,
    frame: float = 6e-10,
    stiffness: float = 30.0,
    damping_time: float | None = 5e-14,
    temperature: float = 300.0,
    seed: int = 1,
    moving: bool = False,
    name: str = "tersoff",
) -> FramedSheet:
    """Build it; four volume cells, one per quadrant.

    Parameters
    ----------
    folder : Path
        Of the log of LAMMPS.
    size : float
        Edge of the sheet, m.
    frame : float
        Width of the anchored frame, m.
    stiffness : float
        Mean of the springs' constants, which rise from 0.8 to 1.2 of it, N/m.
    damping_time : float, optional
        Of the anchors' dampers, s.
    temperature : float
        K.
    seed : int
    moving : bool
        Whether anchors move within a window.
    name : str
        Force field.
    """
    profile = force_field(name)
    atoms = graphene(size, size, spacing=profile.lattice_constant)
    half = np.abs(atoms.position[:, :2]).max(axis=0)
    atom_id = np.flatnonzero((half - np.abs(atoms.position[:, :2])).min(axis=1) < frame)
    anchor = atoms.position[atom_id]
    dynamics = LammpsDynamics(folder, profile, atoms, temperature=temperature, seed=seed)
    engine = Engine(dynamics, temperature=temperature, force_field=profile)
    engine.register_anchors(
        atom_id,
        anchor,
        stiffness * np.linspace(0.8, 1.2, len(atom_id)),
        (anchor[:, 0] > 0.0).astype(np.int64) + 2 * (anchor[:, 1] > 0.0),
        damping_time,
        moving=moving,
    )
    return FramedSheet(engine, dynamics, anchor)
