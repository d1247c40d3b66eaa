"""Anchors and interface volume cells."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from coordinator.interface import Interface, build_interface
from coordinator.ring import rectangle_ring

A = 1e-10


def lattice(half_width: float, half_height: float, spacing: float = 1.3 * A) -> np.ndarray:
    """Return a square lattice of points that fills a rectangle, with z = 0."""
    x = np.linspace(-half_width, half_width, round(2 * half_width / spacing) + 1)
    y = np.linspace(-half_height, half_height, round(2 * half_height / spacing) + 1)
    grid = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
    return np.column_stack([grid, np.zeros(len(grid))])


def built(
    atoms: np.ndarray, inner: float, outer: float, ivc_size: float = 5 * A, crack_y: float | None = None
) -> Interface:
    half = np.array([outer, outer])
    ring = rectangle_ring(((-inner, -inner), (inner, inner)), -half, half, ["left", "right", "bottom", "top"])
    return build_interface(atoms, ring, ivc_size, crack_y)


def boxes_that_hold(interface: Interface, points: np.ndarray) -> np.ndarray:
    """Return for each point in how many cells it lies, cells half-open."""
    low = interface.ivc_lower[None, :, :2] <= points[:, None, :2]
    high = points[:, None, :2] < interface.ivc_upper[None, :, :2]
    return np.count_nonzero(np.all(low & high, axis=2), axis=1)


def area(interface: Interface) -> float:
    sides = interface.ivc_upper - interface.ivc_lower
    return float(np.sum(sides[:, 0] * sides[:, 1]))


@settings(max_examples=60, deadline=None)
@given(
    ring=st.integers(1, 4),
    core=st.integers(2, 9),
    ivc=st.floats(4.0, 12.0),
    crack=st.none() | st.floats(-0.99, 0.99),
)
def test_cells_tile_the_ring_and_every_anchor_is_in_exactly_one(
    ring: int, core: int, ivc: float, crack: float | None
) -> None:
    inner, outer = 5 * A * core, 5 * A * (core + ring)
    atoms = lattice(outer, outer)
    interface = built(atoms, inner, outer, ivc * A, None if crack is None else crack * inner)
    assert area(interface) == pytest.approx(4 * (outer**2 - inner**2), rel=1e-9)
    anchors = atoms[interface.anchor]
    inside = np.all(np.abs(anchors[:, :2]) < outer * (1 - 1e-12), axis=1)
    assert np.all(boxes_that_hold(interface, anchors[inside]) == 1)
    lower, upper = interface.ivc_lower[interface.anchor_ivc], interface.ivc_upper[interface.anchor_ivc]
    reach = 1e-12 * outer
    assert np.all((anchors >= lower - reach) & (anchors <= upper + reach))


def test_all_atoms_of_the_ring_are_anchored_and_none_inside() -> None:
    atoms = lattice(22 * A, 22 * A)
    interface = built(atoms, 12 * A, 22 * A)
    in_ring = np.any(np.abs(atoms[:, :2]) > 12 * A, axis=1)
    assert np.array_equal(interface.anchor, np.flatnonzero(in_ring))


def test_an_atom_on_the_inner_border_is_either_inside_or_in_a_cell_that_touches_it() -> None:
    inner = 10 * A
    corners = [(-inner, 0.0), (inner, 0.0), (0.0, -inner), (0.0, inner), (-inner, inner), (inner, -inner)]
    atoms = np.vstack([lattice(20 * A, 20 * A, 1.7 * A), [(x, y, 0.0) for x, y in corners]])
    interface = built(atoms, inner, 20 * A)
    assert interface.anchor_ivc.min() == 0
    assert interface.anchor_ivc.max() == len(interface.ivc_lower) - 1
    anchors = atoms[interface.anchor]
    lower, upper = interface.ivc_lower[interface.anchor_ivc], interface.ivc_upper[interface.anchor_ivc]
    reach = 1e-12 * inner
    assert np.all((anchors >= lower - reach) & (anchors <= upper + reach))


@pytest.mark.parametrize("crack_y", [0.0, 1.3 * A, -7.7 * A, 9.6 * A, -9.9 * A])
def test_no_cell_reaches_across_a_crack(crack_y: float) -> None:
    inner, outer = 10 * A, 20 * A
    # Dense, so that the thinnest cell has an atom and is kept.
    interface = built(lattice(outer, outer, 0.09 * A), inner, outer, crack_y=crack_y)
    low, high = interface.ivc_lower[:, 1], interface.ivc_upper[:, 1]
    assert np.all((high <= crack_y) | (low >= crack_y))
    assert np.any(high == crack_y) and np.any(low == crack_y)
    # The ring itself stays where it is, however near the crack runs to its border.
    assert area(interface) == pytest.approx(4 * (outer**2 - inner**2), rel=1e-9)


def test_cells_without_atoms_are_dropped_and_the_others_numbered_without_gaps() -> None:
    inner, outer = 10 * A, 20 * A
    atoms = lattice(outer, outer)
    whole = built(atoms, inner, outer)
    mouth = (atoms[:, 0] < -inner) & (np.abs(atoms[:, 1]) < 5 * A)
    cut = built(atoms[~mouth], inner, outer)
    assert len(cut.ivc_lower) == len(whole.ivc_lower) - 4  # two columns, two rows of 5 angstrom
    assert np.array_equal(np.unique(cut.anchor_ivc), np.arange(len(cut.ivc_lower)))
    removed = (whole.ivc_upper[:, 0] <= -inner) & (np.abs(whole.ivc_lower + whole.ivc_upper)[:, 1] < 10 * A)
    assert np.array_equal(whole.ivc_lower[~removed], cut.ivc_lower)


def test_cells_are_about_as_large_as_asked() -> None:
    interface = built(lattice(52.5 * A, 52.5 * A), 37.5 * A, 52.5 * A, 7.5 * A)
    sides = (interface.ivc_upper - interface.ivc_lower)[:, :2] / A
    assert sides == pytest.approx(np.full_like(sides, 7.5), rel=1e-9)
    assert len(sides) == 14**2 - 10**2
