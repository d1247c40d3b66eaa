"""Anchors: points that hold atoms by springs and dampers, inside LAMMPS.

The force on an anchored atom is k (a - r) + gamma (v_a - v) plus the thermostat's noise (Eq 85-86 of the
dissertation, with a damper relative to the anchor's velocity). ``fix addforce`` applies k a + gamma v_a - k r from
per-atom arrays; ``fix langevin`` applies -gamma v and the noise that belongs to gamma at the run's temperature.
Per window of M steps ``fix ave/atom`` averages positions and velocities, from which the mean reaction follows.
Nothing of this runs in Python within a window, and every part works under MPI.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from md_service import units

GROUP = "handshake"


@dataclass
class Anchors:
    """Anchors of the handshake, SI units.

    Attributes
    ----------
    atom_id : ndarray of int64, shape (k,)
        Row of each anchored atom in the engine's position array, from 0.
    position, velocity : ndarray, shape (k, 3)
        Of the anchors, m and m/s.
    stiffness : ndarray, shape (k,)
        Spring constants, N/m.
    ivc : ndarray of int64, shape (k,)
        Interface volume cell of each anchor, from 0.
    damping : float
        Damper constant gamma, kg/s, one for all anchors; 0 for springs alone.
    """

    atom_id: NDArray[np.int64]
    position: NDArray[np.float64]
    velocity: NDArray[np.float64]
    stiffness: NDArray[np.float64]
    ivc: NDArray[np.int64]
    damping: float

    @property
    def n_ivc(self) -> int:
        """Number of interface volume cells."""
        return int(self.ivc.max()) + 1

    def spring_energy(self, atom_position: NDArray[np.float64]) -> float:
        """Energy of all springs, J, for positions (k, 3) of the anchored atoms in m (Eq 85)."""
        return float(0.5 * np.sum(self.stiffness[:, None] * (atom_position - self.position) ** 2))

    def force_on_continuum(
        self, mean_position: NDArray[np.float64], mean_velocity: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Mean reaction of spring and damper on each anchor, N (Eq 86 and the damper's reaction).

        Parameters
        ----------
        mean_position, mean_velocity : ndarray, shape (k, 3)
            Window means of the anchored atoms, m and m/s.
        """
        spring = self.stiffness[:, None] * (mean_position - self.position)
        return spring - self.damping * (self.velocity - mean_velocity)

    def sum_over_ivc(self, force: NDArray[np.float64]) -> NDArray[np.float64]:
        """Sum a per-anchor array (k, 3) over the anchors of each interface volume cell, (m, 3)."""
        total = np.zeros((self.n_ivc, 3))
        np.add.at(total, self.ivc, force)
        return total


def checked_anchors(
    atom_id: ArrayLike,
    position: ArrayLike,
    stiffness: ArrayLike,
    ivc: ArrayLike,
    damping: ArrayLike,
    n_atoms: int,
) -> Anchors:
    """Anchors at rest from a user's arrays; `damping` may be a number or k equal ones.

    Raises
    ------
    ValueError
        Naming the field, its value and what is allowed.
    """
    ids = np.asarray(atom_id)
    if ids.ndim != 1 or len(ids) == 0 or not np.issubdtype(ids.dtype, np.integer):
        raise ValueError(f"atom_id has shape {ids.shape} and type {ids.dtype}; a non-empty list of integers is needed")
    ids = np.array(ids, dtype=np.int64)
    outside = ids[(ids < 0) | (ids >= n_atoms)]
    if len(outside):
        raise ValueError(f"atom_id holds {outside[0]}; allowed are 0 to {n_atoms - 1}")
    if len(np.unique(ids)) != len(ids):
        values, count = np.unique(ids, return_counts=True)
        raise ValueError(f"atom_id holds {values[count > 1][0]} more than once; one anchor per atom is allowed")
    stiffness_array = finite_array("stiffness", stiffness, (len(ids),))
    if not (stiffness_array > 0.0).all():
        raise ValueError(f"stiffness holds {stiffness_array.min()} N/m; every spring needs a positive stiffness")
    cells = np.asarray(ivc)
    if cells.shape != ids.shape or not np.issubdtype(cells.dtype, np.integer) or cells.min() < 0:
        raise ValueError(f"ivc has shape {cells.shape} and type {cells.dtype}; {len(ids)} integers from 0 are needed")
    damper = finite_array("damping", np.broadcast_to(np.asarray(damping, dtype=np.float64), ids.shape), ids.shape)
    if damper.min() != damper.max() or damper.min() < 0.0:
        raise ValueError(
            f"damping runs from {damper.min()} to {damper.max()} kg/s; one value, not negative, for all anchors is "
            "allowed, because one thermostat serves them all"
        )
    return Anchors(
        atom_id=ids,
        position=finite_array("position", position, (len(ids), 3)),
        velocity=np.zeros((len(ids), 3)),
        stiffness=stiffness_array,
        ivc=np.array(cells, dtype=np.int64),
        damping=float(damper[0]),
    )


