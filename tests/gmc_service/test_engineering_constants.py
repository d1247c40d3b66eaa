"""Engineering constants against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gmc_service.engineering_constants import EngineeringConstants, coupling, engineering_constants
from gmc_service.material import isotropic_stiffness

MODULUS = st.floats(1e6, 1e12)
RATIO = st.floats(-0.3, 0.3)


@given(MODULUS, st.floats(-0.9, 0.49))
def test_isotropic_stiffness_gives_back_its_constants(young: float, poisson: float) -> None:
    of = engineering_constants(isotropic_stiffness(young, poisson))
    np.testing.assert_allclose([of.E11, of.E22, of.E33], young, rtol=1e-11)
    np.testing.assert_allclose([of.nu12, of.nu13, of.nu23], poisson, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose([of.G12, of.G13, of.G23], 0.5 * young / (1.0 + poisson), rtol=1e-12)


@given(st.tuples(*[MODULUS] * 3), st.tuples(*[RATIO] * 3), st.tuples(*[MODULUS] * 3))
def test_orthotropic_constants_go_both_ways(
    young: tuple[float, ...], ratio: tuple[float, ...], shear: tuple[float, ...]
) -> None:
    # nu_ij = r_ij sqrt(E_i / E_j) keeps the compliance positive definite for |r| <= 0.3 and any moduli.
    nu12, nu13, nu23 = (
        value * (young[i] / young[j]) ** 0.5 for value, (i, j) in zip(ratio, ((0, 1), (0, 2), (1, 2)), strict=True)
    )
    given_constants = EngineeringConstants(*young, nu12, nu13, nu23, *shear)
    stiffness = given_constants.stiffness()
    assert np.linalg.eigvalsh(stiffness / np.sqrt(np.outer(np.diag(stiffness), np.diag(stiffness))))[0] > 0.0
    of = engineering_constants(stiffness)
    for name in EngineeringConstants.__dataclass_fields__:
        expected = getattr(given_constants, name)
        scale = (
            1.0 if name[0] != "n" else max(abs(expected), (young[int(name[2]) - 1] / young[int(name[3]) - 1]) ** 0.5)
        )
        assert getattr(of, name) == pytest.approx(expected, rel=1e-9, abs=1e-9 * scale)
    assert coupling(stiffness) == 0.0


def test_uniaxial_tests_on_the_stiffness_itself() -> None:
    """Pull along each axis, and shear: the constants say what the strains are."""
    given_constants = EngineeringConstants(160e9, 9e9, 8e9, 0.3, 0.28, 0.45, 5e9, 4.5e9, 3e9)
    stiffness = given_constants.stiffness()
    pull = np.linalg.solve(stiffness, [1e6, 0, 0, 0, 0, 0])
    assert pull[0] == pytest.approx(1e6 / 160e9) and pull[1] == pytest.approx(-0.3 * 1e6 / 160e9)
    assert pull[2] == pytest.approx(-0.28 * 1e6 / 160e9)
    # Order of components: 3 is the shear 23, 4 is 13, 5 is 12.
    for place, modulus in ((3, 3e9), (4, 4.5e9), (5, 5e9)):
        assert np.linalg.solve(stiffness, np.eye(6)[place] * 1e6)[place] == pytest.approx(1e6 / modulus)


def test_coupling_is_seen() -> None:
    stiffness = isotropic_stiffness(1e9, 0.3)
    stiffness[1, 3] = stiffness[3, 1] = 0.1 * np.sqrt(stiffness[1, 1] * stiffness[3, 3])
    assert coupling(stiffness) == pytest.approx(0.1)


def test_singular_stiffness_is_refused() -> None:
    with pytest.raises(ValueError, match="the stiffness is singular"):
        engineering_constants(np.ones((6, 6)))
