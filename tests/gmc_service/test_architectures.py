"""Architectures: the fraction is met exactly, layouts are those that were published, circles do not overlap."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gmc_service.architectures import (
    Architecture,
    OutOfRange,
    hexagonal_pack,
    layered,
    random_pack,
    square_pack,
    square_void,
    user_array,
)
from gmc_service.engineering_constants import coupling, engineering_constants
from gmc_service.fibre_placement import place_fibres
from gmc_service.high_fidelity import homogenise
from gmc_service.material import isotropic_stiffness


def area_fraction(built: Architecture) -> float:
    """By adding up rectangles one by one, independent of the class."""
    inside = sum(
        built.heights[row] * built.widths[column]
        for row in range(len(built.heights))
        for column in range(len(built.widths))
        if built.phase[row, column] == 0
    )
    return float(inside / (sum(built.heights) * sum(built.widths)))


def check(built: Architecture, fraction: float) -> None:
    assert abs(area_fraction(built) - fraction) < 1e-12
    assert abs(built.fraction() - fraction) < 1e-12
    assert (built.heights > 0.0).all() and (built.widths > 0.0).all()
    assert built.phase.shape == (len(built.heights), len(built.widths)) and built.phase.dtype == np.int64
    assert set(np.unique(built.phase)) == {0, 1}


@given(st.sampled_from([(2, 1.0), (7, 0.8125), (26, 3838.0 / 69.0**2)]), st.floats(1e-6, 1.0 - 1e-6))
def test_square_packs_meet_any_fraction(kind: tuple[int, float], share: float) -> None:
    subcells, limit = kind
    built = square_pack(subcells, share * limit)  # type: ignore[arg-type]
    check(built, share * limit)
    assert built.phase.shape == (subcells, subcells)
    assert math.isclose(built.heights.sum(), 1e-5, rel_tol=1e-14)
    np.testing.assert_array_equal(built.phase, built.phase.T)
    np.testing.assert_array_equal(built.heights, built.widths)


@settings(max_examples=30, deadline=None)
@given(st.floats(0.02, 0.9), st.sampled_from([8, 16, 26, 40]))
def test_hexagonal_packs_meet_any_fraction_and_keep_their_symmetry(fraction: float, columns: int) -> None:
    try:
        built = hexagonal_pack(fraction, columns)
    except ValueError as error:
        assert "needs more than" in str(error) and (columns == 8 or fraction < 0.05)
        return
    check(built, fraction)
    assert math.isclose(built.heights.sum(), math.sqrt(3.0) * built.widths.sum(), rel_tol=1e-12)
    np.testing.assert_array_equal(built.phase, built.phase[::-1])
    np.testing.assert_array_equal(built.phase, built.phase[:, ::-1])
    # The fibre in the middle is that at the corners, shifted by half a cell.
    shifted = np.roll(built.phase, (built.phase.shape[0] // 2, columns // 2), (0, 1))
    np.testing.assert_array_equal(built.phase, shifted)


@settings(max_examples=25, deadline=None)
@given(st.floats(0.05, 0.6), st.integers(6, 20), st.integers(0, 10_000))
def test_random_packs_meet_any_fraction(fraction: float, fibres: int, seed: int) -> None:
    built = random_pack(fraction, fibres, seed)
    check(built, fraction)
    even = 1.0 / 64.0
    # What is left to meet after whole subcells is small: no row or column is far from even.
    for sizes in (built.heights, built.widths):
        assert np.abs(sizes / sizes.sum() / even - 1.0).max() < 0.1


@settings(max_examples=25, deadline=None)
@given(st.floats(0.05, 0.6), st.integers(2, 20), st.integers(0, 10_000), st.floats(0.0, 0.1))
def test_circles_lie_apart_in_the_periodic_cell(fraction: float, fibres: int, seed: int, gap: float) -> None:
    try:
        axes = place_fibres(fraction, fibres, seed, gap)
    except ValueError as error:
        assert fibres < 5 and ("was found" in str(error) or "does not fit" in str(error))
        return
    assert axes.shape == (fibres, 2) and (axes >= 0.0).all() and (axes < 1.0).all()
    radius = math.sqrt(fraction / fibres / math.pi)
    images = [axes + np.array([i, j]) for i in (-1, 0, 1) for j in (-1, 0, 1)]
    for number, place in enumerate(axes):
        for image in images:
            distance = np.hypot(*(image - place).T)
            others = np.delete(distance, number) if image is images[4] else distance
            assert others.min() >= (2.0 + gap) * radius * (1.0 - 1e-12)


@pytest.mark.parametrize(("fraction", "fibres"), [(0.4, 6), (0.5, 10), (0.55, 12)])
def test_there_is_matrix_between_any_two_fibres(fraction: float, fibres: int) -> None:
    """Patches of fibre in the periodic grid, counted by flooding: as many as fibres, for any seed."""
    for seed in range(5):
        built = random_pack(fraction, fibres, seed)
        left = built.phase == 0
        patches = 0
        while left.any():
            patches += 1
            front = [tuple(np.argwhere(left)[0])]
            left[front[0]] = False
            while front:
                row, column = front.pop()
                for step in ((1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (1, -1), (-1, 1), (-1, -1)):
                    near = ((row + step[0]) % 64, (column + step[1]) % 64)
                    if left[near]:
                        left[near] = False
                        front.append(near)
        assert patches == fibres


def test_one_seed_gives_one_packing_and_another_gives_another() -> None:
    first, again, other = (random_pack(0.5, 8, seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first.phase, again.phase)
    np.testing.assert_array_equal(first.heights, again.heights)
    assert (first.phase != other.phase).any()


@pytest.mark.parametrize("fraction", [0.2, 0.55, 0.8])
def test_layouts_are_the_published_ones(fraction: float) -> None:
    """Sizes of the rim as NASA's Practical Micromechanics has them (cells 7 and 26), with the fibre's in its units."""
    seven = square_pack(7, fraction)
    unit = seven.heights[1]
    rim = (math.sqrt(13.0) * math.sqrt(fraction) - 4.0 * fraction) / fraction
    np.testing.assert_allclose(seven.heights / unit, [rim, 1, 1, 4, 1, 1, rim], rtol=1e-12)
    assert (seven.phase == 0).sum() == 1 + 3 + 5 + 3 + 1
    assert seven.phase[1].tolist() == [1, 1, 1, 0, 1, 1, 1] and seven.phase[3].tolist() == [1, 0, 0, 0, 0, 0, 1]
    large = square_pack(26, fraction)
    half = [math.sqrt(3838.0 / fraction) - 69.0, 2, 3, 4, 3, 4, 5, 5, 4, 6, 9, 7, 17]
    np.testing.assert_allclose(large.heights / large.heights[1] * 2.0, [*half, *half[::-1]], rtol=1e-12)
    assert [(row == 0).sum() for row in large.phase[:13]] == [0, *range(2, 26, 2)]


def test_stair_steps_follow_a_circle_of_the_same_area() -> None:
    built = square_pack(26, 0.6)
    edges = np.cumsum(built.heights) - 0.5 * built.heights.sum()
    middle = edges - 0.5 * built.heights
    distance = np.hypot(middle[:, None], middle) / built.heights.sum()
    radius = math.sqrt(0.6 / math.pi)
    wrong = (distance < radius) != (built.phase == 0)
    areas = np.outer(built.heights, built.heights) / built.heights.sum() ** 2
    assert areas[wrong].sum() < 0.03


def test_hexagonal_packing_is_isotropic_across_the_fibre() -> None:
    """By finite elements on the grid; what the steps of the outline leave falls with finer grids."""
    epoxy, glass = isotropic_stiffness(4.2e9, 0.34), isotropic_stiffness(74e9, 0.2)
    apart = []
    for columns in (16, 26):
        built = hexagonal_pack(0.6, columns)
        stiffness = np.ascontiguousarray(np.array([glass, epoxy])[built.phase.reshape(-1)])
        effective = homogenise(built.heights, built.widths, stiffness, np.zeros((built.phase.size, 6))).stiffness
        of = engineering_constants(effective)
        apart.append(max(abs(of.E22 / of.E33 - 1.0), abs(of.G12 / of.G13 - 1.0)))
        assert coupling(effective) < 1e-9
    assert apart[1] < 0.01 and apart[1] < 0.2 * apart[0]


def test_two_by_two_and_layers_and_void() -> None:
    two = square_pack(2, 0.36, size=1.0)
    np.testing.assert_allclose(two.heights, [0.6, 0.4], rtol=1e-15)
    assert two.phase.tolist() == [[0, 1], [1, 1]]
    rows, columns = layered(0.3, 2, 1.0), layered(0.3, 3, 1.0)
    assert rows.phase.tolist() == [[0], [1]] and columns.phase.tolist() == [[0, 1]]
    np.testing.assert_allclose(rows.heights, [0.3, 0.7])
    np.testing.assert_allclose(columns.widths, [0.3, 0.7])
    void = square_void(0.25, 1.0)
    check(void, 0.25)
    assert void.phase.tolist() == [[1, 1, 1], [1, 0, 1], [1, 1, 1]]
    own = user_array([1.0, 3.0], [2.0], [[0], [2]])
    assert own.fraction(0) == 0.25 and own.fraction(2) == 0.75


@pytest.mark.parametrize(
    ("call", "field", "said"),
    [
        (lambda: square_pack(7, 0.9), "fraction", "below 0.8125"),
        (lambda: square_pack(26, 0.81), "fraction", "below 0.806133"),
        (lambda: square_pack(2, 0.0), "fraction", "greater than 0 and below 1"),
        (lambda: square_pack(2, math.nan), "fraction", "nan; it must be greater than 0"),
        (lambda: square_pack(3, 0.5), "subcells", "3; it must be 2, 7 or 26"),  # type: ignore[arg-type]
        (lambda: square_pack(7, 0.5, -1.0), "size", "finite and greater than 0"),
        (lambda: hexagonal_pack(0.91), "fraction", "below 0.9069"),
        (lambda: hexagonal_pack(0.5, 7), "columns", "must be even"),
        (lambda: random_pack(0.71, 5, 1), "fraction", "at most 0.7"),
        (lambda: random_pack(0.5, 0, 1), "fibres", "must be 1 to 200"),
        (lambda: random_pack(0.5, 5, -1), "seed", "0 or greater"),
        (lambda: random_pack(0.5, 5, 1, least_gap=0.5), "least_gap", "0 to 0.3"),
        (lambda: layered(0.5, 1), "along", "must be 2 or 3"),  # type: ignore[arg-type]
        (lambda: square_void(1.0), "fraction", "below 1"),
        (lambda: user_array([1.0], [1.0, math.inf], [[0, 0]]), "widths", "finite"),
    ],
)
def test_what_is_out_of_range_names_field_value_and_limits(call: object, field: str, said: str) -> None:
    with pytest.raises(OutOfRange) as caught:
        call()  # type: ignore[operator]
    assert caught.value.field == field and str(caught.value).startswith(f"{field} is ")
    assert said in str(caught.value)


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: hexagonal_pack(0.001, 8), "fraction 0.001 needs more than 14 x 8 subcells"),
        (lambda: random_pack(0.7, 2, 1, least_gap=0.3), "take another seed|does not fit"),
        (lambda: user_array([1.0, 1.0], [1.0], [[0]]), "phase has 1 rows; heights has 2"),
        (lambda: user_array([1.0], [1.0], [[0, 1]]), "phase.0 has 2 subcells; widths has 1"),
        (lambda: user_array([], [1.0], []), "heights is empty"),
    ],
)
def test_what_cannot_be_built_says_why(call: object, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        call()  # type: ignore[operator]
