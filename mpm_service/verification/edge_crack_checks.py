"""Checks of the case `mpm/edge-crack`."""

from __future__ import annotations

from pathlib import Path

from protocol.verification import Check

from . import edge_crack

#: Allowed relative error of J by a/h.
LIMITS = {5: 0.04, 10: 0.015, 20: 0.005}
TADA = "Tada, Paris and Irwin, single edge notch in tension, a/W = 0.5 (within 0.5 % of the exact answer)"


def edge_crack_checks(folder: Path) -> list[Check]:
    """Energy release rate of an edge crack by J-integral and by crack closure."""
    runs, places = edge_crack.edge_crack(folder)
    reference = edge_crack.tada_release_rate()
    checks = [
        Check(f"J at a/h = {cells}", float(run.release_rate[0]), reference, LIMITS[cells], TADA, unit="J/m^2")
        for cells, run in runs.items()
    ]
    checks += [
        Check(
            f"spread of J over {len(run.rings)} rings, a/h = {cells}",
            run.contour_spread,
            0.015,
            0.0,
            "J does not depend on the contour; limit set for the product",
            at_most=True,
        )
        for cells, run in runs.items()
    ]
    finest = runs[max(runs)]
    released = float(finest.release_rate[0])
    checks += [
        Check(
            f"G_I by crack closure at a/h = {finest.cells}",
            finest.closure[0],
            released,
            0.03,
            "J of the same run",
            unit="J/m^2",
        ),
        Check(
            f"K_I by the interaction integral at a/h = {finest.cells}",
            finest.intensities.opening,
            edge_crack.tada_intensity(),
            0.005,
            TADA,
            unit="Pa m^0.5",
        ),
        Check(
            f"largest error of J over {len(places)} other places of the tip in its cell, a/h = {edge_crack.ELSEWHERE}",
            max(abs(error) for error in places.values()),
            0.06,
            0.0,
            TADA + "; limit set for the product",
            at_most=True,
        ),
    ]
    return checks
