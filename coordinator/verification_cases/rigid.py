"""Cases `coupling/rigid` and `rigid-graphene`: a body moved or turned as a whole has no force in its handshake.

Continuum, anchors and atoms begin displaced or turned, all at once. A translation must then leave nothing. A turn by
edges that follow it to first order is a strain of the second order, and a law of small strain makes another one of it,
half the angle squared; so some such force remains, and twice the angle must leave four times as much.

Or the edges carry the body along, smoothly, and stop: what then remains is what points keep that moved through the
grid while the body was strained by its inertia and by damping, which is against rest.

Graphene is at 1 K, so its forces are noise; the body that is moved is compared with the same body at rest.
Forces are told over that of a cell at 1 % strain: E times 1 % times the area of its side.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from coordinator.checkpoint import read_checkpoint
from coordinator.results import Results
from coordinator.verification_cases.edge_texts import edge_text, gradient_text
from coordinator.verification_cases.runs import run_text, shipped
from protocol.arrays import FloatArray
from protocol.verification import Case, Check

_HALF, _HALF_GRAPHENE = 64e-10, 52.5e-10
#: Slow, since damping is against rest and the atoms have inertia: both strain the body on its way.
_RISE = 9e-12
_WAY = (0.3e-10, 0.2e-10)
_ANGLE = 2e-3
_DAMPED = "continuum.damping_rate=6 1/ps"
_AT_ONCE = ("run.steps=400", _DAMPED, 'continuum.preload={method = "static", tolerance = 1e-9, max_steps = 20}')
_CARRIED = ("run.steps=2800", "run.output_every=2800", "run.checkpoint_every=2800", _DAMPED)
#: Parts of a run whose means count as independent of each other.
_BLOCKS = 10
_LAW = "a body that moves as a whole is not strained"


def translation_text(share: float = 1.0, rise: float = 0.0) -> str:
    """Return edges that have all of the body moved by a share of the same way, both components of every edge."""
    text = ""
    for edge in ("left", "right", "bottom", "top"):
        for axis, way in zip("xy", _WAY, strict=True):
            text += edge_text(edge, axis, share * way, rise)
    return text


def turn_text(angle: float, half: float = _HALF) -> str:
    """Return edges that turn a body of half size `half`, m, by a small angle, rad."""
    return gradient_text(angle * np.array([[0.0, -1.0], [1.0, 0.0]]), half)


def leftover(text: str, folder: Path, overrides: Sequence[str]) -> float:
    """Run the free body with edges and return the largest force on a cell at the end, over that at 1 % strain."""
    with run_text(shipped("free_lattice") + text, folder, overrides) as results:
        force = np.linalg.norm(results.interface["force"][-1], axis=1)
        return float(force.max()) / _unit_force(results, folder)


def _unit_force(results: Results, folder: Path) -> float:
    """Force on the side of a cell at a strain of 1 %, N."""
    header, _ = read_checkpoint(folder / "run")
    measured = header["properties"]
    side = float(results.scene["resolved"]["handshake"]["ivc_size"])
    return 0.01 * float(measured["young"]) * float(measured["thickness"]) * side


def rigid(folder: Path) -> list[Check]:
    """Translation at once and across the lines of the grid, and turns by two small angles."""
    moved = leftover(translation_text(), folder / "translation", _AT_ONCE)
    carried = leftover(translation_text(rise=_RISE), folder / "carried", _CARRIED)
    once = leftover(turn_text(_ANGLE), folder / "turn", _AT_ONCE)
    twice = leftover(turn_text(2.0 * _ANGLE), folder / "turn-twice", _AT_ONCE)
    # Half the angle squared against 1 %: what a small-strain law makes of a turn.
    square = 0.5 * _ANGLE**2 / 0.01
    return [
        Check("translation by 0.36 angstrom at once: largest force on a cell over that at 1 % strain", moved, 0.0, 1e-8,
              _LAW),
        Check("carried there in 9 ps: the same, 5 ps later", carried, 0.0, 1e-4, _LAW),
        Check("turn by 2 mrad: the same over half the angle squared", once / square, 2.0, 0.0,
              "strain of a small-strain law under a turn, cos(angle) - 1", at_most=True),
        Check("turn by 4 mrad: force over that at 2 mrad", twice / once, 4.0, 0.1, "of the order of the angle squared"),
    ]  # fmt: skip


# Graphene ------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Means:
    """Forces on the cells of the handshake, in the plane, over a run.

    Attributes
    ----------
    force, error : float64 array, shape (cells, 2)
        Mean and its standard error, from the scatter of the means of `_BLOCKS` parts, over the force at 1 % strain.
    """

    force: FloatArray
    error: FloatArray


def graphene_means(text: str, folder: Path) -> Means:
    """Run the body with graphene and edges."""
    with run_text(shipped("rigid_graphene") + text, folder) as results:
        force = np.asarray(results.interface["force"])[:, :, :2] / _unit_force(results, folder)
    parts = np.array([part.mean(axis=0) for part in np.array_split(force, _BLOCKS)])
    return Means(force.mean(axis=0), parts.std(axis=0, ddof=1) / np.sqrt(_BLOCKS))


def rigid_graphene(folder: Path) -> list[Check]:
    """Translation and turn of a body with graphene at 1 K, against the body at rest."""
    rest = graphene_means(translation_text(0.0), folder / "rest")
    noise = float(np.sqrt(np.mean(rest.error**2)))
    checks = []
    for name, text in (
        ("translation by 0.36 angstrom", translation_text()),
        ("turn by 2 mrad", turn_text(_ANGLE, _HALF_GRAPHENE)),
    ):
        moved = graphene_means(text, folder / name.split()[0])
        more = moved.force - rest.force
        checks.append(
            Check(f"{name}: rms over cells of the mean force beyond that at rest, over its standard error, {noise:.1e} "
                  "of the force at 1 % strain", float(np.sqrt(np.mean((more / rest.error) ** 2))), 2.0, 0.0,
                  "two runs that differ by noise alone: about 1.6", at_most=True)
        )  # fmt: skip
    return checks


CASES = [
    Case("coupling", "rigid", "the body moved and turned as a whole: no force in the handshake", rigid),
    Case("coupling", "rigid-graphene", "the same with graphene at 1 K: no force beyond noise", rigid_graphene,
         slow=True),
]  # fmt: skip
