"""Case `coupling/phonon`: short waves that start among the atoms, as those of a broken bond, and how many come back.

A bond in the middle of a harmonic lattice has been stretched and lets go: two neighbours start away from their places,
and nearly all of that energy runs outwards in waves of a few spacings, which no grid can carry. They may be taken by
the handshake, but not sent back. The energy of the atoms inside the ring is held against that of the same atoms in a
lattice so large that nothing comes back from its border; the difference is what has returned.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.sparse import coo_matrix, csr_matrix

from coordinator.coupling import Coupling
from coordinator.figures import BLUE, INK, ORANGE, RED, STYLE
from coordinator.launcher import Services
from coordinator.scene import Scene, read_scene
from coordinator.verification_cases.chain import BOND, MASS, SPACING
from coordinator.verification_cases.runs import shipped
from coordinator.verification_cases.whole_lattice import Lattice
from protocol.arrays import FloatArray
from protocol.messages import FieldsReply, FieldsRequest
from protocol.verification import Case, Check

#: Of the two neighbours along their bond, m: so small that the springs are linear.
_START = 0.01e-10
#: Share of the energy that may come back within the time of the scene, 2 ps.
LIMIT = 0.10
#: Waves run at most so fast, m/s; the large lattice is so wide that they do not come back from its border.
_FASTEST = 24e3


@dataclass(frozen=True)
class Decay:
    """Energy of the atoms inside the ring over that of the start.

    Attributes
    ----------
    time : float64 array, shape (times,)
        s
    energy : float64 array, shape (times,)
    """

    time: FloatArray
    energy: FloatArray


def _energy(lattice: Lattice, displacement: FloatArray, velocity: FloatArray) -> float:
    """Return the energy of all atoms of a lattice and of the springs between them, J."""
    stretch = lattice.stretches(displacement)
    return float(0.5 * BOND * np.sum(stretch**2) + 0.5 * MASS * np.sum(velocity**2))


def _pair(place: FloatArray) -> FloatArray:
    """Return displacements, shape (atoms, 2), of the two atoms in the middle away from each other along x."""
    order = np.argsort(np.linalg.norm(place - place.mean(axis=0), axis=1))
    first = order[0]
    row = np.flatnonzero(np.abs(place[:, 1] - place[first, 1]) < 0.1 * SPACING)
    second = row[np.argmin(np.abs(place[row, 0] - place[first, 0] - SPACING))]
    moved = np.zeros((len(place), 2))
    moved[first, 0], moved[second, 0] = -_START, _START
    return moved


def coupled(scene: Scene, folder: Path, every: int = 2) -> tuple[Decay, FloatArray]:
    """Run a scene from the displaced pair; returns the decay, and the places of the atoms inside the ring, m."""
    services = Services(folder, "phonon")
    try:
        services.start("continuum", "continuum", scene.continuum.backend)
        assert scene.atomistic is not None
        services.start("atomistic", "atomistic", scene.atomistic.backend)
        continuum, atoms = services.connect("continuum"), services.connect("atomistic")
        coupling = Coupling(scene, continuum, {"atomistic": atoms})
        coupling.configure()
        coupling.equilibrate()
        (region,) = coupling.regions
        place = np.ascontiguousarray(region.reference[:, :2])
        inside = region.interface.ring.inside(region.own_reference[:, :2])
        lattice = Lattice.of(place[inside], SPACING)
        moved = _pair(place)
        region.displace(np.column_stack([moved, np.zeros(len(place))]))
        time, energy = [0.0], [_energy(lattice, moved[inside], np.zeros_like(moved[inside]))]
        while coupling.step < scene.run.steps:
            coupling.advance()
            if coupling.step % every == 0:
                found = atoms.call("fields", FieldsRequest(names=["position", "velocity"]), FieldsReply).fields
                away, velocity = (found[name][inside, :2] for name in ("position", "velocity"))
                time.append(coupling.step * scene.time_step)
                energy.append(_energy(lattice, away - place[inside], velocity))
    finally:
        services.stop()
    return Decay(np.array(time), np.array(energy) / energy[0]), place[inside]


def unbounded(inside: FloatArray, times: FloatArray, time_step: float) -> Decay:
    """Return the decay among the same atoms, places (atoms, 2) in m, in a lattice without an end."""
    middle = inside.mean(axis=0)
    reach = float(np.ptp(inside, axis=0).max()) / 2 + 0.55 * _FASTEST * float(times[-1])
    rows, columns = int(reach / (SPACING * np.sqrt(0.75))), int(reach / SPACING)
    j, i = np.meshgrid(np.arange(-rows, rows + 1), np.arange(-columns, columns + 1), indexing="ij")
    place = np.column_stack([(i + 0.5 * (j % 2)).ravel() * SPACING, j.ravel() * SPACING * np.sqrt(0.75)])
    # The same lattice: one of its atoms onto one of those inside, which lies in an even row of both.
    corner = inside[np.argmin(np.linalg.norm(inside - middle, axis=1))]
    place += corner - place[np.argmin(np.linalg.norm(place, axis=1))]
    far = np.linalg.norm(place[:, None, 0] - inside[None, :1, 0], axis=1)
    del far
    from scipy.spatial import cKDTree

    distance, mine = cKDTree(place).query(inside)
    assert distance.max() < 1e-3 * SPACING
    whole, part = Lattice.of(place, SPACING), Lattice.of(inside, SPACING)
    stiffness = _stiffness(whole)
    moved = np.zeros((len(place), 2))
    moved[mine] = _pair(inside)
    velocity = np.zeros_like(moved)
    steps = np.round(times / time_step).astype(int)
    energy = []
    force = -(stiffness @ moved.ravel()).reshape(-1, 2)
    for step in range(steps[-1] + 1):
        if step in steps:
            energy.append(_energy(part, moved[mine], velocity[mine]))
        velocity += 0.5 * time_step / MASS * force
        moved += time_step * velocity
        force = -(stiffness @ moved.ravel()).reshape(-1, 2)
        velocity += 0.5 * time_step / MASS * force
    return Decay(times, np.array(energy) / energy[0])


def _stiffness(lattice: Lattice) -> csr_matrix:
    """Return the stiffness matrix of a lattice, shape (2 atoms, 2 atoms), N/m."""
    first, second = lattice.bonds.T
    along = lattice.directions
    rows, columns, values = [], [], []
    for a in range(2):
        for b in range(2):
            block = BOND * along[:, a] * along[:, b]
            for one, other, sign in ((first, first, 1), (second, second, 1), (first, second, -1), (second, first, -1)):
                rows.append(2 * one + a)
                columns.append(2 * other + b)
                values.append(sign * block)
    size = 2 * len(lattice.place)
    return coo_matrix((np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), (size, size)).tocsr()
