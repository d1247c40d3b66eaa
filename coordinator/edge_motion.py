"""What the edges of a scene prescribe to atoms that lie beyond them, as tables over time tell it."""

from __future__ import annotations

from typing import Final, Literal

import numpy as np

from coordinator.continuum_tables import Continuum, Edge, KField
from protocol.arrays import FloatArray
from protocol.continuum import IsotropicMaterial

Assumption = Literal["plane_stress", "plane_strain"]
SIDES: Final = ("left", "right", "bottom", "top")
_OPPOSITE: Final = {"left": "right", "right": "left", "bottom": "top", "top": "bottom"}


class EdgeMotion:
    """Displacement and velocity of atoms beyond the edges that a scene moves.

    A component that the edge prescribes is that of the edge, with the strain between it and the opposite edge going
    on beyond; where a crack-tip field is prescribed, that field at the atom's own place. A component that the edge
    leaves free lies on the straight line between the two other edges, where they prescribe it, and is held at zero
    where they do not.

    Parameters
    ----------
    continuum : Continuum
        Body, edges and assumption of the scene.
    material : IsotropicMaterial
        For crack-tip fields.
    place : float64 array, shape (atoms, 3)
        Undeformed, m.

    Attributes
    ----------
    side : int64 array, shape (atoms,)
        Edge beyond which an atom lies, as an index of `SIDES`: top and bottom before left and right.
    held : list of str
        Components of edges that the scene leaves free and that are held here.
    """

    def __init__(self, continuum: Continuum, material: IsotropicMaterial, place: FloatArray) -> None:
        self._edges = continuum.edges
        self._body = continuum
        self.held: list[str] = []
        self.side = edge_beyond(continuum, place)
        #: Displacement of each atom for a value 1 of each edge's table, x and y.
        self._share = np.zeros((2, len(place), len(self._edges)))
        for number, name in enumerate(SIDES):
            rows = np.flatnonzero(self.side == number)
            for axis in (0, 1):
                if len(rows) and not self._prescribe(name, axis, rows, place, material):
                    self.held.append(f"{'xy'[axis]} of the {name} edge")

    def displacement(self, time: float) -> FloatArray:
        """Return displacements at a time, s; shape (atoms, 3), m."""
        values = np.array([table_value(edge, time) for edge in self._edges])
        found = np.zeros((self._share.shape[1], 3))
        found[:, :2] = (self._share @ values).T
        return found

    def _prescribe(
        self, name: str, axis: int, rows: np.ndarray, place: FloatArray, material: IsotropicMaterial
    ) -> bool:
        """Fill the shares of one component of the atoms beyond one edge; return whether the scene prescribes it."""
        for k, edge in enumerate(self._edges):
            if edge.edge == name and edge.kind == "k_field":
                assert edge.field is not None  # held by the scene's checks
                field = k_field_displacement(edge.field, material, self._body.assumption, place[rows])
                self._share[axis, rows, k] = field[:, axis]
                return True
        own, other = self._edge(name, axis), self._edge(_OPPOSITE[name], axis)
        across = 0 if name in ("left", "right") else 1
        low, high = self._body.lower[across], self._body.upper[across]
        if own is not None:
            beyond = np.maximum(low - place[rows, across], place[rows, across] - high) / (high - low)
            self._share[axis, rows, own] = 1.0
            if other is not None:
                self._share[axis, rows, own] += beyond
                self._share[axis, rows, other] -= beyond
            return True
        low, high = self._body.lower[1 - across], self._body.upper[1 - across]
        first, last = (("bottom", "top"), ("left", "right"))[across]
        start, end = self._edge(first, axis), self._edge(last, axis)
        if start is None or end is None:
            return False
        way = (place[rows, 1 - across] - low) / (high - low)
        self._share[axis, rows, start] = 1.0 - way
        self._share[axis, rows, end] = way
        return True

    def _edge(self, name: str, axis: int) -> int | None:
        """Return the row of the condition that moves a component of an edge evenly."""
        for k, edge in enumerate(self._edges):
            if edge.edge == name and edge.moves and edge.kind != "k_field" and edge.axis == axis:
                return k
        return None


def table_value(edge: Edge, time: float) -> float:
    """Return what a moving edge's table says at a time, s: its displacement, m, or the factor of its field."""
    if edge.kind == "symmetry":
        return 0.0
    assert edge.times is not None  # held by the scene's checks
    times = np.array(edge.times)
    if edge.kind == "velocity":
        assert edge.velocities is not None
        until = np.unique(np.clip(np.append(times, time), times[0], max(time, times[0])))
        return float(np.trapezoid(np.interp(until, times, edge.velocities), until))
    values = edge.factors if edge.kind == "k_field" else edge.displacements
    assert values is not None
    return float(np.interp(time, times, values))


def k_field_displacement(
    field: KField, material: IsotropicMaterial, assumption: Assumption, place: FloatArray
) -> FloatArray:
    """Return the displacement around a crack tip in an infinite body (Williams 1957, the singular term).

    Parameters
    ----------
    field : KField
    material : IsotropicMaterial
    assumption : {"plane_stress", "plane_strain"}
    place : float64 array, shape (n, 3)
        m.

    Returns
    -------
    float64 array, shape (n, 2)
        m.
    """
    turn = np.array([[np.cos(field.angle), np.sin(field.angle)], [-np.sin(field.angle), np.cos(field.angle)]])
    x, y = ((place[:, :2] - np.array(field.tip)) @ turn.T).T
    nu = material.poisson
    kappa = (3 - nu) / (1 + nu) if assumption == "plane_stress" else 3 - 4 * nu
    theta = np.arctan2(y, x)
    cosine, sine = np.cos(0.5 * theta), np.sin(0.5 * theta)
    size = np.sqrt(np.hypot(x, y) / (2 * np.pi)) * (1 + nu) / material.young
    along = size * (field.k_1 * cosine * (kappa - np.cos(theta)) + field.k_2 * sine * (kappa + 2 + np.cos(theta)))
    across = size * (field.k_1 * sine * (kappa - np.cos(theta)) - field.k_2 * cosine * (kappa - 2 + np.cos(theta)))
    return np.asarray(np.column_stack([along, across]) @ turn)


def edge_beyond(continuum: Continuum, place: FloatArray) -> np.ndarray:
    """Return the moved edge beyond which each atom lies, as an index of `SIDES`; -1 for none."""
    moved = {edge.edge for edge in continuum.edges if edge.moves}
    found = np.full(len(place), -1, dtype=np.int64)
    beyond = (
        place[:, 0] < continuum.lower[0],
        place[:, 0] > continuum.upper[0],
        place[:, 1] < continuum.lower[1],
        place[:, 1] > continuum.upper[1],
    )
    for number, name in enumerate(SIDES):
        if name in moved:
            found[beyond[number]] = number
    return found
