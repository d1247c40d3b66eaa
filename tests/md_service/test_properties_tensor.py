"""Averages and constants of stiffness tensors, against closed forms and rotations."""

import numpy as np
import pytest

from md_service.elastic_tensor import VOIGT, engineering_constants, isotropic_average
from md_service.properties import mean_about_axis_1
from protocol.constituent import Constituent, Figure


def isotropic(young, poisson):
    scale = young / ((1 + poisson) * (1 - 2 * poisson))
    tensor = np.zeros((6, 6))
    tensor[:3, :3] = poisson * scale
    tensor[range(3), range(3)] = (1 - poisson) * scale
    tensor[range(3, 6), range(3, 6)] = 0.5 * young / (1 + poisson)
    return tensor


def plane_stress(young, poisson):
    return young / (1 - poisson**2) * np.array([[1, poisson, 0], [poisson, 1, 0], [0, 0, 0.5 * (1 - poisson)]])


def rotated(tensor, rotation):
    """Voigt tensor in turned axes, by way of all 81 components."""
    index = np.zeros((3, 3), dtype=int)
    for row, (i, j) in enumerate(VOIGT):
        index[i, j] = index[j, i] = row
    full = tensor[index[:, :, None, None], index[None, None, :, :]]
    full = np.einsum("ai,bj,ck,dl,ijkl->abcd", rotation, rotation, rotation, rotation, full)
    return np.array([[full[i, j, k, m] for k, m in VOIGT] for i, j in VOIGT])


def random_stiffness(seed):
    half = np.random.default_rng(seed).normal(size=(6, 6))
    return 1e10 * (half @ half.T + 6 * np.eye(6))


@pytest.mark.parametrize("make", [isotropic, plane_stress])
@pytest.mark.parametrize(("young", "poisson"), [(3e9, 0.36), (70e9, -0.2), (1e12, 0.0)])
def test_average_of_an_isotropic_tensor_is_that_material(make, young, poisson):
    average = isotropic_average(make(young, poisson))
    assert average.young == pytest.approx(young)
    assert average.poisson == pytest.approx(poisson, abs=1e-12)
    assert average.shear == pytest.approx(0.5 * young / (1 + poisson))
    dimensions = 3 if make is isotropic else 2
    expected = young / (3 * (1 - 2 * poisson)) if dimensions == 3 else young / (2 * (1 - poisson))
    assert average.bulk == pytest.approx(expected)
    assert abs(average.spread) < 1e-9 * young


def test_average_does_not_depend_on_the_axes():
    tensor = random_stiffness(3)
    rotation, _ = np.linalg.qr(np.random.default_rng(8).normal(size=(3, 3)))
    one, other = isotropic_average(tensor), isotropic_average(rotated(tensor, rotation))
    for name in ("young", "poisson", "bulk", "shear", "spread"):
        assert getattr(other, name) == pytest.approx(getattr(one, name), rel=1e-9)
    assert one.spread > 0.0  # Voigt lies above Reuss


def test_engineering_constants_invert_a_compliance_made_from_them():
    constants = {
        "E1": 150e9, "E2": 9e9, "E3": 11e9, "nu12": 0.3, "nu13": 0.28, "nu23": 0.45,
        "G23": 3e9, "G13": 4e9, "G12": 5e9,
    }  # fmt: skip
    material = Constituent(
        name="ply", source="test", temperature=Figure(300.0), density=Figure(1600.0), kind="orthotropic",
        elastic={name: Figure(value) for name, value in constants.items()},
    )  # fmt: skip
    assert engineering_constants(material.stiffness()) == pytest.approx(constants, rel=1e-12)


def test_mean_about_axis_1_is_the_mean_over_rotations():
    tensor = random_stiffness(11)
    mean = np.zeros((6, 6))
    count = 12  # a fourth-order tensor has harmonics up to four: any five angles or more are exact
    for angle in 2 * np.pi * np.arange(count) / count:
        c, s = np.cos(angle), np.sin(angle)
        mean += rotated(tensor, np.array([[1, 0, 0], [0, c, -s], [0, s, c]])) / count
    np.testing.assert_allclose(mean_about_axis_1(tensor), mean, atol=1e-9 * tensor.max())


def test_bad_tensors_are_refused():
    with pytest.raises(ValueError, match=r"shape \(2, 2\)"):
        isotropic_average(np.eye(2))
    with pytest.raises(ValueError, match="not finite"):
        isotropic_average(np.full((6, 6), np.nan))
    with pytest.raises(ValueError, match="singular"):
        isotropic_average(np.zeros((6, 6)))
