"""Shape functions of Eq 78 and weighted least squares fits."""

import numpy as np
import pytest

from md_service.nine_node import GAUSS_POINTS, GAUSS_WEIGHTS, NODES, shape_functions, shape_gradients
from md_service.weighted_fit import Slit, fit


def test_shape_functions_are_one_at_their_own_node_and_zero_at_the_others() -> None:
    np.testing.assert_allclose(shape_functions(*NODES.T), np.eye(9), atol=1e-15)


@pytest.mark.parametrize(
    ("xi", "eta", "by_hand"),
    [
        # Eq 78, with N8 as -1/2 xi (1 - xi) (1 - eta) (1 + eta), worked out on paper.
        (0.5, 0.5, [1 / 64, -3 / 64, 9 / 64, -3 / 64, -6 / 64, 18 / 64, 18 / 64, -6 / 64, 36 / 64]),
        (0.5, 0.0, [0.0, 0.0, 0.0, 0.0, 0.0, 3 / 8, 0.0, -1 / 8, 3 / 4]),
        (-0.5, 0.0, [0.0, 0.0, 0.0, 0.0, 0.0, -1 / 8, 0.0, 3 / 8, 3 / 4]),
        (0.0, -0.5, [0.0, 0.0, 0.0, 0.0, 3 / 8, 0.0, -1 / 8, 0.0, 3 / 4]),
    ],
)
def test_shape_functions_have_the_values_found_by_hand(xi: float, eta: float, by_hand: list[float]) -> None:
    np.testing.assert_allclose(shape_functions(xi, eta), by_hand, atol=1e-15)


def test_shape_functions_carry_every_biquadratic_field_exactly() -> None:
    rng = np.random.default_rng(1)
    xi, eta = rng.uniform(-1.0, 1.0, (2, 20))
    coefficient = rng.normal(size=(3, 3))

    def field(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return np.polynomial.polynomial.polyval2d(x, y, coefficient)

    at_nodes = field(*NODES.T)
    np.testing.assert_allclose(shape_functions(xi, eta) @ at_nodes, field(xi, eta), rtol=1e-13, atol=1e-13)
    by_xi = np.polynomial.polynomial.polyval2d(xi, eta, np.polynomial.polynomial.polyder(coefficient, axis=0))
    by_eta = np.polynomial.polynomial.polyval2d(xi, eta, np.polynomial.polynomial.polyder(coefficient, axis=1))
    gradient = np.einsum("gnx,n->gx", shape_gradients(xi, eta), at_nodes)
    np.testing.assert_allclose(gradient, np.column_stack([by_xi, by_eta]), rtol=1e-12, atol=1e-12)


def test_shape_functions_are_a_partition_of_unity() -> None:
    xi, eta = np.random.default_rng(2).uniform(-1.0, 1.0, (2, 50))
    np.testing.assert_allclose(shape_functions(xi, eta).sum(axis=-1), 1.0, rtol=1e-14)
    np.testing.assert_allclose(shape_gradients(xi, eta).sum(axis=-2), 0.0, atol=1e-14)


def test_gauss_points_integrate_up_to_degree_five() -> None:
    for degree in range(6):
        exact = (1.0 - (-1.0) ** (degree + 1)) / (degree + 1)
        assert GAUSS_WEIGHTS @ GAUSS_POINTS**degree == pytest.approx(exact, abs=1e-15)


def scattered(seed: int, count: int = 400) -> np.ndarray:
    """Random places in a square of 20 angstrom, as of a glass."""
    return np.random.default_rng(seed).uniform(-10e-10, 10e-10, (count, 2))


def test_fit_returns_a_quadratic_field_and_its_gradient_whatever_the_places() -> None:
    atoms = scattered(3)
    points = np.array([[0.0, 0.0], [3e-10, -2e-10], [-9.5e-10, 9.5e-10]])
    c = np.array([0.3, -1.2e9, 0.7e9, 2e17, -3e17, 1e18])

    def field(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return c[0] + c[1] * x + c[2] * y + c[3] * x * x + c[4] * x * y + c[5] * y * y

    made = fit(points, atoms, 2e-10)
    x, y = points.T
    values = field(*atoms.T)
    np.testing.assert_allclose(made.value @ values, field(x, y), rtol=1e-10)
    np.testing.assert_allclose(made.by_x @ values, c[1] + 2.0 * c[3] * x + c[4] * y, rtol=1e-9)
    np.testing.assert_allclose(made.by_y @ values, c[2] + c[4] * x + 2.0 * c[5] * y, rtol=1e-9)


def test_fit_beside_a_crack_does_not_see_the_other_side() -> None:
    atoms = scattered(4)
    slit = Slit(tip_x=0.0, y=0.0)
    jump = np.where((atoms[:, 1] > 0.0) & (atoms[:, 0] < 0.0), 1.0, 0.0)
    points = np.array([[-5e-10, 1e-11], [-5e-10, -1e-11]])
    np.testing.assert_allclose(fit(points, atoms, 2e-10, slit).value @ jump, [1.0, 0.0], atol=1e-12)
    without_slit = fit(points, atoms, 2e-10).value @ jump
    assert (np.abs(without_slit - 0.5) < 0.3).all()


def test_slit_hides_by_line_of_sight() -> None:
    slit = Slit(tip_x=1.0, y=2.0)
    point = np.array([[0.0, 2.5]])
    others = np.array([[0.0, 1.5], [0.0, 3.0], [1.9, 1.5], [2.1, 1.5]])
    # The lines to the last two cross y = 2 at x = 0.95 and 1.05.
    np.testing.assert_array_equal(slit.hides(point, others), [True, False, True, False])


def test_fit_leaves_out_atoms() -> None:
    atoms = scattered(5)
    left_out = np.arange(0, 400, 7)
    made = fit(np.zeros((1, 2)), atoms, 2e-10, without=left_out)
    assert np.abs(made.value.toarray()[:, left_out]).max() == 0.0
    assert made.value.sum() == pytest.approx(1.0, rel=1e-12)


def test_fit_where_there_are_no_atoms_says_where() -> None:
    with pytest.raises(ValueError, match=r"the 0 atoms around the point \(5e-09, 0\) m do not suffice"):
        fit(np.array([[0.0, 0.0], [5e-9, 0.0]]), scattered(6), 2e-10)
    with pytest.raises(ValueError, match="width is 0"):
        fit(np.zeros((1, 2)), scattered(6), 0.0)
