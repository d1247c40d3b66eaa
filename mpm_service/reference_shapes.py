"""Shape functions of the reference solver: plain numpy, for points anywhere in a uniform grid.

Every kind is a product of one-dimensional functions, worked out node by node from its definition: the hat function
at the point, its exact average over the point's domain, or the quadratic B-spline.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .scheme import Interpolation
from .shapes import SLIVER

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


def shape_functions(
    xi: FloatArray, half: FloatArray, interpolation: Interpolation, nodes: tuple[int, ...]
) -> tuple[IntArray, FloatArray, FloatArray]:
    """Nodes, weights and slopes of points in a uniform grid.

    Parameters
    ----------
    xi : (n, d) ndarray
        Places of the points [cells from the lowest node].
    half : (n, d) ndarray
        Half sides of their domains [cells]; read by the averaged kinds alone.
    interpolation : {"linear", "ugimp", "cpgimp", "bspline"}
    nodes : (d,) tuple of int
        Nodes in each direction.

    Returns
    -------
    row : (n, k) ndarray of int
        Grid nodes, x fastest; weights of nodes outside the grid are left out.
    weight : (n, k) ndarray
        Values of their functions.
    slope : (d, n, k) ndarray
        Their derivatives [1/cell].
    """
    count, dimension = xi.shape
    row = np.zeros((count, 1), dtype=np.int64)
    weight = np.ones((count, 1))
    slope = np.ones((dimension, count, 1))
    inside = np.ones((count, 1), dtype=bool)
    for axis in reversed(range(dimension)):
        node, value, derivative = _along(xi[:, axis], half[:, axis], interpolation)
        inside = _product(inside, (node >= 0) & (node < nodes[axis]))
        lines = np.tile(np.clip(node, 0, nodes[axis] - 1), (1, row.shape[1]))
        row = np.repeat(row * nodes[axis], node.shape[1], axis=1) + lines
        weight = _product(weight, value)
        slope = np.stack([_product(slope[b], derivative if b == axis else value) for b in range(dimension)])
    return row, np.where(inside, weight, 0.0), np.where(inside, slope, 0.0)


def _product(outer: NDArray[Any], inner: NDArray[Any]) -> NDArray[Any]:
    """Products of each entry of a row with each of another, (n, a) and (n, b) to (n, a b)."""
    return (outer[:, :, None] * inner[:, None, :]).reshape(outer.shape[0], outer.shape[1] * inner.shape[1])


def _along(xi: FloatArray, half: FloatArray, interpolation: Interpolation) -> tuple[IntArray, FloatArray, FloatArray]:
    """Nodes, values and slopes along one direction, (n, k) each."""
    if interpolation == "linear":
        first = np.floor(xi)
        node = first.astype(np.int64)[:, None] + np.arange(2)
        beyond = np.maximum(xi - first, SLIVER)[:, None]
        return node, np.hstack([1.0 - beyond, beyond]), np.broadcast_to(np.array([-1.0, 1.0]), node.shape)
    if interpolation == "bspline":
        node = np.floor(xi + 0.5).astype(np.int64)[:, None] + np.arange(-1, 2)
        offset = xi[:, None] - node
        near = np.abs(offset) <= 0.5
        tail = np.maximum(1.5 - np.abs(offset), 0.0)
        value = np.where(near, 0.75 - offset**2, 0.5 * tail**2)
        return node, value, np.where(near, -2.0 * offset, -np.sign(offset) * tail)
    first = np.floor(xi - half).astype(np.int64)
    reach = int(np.max(np.floor(xi + half).astype(np.int64) - first, initial=0)) + 2
    node = first[:, None] + np.arange(reach)
    offset = xi[:, None] - node
    low, high = offset - half[:, None], offset + half[:, None]
    length = 2.0 * half[:, None]
    return node, _hat_integral(low, high) / length, (_hat(high) - _hat(low)) / length


def _hat(offset: FloatArray) -> FloatArray:
    return np.maximum(1.0 - np.abs(offset), 0.0)


def _hat_integral(low: FloatArray, high: FloatArray) -> FloatArray:
    """Integral of the hat function from `low` to `high`: two trapezoids, so a sliver keeps all its digits."""
    a, b = np.clip(low, -1.0, 0.0), np.clip(high, -1.0, 0.0)
    rising = 0.5 * (b - a) * ((1.0 + a) + (1.0 + b))
    a, b = np.clip(low, 0.0, 1.0), np.clip(high, 0.0, 1.0)
    return rising + 0.5 * (b - a) * ((1.0 - a) + (1.0 - b))
