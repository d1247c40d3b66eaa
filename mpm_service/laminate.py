"""Plies that share the strain in the plane, each with a microstructure that answers stress and failure."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from .elastic import largest_acoustic_eigenvalue
from .material import (
    GRADIENT_2D,
    HALF_2D,
    STRESS_2D,
    VOLUME_2D,
    Assumption,
    FloatArray,
    IdArray,
    Material,
    raise_no_volume,
    require_above,
)

#: In the plane of the ply, and out of it, among 11, 22, 33, 23, 13, 12.
IN_PLANE, OUT_OF_PLANE = [0, 1, 5], [2, 3, 4]

# History of a point: recoverable and dissipated energy [J/m^3], thickness strain, strain xx, yy, xy; then for each
# direction of fibres the out-of-plane strain of in-plane strain (3 x 3), the reduced stiffness (3 x 3) [Pa], the bytes
# of what has failed, the cell's own history.
_ENERGY, _DISSIPATED, _THINNING, _STRAIN, _PLIES = 0, 1, 2, 3, 6
_ACROSS, _REDUCED, _FAILED = 0, 9, 18
#: Part of the strain in the plane by which strains out of it may still move where a softening ply is not asked again,
#: and how often it is asked in a step at most.
_STILL, _ROUNDS = 1e-7, 30


@dataclass(frozen=True, eq=False)
class CellAnswer:
    """What a microstructure answers for many points.

    Attributes
    ----------
    stress : (n, 6) ndarray
        [Pa]
    failed : (n, bytes) ndarray of uint8
        What has failed now.
    history : (n, values) ndarray
        Damage now.
    tangent_index : (n,) ndarray of int64
        Row of `tangents` of each point.
    tangents : (k, 6, 6) ndarray
        [Pa]
    """

    stress: FloatArray
    failed: NDArray[np.uint8]
    history: FloatArray
    tangent_index: IdArray
    tangents: FloatArray


class Microstructure(Protocol):
    """A cell of which parts fail or soften for good, and which is linear as long as none does.

    Its tangents are secants: stress is tangent times strain.

    Attributes
    ----------
    stiffness : (6, 6) ndarray
        Of the intact cell [Pa]; order 11, 22, 33, 23, 13, 12, engineering shear, axis 1 along the fibre.
    safe_energy : float
        No intact point with less energy per volume can fail [J/m^3]; 0 where that is not known.
    phase : (subcells,) ndarray of int64
        Material of each subcell; bit n % 8 of byte n // 8 of a point tells that subcell n has failed.
    failed_bytes, history_values : int
        Numbers that a point keeps; zeros are those of an intact one.
    """

    stiffness: FloatArray
    safe_energy: float
    phase: IdArray
    failed_bytes: int
    history_values: int

    def evaluate(
        self, strain: FloatArray, failed: NDArray[np.uint8], history: FloatArray, length: FloatArray
    ) -> CellAnswer:
        """Answer to strains (n, 6) of points with bits (n, bytes), history (n, values) and crack band (n,) [m]."""


class Laminate(Material):
    """A laminate in plane stress: classical lamination theory of its membrane, with a cell in every ply of every point.

    The strain in the plane is that of all plies, ``(F + F^T)/2 - I``. Each ply takes up the strains out of the plane
    that leave it without stress there: with B* of the cell in its present state, i in the plane and o out of it,

        e_o = -B_oo^-1 B_oi e_i,        Q = B_ii - B_io B_oo^-1 B_oi,

    which is exact, since the cell is linear as long as nothing fails. Where a query tells of new failures, e_o is found
    anew and the ply is asked again, until nothing more fails; where it softens, until e_o rests. Intact plies with too
    little energy to fail are answered by the intact stiffness, with the same bits. A crack is spread over a cell of the
    grid (crack band).

    The mean stress s of the plies acts on the undeformed section, so the Kirchhoff stress is the symmetric part of
    ``s F^T``: force over the first section, as a small-strain finite element has it. The law is not objective, and
    fibres do not turn with the material.

    A ply that fails between two strains loses half of ``e_i (Q - Q') e_i'``: that is `dissipated`. It takes the failure
    for one halfway, and makes what is stored and dissipated equal to the trapezoidal sum of stress times strain.

    Plies with fibres in the same direction have the same strain and the same state, and are kept once.

    Parameters
    ----------
    cell : Microstructure
        At its stress-free temperature, where the law lives.
    angles : (n,) array_like
        Of each ply from x towards y [rad]; all plies are equally thick.
    density : float
        [kg/m^3]
    points_per_cell : int
        Points per cell and direction of the body it is for; only softening looks at it.
    assumption : {"plane_stress"}

    Attributes
    ----------
    directions : (m,) ndarray
        The distinct directions of fibres, in the order of the plies [rad], above -pi/2 and at most pi/2.
    queried, spared : int
        Plies of points that were asked for and that were not.
    has_failed : bool
        Whether anything has failed. Whoever reads these three may set them back.

    Raises
    ------
    ValueError
        If a value is outside its range or the laminate is not in plane stress.
    """

    def __init__(
        self,
        cell: Microstructure,
        angles: ArrayLike,
        density: float,
        points_per_cell: int = 2,
        assumption: Assumption = "plane_stress",
    ) -> None:
        require_above("density", density, 0.0, "kg/m^3")
        if assumption != "plane_stress":
            raise ValueError(f"assumption = {assumption!r}: a laminate is in plane stress")
        given = np.asarray(angles, dtype=np.float64)
        if given.ndim != 1 or not given.size or not np.all(np.isfinite(given)):
            raise ValueError(f"angles = {given.tolist()!r}: at least one finite angle [rad] is needed")
        self.cell, self.density, self.assumption = cell, float(density), assumption
        turned = 0.5 * np.pi - np.mod(0.5 * np.pi - given, np.pi)
        _, first, kind = np.unique(np.round(turned, 12), return_index=True, return_inverse=True)
        order = np.argsort(first)
        self.directions = turned[first[order]]
        self._share = np.bincount(kind.reshape(-1))[order] / len(turned)
        self._turn = np.stack([_in_plane_strain_to_ply(angle) for angle in self.directions])
        self._stiffness6 = np.ascontiguousarray(cell.stiffness)
        self._points_per_cell = int(points_per_cell)
        self._history = _FAILED + cell.failed_bytes
        self._ply_size = self._history + cell.history_values
        across, reduced = condense(self._stiffness6[None])
        self._intact = np.concatenate([across.ravel(), reduced.ravel(), np.zeros(self._ply_size - _FAILED)])
        self.stiffness = np.einsum("m,mki,kl,mlj->ij", self._share, self._turn, reduced[0], self._turn)
        tensor = self.stiffness[np.array([[0, 2], [2, 1]])[:, :, None, None], np.array([[0, 2], [2, 1]])]
        self._wave_speed = float(np.sqrt(largest_acoustic_eigenvalue(tensor, 2) / self.density))
        self.queried = self.spared = 0
        self.has_failed = False

    @property
    def pressure_wave_speed(self) -> float:
        """Speed of the fastest wave in the plane of the intact laminate [m/s]."""
        return self._wave_speed

    @property
    def history_size(self) -> int:
        """Energies, thickness strain, strain, and the state of each direction of fibres."""
        return _PLIES + len(self.directions) * self._ply_size

    def start_history(self, count: int) -> FloatArray:
        """Intact points, (count, history_size)."""
        return np.tile(np.concatenate([np.zeros(_PLIES), np.tile(self._intact, len(self.directions))]), (count, 1))

    def _plies(self, history: FloatArray) -> FloatArray:
        """States of the plies as a view, (points, directions, values)."""
        return history[:, _PLIES:].reshape(len(history), len(self.directions), self._ply_size)

    def update_stress(self, rows: FloatArray, ids: IdArray, history: FloatArray) -> None:
        """Find what fails at each row's strain and write its Kirchhoff stress; see `Material.update_stress`."""
        count, directions = len(rows), len(self.directions)
        strain = np.empty((count, directions, 6))
        stress = np.empty((count, directions, 3))
        safe = np.empty((count, directions), dtype=np.bool_)
        plies = self._plies(history)
        bad = _elastic(rows, ids, plies, self._turn, self._stiffness6, self.cell.safe_energy, strain, stress, safe)
        if bad >= 0:
            raise_no_volume("Laminate", rows, ids, bad)
        row, direction = np.nonzero(~safe)
        self.queried += len(row)
        self.spared += count * directions - len(row)
        if len(row):
            asked = strain[row, direction]
            length = 2.0 * self._points_per_cell * rows[row, HALF_2D]
            stress[row, direction] = self._ask(asked, length, plies, history, ids[row], direction)
            strain[row, direction] = asked
        _assemble(rows, ids, history, plies, self._turn, self._share, strain, stress)

    def _ask(
        self,
        strain: FloatArray,
        length: FloatArray,
        plies: FloatArray,
        history: FloatArray,
        point: IdArray,
        direction: IdArray,
    ) -> FloatArray:
        """Stress in the plane of plies that may fail, (n, 3), in their axes; advances their states and strains."""
        stress = np.empty((len(strain), 3))
        todo = np.arange(len(strain))
        rounds = 0
        while len(todo):
            rounds += 1
            state = plies[point[todo], direction[todo]]
            failed = state[:, _FAILED : self._history].astype(np.uint8)
            answer = self.cell.evaluate(strain[todo], failed, state[:, self._history :], length[todo])
            stress[todo] = answer.stress[:, IN_PLANE]
            broken = (answer.failed != failed).any(axis=1)
            new = np.flatnonzero(broken | (answer.history != state[:, self._history :]).any(axis=1))
            todo = todo[new]
            if len(todo):
                self.has_failed = self.has_failed or bool(broken.any())
                moved = self._fail(strain, todo, answer, new, plies, history, point[todo], direction[todo])
                todo = todo[broken[new] | (moved & (rounds < _ROUNDS))]
        return stress

    def _fail(
        self,
        strain: FloatArray,
        todo: IdArray,
        answer: CellAnswer,
        new: IdArray,
        plies: FloatArray,
        history: FloatArray,
        point: IdArray,
        direction: IdArray,
    ) -> NDArray[np.bool_]:
        """Give plies that have failed further their new state, and the strain across them that it brings.

        Returns where that strain has moved.
        """
        in_plane = strain[todo][:, IN_PLANE]
        state = plies[point, direction]
        across, reduced = condense(answer.tangents)
        kind = answer.tangent_index[new]
        before = np.einsum("nij,nj->ni", self._turn[direction], history[point, _STRAIN:_PLIES])
        lost = 0.5 * np.einsum(
            "ni,nij,nj->n", in_plane, state[:, _REDUCED:_FAILED].reshape(-1, 3, 3) - reduced[kind], before
        )
        # Several plies of one point may fail together.
        np.add.at(history[:, _DISSIPATED], point, self._share[direction] * lost)
        state[:, _ACROSS:_REDUCED] = across[kind].reshape(-1, 9)
        state[:, _REDUCED:_FAILED] = reduced[kind].reshape(-1, 9)
        state[:, _FAILED : self._history] = answer.failed[new]
        state[:, self._history :] = answer.history[new]
        plies[point, direction] = state
        found = np.einsum("nij,nj->ni", across[kind], in_plane)
        moved = np.abs(found - strain[todo[:, None], OUT_OF_PLANE]).max(axis=1)
        strain[todo[:, None], OUT_OF_PLANE] = found
        return np.asarray(moved > _STILL * np.abs(in_plane).max(axis=1))

    def tangent(self, rows: FloatArray, ids: IdArray, history: FloatArray) -> FloatArray:
        """Return the stiffness of the plies as they are, right to the first order of strain; see `Material.tangent`."""
        reduced = self._plies(history)[ids][:, :, _REDUCED:_FAILED].reshape(len(ids), -1, 3, 3)
        return np.einsum("m,mki,nmkl,mlj->nij", self._share, self._turn, reduced, self._turn)

    def strain_energy(self, rows: FloatArray, ids: IdArray, history: FloatArray) -> FloatArray:
        """Half of stress times strain of the plies times reference volume [J], (n,)."""
        return rows[:, VOLUME_2D] * history[ids, _ENERGY]

    def dissipated(self, rows: FloatArray, ids: IdArray, history: FloatArray) -> FloatArray:
        """Elastic energy that failures have taken [J], (n,)."""
        return rows[:, VOLUME_2D] * history[ids, _DISSIPATED]

    def thickness_stretch(self, rows: FloatArray, ids: IdArray, history: FloatArray) -> FloatArray:
        """Current over reference thickness, (n,)."""
        return 1.0 + history[ids, _THINNING]

    def failed_share(self, history: FloatArray) -> FloatArray:
        """Share of the subcells of each material that has failed, by point and direction.

        Returns
        -------
        (points, directions, materials) ndarray
        """
        phase = self.cell.phase
        failed = self._plies(history)[:, :, _FAILED : self._history].astype(np.uint8)
        bits = np.unpackbits(failed, axis=2, bitorder="little")[:, :, : len(phase)]
        materials = np.arange(int(phase.max()) + 1)
        # A material may be defined and have no subcell.
        return np.stack([bits[:, :, phase == k].sum(axis=2) / max(1, np.sum(phase == k)) for k in materials], axis=2)


def condense(stiffness: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Take the stresses out of the plane from stiffnesses (k, 6, 6) [Pa].

    Returns
    -------
    across, reduced : (k, 3, 3) ndarray
        Strains 33, 23, 13 of strains 11, 22, 12 where there is no stress 33, 23, 13; stress 11, 22, 12 of the same
        [Pa], symmetric.
    """
    out = stiffness[:, OUT_OF_PLANE]
    across = -np.linalg.solve(out[:, :, OUT_OF_PLANE], out[:, :, IN_PLANE])
    inner = stiffness[:, IN_PLANE]
    reduced = inner[:, :, IN_PLANE] + inner[:, :, OUT_OF_PLANE] @ across
    return np.asarray(across, dtype=np.float64), np.asarray(0.5 * (reduced + reduced.transpose(0, 2, 1)))


def _in_plane_strain_to_ply(angle: float) -> FloatArray:
    """T of strain xx, yy, xy to 11, 22, 12 of a ply turned by an angle [rad]; its transpose carries stress back."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c * c, s * s, c * s], [s * s, c * c, -c * s], [-2.0 * c * s, 2.0 * c * s, c * c - s * s]])


@njit(cache=True, nogil=True)
def _elastic(
    rows: FloatArray,
    ids: IdArray,
    plies: FloatArray,
    turn: FloatArray,
    stiffness: FloatArray,
    safe_energy: float,
    strain: FloatArray,
    stress: FloatArray,
    safe: NDArray[np.bool_],
) -> int:
    """Strain of each ply, its stress were it intact, and whether it is and cannot fail.

    Returns the first row without positive area, -1 if there is none. Stress is summed from the first component of
    strain to the last, as the GMC service does it: sparing a query then changes no bit.
    """
    rows_of_stress = (0, 1, 5)
    for row in range(rows.shape[0]):
        hxx, hxy = rows[row, GRADIENT_2D], rows[row, GRADIENT_2D + 1]
        hyx, hyy = rows[row, GRADIENT_2D + 2], rows[row, GRADIENT_2D + 3]
        if not (1.0 + hxx) * (1.0 + hyy) - hxy * hyx > 0.0:
            return row
        shear = hxy + hyx
        for m in range(turn.shape[0]):
            state = plies[ids[row], m]
            e = strain[row, m]
            e[0] = turn[m, 0, 0] * hxx + turn[m, 0, 1] * hyy + turn[m, 0, 2] * shear
            e[1] = turn[m, 1, 0] * hxx + turn[m, 1, 1] * hyy + turn[m, 1, 2] * shear
            e[5] = turn[m, 2, 0] * hxx + turn[m, 2, 1] * hyy + turn[m, 2, 2] * shear
            for k in range(3):
                a = _ACROSS + 3 * k
                e[2 + k] = state[a] * e[0] + state[a + 1] * e[1] + state[a + 2] * e[5]
            energy = 0.0
            for k in range(3):
                i = rows_of_stress[k]
                total = stiffness[i, 0] * e[0]
                for j in range(1, 6):
                    total += stiffness[i, j] * e[j]
                stress[row, m, k] = total
                energy += 0.5 * e[i] * total
            intact = True
            for k in range(_FAILED, state.size):
                intact = intact and state[k] == 0.0
            safe[row, m] = intact and energy < safe_energy
    return -1


@njit(cache=True, nogil=True)
def _assemble(
    rows: FloatArray,
    ids: IdArray,
    history: FloatArray,
    plies: FloatArray,
    turn: FloatArray,
    share: FloatArray,
    strain: FloatArray,
    stress: FloatArray,
) -> None:
    """Mean stress of the plies as Kirchhoff stress; recoverable energy, thickness strain and strain."""
    for row in range(rows.shape[0]):
        sxx, syy, sxy, energy, thinning = 0.0, 0.0, 0.0, 0.0, 0.0
        for m in range(turn.shape[0]):
            s0, s1, s2 = stress[row, m, 0], stress[row, m, 1], stress[row, m, 2]
            e = strain[row, m]
            sxx += share[m] * (turn[m, 0, 0] * s0 + turn[m, 1, 0] * s1 + turn[m, 2, 0] * s2)
            syy += share[m] * (turn[m, 0, 1] * s0 + turn[m, 1, 1] * s1 + turn[m, 2, 1] * s2)
            sxy += share[m] * (turn[m, 0, 2] * s0 + turn[m, 1, 2] * s1 + turn[m, 2, 2] * s2)
            energy += share[m] * 0.5 * (s0 * e[0] + s1 * e[1] + s2 * e[5])
            thinning += share[m] * e[2]
        hxx, hxy = rows[row, GRADIENT_2D], rows[row, GRADIENT_2D + 1]
        hyx, hyy = rows[row, GRADIENT_2D + 2], rows[row, GRADIENT_2D + 3]
        rows[row, STRESS_2D] = sxx * (1.0 + hxx) + sxy * hxy
        rows[row, STRESS_2D + 1] = sxy * hyx + syy * (1.0 + hyy)
        rows[row, STRESS_2D + 2] = 0.5 * (sxx * hyx + sxy * (2.0 + hxx + hyy) + syy * hxy)
        history[ids[row], _ENERGY] = energy
        history[ids[row], _THINNING] = thinning
        history[ids[row], _STRAIN] = hxx
        history[ids[row], _STRAIN + 1] = hyy
        history[ids[row], _STRAIN + 2] = hxy + hyx
