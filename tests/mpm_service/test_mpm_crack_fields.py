"""Which velocity field material uses at a node near cracks: hand cases, exact arithmetic, moved bodies."""

from fractions import Fraction
from itertools import pairwise

import numpy as np
import pytest

from mpm_service import Crack, CrackSet, Grid, HierarchicalGrid, SolverError
from mpm_service.crack_line import crosses_odd, nearest_on_line

GRID = Grid((-4.0, -4.0), 1.0, (20, 20))
TILTED = np.array([[-3.0, 3.3], [4.2, 3.3], [6.1, 7.2], [13.0, 7.2]])


def lattice(lower: float, upper: float, spacing: float = 0.5) -> np.ndarray:
    x = np.arange(lower + 0.5 * spacing, upper, spacing)
    return np.stack([a.ravel() for a in np.meshgrid(x, x)], axis=1)


def fields(cracks: CrackSet, place: np.ndarray, node: np.ndarray) -> np.ndarray:
    """Row that material at each place uses at each node (n, m)."""
    table = np.repeat(np.asarray(node, dtype=np.int64)[None, :], place.shape[0], axis=0)
    cracks.assign_fields_at(place, table, np.full(place.shape[0], table.shape[1]))
    return table


def node_at(x: float, y: float) -> int:
    return round(y + 4) * 21 + round(x + 4)


def exact_crossings(line: np.ndarray, p: np.ndarray, n: np.ndarray) -> int:
    """Crossings of p-n with a line in exact arithmetic; no place may lie on a line."""
    f = [[Fraction(float(v)) for v in place] for place in line]
    (px, py), (nx, ny) = ([Fraction(float(v)) for v in place] for place in (p, n))
    count = 0
    for (ax, ay), (bx, by) in pairwise(f):
        across = (nx - px) * (by - ay) - (ny - py) * (bx - ax)
        if across != 0:
            t = ((ax - px) * (by - ay) - (ay - py) * (bx - ax)) / across
            u = ((ax - px) * (ny - py) - (ay - py) * (nx - px)) / across
            count += 0 < t < 1 and 0 < u < 1
    return count


def test_crossing_rule() -> None:
    # point above at x = 2, node below at x = 4, equal distances: they meet the line y = 0 at x = 3
    line = np.array([[0.0, 0.0], [3.5, 0.0]])
    assert crosses_odd(line, 0, 1, 2.0, 0.5, 4.0, -0.5)
    assert not crosses_odd(np.array([[0.0, 0.0], [2.9, 0.0]]), 0, 1, 2.0, 0.5, 4.0, -0.5)
    assert not crosses_odd(line, 0, 1, 2.0, 0.5, 4.0, 0.5)
    assert not crosses_odd(line, 0, 1, -1.0, 0.5, 0.5, -0.5)
    # in and out again through a corner; straight through the corner itself
    corner = np.array([[0.0, 0.0], [1.0, 1.0], [2.0, 0.0]])
    assert not crosses_odd(corner, 0, 2, 0.0, 0.5, 2.0, 0.5)
    assert crosses_odd(corner, 0, 2, 1.0, 0.0, 1.0, 2.0)
    assert not crosses_odd(corner, 0, 2, 0.0, 1.0, 2.0, 1.0)


def test_crossings_agree_with_exact_arithmetic() -> None:
    random = np.random.default_rng(5)
    odd = 0
    for _ in range(400):
        line = random.uniform(0.0, 4.0, (random.integers(2, 7), 2))
        p, n = random.uniform(0.0, 4.0, (2, 2))
        expected = exact_crossings(line, p, n) % 2 == 1
        assert crosses_odd(line, 0, line.shape[0] - 1, *p, *n) == expected
        odd += expected
    assert 100 < odd < 300


@pytest.mark.parametrize("direction", [1, -1])
def test_node_on_the_line_counts_as_left_and_node_at_the_tip_as_ahead(direction: int) -> None:
    ends = ((-3.0, 5.0), (6.0, 5.0)) if direction > 0 else ((13.0, 5.0), (4.0, 5.0))
    cracks = CrackSet([Crack(ends)], GRID, lattice(0.0, 10.0))
    cracks.follow()
    on_line, at_tip = node_at(5.0, 5.0), node_at(ends[1][0], 5.0)
    above, below = np.array([[5.25, 5.25]]), np.array([[4.75, 4.75]])
    left, right = (above, below) if direction > 0 else (below, above)
    assert fields(cracks, left, [on_line])[0, 0] == on_line
    assert fields(cracks, right, [on_line])[0, 0] >= GRID.node_count
    # A way that passes the tip counts by the place a third of the way on: 0.25 cells short of the tip is half.
    for along, far in ((-0.35, False), (-0.40, True)):
        crossing = np.array([[ends[1][0] + along * direction, 5.0 - 0.25 * direction]])
        assert (fields(cracks, crossing, [at_tip])[0, 0] != at_tip) == far
    (tip,) = cracks.tips
    assert (tip.end, tip.length) == (1, pytest.approx(9.0))
    np.testing.assert_allclose(tip.direction, [direction, 0.0], atol=1e-12)


