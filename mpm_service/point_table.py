"""All data of the material points of a run, and how they look to a user."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .mapping import Points
from .material import Material
from .material_points import Body, columns

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


class PointTable:
    """Point rows in memory order, and what belongs to points by stable id.

    Parameters
    ----------
    body : Body
    materials : sequence of Material
        `body.material` counts in it.
    thickness : float
        [m]; 1 in space.

    Attributes
    ----------
    origin : (n,) ndarray of int
        Point of the body, by its id, that each point is or is a piece of.
    """

    def __init__(self, body: Body, materials: Sequence[Material], thickness: float) -> None:
        self.columns = columns(body.dimension)
        self.materials = tuple(materials)
        self.reference = body.position.copy()
        self.weight = body.weight.copy()
        self.stiffness = body.stiffness_share.copy()
        self.material = np.array(body.material, dtype=np.int64)
        count = body.count
        c = self.columns
        rows = np.zeros((count, c.width))
        rows[:, : c.dimension] = body.position
        volume = (2.0 * body.half) ** c.dimension * thickness
        rows[:, c.volume] = self.stiffness * volume
        rows[:, c.mass] = self.weight * volume * np.array([m.density for m in materials])[self.material]
        rows[:, c.half] = body.half
        self.points = Points(rows, np.arange(count), np.arange(count))
        self.origin = np.arange(count)
        self.histories = [np.ascontiguousarray(m.start_history(count)) for m in self.materials]

    @property
    def count(self) -> int:
        """Number of points, lost ones included."""
        return int(self.points.ids.size)

    def update_stress(self, chunk: slice) -> None:
        """Compute the stress of a slice of rows from their deformation."""
        rows, ids = self.points.rows[chunk], self.points.ids[chunk]
        if len(self.materials) == 1:
            self.materials[0].update_stress(rows, ids, self.histories[0])
            return
        kinds = self.material[ids]
        for number, (material, history) in enumerate(zip(self.materials, self.histories, strict=True)):
            mine = np.flatnonzero(kinds == number)
            if mine.size:
                own = rows[mine]
                material.update_stress(own, ids[mine], history)
                rows[mine] = own

    def tangent(self, rows: FloatArray, ids: IntArray) -> FloatArray:
        """Ask the materials for the moduli of rows [Pa], (n, v, v); see `Material.tangent`."""
        if len(self.materials) == 1:
            return self.materials[0].tangent(rows, ids, self.histories[0])
        kinds = self.material[ids]
        components = self.columns.mass - self.columns.stress
        found = np.empty((ids.size, components, components))
        for number, (material, history) in enumerate(zip(self.materials, self.histories, strict=True)):
            mine = np.flatnonzero(kinds == number)
            found[mine] = material.tangent(np.ascontiguousarray(rows[mine]), ids[mine], history)
        return found

    def by_material(self, function: str) -> FloatArray:
        """Ask the materials for a quantity of all points; the answer is ordered by id, (n,)."""
        rows = self.points.rows[self.points.row_of]
        ids = np.arange(self.count)
        answer = np.empty(self.count)
        for number, (material, history) in enumerate(zip(self.materials, self.histories, strict=True)):
            mine = np.flatnonzero(self.material == number) if len(self.materials) > 1 else ids
            answer[mine] = getattr(material, function)(np.ascontiguousarray(rows[mine]), ids[mine], history)
        return answer

    def total(self, function: str, alive: int) -> float:
        """Sum of a quantity that the materials tell over the first rows, which live; `by_material` has the parts."""
        if len(self.materials) > 1:
            return float(np.sum(self.by_material(function)[self.points.ids[:alive]]))
        rows, ids = self.points.rows[:alive], self.points.ids[:alive]
        return float(np.sum(getattr(self.materials[0], function)(rows, ids, self.histories[0])))

    def replace_by_four(self, parent: IntArray, children: FloatArray, offset: FloatArray, alive: int) -> None:
        """Put four children in the place of each parent; child 0 has its row and id.

        Parameters
        ----------
        parent : (m,) ndarray of int
            Rows.
        children : (m, 4, columns) ndarray
            Their rows.
        offset : (m, 4, 2) ndarray
            Reference positions less that of the parent [m].
        alive : int
            Living rows; the new ones follow them.
        """
        rows, ids, _ = self.points
        owner = ids[parent]
        fresh = self.count + np.arange(3 * parent.size)
        born = np.repeat(owner, 3)
        rows[parent] = children[:, 0]
        rows = np.insert(rows, alive, children[:, 1:].reshape(-1, rows.shape[1]), axis=0)
        ids = np.insert(ids, alive, fresh)
        row_of = np.empty(ids.size, dtype=np.int64)
        row_of[ids] = np.arange(ids.size)
        self.points = Points(rows, ids, row_of)
        self.reference = np.concatenate([self.reference, self.reference[born] + offset[:, 1:].reshape(-1, 2)])
        self.reference[owner] += offset[:, 0]
        self.origin = np.concatenate([self.origin, self.origin[born]])
        self.weight = np.concatenate([self.weight, self.weight[born]])
        self.stiffness = np.concatenate([self.stiffness, self.stiffness[born]])
        self.material = np.concatenate([self.material, self.material[born]])
        self.histories = [np.concatenate([history, history[born]]) for history in self.histories]

    def deform(self, displacement: FloatArray, gradient: FloatArray) -> None:
        """Put each point, by id, at its reference place plus a displacement (n, d) [m] with ``F - I`` (n, d, d)."""
        rows, _, row_of = self.points
        c = self.columns
        rows[row_of, : c.dimension] = self.reference + displacement
        rows[row_of, c.gradient : c.stress] = gradient.reshape(self.count, -1)
        self.update_stress(slice(None))

    def take(self, other: PointTable, matching: IntArray, body: Body) -> None:
        """Take place, deformation, stress and history of points of another table, and the pieces they are in now.

        Parameters
        ----------
        other : PointTable
        matching : (n,) ndarray of int
            Point of its body that is the same material as each point of this one's body.
        body : Body
            This one's.
        """
        mine = np.full(int(other.origin.max()) + 1, -1, dtype=np.int64)
        mine[matching] = np.arange(matching.size)
        pieces = np.setdiff1d(np.flatnonzero(mine[other.origin] >= 0), matching)
        ids = np.concatenate([matching, pieces])
        c = self.columns
        self.origin = mine[other.origin[ids]]
        self.weight, self.stiffness = body.weight[self.origin], body.stiffness_share[self.origin]
        self.reference = other.reference[ids]
        self.material = other.material[ids]
        self.histories = [history[ids] for history in other.histories]
        rows = other.points.rows[other.points.row_of[ids]]
        rows[:, c.mass] *= self.weight / other.weight[ids]
        rows[:, c.volume] *= self.stiffness / other.stiffness[ids]
        rows[:, c.velocity : c.gradient] = 0.0
        rows[:, c.increment : c.increment + c.dimension] = 0.0
        self.points = Points(np.ascontiguousarray(rows), np.arange(ids.size), np.arange(ids.size))

    def state(self) -> dict[str, NDArray[Any]]:
        """Everything of the points that changes, as copies."""
        state: dict[str, NDArray[Any]] = {
            "rows": self.points.rows.copy(),
            "ids": self.points.ids.copy(),
            "reference": self.reference.copy(),
            "point_origin": self.origin.copy(),
            "point_weight": self.weight.copy(),
            "point_stiffness": self.stiffness.copy(),
            "point_material": self.material.copy(),
        }
        return state | {f"history_{k}": history.copy() for k, history in enumerate(self.histories)}

    def restore(self, state: dict[str, NDArray[Any]]) -> None:
        """Take back a saved state, also of another number of points."""
        ids = np.array(state["ids"], dtype=np.int64)
        row_of = np.empty(ids.size, dtype=np.int64)
        row_of[ids] = np.arange(ids.size)
        self.points = Points(np.array(state["rows"], dtype=np.float64), ids, row_of)
        self.reference = np.array(state["reference"], dtype=np.float64)
        self.origin = np.array(state["point_origin"], dtype=np.int64)
        self.weight = np.array(state["point_weight"], dtype=np.float64)
        self.stiffness = np.array(state["point_stiffness"], dtype=np.float64)
        self.material = np.array(state["point_material"], dtype=np.int64)
        self.histories = [np.array(state[f"history_{k}"], dtype=np.float64) for k in range(len(self.materials))]