def finite_array(name: str, value: ArrayLike, shape: tuple[int, ...]) -> NDArray[np.float64]:
    array = np.array(value, dtype=np.float64, order="C")
    if array.shape != shape:
        raise ValueError(f"{name} has shape {array.shape}; {shape} is needed")
    if not np.isfinite(array).all():
        raise ValueError(f"{name} holds values that are not finite")
    return array


def anchor_commands() -> list[str]:
    """LAMMPS commands that make the per-atom arrays: k, and c = k a + gamma v_a."""
    return ["fix anchor_data all property/atom d_anchor_k d2_anchor_c 3"]


def group_commands() -> list[str]:
    """LAMMPS commands that group anchored and inner atoms, once the arrays are filled."""
    return [
        "variable is_anchored atom d_anchor_k>0",
        f"group {GROUP} variable is_anchored",
        "variable is_anchored delete",
        f"group inner subtract all {GROUP}",
    ]


def force_commands(with_energy: bool = False) -> list[str]:
    """LAMMPS commands that apply the anchor forces; the energy is for minimisation only."""
    lines = [
        f"variable anchor_f{axis} atom d2_anchor_c[{column}]-d_anchor_k*{axis}"
        for column, axis in enumerate("xyz", start=1)
    ]
    fix = f"fix anchor_force {GROUP} addforce v_anchor_fx v_anchor_fy v_anchor_fz"
    if not with_energy:
        return [*lines, fix]
    # With anchors at rest c / k is the anchor's position.
    terms = "+".join(f"({axis}-d2_anchor_c[{i}]/d_anchor_k)^2" for i, axis in enumerate("xyz", start=1))
    energy = f"variable anchor_energy atom 0.5*d_anchor_k*({terms})"
    return [*lines, energy, f"{fix} energy v_anchor_energy", "fix_modify anchor_force energy yes"]


def thermostat_command(group: str, temperature: float, damping_time: float, seed: int) -> str:
    """``fix langevin`` on a group; temperature in K, damping time m/gamma in s."""
    damp = damping_time / units.TIME
    return f"fix thermostat {group} langevin {temperature!r} {temperature!r} {damp!r} {seed} tally yes"


def averaging_command(window: int) -> str:
    """``fix ave/atom`` that averages positions and velocities over windows of the given number of steps."""
    return f"fix window_mean {GROUP} ave/atom 1 {window} {window} x y z vx vy vz"


def write_anchor_arrays(lmp: object, anchors: Anchors, row_of_atom: NDArray[np.int64]) -> None:
    """Write k and c = k a + gamma v_a of this rank's atoms into LAMMPS.

    Parameters
    ----------
    lmp : lammps.lammps
        Instance with the arrays of `anchor_commands`.
    anchors : Anchors
        Current anchors.
    row_of_atom : ndarray of int64, shape (n,)
        Row of each atom's anchor, -1 where there is none.
    """
    numpy_view = lmp.numpy  # type: ignore[attr-defined]
    n_local = lmp.extract_global("nlocal")  # type: ignore[attr-defined]
    row = row_of_atom[numpy_view.extract_atom("id")[:n_local] - 1]
    local = np.flatnonzero(row >= 0)
    row = row[local]
    stiffness = anchors.stiffness[row] / units.STIFFNESS
    carried = anchors.velocity[row] * (anchors.damping / units.FORCE)
    numpy_view.extract_atom("d_anchor_k")[local] = stiffness
    numpy_view.extract_atom("d2_anchor_c")[local] = (
        stiffness[:, None] * (anchors.position[row] / units.LENGTH) + carried
    )
