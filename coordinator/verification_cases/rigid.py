"""Case `coupling/rigid`: a body that is moved or turned as a whole has no force in its handshake.

The edges carry the body along, smoothly, and stop; then nothing may be left between continuum and atoms. Or the body
begins turned by a small angle, atoms and all, and may find another equilibrium if there is one. Its law is that of
small strain, which takes a turn for a strain of half the angle squared, so twice the angle must leave four times the
force.
Forces are told over that of a cell at 1 % strain: E times 1 % times the area of its side.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from coordinator.checkpoint import read_checkpoint
from coordinator.results import Results
from coordinator.verification_cases.edge_texts import edge_text, gradient_text
from coordinator.verification_cases.runs import run_text, shipped
from protocol.verification import Case, Check

_HALF = 64e-10
#: Slow enough that the body hardly feels its own inertia: a strain of 0.02 %.
_RISE = 3e-12
#: A fraction of a cell: material points that cross lines of the grid while they are strained keep part of that stress.
_WAY = (0.3e-10, 0.2e-10)
_ANGLE = 2e-3
_DAMPED = "continuum.damping_rate=6 1/ps"
_CARRIED = ("run.steps=2000", _DAMPED)
_TURNED = ("run.steps=400", _DAMPED, 'continuum.preload={method = "static", tolerance = 1e-9, max_steps = 20}')


def translation_text() -> str:
    """Return edges that carry all of the body by the same way, both components of every edge."""
    text = ""
    for edge in ("left", "right", "bottom", "top"):
        for axis, way in zip("xy", _WAY, strict=True):
            text += edge_text(edge, axis, way, _RISE)
    return text


def turn_text(angle: float) -> str:
    """Return edges that turn the body by a small angle, rad."""
    return gradient_text(angle * np.array([[0.0, -1.0], [1.0, 0.0]]), _HALF)


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
    """Translation across the lines of the grid, and turns by two small angles."""
    moved = leftover(translation_text(), folder / "translation", _CARRIED)
    once = leftover(turn_text(_ANGLE), folder / "turn", _TURNED)
    twice = leftover(turn_text(2.0 * _ANGLE), folder / "turn-twice", _TURNED)
    law = "a body that moves as a whole is not strained"
    # Half the angle squared against 1 %: what a small-strain law makes of a turn.
    square = 0.5 * _ANGLE**2 / 0.01
    return [
        Check("translation by 0.36 angstrom: largest force on a cell over that at 1 % strain", moved, 0.0, 1e-4, law),
        Check("turn by 2 mrad: the same over half the angle squared", once / square, 2.0, 0.0,
              "strain of a small-strain law under a turn, cos(angle) - 1", at_most=True),
        Check("turn by 4 mrad: force over that at 2 mrad", twice / once, 4.0, 0.1, "of the order of the angle squared"),
    ]  # fmt: skip


CASES = [Case("coupling", "rigid", "the body moved and turned as a whole: no force in the handshake", rigid)]
