"""Case `coupling/patch`: a uniform strain goes through the handshake, along x, along y and as shear.

The edges of the body are held as a uniform strain asks, and the run begins with that strain in continuum and atoms
alike. Both then move, damped, to the equilibrium that the handshake gives them; what it differs by from the strain
applied is the handshake's own. The strain of the atoms is fitted to their displacements, that of the continuum follows
from its stress: displacements of material points keep ripples of waves that passed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from coordinator.checkpoint import read_checkpoint
from coordinator.local_strain import local_strain, mean_gradient
from coordinator.results import Results
from coordinator.verification_cases.edge_texts import gradient_text
from coordinator.verification_cases.runs import run_text, shipped
from protocol.arrays import FloatArray
from protocol.verification import Case, Check

SOURCE = "edges moved as a uniform strain asks; a perfect handshake passes it unchanged"
NAMES = ("xx", "yy", "xy")
#: Displacement gradients over the strain: stretch along x, along y, simple shear.
STATES: dict[str, FloatArray] = {
    "xx": np.array([[1.0, 0.0], [0.0, 0.0]]),
    "yy": np.array([[0.0, 0.0], [0.0, 1.0]]),
    "xy": np.array([[0.0, 2.0], [0.0, 0.0]]),
}


@dataclass(frozen=True)
class Body:
    """A scene of the patch test.

    Attributes
    ----------
    scene : str
        Name of its file, without edges.
    strain : float
        Applied.
    half : float
        Half the side of the body, m.
    bin_size : float
        Bins over which the strain of atoms is fitted, each with its eight neighbours, m.
    """

    scene: str
    strain: float
    half: float
    bin_size: float


@dataclass(frozen=True)
class StrainErrors:
    """Differences from the applied strain over that strain; rows xx, yy, xy.

    Attributes
    ----------
    mean : float64 array, shape (3,)
        Of the one gradient fitted to all atoms inside the handshake.
    place, atoms : float64 array, shape (n, 2) and (n, 3)
        Bins of atoms, m, and the strain fitted in each.
    inside : bool array, shape (n,)
        Which of them lie inside the handshake.
    point, continuum : float64 array, shape (m, 2) and (m, 3)
        Material points outside the handshake, m, and their strain.
    beyond : bool array, shape (m,)
        Which of them lie more than a cell from it and from the edges of the body: nodes there carry parts of cells.
    """

    mean: FloatArray
    place: FloatArray
    atoms: FloatArray
    inside: np.ndarray
    point: FloatArray
    continuum: FloatArray
    beyond: np.ndarray

    @property
    def worst_inside(self) -> float:
        """Largest error of any bin inside the handshake."""
        return float(np.max(np.abs(self.atoms[self.inside])))

    @property
    def worst_handshake(self) -> float:
        """Largest error of any bin of atoms in the handshake."""
        return float(np.max(np.abs(self.atoms[~self.inside])))

    @property
    def worst_outside(self) -> float:
        """Largest error of a material point more than a cell from the handshake."""
        return float(np.max(np.abs(self.continuum[self.beyond])))

    @property
    def scatter_outside(self) -> float:
        """Root mean square of the error of the same material points."""
        return float(np.sqrt(np.mean(self.continuum[self.beyond] ** 2)))


def strain_errors(results: Results, folder: Path, strain: FloatArray, bin_size: float) -> StrainErrors:
    """Compare the strain of a finished run with that applied.

    Parameters
    ----------
    results : Results
    folder : Path
        Of the run, with its checkpoint.
    strain : float64 array, shape (3,)
        xx, yy and half the shear xy.
    bin_size : float
        m.
    """
    if results.atoms is None or results.points is None:
        raise RuntimeError("the run wrote no atoms or no points")
    scale = float(np.max(np.abs(strain)))
    reference = results.atoms.reference[:, :2]
    moved = _last_displacement(results)
    low, high = results.interface["inner"]
    outer_low, outer_high = results.interface["outer"]
    inside = np.all((reference > low) & (reference < high), axis=1)
    mean = _symmetric(mean_gradient(reference[inside], moved[inside])[None])[0]
    fitted = local_strain(reference, moved, bin_size)
    frame = results.points.frame(len(results.points) - 1)
    start = frame.position[:, :2] - frame.displacement[:, :2]
    outside = np.any((start < outer_low) | (start > outer_high), axis=1)
    body = results.scene["resolved"]["continuum"]
    cell = float(body["cell_size"])
    clear = np.all((start > np.array(body["lower"]) + cell) & (start < np.array(body["upper"]) - cell), axis=1)
    beyond = np.any((start < outer_low - cell) | (start > outer_high + cell), axis=1) & clear
    return StrainErrors(
        (mean - strain) / scale,
        fitted.centre,
        (_symmetric(fitted.gradient) - strain) / scale,
        np.all((fitted.centre > low) & (fitted.centre < high), axis=1),
        start[outside],
        (_elastic_strain(frame.stress[outside], folder) - strain) / scale,
        beyond[outside],
    )


def _last_displacement(results: Results) -> FloatArray:
    """Displacements of the atoms at the end, m: means over the last interval where the run keeps them."""
    assert results.atoms is not None
    try:
        _, values = results.atoms.field("displacement")
        return np.asarray(values[-1][:, :2], dtype=np.float64)
    except KeyError:
        last = results.atoms.position(len(results.atoms) - 1)
        return np.asarray((last - results.atoms.reference)[:, :2])


def _symmetric(gradient: FloatArray) -> FloatArray:
    """Strains xx, yy, xy of gradients, shape (n, 2, 2)."""
    shear = 0.5 * (gradient[:, 0, 1] + gradient[:, 1, 0])
    return np.column_stack([gradient[:, 0, 0], gradient[:, 1, 1], shear])


def _elastic_strain(stress: FloatArray, folder: Path) -> FloatArray:
    """Strains xx, yy, xy in plane stress, by the constants that the run measured."""
    header, _ = read_checkpoint(folder)
    young, poisson = header["properties"]["young"], header["properties"]["poisson"]
    xx, yy, xy = stress[:, 0], stress[:, 1], stress[:, 2]
    return np.column_stack([xx - poisson * yy, yy - poisson * xx, (1.0 + poisson) * xy]) / young


def run_state(body: Body, state: str, folder: Path, overrides: Sequence[str] = ()) -> StrainErrors:
    """Run one state of strain and return its errors."""
    gradient = body.strain * STATES[state]
    text = shipped(body.scene) + gradient_text(gradient, body.half)
    with run_text(text, folder, overrides) as results:
        return strain_errors(results, folder / "run", _symmetric(gradient[None])[0], body.bin_size)


def draw(errors: dict[str, StrainErrors], picture: Path) -> None:
    """Draw the error of the main component, one map for each state."""
    figure, axes = plt.subplots(1, len(errors), figsize=(4.6 * len(errors), 4.2), layout="constrained")
    for one, (state, found) in zip(np.atleast_1d(axes), errors.items(), strict=True):
        k = NAMES.index(state)
        place = np.concatenate([found.place, found.point]) * 1e10
        value = 100.0 * np.concatenate([found.atoms[:, k], found.continuum[:, k]])
        drawn = one.scatter(*place.T, c=value, s=5, cmap="coolwarm", vmin=-3.0, vmax=3.0, edgecolors="none")
        one.set(aspect="equal", xlabel="x (Å)", title=f"strain {state}: mean inside {100 * found.mean[k]:+.2f} %")
    np.atleast_1d(axes)[0].set_ylabel("y (Å)")
    figure.colorbar(drawn, ax=axes, label="error of the strain (%)", shrink=0.8)
    figure.savefig(picture, dpi=130)
    plt.close(figure)


def _checks(errors: dict[str, StrainErrors]) -> list[Check]:
    found = []
    for state, one in errors.items():
        worst = one.mean[np.argmax(np.abs(one.mean))]
        found += [
            Check(f"{state}: error of the mean strain inside", float(worst), 0.0, 0.005, SOURCE),
            Check(f"{state}: worst error among the atoms inside", one.worst_inside, 0.0, 0.005, SOURCE),
            Check(f"{state}: worst error in the continuum outside", one.worst_outside, 0.0, 0.005, SOURCE),
            Check(f"{state}: mean square error in the continuum outside", one.scatter_outside, 0.0, 0.005, SOURCE),
            Check(f"{state}: worst error in the handshake", one.worst_handshake, 0.0, 0.02, SOURCE),
        ]
    return found


def _case(body: Body, folder: Path) -> list[Check]:
    errors = {state: run_state(body, state, folder / state) for state in STATES}
    draw(errors, folder / "patch.png")
    return _checks(errors)


LATTICE = Body("patch_lattice", strain=1e-3, half=120e-10, bin_size=4e-10)


def lattice(folder: Path) -> list[Check]:
    """Harmonic lattice at rest: what is left is the handshake's own error."""
    return _case(LATTICE, folder)


CASES = [Case("coupling", "patch", "uniform strain through the handshake, harmonic lattice", lattice)]
