"""A plane mesh of quadrilaterals from a file of another program."""

from __future__ import annotations

import contextlib
import io
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from fem_service.inp_deck import read_inp
from fem_service.plane_check import check_plane, corner_sines
from fem_service.plane_mesh import PlaneMesh

#: Part of the mesh's extent by which its nodes may lie above or below each other.
_FLAT = 1e-6
#: Cells of meshio that bear no part of a plate.
_LINES: Final = ("vertex", "line")


def read_plane_mesh(path: Path, unit: float) -> PlaneMesh:
    """Read a mesh.

    Parameters
    ----------
    path : Path
        ``.inp`` of Abaqus or CalculiX, or anything that meshio reads (``.msh`` of gmsh, ``.vtu``, ``.bdf``, ...).
    unit : float
        Metres of the file's unit of length.

    Returns
    -------
    PlaneMesh
        Nodes and elements in the order of the file. Nodes of no element are dropped, elements whose nodes go clockwise
        are turned round.

    Raises
    ------
    ValueError
        If the file cannot be read, holds other elements than quadrilaterals of four nodes, is not flat in z, or is
        refused by `fem_service.plane_check.check_plane`. Elements are named by their number in an ``.inp``, in other
        files by their place among the quadrilaterals, from 1.
    """
    if path.suffix.lower() == ".inp":
        nodes, elements, labels = _from_inp(path)
    else:
        nodes, elements, labels = _by_meshio(path)
    try:
        return _plane(nodes, elements, labels, unit)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def _plane(
    nodes: NDArray[np.float64], elements: NDArray[np.int64], labels: NDArray[np.int64], unit: float
) -> PlaneMesh:
    used, place = np.unique(elements, return_inverse=True)
    nodes, elements = nodes[used], place.reshape(elements.shape)
    height, extent = np.ptp(nodes[:, 2]), np.ptp(nodes[:, :2], axis=0).max()
    if height > _FLAT * extent:
        raise ValueError(f"the mesh is not flat: its nodes differ by {height:g} in z, their extent is {extent:g}")
    plane = PlaneMesh(np.ascontiguousarray(unit * nodes[:, :2]), elements.astype(np.int64))
    clockwise: NDArray[np.bool_] = np.all(corner_sines(plane) < 0.0, axis=1)
    elements = np.where(clockwise[:, None], plane.elements[:, ::-1], plane.elements)
    plane = PlaneMesh(plane.nodes, np.ascontiguousarray(elements))
    check_plane(plane, labels)
    return plane


def _from_inp(path: Path) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.int64]]:
    deck = read_inp(path)
    bricks = next((block for block in deck.blocks if block.nodes.shape[1] != 4), None)
    if bricks is not None:
        raise ValueError(f"{path}: element {bricks.labels[0]} is a {bricks.kind}; a plane mesh has quadrilaterals only")
    if not deck.blocks:
        raise ValueError(f"{path}: holds no quadrilaterals")
    elements = np.concatenate([block.nodes for block in deck.blocks])
    return deck.nodes, elements, np.concatenate([block.labels for block in deck.blocks])


def _by_meshio(path: Path) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.int64]]:
    import meshio

    said = io.StringIO()
    try:
        # What it cannot read it prints, and then ends the process.
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
            mesh = meshio.read(path)
    except (Exception, SystemExit) as error:
        reason = " ".join(f"{error if isinstance(error, Exception) else ''} {said.getvalue()}".split())
        raise ValueError(f"{path}: cannot be read: {reason}") from None
    other = next((block for block in mesh.cells if block.type not in ("quad", *_LINES)), None)
    if other is not None:
        raise ValueError(f"{path}: holds {len(other.data)} cells of type {other.type}; only quad is read")
    quads = [block.data for block in mesh.cells if block.type == "quad"]
    if not quads:
        raise ValueError(f"{path}: holds no quadrilaterals")
    elements = np.concatenate(quads).astype(np.int64)
    points = np.asarray(mesh.points, dtype=np.float64)
    nodes = np.column_stack([points, np.zeros((len(points), 3 - points.shape[1]))])
    return nodes, elements, 1 + np.arange(len(elements))
