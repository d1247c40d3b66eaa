"""Solutions with factors of the same and of other matrices."""

from __future__ import annotations

import importlib.util

import numpy as np
import pytest
import scipy.sparse

from fem_service.factorisation import Factoriser, Pardiso, SuperLU
from fem_service.sparse_solution import HeldSystem

FACTORISERS = [SuperLU]
if importlib.util.find_spec("pypardiso") is not None:
    FACTORISERS.append(Pardiso)
SIZE = 400
HELD = np.array([0, SIZE - 1], dtype=np.int64)


def chain(weak: int = 0, left: float = 1e-3) -> scipy.sparse.csc_matrix:
    """Springs in a row, a little unsymmetric; `weak` of them, spread over the row, keep a part of their stiffness."""
    springs = np.ones(SIZE - 1)
    springs[np.linspace(10, SIZE - 20, weak).astype(int)] = left
    return of_springs(springs)


def of_springs(springs: np.ndarray) -> scipy.sparse.csc_matrix:
    main = np.zeros(SIZE)
    main[:-1] += springs
    main[1:] += springs
    return scipy.sparse.diags([-springs, main, -1.001 * springs], [-1, 0, 1], format="csc")


def right() -> np.ndarray:
    return np.random.default_rng(5).normal(size=SIZE)


@pytest.mark.parametrize("factoriser", FACTORISERS)
@pytest.mark.parametrize("weak", [0, 1, 3, 200])
def test_a_solution_is_that_of_a_dense_solver_whatever_was_factorised_before(
    factoriser: type[Factoriser], weak: int
) -> None:
    system = HeldSystem(SIZE, HELD, factoriser())
    system.solve(chain(), right())
    matrix = chain(weak)
    found = system.solve(matrix, right())
    dense = matrix.toarray()[1:-1, 1:-1]
    np.testing.assert_allclose(dense @ found[1:-1], right()[1:-1], atol=1e-8)
    np.testing.assert_allclose(found[1:-1], np.linalg.solve(dense, right()[1:-1]), rtol=1e-6, atol=1e-6)
    assert found[0] == found[-1] == 0.0


def test_factors_serve_a_matrix_that_differs_at_few_places_and_no_other() -> None:
    system = HeldSystem(SIZE, HELD)
    for weak, factorisations, reused in ((0, 1, 0), (1, 1, 1), (3, 1, 2), (0, 1, 2), (200, 2, 2), (200, 2, 2)):
        system.solve(chain(weak), right())
        assert (system.factorisations, system.reused) == (factorisations, reused)


@pytest.mark.parametrize("factoriser", FACTORISERS)
def test_what_follows_a_beginning_does_not_depend_on_what_went_before(factoriser: type[Factoriser]) -> None:
    fresh, used = HeldSystem(SIZE, HELD, factoriser()), HeldSystem(SIZE, HELD, factoriser())
    for weak in (0, 2):
        used.solve(chain(weak), right())
    for system in (fresh, used):
        system.begin()
    for weak in (3, 4):
        np.testing.assert_array_equal(used.solve(chain(weak), right()), fresh.solve(chain(weak), right()))


@pytest.mark.parametrize("factoriser", FACTORISERS)
def test_what_can_move_without_force_is_told(factoriser: type[Factoriser]) -> None:
    springs = np.ones(SIZE - 1)
    springs[[100, 101]] = 0.0
    with pytest.raises(ValueError, match="singular"):
        HeldSystem(SIZE, HELD, factoriser()).solve(of_springs(springs), right())
