"""The mesh of a notched bar, and its stress concentration against Peterson."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from fem_service.laminate_mesh import stack
from fem_service.notched_bar import edge_notches
from fem_service.plane_mesh import PlaneMesh
from fem_service.point_material import ElasticMaterial
from fem_service.quasi_static import QuasiStatic
from fem_service.tension import tension_grips
from fem_service.verification.elements import isotropic

LENGTH, WIDTH, NOTCH = 30e-3, 10e-3, 2.5e-3


def areas(mesh: PlaneMesh) -> NDArray[np.float64]:
    x, y = mesh.nodes[mesh.elements].transpose(2, 0, 1)
    following = np.roll(np.arange(4), -1)
    return np.asarray(0.5 * (x * y[:, following] - x[:, following] * y).sum(axis=1))


def test_area_is_that_of_the_bar_without_its_notches() -> None:
    sizes = {"around": 16, "radial": 6, "growth": 3.0, "beyond": 4}
    quarter = edge_notches(LENGTH, WIDTH, NOTCH, quadrant=True, **sizes)
    whole = edge_notches(LENGTH, WIDTH, NOTCH, **sizes)
    turn = 0.5 * np.pi / 16
    notch = 16 * 0.5 * (0.5 * NOTCH) ** 2 * np.sin(turn)  # the notch of a quarter is half of a polygon
    assert areas(quarter).min() > 0.0 and areas(whole).min() > 0.0
    assert areas(quarter).sum() == pytest.approx(0.25 * LENGTH * WIDTH - notch, rel=1e-12)
    assert areas(whole).sum() == pytest.approx(LENGTH * WIDTH - 4.0 * notch, rel=1e-12)
    assert len(whole.elements) == 4 * len(quarter.elements)


def test_notches_lie_in_the_middle_of_both_sides() -> None:
    mesh = edge_notches(LENGTH, WIDTH, NOTCH, around=8, radial=4, beyond=3)
    x, y = mesh.nodes.T
    root = 0.5 * (WIDTH - NOTCH)
    across = np.abs(x) < 1e-12
    assert np.abs(y[across]).max() == pytest.approx(root)
    assert np.abs(y).max() == pytest.approx(0.5 * WIDTH) and np.abs(x).max() == pytest.approx(0.5 * LENGTH)
    for side in (-1.0, 1.0):
        distance = np.hypot(x, y - side * 0.5 * WIDTH)
        assert distance.min() == pytest.approx(0.5 * NOTCH)
        assert np.sum(distance < 0.5 * NOTCH * (1.0 + 1e-9)) == 17  # twice eight elements round a notch
    assert np.sum(across & (np.abs(y) < 1e-12)) == 1  # the sides meet in the middle


def test_a_notch_wider_than_the_bar_is_refused() -> None:
    with pytest.raises(ValueError, match=r"diameter is 0\.01 m; it must be less than the width"):
        edge_notches(LENGTH, WIDTH, WIDTH, around=8, radial=4, beyond=2)


def peterson(ratio: float) -> float:
    """K_T on the net section of opposite half-round notches, of notch diameter over width.

    W. D. Pilkey, D. F. Pilkey: Peterson's Stress Concentration Factors, chart 2.3.
    """
    return 3.065 - 3.472 * ratio + 1.009 * ratio**2 + 0.405 * ratio**3


@pytest.mark.parametrize("ratio", [0.1, 0.25, 0.4])
def test_stress_concentration_is_petersons(ratio: float) -> None:
    thin = 0.02 * NOTCH
    width = NOTCH / ratio
    plane = edge_notches(3.0 * width, width, NOTCH, around=32, radial=32, growth=20.0, beyond=12, quadrant=True)
    mesh = stack(plane, np.zeros(1), thin)
    bar = QuasiStatic(mesh, ElasticMaterial(isotropic(70e9, 0.3)), tension_grips(mesh, quarter=True), tolerance=1e-7)
    pulled = bar.advance(bar.rest(), 1.0)
    net = 2.0 * pulled.force / (0.5 * (width - NOTCH) * thin)  # the end moves by half a metre
    x, y, _ = bar.bricks.positions(mesh.nodes).mean(axis=1).T
    stress = pulled.stress[:, :, 0].mean(axis=1) / net
    # At the root of the notch, from the middles of the three elements that follow each other along the ligament.
    column = np.argsort(np.arctan2(x, 0.5 * width - y))[:32]
    nearest = column[np.argsort(-y[column])[:3]]
    depth = 0.5 * (width - NOTCH) - y[nearest]
    root = np.polyfit(depth, stress[nearest], 2)[-1]
    assert root == pytest.approx(peterson(ratio), rel=0.02)
