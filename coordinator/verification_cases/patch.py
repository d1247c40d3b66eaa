"""Cases `coupling/patch...`: a uniform strain goes through the handshake, along x, along y and as shear.

The edges of the body are held as a uniform strain asks, and the run begins with that strain in continuum and atoms
alike. Both then move, damped, to the equilibrium that the handshake gives them; what it differs by from the strain
applied is the handshake's own. How strain is told is in `patch_strain`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from coordinator.verification_cases.edge_texts import edge_text, gradient_text
from coordinator.verification_cases.patch_strain import PatchState, StrainErrors, as_built, read_state, strain_errors
from coordinator.verification_cases.runs import run_text, shipped
from protocol.arrays import FloatArray
from protocol.verification import Case, Check

SOURCE = "edges moved as a uniform strain asks; a perfect handshake passes it unchanged"
NAMES = ("xx", "yy", "xy")
#: Displacement gradients over the strain: stretch along x, along y, shear without rotation.
STATES: dict[str, FloatArray] = {
    "xx": np.array([[1.0, 0.0], [0.0, 0.0]]),
    "yy": np.array([[0.0, 0.0], [0.0, 1.0]]),
    "xy": np.array([[0.0, 1.0], [1.0, 0.0]]),
}
#: Allowed outside the handshake, among the atoms and in the continuum, and within it.
OUTSIDE, WITHIN = 0.005, 0.02
#: Allowed in hot atoms, in strain and in standard errors; the share that lies further out by chance, of 16 blocks
#: (Student's t with 15 degrees of freedom).
HOT, ERRORS, CHANCE = 0.01, 2.0, 0.064


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
    blocks : int
        Of time, over which displacements are averaged; 1 for atoms at rest.
    settled : float
        Share of the run before the first of them.
    relaxes : bool
        Whether atoms move from where they were built without load; else that run is left out.
    """

    scene: str
    strain: float
    half: float
    blocks: int = 1
    settled: float = 0.0
    relaxes: bool = True


LATTICE = Body("patch_lattice", strain=2e-4, half=780e-10, relaxes=False)
ARGON = Body("patch_argon", strain=2e-4, half=270e-10)
GRAPHENE = Body("patch_graphene", strain=5e-3, half=102.5e-10, blocks=4, settled=0.5)
HOT_GRAPHENE = Body("patch_graphene_300K", strain=1e-2, half=102.5e-10, blocks=16, settled=0.2)


def run_body(body: Body, folder: Path, gradient: FloatArray | None = None) -> PatchState:
    """Run a body under a displacement gradient of its edges, shape (2, 2), or with its edges at rest."""
    if gradient is None:
        edges = (("left", "x"), ("right", "x"), ("bottom", "y"), ("top", "y"))
        text = "".join(edge_text(edge, component, 0.0) for edge, component in edges)
    else:
        text = gradient_text(gradient, body.half)
    with run_text(shipped(body.scene) + text, folder) as results:
        return read_state(results, folder / "run", body.blocks, body.settled)


def run_states(body: Body, folder: Path) -> dict[str, StrainErrors]:
    """Run a body without load and under each state of strain, and draw the errors."""
    gradients = {state: body.strain * shape for state, shape in STATES.items()}
    loaded = {state: run_body(body, folder / state, gradient) for state, gradient in gradients.items()}
    unloaded = run_body(body, folder / "unloaded") if body.relaxes else as_built(next(iter(loaded.values())))
    errors = {state: strain_errors(loaded[state], unloaded, gradient) for state, gradient in gradients.items()}
    draw(errors, folder / "patch.png")
    return errors


def draw(errors: dict[str, StrainErrors], picture: Path) -> None:
    """Draw the error of the main component, one map for each state."""
    figure = Figure(figsize=(4.6 * len(errors), 4.2), layout="constrained")
    axes = figure.subplots(1, len(errors))
    for one, (state, found) in zip(np.atleast_1d(axes), errors.items(), strict=True):
        k = NAMES.index(state)
        place = np.concatenate([found.place, found.point]) * 1e10
        value = 100.0 * np.concatenate([found.atoms[:, k], found.continuum[:, k]])
        limit = max(1.0, float(np.quantile(np.abs(value), 0.99)))
        drawn = one.scatter(*place.T, c=value, s=9, cmap="coolwarm", vmin=-limit, vmax=limit, edgecolors="none")
        one.set(aspect="equal", xlabel="x (Å)", title=f"strain {state}: mean inside {100 * found.mean[k]:+.2f} %")
        figure.colorbar(drawn, ax=one, label="error of the strain (%)", shrink=0.8)
    np.atleast_1d(axes)[0].set_ylabel("y (Å)")
    figure.savefig(picture, dpi=130)


def cold_checks(name: str, errors: dict[str, StrainErrors]) -> list[Check]:
    """Hold the worst of every region against its limit."""
    found = []
    for state, one in errors.items():
        worst = float(one.mean[np.argmax(np.abs(one.mean))])
        found += [
            Check(f"{name}, {state}: error of the mean strain inside", worst, 0.0, OUTSIDE, SOURCE),
            Check(f"{name}, {state}: worst window of atoms inside", one.worst_inside, 0.0, OUTSIDE, SOURCE),
            Check(f"{name}, {state}: worst window of the continuum", one.worst_outside, 0.0, OUTSIDE, SOURCE),
            Check(f"{name}, {state}: worst window in the handshake", one.worst_handshake, 0.0, WITHIN, SOURCE),
        ]
    return found


def hot_checks(name: str, errors: dict[str, StrainErrors]) -> list[Check]:
    """Hold means over time against their standard errors as well."""
    found = []
    for state, one in errors.items():
        worst = float(one.mean[np.argmax(np.abs(one.mean))])
        far = float(np.max(np.abs(one.mean) / one.mean_scatter))
        windows = np.abs(one.atoms[one.inside]) > ERRORS * one.atoms_error[one.inside]
        found += [
            Check(f"{name}, {state}: error of the mean strain inside", worst, 0.0, HOT, SOURCE),
            Check(f"{name}, {state}: the same over the standard error of the strain", far, ERRORS, 0.0, SOURCE,
                  at_most=True),
            Check(f"{name}, {state}: windows of atoms inside beyond two standard errors", float(windows.mean()), CHANCE,
                  0.0, SOURCE, at_most=True),
            Check(f"{name}, {state}: worst window of atoms inside", one.worst_inside, 0.0, HOT, SOURCE),
            Check(f"{name}, {state}: worst window of the continuum", one.worst_outside, 0.0, HOT, SOURCE),
            Check(f"{name}, {state}: worst window in the handshake", one.worst_handshake, 0.0, WITHIN, SOURCE),
        ]  # fmt: skip
    return found


def _case(
    name: str, summary: str, title: str, body: Body, check: Callable[[str, dict[str, StrainErrors]], list[Check]]
) -> Case:
    def run(folder: Path) -> list[Check]:
        return check(title, run_states(body, folder))

    return Case("coupling", name, f"uniform strain through the handshake, {summary}", run, slow=True)


CASES = [
    _case("patch", "harmonic lattice", "lattice", LATTICE, cold_checks),
    _case("patch-argon", "Lennard-Jones atoms", "argon", ARGON, cold_checks),
    _case("patch-graphene", "graphene at 1 K", "graphene 1 K", GRAPHENE, cold_checks),
    _case("patch-graphene-300K", "graphene at 300 K", "graphene 300 K", HOT_GRAPHENE, hot_checks),
]
