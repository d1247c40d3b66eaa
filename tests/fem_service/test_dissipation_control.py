"""Snap-back against its closed form: two soft bricks and the layer between them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fem_service.cohesive_law import CohesiveLaw
from fem_service.dissipation_control import advance_by_dissipation
from fem_service.equilibrium import Grips
from fem_service.laminate_mesh import stack
from fem_service.lever import Lever
from fem_service.plane_mesh import rectangle
from fem_service.point_material import ElasticMaterial
from fem_service.quasi_static import QuasiStatic

LAW = CohesiveLaw(1e14, 60e6, 90e6, 200.0, 1000.0, 1.0)
YOUNG, HEIGHT, AREA = 1e9, 0.2e-3, 1e-6  # of both bricks together: softer than the layer softens
SPRING = YOUNG / HEIGHT


def soft_bar(lever: bool) -> QuasiStatic:
    """Pulled along z by grips, or by a lever with the stiffness of the bar itself."""
    mesh = stack(rectangle(1e-3, 1e-3, 1, 1), np.array([0.0, np.pi]), 0.5 * HEIGHT, cohesive=True)
    top = mesh.nodes[:, 2] == HEIGHT
    held = np.ones((len(mesh.nodes), 3), bool)
    held[:, 2] = (mesh.nodes[:, 2] == 0.0) | (top & (not lever))
    moves = np.zeros((len(mesh.nodes), 3))
    moves[top, 2] = 1.0
    freedoms = np.flatnonzero(held)
    grips = Grips(freedoms, np.zeros(len(freedoms)) if lever else moves.reshape(-1)[freedoms])
    machine = Lever(np.flatnonzero(top), 0.25 * moves[top], SPRING * AREA) if lever else None
    material = ElasticMaterial(YOUNG * np.diag([1.0, 1.0, 1.0, 0.5, 0.5, 0.5]))
    return QuasiStatic(mesh, material, grips, law=LAW, lever=machine, tolerance=1e-9)


@pytest.mark.parametrize("lever", [False, True])
def test_snap_back_follows_the_closed_form(lever: bool) -> None:
    bar = soft_bar(lever)
    spring = SPRING / 2.0 if lever else SPRING
    onset, final = 60e6 / LAW.stiffness, LAW.final_opening(0.0)
    falling = 60e6 / (final - onset)
    assert spring < falling  # so it snaps back
    # Damage has to have begun: the state with an opening just past the onset, written down.
    opening = onset * (1 + 1e-4)
    traction = falling * (final - opening)
    bricks = traction / SPRING
    damage = final * (opening - onset) / (opening * (final - onset))
    displacement = np.zeros_like(bar.mesh.nodes)
    displacement[:, 2] = np.repeat([0.0, 0.5 * bricks, 0.5 * bricks + opening, bricks + opening], 4)
    state = replace(
        bar.rest(),
        load=opening + traction / spring,
        force=traction * AREA,
        displacement=displacement,
        layers=np.full((1, 4, 2), damage),
    )
    loads = [state.load]
    for _ in range(40):
        before = state
        state = advance_by_dissipation(bar, before, 0.02 * 200.0 * AREA)
        traction = state.force / AREA
        opening = final - traction / falling
        assert state.load == pytest.approx(opening + traction / spring, rel=1e-5)
        taken = 0.5 * (before.force * state.load - state.force * before.load)
        assert taken == pytest.approx(0.02 * 200.0 * AREA, rel=2e-6)
        loads.append(state.load)
    assert np.all(np.diff(loads) < 0.0) and state.force < 0.25 * 60e6 * AREA


def test_wrong_arguments_are_named() -> None:
    bar = soft_bar(False)
    with pytest.raises(ValueError, match="dissipation is 0"):
        advance_by_dissipation(bar, bar.rest(), 0.0)
    with pytest.raises(ValueError, match=r"force is 0\.0 at the start"):
        advance_by_dissipation(bar, bar.rest(), 1.0)
    bar.viscosity = 1.0
    with pytest.raises(ValueError, match=r"viscosity is 1\.0"):
        advance_by_dissipation(bar, bar.rest(), 1.0)
