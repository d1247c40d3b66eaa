"""Increments that shrink where they must: far too large ones, the same answer as small ones, clear failure."""

from __future__ import annotations

import numpy as np
import pytest

from fem_service.cohesive_law import CohesiveLaw
from fem_service.equilibrium import NotConverged
from fem_service.increments import Steps, next_increment
from fem_service.verification.beams import curve, double_cantilever, split_beam

LAW = CohesiveLaw(1e15, 80e6, 100e6, 969.0, 1719.0, 2.284)


def test_one_increment_ends_where_twenty_end() -> None:
    beam = split_beam(40e-3, 32.9e-3, coarse=4e-3, fine=0.5e-3, ahead=5e-3)
    end = 4.9e-3
    ends = {}
    for size in (end / 20.0, end):
        problem = double_cantilever(beam, LAW)
        problem.viscosity = 2e-7
        states = curve(problem, beam.begin(problem), end, Steps(size, end / 1e5, size))
        ends[size] = states[-1]
        if size < end:
            peak = max(state.force for state in states)
            assert states[-1].force < 0.97 * peak  # the run is well past its peak
    small, large = ends.values()
    assert large.load == small.load == end
    assert large.residual <= 1e-6
    assert large.force == pytest.approx(small.force, rel=2e-3)
    assert beam.crack_length(large) == beam.crack_length(small) > 34e-3


def test_what_cannot_converge_says_where_and_what_to_change() -> None:
    beam = split_beam(48e-3, 32.9e-3, coarse=1e-3, fine=1e-3, ahead=4e-3)
    problem = double_cantilever(beam, LAW)
    problem.iterations = 1  # not even the elastic part
    tries: list[int] = []
    problem.watch = tries.append
    with pytest.raises(NotConverged, match=r"load 0\.0002.*least, 0\.0002: a smaller least increment, a finer"):
        next_increment(problem, beam.begin(problem), 1e-3, 5e-3, Steps(1e-3, 2e-4, 1e-3))
    assert len(tries) == 3  # 1, 0.5 and 0.25 mm


def test_increments_grow_where_it_is_easy_and_meet_the_end() -> None:
    beam = split_beam(48e-3, 32.9e-3, coarse=1e-3, fine=1e-3, ahead=4e-3)
    problem = double_cantilever(beam, LAW)
    states = curve(problem, beam.begin(problem), 1e-3, Steps(1e-4, 1e-5, 3e-4))
    sizes = np.diff([state.load for state in states])
    assert states[-1].load == 1e-3
    assert np.allclose(sizes[:3], [1e-4, 1.5e-4, 2.25e-4]) and sizes.max() <= 3e-4 * (1 + 1e-9)


def test_steps_out_of_order_are_named() -> None:
    with pytest.raises(ValueError, match="first is 1; it must lie between least, 2, and most, 3"):
        Steps(1.0, 2.0, 3.0)
