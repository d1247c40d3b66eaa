"""Round holes: areas, weights, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest

from mpm_service import Grid, HierarchicalGrid, Hole, cut_holes, fill_hierarchy, fill_rectangle

SIZE = 0.25


def area(body: object) -> float:
    return float(np.sum(body.weight * (2.0 * body.half) ** 2))  # type: ignore[attr-defined]


@pytest.mark.parametrize(("centre", "part"), [((2.0, 2.0), 1.0), ((0.0, 0.0), 0.25), ((0.0, 1.7), 0.5)])
def test_area_that_is_left_is_exact(centre: tuple[float, float], part: float) -> None:
    whole = fill_rectangle((0.0, 0.0), (4.0, 4.0), SIZE)
    body = cut_holes(whole, [Hole(centre, 1.3)])
    assert area(body) == pytest.approx(16.0 - part * np.pi * 1.3**2, rel=1e-6)
    assert np.array_equal(body.stiffness_share, body.weight)
    near = np.hypot(*(body.position - np.array(centre)).T)
    cut = np.abs(near - 1.3) < SIZE
    assert np.all(body.weight[~cut] == 1.0) and np.all(near > 1.3 - SIZE)


def test_nested_cells_and_two_holes() -> None:
    grid = HierarchicalGrid(Grid((-1.0, -1.0), SIZE, (24, 24)), [((0.5, 0.5), (2.5, 2.5))])
    body = cut_holes(fill_hierarchy(grid, (0.0, 0.0), (4.0, 4.0)), [Hole((1.5, 1.5), 0.6), Hole((3.3, 3.3), 0.4)])
    assert area(body) == pytest.approx(16.0 - np.pi * (0.6**2 + 0.4**2), rel=1e-6)


@pytest.mark.parametrize(
    ("holes", "words"),
    [
        ([((9.0, 9.0), 1.0)], r"holes\[0\]: lies outside the body"),
        ([((1.0, 1.0), 0.5), ((1.6, 1.0), 0.5)], r"holes\[1\]: meets holes\[0\]"),
        ([((2.0, 2.0), 9.0)], "holes: cover the whole body"),
    ],
)
def test_holes_that_cannot_be(holes: list[tuple[tuple[float, float], float]], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        cut_holes(fill_rectangle((0.0, 0.0), (4.0, 4.0), SIZE), [Hole(*hole) for hole in holes])


@pytest.mark.parametrize(("centre", "radius", "word"), [((0.0, np.nan), 1.0, "centre"), ((0.0, 0.0), 0.0, "radius")])
def test_bad_numbers_are_named(centre: tuple[float, float], radius: float, word: str) -> None:
    with pytest.raises(ValueError, match=f"hole {word}"):
        Hole(centre, radius)
