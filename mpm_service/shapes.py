"""Shape functions of one direction, in the form the compiled sweeps use.

Lengths in cells. Each kind of function is a type of its own; `shape_1d` compiles to the one of its argument.
It returns the first node it touches, the weights of that node and the next ones, and their slopes.

Linear, point at ``xi`` between nodes c and c+1: ``S = (1 - d, d)`` with ``d = xi - c``, but never quite zero.

Averaged over a domain ``xi - l ... xi + l`` (GIMP, ``l <= 1/2``), c the nearest node, d = xi - c::

        c-1            c            c+1
    -----o-------------o--+----------o-----
                       |--d    [  domain 2l  ]

Only these three nodes see the point. With ``a = min(max(d, -l), l)`` the hat function averaged over the domain
is, without a branch,

    S(c+1) = (l + a)^2 / 4l + max(d - l, 0),   S(c-1) = (l - a)^2 / 4l + max(-d - l, 0),
    S(c) = 1 - S(c-1) - S(c+1).

Quadratic B-spline, c and d as above: ``S = ((1/2 - d)^2 / 2, 3/4 - d^2, (1/2 + d)^2 / 2)``.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numba.extending import overload

from .scheme import Interpolation

#: Least weight [cells] that a linear function leaves the node beyond a point on a cell line: that node's velocity
#: enters the point's velocity gradient in full, so it must be some point's and not that of an empty node.
SLIVER = 1e-15


class LinearShape(NamedTuple):
    """Linear functions at the point."""

    nodes: int


class UniformShape(NamedTuple):
    """Linear functions averaged over a fixed domain of half length `half` [cells]."""

    half: float
    inverse_2l: float
    inverse_4l: float


class ConvectedShape(NamedTuple):
    """Linear functions averaged over a domain whose half length is `half` times the point's stretch [cells]."""

    half: float


class SplineShape(NamedTuple):
    """Quadratic B-splines."""

    nodes: int


Shape = LinearShape | UniformShape | ConvectedShape | SplineShape


def make_shape(interpolation: Interpolation, half: float) -> Shape:
    """Return the kernel form of a kind of function for points of half length `half` [cells]."""
    if interpolation == "linear":
        return LinearShape(2)
    if interpolation == "bspline":
        return SplineShape(3)
    if interpolation == "cpgimp":
        return ConvectedShape(half)
    return UniformShape(half, 0.5 / half, 0.25 / half)


def shape_1d(shape: Shape, xi: float, stretch: float) -> tuple[int, tuple[float, ...], tuple[float, ...]]:
    """First node, weights, and slopes [1/cell] at place `xi` [cells] for a point stretched by `stretch`."""
    raise NotImplementedError("for compiled code only")


@njit(inline="always")
def _average(xi: float, half: float, inverse_2l: float, inverse_4l: float) -> tuple[int, Any, Any]:
    centre = int(xi + 0.5)
    d = xi - centre
    a = min(max(d, -half), half)
    up = half + a
    down = half - a
    right = up * up * inverse_4l + max(d - half, 0.0)
    left = down * down * inverse_4l + max(-d - half, 0.0)
    slope_right = up * inverse_2l
    slope_left = -down * inverse_2l
    return (
        centre - 1,
        (left, 1.0 - left - right, right),
        (slope_left, -slope_left - slope_right, slope_right),
    )


def _linear(shape: Any, xi: float, stretch: float) -> tuple[int, Any, Any]:
    first = int(xi)
    d = max(xi - first, SLIVER)
    return first, (1.0 - d, d), (-1.0, 1.0)


def _uniform(shape: Any, xi: float, stretch: float) -> tuple[int, Any, Any]:
    return _average(xi, shape.half, shape.inverse_2l, shape.inverse_4l)


def _convected(shape: Any, xi: float, stretch: float) -> tuple[int, Any, Any]:
    half = min(shape.half * stretch, 0.5)  # wider ones are swept over stencils; sorting may lag behind a little
    inverse = 0.5 / half
    return _average(xi, half, inverse, 0.5 * inverse)


def _spline(shape: Any, xi: float, stretch: float) -> tuple[int, Any, Any]:
    centre = int(xi + 0.5)
    d = xi - centre
    up = 0.5 + d
    down = 0.5 - d
    return centre - 1, (0.5 * down * down, 0.75 - d * d, 0.5 * up * up), (-down, -2.0 * d, up)


_KERNELS: dict[type, Callable[[Any, float, float], tuple[int, Any, Any]]] = {
    LinearShape: _linear,
    UniformShape: _uniform,
    ConvectedShape: _convected,
    SplineShape: _spline,
}


@overload(shape_1d, inline="always")
def _choose(shape: Any, xi: float, stretch: float) -> Callable[[Any, float, float], tuple[int, Any, Any]] | None:
    return _KERNELS.get(getattr(shape, "instance_class", type(None)))


def row_stretches(shape: Shape, hxx: float, hxy: float, hyx: float, hyy: float) -> tuple[float, float]:
    """Stretch of a domain in x and y: norms of the rows of F where domains convect, else 1."""
    raise NotImplementedError("for compiled code only")


@overload(row_stretches, inline="always")
def _choose_stretches(shape: Any, hxx: float, hxy: float, hyx: float, hyy: float) -> Callable[..., tuple[float, float]]:
    if getattr(shape, "instance_class", None) is ConvectedShape:

        def follow(shape: Any, hxx: float, hxy: float, hyx: float, hyy: float) -> tuple[float, float]:
            return np.sqrt((1.0 + hxx) ** 2 + hxy * hxy), np.sqrt((1.0 + hyy) ** 2 + hyx * hyx)

        return follow

    def stay(shape: Any, hxx: float, hxy: float, hyx: float, hyy: float) -> tuple[float, float]:
        return 1.0, 1.0

    return stay