@pytest.mark.parametrize("offset", [(0.0, 0.0), (0.5, 0.5), (0.3, -0.2)])
def test_t_of_two_cracks_has_three_fields(offset: tuple) -> None:
    x, y = 5.0 + offset[0], 5.0 + offset[1]
    place = lattice(0.0, 10.0)
    cracks = CrackSet([Crack(((-3.0, y), (13.0, y))), Crack(((x, y), (x, -3.0)))], GRID, place)
    assert cracks.tips == [] and cracks.field_map.extra == 2
    cracks.follow()
    region = np.where(place[:, 1] > y, 0, np.where(place[:, 0] < x, 1, 2))
    material: dict[int, set[int]] = {}
    held: dict[int, set[int]] = {}
    for node, at in enumerate(GRID.node_positions()):
        seen = np.flatnonzero(np.all(np.abs(place - at) < 1.5, axis=1))
        for row, part in zip(fields(cracks, place[seen], [node])[:, 0], region[seen], strict=True):
            material.setdefault(int(row), set()).add(int(part))
            held.setdefault(node, set()).add(int(row))
    assert all(len(parts) == 1 for parts in material.values())
    assert len(held[node_at(x, y)]) == 3
    assert set(material) - set(range(GRID.node_count)) <= set(cracks.extra_rows.tolist())


def test_tip_just_before_another_crack_needs_no_fourth_field() -> None:
    place = lattice(0.0, 10.0)
    cracks = CrackSet([Crack(((-3.0, 5.3), (13.0, 5.3))), Crack(((5.1, -3.0), (5.1, 4.6)))], GRID, place)
    assert [(tip.crack, tip.end) for tip in cracks.tips] == [(1, 1)]
    cracks.follow()
    for node, at in enumerate(GRID.node_positions()):
        seen = np.flatnonzero(np.all(np.abs(place - at) < 1.5, axis=1))
        rows = fields(cracks, place[seen], [node])[:, 0]
        across = (place[seen, 1] > 5.3) != (at[1] >= 5.3)
        assert not set(rows[across]) & set(rows[~across])


def test_four_parts_at_a_node_are_refused() -> None:
    place = lattice(0.0, 10.0)
    cracks = CrackSet([Crack(((-3.0, 5.3), (13.0, 5.3))), Crack(((5.1, -3.0), (5.1, 13.0)))], GRID, place)
    cracks.follow()
    around = np.array([[5.0, 5.2], [5.2, 5.2], [5.0, 5.4]])
    assert len(set(fields(cracks, around, [node_at(5.0, 5.0)])[:, 0])) == 3
    with pytest.raises(SolverError, match=rf"node {node_at(5.0, 5.0)} at \(5, 5\) m: cracks 0, 1"):
        fields(cracks, np.array([[5.2, 5.4]]), [node_at(5.0, 5.0)])


def test_two_cracks_that_end_at_one_place_are_refused() -> None:
    with pytest.raises(ValueError, match="cracks 0 and 1: both end"):
        CrackSet([Crack(((0.0, 5.0), (5.0, 5.0))), Crack(((5.0, 5.0), (5.0, 9.0)))], GRID, lattice(0.0, 10.0))


@pytest.mark.parametrize("angle", [0.4, np.pi / 2, 2.5])
def test_fields_turn_with_the_body(angle: float) -> None:
    """A rigid motion maps each node to one place of the reference body: the rule must be that place's rule there."""
    place = lattice(0.0, 10.0)
    line = np.array([[-3.0, 3.3], [3.7, 3.3], [5.2, 6.4]])
    cracks = CrackSet([Crack(line)], GRID, place)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    shift = np.array([0.31, -0.17])
    moved = (place - 5.0) @ turn.T + 5.0 + shift
    cracks.move(np.ascontiguousarray(moved), np.arange(place.shape[0]))
    cracks.follow()
    compared = far = 0
    for node, at in enumerate(GRID.node_positions()):
        seen = np.flatnonzero(np.all(np.abs(moved - at) < 1.5, axis=1))
        back = (at - shift - 5.0) @ turn + 5.0
        for p, row in zip(seen, fields(cracks, place[seen], [node])[:, 0], strict=True):
            if np.hypot(*(place[p] - line[-1])) < 2.0:
                continue  # past the tip a way counts by a share
            expected = exact_crossings(line, place[p], back) % 2 == 1
            assert (row != node) == expected
            compared += 1
            far += expected
    assert compared > 2000 and far > 100
    _, opening = cracks.opening()
    assert np.abs(opening).max() < 1e-12
    (tip,) = cracks.tips
    np.testing.assert_allclose(tip.position, (line[-1] - 5.0) @ turn.T + 5.0 + shift, atol=1e-12)
    np.testing.assert_allclose(tip.direction, turn @ tip.reference_direction, atol=1e-12)


