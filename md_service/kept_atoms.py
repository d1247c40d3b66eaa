"""Samples of any outline: the atoms inside a polygon."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import shapely
from numpy.typing import NDArray

from md_service.atoms import Atoms, Topology


def kept_atoms(atoms: Atoms, corners: list[tuple[float, float]]) -> Atoms:
    """Leave out the atoms outside of a polygon; those on its border stay.

    An atom keeps its volume, and bonds of a crystal that cross the border are gone. Molecules are in or out as a whole.

    Parameters
    ----------
    atoms : Atoms
        The sample.
    corners : list of (float, float)
        x and y of the corners of a simple polygon in their order, m.

    Returns
    -------
    Atoms
        Rows in their order.

    Raises
    ------
    ValueError
        If this is no simple polygon, holds no atom, or cuts a bond of a molecule.
    """
    if len(corners) < 3:
        raise ValueError(f"keep has {len(corners)} corners; a polygon has at least 3")
    polygon = shapely.Polygon(corners)
    if not polygon.is_valid or polygon.area == 0.0:
        raise ValueError(f"keep is no simple polygon: {shapely.is_valid_reason(polygon)}")
    inside = np.asarray(shapely.intersects_xy(polygon, *atoms.position[:, :2].T))
    if not inside.any():
        low, high = atoms.position.min(axis=0), atoms.position.max(axis=0)
        raise ValueError(f"keep holds no atom; they lie from {low[:2]} m to {high[:2]} m")
    return replace(
        atoms,
        position=np.ascontiguousarray(atoms.position[inside]),
        kind=atoms.kind[inside],
        charge=None if atoms.charge is None else atoms.charge[inside],
        molecule=None if atoms.molecule is None else atoms.molecule[inside],
        topology=None if atoms.topology is None else _kept_topology(atoms.topology, inside),
        site_volume=atoms.atom_volume,
    )


def _kept_topology(topology: Topology, inside: NDArray[np.bool_]) -> Topology:
    ends = inside[topology.bonds[:, 1:]]
    cut = int(np.count_nonzero(ends[:, 0] != ends[:, 1]))
    if cut:
        raise ValueError(f"keep cuts {cut} bonds of molecules; a force field with lists of bonds needs them whole")
    row = np.cumsum(inside) - 1

    def kept(members: NDArray[np.int64]) -> NDArray[np.int64]:
        # A part of a molecule is where its first atom is.
        found = members[inside[members[:, 1]]].copy()
        found[:, 1:] = row[found[:, 1:]]
        return found

    return replace(
        topology,
        bonds=kept(topology.bonds),
        angles=kept(topology.angles),
        dihedrals=kept(topology.dihedrals),
        impropers=kept(topology.impropers),
    )
