"""Overlaps whose borders lie on lines of the grid."""

from __future__ import annotations

from coordinator.table import Corners, Point


def snapped_overlap(
    lower: Point, cell_size: float, width: float, height: float, handshake: float
) -> tuple[Corners, Corners]:
    """Lay the overlap ring of a centred sheet onto grid lines.

    Parameters
    ----------
    lower : tuple of float
        A corner of the grid's cells, m.
    cell_size : float
        Edge of a cell, m.
    width, height : float
        Extent of the sheet, m.
    handshake : float
        Width of the ring, a whole number of cells, m.

    Returns
    -------
    inner, outer : tuple of tuple of float
        Lower and upper corners, m. The outer rectangle has the grid lines nearest to the edges of
        the sheet, the inner one lies `handshake` inside it.
    """
    ring = round(handshake / cell_size)
    low: list[int] = []
    high: list[int] = []
    for axis, half in ((0, width / 2), (1, height / 2)):
        low.append(round((-half - lower[axis]) / cell_size))
        high.append(round((half - lower[axis]) / cell_size))

    def corner(cells: list[int], shift: int) -> Point:
        return (lower[0] + (cells[0] + shift) * cell_size, lower[1] + (cells[1] + shift) * cell_size)

    return (corner(low, ring), corner(high, -ring)), (corner(low, 0), corner(high, 0))