def test_faces_follow_any_affine_motion_of_either_side() -> None:
    place = lattice(0.0, 10.0)
    cracks = CrackSet([Crack(TILTED)], GRID, place)
    left = np.array([side_of(TILTED, p) > 0 for p in place])
    gradient = np.array([[0.1, -0.4], [0.2, 0.05]])
    moved = place + np.where(left[:, None], place @ gradient.T + (0.3, 0.9), 0.0)
    cracks.move(np.ascontiguousarray(moved), np.arange(place.shape[0]))
    reference, upper, lower = cracks.faces(0)
    inside = np.all((reference > 0.0) & (reference < 10.0), axis=1)
    assert inside.sum() > 20
    np.testing.assert_allclose((upper - reference)[inside], reference[inside] @ gradient.T + (0.3, 0.9), atol=1e-12)
    np.testing.assert_allclose((lower - reference)[inside], 0.0, atol=1e-12)


def side_of(line: np.ndarray, place: np.ndarray) -> float:
    g, t, _, tx, ty = nearest_on_line(line, 0, line.shape[0] - 1, *place)
    away = place - line[g] - t * (line[g + 1] - line[g])
    return float(tx * away[1] - ty * away[0])


def test_special_points_are_all_that_may_need_a_field_before_they_move_a_cell() -> None:
    grid = HierarchicalGrid(GRID, [((2.0, 2.0), (10.0, 10.0))])
    place = lattice(0.0, 14.0, 0.25)
    cracks = CrackSet([Crack(((-3.0, 4.1), (5.2, 6.3)))], grid, place)
    mask = np.zeros(grid.node_count, dtype=np.uint8)
    cracks.mark_special(mask)
    cracks.follow()
    fine = grid.grids[1]
    node = grid.first_rows[1] + np.arange(fine.node_count)
    at = fine.node_positions()
    crossing = 0
    for p in place[np.all((place > 4.0) & (place < 8.0), axis=1)]:
        used = node[np.all(np.abs(at - p) < 1.5 * fine.cell_size, axis=1)]
        if np.any(fields(cracks, p[None], used)[0] != used):
            crossing += 1
            # up to a cell away at the last sort
            for way in ((0.49, 0.0), (-0.49, 0.0), (0.0, 0.49), (0.0, -0.49)):
                nearest = np.rint((p + way - fine.lower) / fine.cell_size).astype(int)
                assert mask[grid.first_rows[1] + nearest[1] * (fine.cells[0] + 1) + nearest[0]]
    assert crossing > 20
    assert 0.02 < mask.mean() < 0.5


def test_no_crack_costs_nothing() -> None:
    cracks = CrackSet([], GRID, lattice(0.0, 10.0))
    assert not cracks and cracks.row_count == GRID.node_count and cracks.extra_rows.size == 0
    assert cracks.field_map.near.size == 0 and cracks.tips == [] and not cracks.changed and cracks.state() == {}


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"points": ((0.0, 0.0), (0.0, 0.0))}, "coincide"),
        ({"points": ((0.0, 0.0), (np.nan, 1.0))}, "finite"),
        ({"points": ((0.0, 0.0),)}, "at least two"),
        ({"points": ((0.0, 0.0), (1.0,))}, "at least two"),
        ({"points": ((0.0, 0.0), (2.0, 0.0), (1.0, 0.0))}, "straight back"),
        ({"points": ((0.0, 0.0), (2.0, 0.0), (2.0, 1.0), (1.0, -1.0))}, "meet each other"),
        ({"points": ((0.0, 0.0), (1.0, 0.0)), "contact": "glue"}, "contact"),
        ({"points": ((0.0, 0.0), (1.0, 0.0)), "contact": "coulomb", "friction": -0.1}, "friction"),
        ({"points": ((0.0, 0.0), (1.0, 0.0)), "friction": 0.3}, "friction"),
    ],
)
def test_a_bad_crack_is_refused(arguments: dict, message: str) -> None:
    with pytest.raises(ValueError, match=rf"^Crack\.points.*{message}|^Crack\.{message}"):
        Crack(**arguments)
