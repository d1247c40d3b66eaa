"""Case `coupling/phonon`: short waves that start among the atoms, as those of a broken bond, and how many come back.

A bond in the middle of a harmonic lattice has been stretched and lets go: two neighbours start away from their places,
and nearly all of that energy runs outwards in waves of a few spacings, which no grid can carry. They may be taken by
the handshake, but not sent back. The energy of the atoms inside the ring is held against that of the same atoms in a
lattice so large that nothing comes back from its border; the difference is what has returned.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.sparse import coo_matrix, csr_matrix
from scipy.spatial import cKDTree

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
#: Of the large lattice, s; a seventeenth of the period of its fastest vibration.
_TIME_STEP = 2e-15
#: Of the atoms in the handshake against their anchors: about the time of a wave through it.
_DAMPER = "handshake.damping_time=0.1 ps"
SCHEMES = {
    "default, damper of 0.1 ps": ((_DAMPER,), BLUE),
    "default, no damper": ((), ORANGE),
    "seed, damper of 0.1 ps": ((_DAMPER, "handshake.preset=seed"), RED),
}


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


def unbounded(inside: FloatArray, times: FloatArray) -> Decay:
    """Return the decay among the same atoms, places (atoms, 2) in m, at the same times in a lattice without an end."""
    # To the border and back in the time of the run, from the edge of the inner atoms.
    reach = 0.5 * float(np.ptp(inside, axis=0).max()) + 0.5 * _FASTEST * float(times[-1])
    rows, columns = int(reach / (SPACING * np.sqrt(0.75))) + 1, int(reach / SPACING) + 1
    j, i = np.meshgrid(np.arange(-rows, rows + 1), np.arange(-columns, columns + 1), indexing="ij")
    place = np.column_stack([(i + 0.5 * (j % 2)).ravel() * SPACING, j.ravel() * SPACING * np.sqrt(0.75)])
    corner = inside[np.argmin(np.linalg.norm(inside - inside.mean(axis=0), axis=1))]
    place += corner - place[np.argmin(np.linalg.norm(place, axis=1))]
    distance, mine = cKDTree(place).query(inside)
    if distance.max() > 1e-3 * SPACING:
        raise ValueError("the atoms inside the ring are not those of one lattice")
    whole, part = Lattice.of(place, SPACING), Lattice.of(inside, SPACING)
    stiffness = _stiffness(whole)
    moved = np.zeros((len(place), 2))
    moved[mine] = _pair(inside)
    velocity = np.zeros_like(moved)
    wanted = np.round(times / _TIME_STEP).astype(int)
    energy = [_energy(part, moved[mine], velocity[mine])]
    kick = -_TIME_STEP / MASS * (stiffness @ moved.ravel()).reshape(-1, 2)
    for step in range(1, wanted[-1] + 1):
        velocity += 0.5 * kick
        moved += _TIME_STEP * velocity
        kick = -_TIME_STEP / MASS * (stiffness @ moved.ravel()).reshape(-1, 2)
        velocity += 0.5 * kick
        if step in wanted:
            energy.append(_energy(part, moved[mine], velocity[mine]))
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


def phonon(folder: Path) -> list[Check]:
    """Share of the energy of a broken bond that comes back into the inner region."""
    text = shipped("phonon_lattice")
    found: dict[str, Decay] = {}
    for number, (label, (overrides, _)) in enumerate(SCHEMES.items()):
        found[label], inside = coupled(read_scene(text, "phonon", overrides), folder / f"run{number}")
    first, *others = found
    whole = unbounded(inside, found[first].time)
    draw(folder / "phonon.png", whole, found)
    back = {label: float(np.max(decay.energy - whole.energy)) for label, decay in found.items()}
    told = ", ".join(f"{label}: {100 * back[label]:.1f} %" for label in others)
    source = "the same atoms in a lattice without an end"
    span = f"within {1e12 * float(whole.time[-1]):g} ps"
    return [
        Check(f"energy of a broken bond back inside {span}, {first} ({told})", back[first], LIMIT, 0.0, source,
              at_most=True),
        Check(f"energy that does not leave the inner atoms {span} in a lattice without an end",
              float(whole.energy[-1]), LIMIT, 0.0, "else there is little that could come back", at_most=True),
    ]  # fmt: skip


def draw(path: Path, whole: Decay, found: dict[str, Decay]) -> None:
    """Draw the energy of the inner atoms over time, and what has come back."""
    import matplotlib
    from matplotlib.figure import Figure

    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(9.6, 4.0), layout="constrained")
        left, right = figure.subplots(1, 2)
        left.plot(whole.time * 1e12, whole.energy, color=INK, label="lattice without an end")
        for label, decay in found.items():
            colour = SCHEMES[label][1]
            left.plot(decay.time * 1e12, decay.energy, color=colour, label=label)
            right.plot(decay.time * 1e12, decay.energy - whole.energy, color=colour, label=label)
        right.axhline(LIMIT, color=INK, linestyle="--", label="largest allowed")
        left.set(xlabel="time / ps", ylabel="energy of the inner atoms / start", ylim=(0.0, 1.05))
        right.set(xlabel="time / ps", ylabel="energy come back / start")
        left.set_title("A bond lets go in the middle")
        right.set_title("More than without an end")
        left.legend()
        right.legend()
        figure.savefig(path)


CASES = [Case("coupling", "phonon", "short waves of a broken bond leave the atoms through the handshake", phonon)]
