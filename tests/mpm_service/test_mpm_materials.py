"""Materials against closed forms, their own energies, tensor algebra and an independent plastic integration."""

from __future__ import annotations

import textwrap
from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.linalg import expm, logm, sqrtm
from scipy.optimize import brentq

from mpm_service import material as contract
from mpm_service.material_points import columns
from mpm_service.materials import (
    Assumption,
    IsotropicElastic,
    J2Plasticity,
    Material,
    MaterialError,
    NeoHookean,
    OrthotropicElastic,
    displacement_gradient,
    kirchhoff_stress,
    set_kirchhoff_stress,
)
from mpm_service.spectral_decomposition import decompose

Array = NDArray[np.float64]
E, NU, RHO = 70.0e9, 0.3, 2700.0
MU, LAME, BULK = E / 2.6, E * NU / (1.3 * 0.4), E / 1.2
YIELD, HARD, VOCE, RATE = 200.0e6, 1.0e9, 100.0e6, 20.0
ORTHO = (140.0e9, 10.0e9, 12.0e9, 0.28, 0.3, 0.4, 5.0e9, 6.0e9, 3.5e9, 1600.0)
VOLUME = 2.5e-9
ASSUMPTIONS: tuple[Assumption, ...] = ("plane_strain", "plane_stress", "three_dimensional")

LAWS: dict[str, Callable[[Assumption], Material]] = {
    "isotropic": lambda a: IsotropicElastic(E, NU, RHO, a),
    "orthotropic": lambda a: OrthotropicElastic(*ORTHO, 0.4, a),
    "neo-hookean": lambda a: NeoHookean(E, NU, RHO, a),
    "j2": lambda a: J2Plasticity(E, NU, RHO, YIELD, HARD, VOCE, RATE, a),
}
LINEAR, FINITE = ("isotropic", "orthotropic"), ("neo-hookean", "j2")


class Points:
    """Points of one material, in an order that is not that of their ids."""

    def __init__(self, material: Material, count: int) -> None:
        self.material = material
        self.dim = 3 if material.assumption == "three_dimensional" else 2
        self.rows = np.zeros((count, columns(self.dim).width))
        self.rows[:, columns(self.dim).volume] = VOLUME
        self.ids = np.random.default_rng(count).permutation(count).astype(np.int64)
        self.history = material.start_history(count)

    def gradient(self, gradient: Array) -> None:
        displacement_gradient(self.rows, self.dim)[:] = gradient

    def stress(self, gradient: Array) -> Array:
        """Kirchhoff stress as (n, d, d) after an update."""
        self.gradient(gradient)
        self.material.update_stress(self.rows, self.ids, self.history)
        return tensor(kirchhoff_stress(self.rows, self.dim))

    def ask(self, name: str) -> Array:
        answer: Array = getattr(self.material, name)(self.rows, self.ids, self.history)
        return answer


def tensor(stress: Array) -> Array:
    order = [[0, 2], [2, 1]] if stress.shape[1] == 3 else [[0, 5, 4], [5, 1, 3], [4, 3, 2]]
    return stress[:, np.array(order)]


def stress_of(material: Material, gradient: Array) -> Array:
    return Points(material, len(gradient)).stress(gradient)


def random_gradients(count: int, dim: int, size: float, seed: int = 1) -> Array:
    return size * np.random.default_rng(seed).standard_normal((count, dim, dim))


def in_space(gradient: Array, stretch: Array | float = 1.0) -> Array:
    full = np.zeros((len(gradient), 3, 3))
    full[:, :2, :2] = gradient
    full[:, 2, 2] = np.asarray(stretch) - 1.0
    return full


def random_rotation(dim: int, seed: int) -> Array:
    turn, _ = np.linalg.qr(np.random.default_rng(seed).standard_normal((dim, dim)))
    turn[:, 0] *= np.linalg.det(turn)
    return np.asarray(turn)


def diagonal(*logarithms: Array) -> Array:
    """F - I of principal logarithmic strains, (n, d, d)."""
    full = np.zeros((len(logarithms[0]), len(logarithms), len(logarithms)))
    for i, strain in enumerate(logarithms):
        full[:, i, i] = np.expm1(strain)
    return full


# --- the plane assumptions against the same deformation in space -----------------------------------------------


@pytest.mark.parametrize("name", LAWS)
def test_plane_strain_is_space_without_thickness_strain(name: str) -> None:
    plane, space = Points(LAWS[name]("plane_strain"), 50), Points(LAWS[name]("three_dimensional"), 50)
    for step in range(1, 4):  # three steps, so that the plastic law builds on its own history
        gradient = random_gradients(50, 2, 0.02 * step)
        flat, full = plane.stress(gradient), space.stress(in_space(gradient))
        scale = np.abs(full).max()
        np.testing.assert_allclose(flat, full[:, :2, :2], rtol=0, atol=2e-12 * scale)
        np.testing.assert_allclose(full[:, :2, 2], 0.0, atol=1e-13 * scale)
        change = np.linalg.det(np.eye(2) + gradient)
        np.testing.assert_allclose(plane.ask("stress_zz") * change, full[:, 2, 2], rtol=0, atol=2e-12 * scale)
        np.testing.assert_allclose(plane.ask("strain_energy"), space.ask("strain_energy"), rtol=1e-11)
        np.testing.assert_allclose(plane.ask("dissipated"), space.ask("dissipated"), rtol=1e-11)
        np.testing.assert_array_equal(plane.ask("thickness_stretch"), 1.0)


@pytest.mark.parametrize("name", LAWS)
def test_plane_stress_is_space_with_its_thickness_stretch(name: str) -> None:
    plane, space = Points(LAWS[name]("plane_stress"), 50), Points(LAWS[name]("three_dimensional"), 50)
    for step in range(1, 4):
        gradient = random_gradients(50, 2, 0.02 * step)
        flat = plane.stress(gradient)
        full = space.stress(in_space(gradient, plane.ask("thickness_stretch")))
        scale = np.abs(full).max()
        np.testing.assert_allclose(full[:, 2, 2], 0.0, atol=1e-11 * scale)
        np.testing.assert_allclose(flat, full[:, :2, :2], rtol=0, atol=1e-11 * scale)
        np.testing.assert_allclose(plane.ask("strain_energy"), space.ask("strain_energy"), rtol=1e-10)
        np.testing.assert_allclose(plane.ask("dissipated"), space.ask("dissipated"), rtol=1e-10)
        np.testing.assert_array_equal(plane.ask("stress_zz"), 0.0)


# --- stress as the derivative of the energy, objectivity, small strain ------------------------------------------


def energy_slope(points: Points, gradient: Array, step: float = 1e-5) -> Array:
    """dW/dF per reference volume by central differences of fourth order, the history held."""
    slope = np.empty_like(gradient)
    for i in range(points.dim):
        for j in range(points.dim):
            total = np.zeros(len(gradient))
            for reach, share in ((1.0, 8.0), (2.0, -1.0)):
                for sign in (1.0, -1.0):
                    moved = gradient.copy()
                    moved[:, i, j] += sign * reach * step
                    points.gradient(moved)
                    total += sign * share * points.ask("strain_energy")
            slope[:, i, j] = total / (12.0 * step * VOLUME)
    points.gradient(gradient)
    return slope


@pytest.mark.parametrize("assumption", ASSUMPTIONS)
@pytest.mark.parametrize("name", FINITE)
def test_stress_is_the_slope_of_the_energy(name: str, assumption: Assumption) -> None:
    points = Points(LAWS[name](assumption), 20)
    gradient = random_gradients(20, points.dim, 0.1, 3)
    stress = points.stress(gradient)
    if name == "j2":
        assert np.all(points.history[:, -1] > 0.01)  # every point has yielded
    expected = energy_slope(points, gradient) @ (np.eye(points.dim) + gradient).transpose(0, 2, 1)
    np.testing.assert_allclose(stress, expected, rtol=0, atol=1e-8 * np.abs(stress).max())


@pytest.mark.parametrize("assumption", ASSUMPTIONS)
@pytest.mark.parametrize("name", LINEAR)
def test_linear_stress_over_volume_ratio_is_the_slope_of_the_energy(name: str, assumption: Assumption) -> None:
    points = Points(LAWS[name](assumption), 20)
    gradient = random_gradients(20, points.dim, 0.05, 4)
    stress = points.stress(gradient)
    ratio = np.linalg.det(np.eye(points.dim) + gradient) * points.ask("thickness_stretch")
    expected = energy_slope(points, gradient)
    np.testing.assert_allclose(stress / ratio[:, None, None], expected, rtol=0, atol=1e-9 * np.abs(stress).max())


@pytest.mark.parametrize("assumption", ASSUMPTIONS)
@pytest.mark.parametrize("name", FINITE)
def test_rotation_turns_the_stress(name: str, assumption: Assumption) -> None:
    still, turned = Points(LAWS[name](assumption), 20), Points(LAWS[name](assumption), 20)
    identity = np.eye(still.dim)
    for step in range(1, 4):
        turn = random_rotation(still.dim, step)  # another rotation at every step
        gradient = random_gradients(20, still.dim, 0.05 * step, step)
        stress = still.stress(gradient)
        found = turned.stress(turn @ (identity + gradient) - identity)
        np.testing.assert_allclose(found, turn @ stress @ turn.T, rtol=0, atol=1e-11 * np.abs(stress).max())
        np.testing.assert_allclose(turned.ask("strain_energy"), still.ask("strain_energy"), rtol=1e-10)


@pytest.mark.parametrize("assumption", ASSUMPTIONS)
@pytest.mark.parametrize("name", FINITE)
@pytest.mark.parametrize("size", [1e-12, 1e-9])
def test_small_strains_keep_every_digit(name: str, assumption: Assumption, size: float) -> None:
    law, linear = Points(LAWS[name](assumption), 30), Points(IsotropicElastic(E, NU, RHO, assumption), 30)
    gradient = random_gradients(30, law.dim, size, 5)
    expected = linear.stress(gradient)
    # 1 + H would leave 1e-4 of the digits at 1e-12; what differs here is the strain itself.
    bound = 20.0 * size + 1e-14
    np.testing.assert_allclose(law.stress(gradient), expected, rtol=0, atol=bound * np.abs(expected).max())
    # The rotation within H is of the size of the strain, so the energies differ by another such term.
    np.testing.assert_allclose(law.ask("strain_energy"), linear.ask("strain_energy"), rtol=50.0 * bound)


@pytest.mark.parametrize("assumption", ASSUMPTIONS)
@pytest.mark.parametrize("name", LAWS)
def test_no_deformation_no_stress(name: str, assumption: Assumption) -> None:
    points = Points(LAWS[name](assumption), 3)
    np.testing.assert_array_equal(points.stress(np.zeros((3, points.dim, points.dim))), 0.0)
    np.testing.assert_array_equal(points.ask("strain_energy"), 0.0)
    np.testing.assert_array_equal(points.ask("thickness_stretch"), 1.0)


# --- linear elasticity --------------------------------------------------------------------------------------------


def test_isotropic_closed_forms() -> None:
    gradient = np.array([[[1e-3, 4e-4], [0.0, -2e-4]]])
    xx, yy, xy = 1e-3, -2e-4, 2e-4
    ratio = 1.001 * 0.9998
    strain = stress_of(IsotropicElastic(E, NU, RHO, "plane_strain"), gradient)[0] / ratio
    trace = E * NU / ((1 + NU) * (1 - 2 * NU)) * (xx + yy)
    np.testing.assert_allclose(strain, [[trace + 2 * MU * xx, 2 * MU * xy], [2 * MU * xy, trace + 2 * MU * yy]])
    thin = 1.0 - NU / (1.0 - NU) * (xx + yy)
    stress = stress_of(IsotropicElastic(E, NU, RHO, "plane_stress"), gradient)[0] / (ratio * thin)
    factor = E / (1.0 - NU**2)
    np.testing.assert_allclose(
        stress, [[factor * (xx + NU * yy), 2 * MU * xy], [2 * MU * xy, factor * (yy + NU * xx)]], rtol=1e-14
    )


def compliance_tensor(constants: tuple[float, ...]) -> Array:
    """Orthotropic compliance as a tensor of fourth order in its own axes."""
    e1, e2, e3, n12, n13, n23, g12, g13, g23 = constants[:9]
    s = np.zeros((3, 3, 3, 3))
    for i, j, value in ((0, 0, 1 / e1), (1, 1, 1 / e2), (2, 2, 1 / e3), (0, 1, -n12 / e1), (0, 2, -n13 / e1),
                        (1, 2, -n23 / e2)):  # fmt: skip
        s[i, i, j, j] = s[j, j, i, i] = value
    for i, j, g in ((0, 1, g12), (0, 2, g13), (1, 2, g23)):
        s[i, j, i, j] = s[i, j, j, i] = s[j, i, i, j] = s[j, i, j, i] = 0.25 / g
    return s


@pytest.mark.parametrize("angle", [0.0, 0.4, -1.2, np.pi / 2])
def test_orthotropic_is_its_turned_compliance(angle: float) -> None:
    turn = np.array([[np.cos(angle), -np.sin(angle), 0.0], [np.sin(angle), np.cos(angle), 0.0], [0.0, 0.0, 1.0]])
    compliance = np.einsum("ai,bj,ck,dl,ijkl->abcd", turn, turn, turn, turn, compliance_tensor(ORTHO))
    gradient = random_gradients(10, 3, 1e-3, 6)
    ratio = np.linalg.det(np.eye(3) + gradient)[:, None, None]
    stress = stress_of(OrthotropicElastic(*ORTHO, angle, "three_dimensional"), gradient) / ratio
    strain = np.einsum("abcd,ncd->nab", compliance, stress)
    np.testing.assert_allclose(strain, 0.5 * (gradient + gradient.transpose(0, 2, 1)), rtol=0, atol=2e-15)


def test_orthotropic_lamina_off_its_axes() -> None:
    # Modulus of a unidirectional lamina at an angle to the load (Jones, Mechanics of Composite Materials, Eq 2.97).
    e1, e2, _, n12, _, _, g12, *_ = ORTHO
    for angle in np.linspace(0.0, np.pi, 7):
        c, s = np.cos(angle), np.sin(angle)
        compliance = np.linalg.inv(OrthotropicElastic(*ORTHO, angle, "plane_stress").stiffness)
        expected = c**4 / e1 + (1.0 / g12 - 2.0 * n12 / e1) * s**2 * c**2 + s**4 / e2
        assert compliance[0, 0] == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("assumption", ASSUMPTIONS)
def test_stiffness_is_symmetric_and_positive_definite(assumption: Assumption) -> None:
    for law in (OrthotropicElastic(*ORTHO, 0.4, assumption), IsotropicElastic(E, 0.4999, RHO, assumption)):
        np.testing.assert_array_equal(law.stiffness, law.stiffness.T)
        assert np.linalg.eigvalsh(law.stiffness)[0] > 0.0


@pytest.mark.parametrize("assumption", ASSUMPTIONS)
@pytest.mark.parametrize("poisson", [-0.5, 0.0, 0.3, 0.499])
def test_orthotropic_with_isotropic_constants(assumption: Assumption, poisson: float) -> None:
    mu = E / (2.0 * (1.0 + poisson))
    isotropic = IsotropicElastic(E, poisson, RHO, assumption)
    law = OrthotropicElastic(E, E, E, poisson, poisson, poisson, mu, mu, mu, RHO, 0.7, assumption)
    gradient = random_gradients(10, 3 if assumption == "three_dimensional" else 2, 1e-3)
    expected = stress_of(isotropic, gradient)
    np.testing.assert_allclose(stress_of(law, gradient), expected, rtol=0, atol=1e-12 * np.abs(expected).max())
    assert law.pressure_wave_speed == pytest.approx(isotropic.pressure_wave_speed, rel=1e-12)


@pytest.mark.parametrize("assumption", ASSUMPTIONS)
def test_fastest_wave_of_an_orthotropic_solid(assumption: Assumption) -> None:
    # A stiff shear modulus puts the fastest wave off the axes; the scan here is finer and knows no hill climbing.
    constants = (40.0e9, 30.0e9, 35.0e9, 0.2, 0.2, 0.2, 60.0e9, 20.0e9, 10.0e9, 2000.0)
    law = OrthotropicElastic(*constants, 0.3, assumption)
    turn = np.linspace(0.0, np.pi, 4001)
    if assumption == "three_dimensional":
        order = np.array([[0, 5, 4], [5, 1, 3], [4, 3, 2]])
        height = np.linspace(-0.2, 0.2, 41)  # the stiff shear is that of the plane
        a, z = (part.ravel() for part in np.meshgrid(turn, height))
        normal = np.stack([np.cos(a) * np.sqrt(1 - z**2), np.sin(a) * np.sqrt(1 - z**2), z], axis=1)
    else:
        order = np.array([[0, 2], [2, 1]])
        normal = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    stiffness = law.stiffness[order[:, :, None, None], order[None, None, :, :]]
    acoustic = np.einsum("nj,ijkl,nl->nik", normal, stiffness, normal, optimize=True)
    fastest = np.sqrt(np.linalg.eigvalsh(acoustic)[:, -1].max() / 2000.0)
    assert law.pressure_wave_speed == pytest.approx(fastest, rel=1e-6)
    assert law.pressure_wave_speed >= fastest * (1.0 - 1e-14)
    along = np.sqrt(max(np.diag(law.full_stiffness)[:2]) / 2000.0)
    assert fastest > 1.01 * along


def test_wave_speeds_at_rest() -> None:
    modulus = E * (1.0 - NU) / ((1.0 + NU) * (1.0 - 2.0 * NU))
    for name in ("isotropic", "neo-hookean", "j2"):
        assert LAWS[name]("plane_strain").pressure_wave_speed == pytest.approx(np.sqrt(modulus / RHO))
        assert LAWS[name]("three_dimensional").pressure_wave_speed == pytest.approx(np.sqrt(modulus / RHO))
        assert LAWS[name]("plane_stress").pressure_wave_speed == pytest.approx(np.sqrt(E / (1.0 - NU**2) / RHO))


# --- neo-Hookean closed forms -------------------------------------------------------------------------------------

STRETCH = np.array([0.3, 0.7, 0.95, 1.0, 1.2, 2.0, 5.0])


def test_neo_hookean_bar() -> None:
    # Lateral stretch of a bar from zero lateral stress: lambda s^2 l^2 + 2 mu l - (2 mu + lambda) = 0 in l = lateral^2.
    squared = STRETCH**2
    lateral = (np.sqrt(MU**2 + LAME * squared * (2.0 * MU + LAME)) - MU) / (LAME * squared)
    expected = MU * (squared - lateral)
    space = stress_of(
        LAWS["neo-hookean"]("three_dimensional"), diagonal(*np.log([STRETCH, lateral**0.5, lateral**0.5]))
    )
    np.testing.assert_allclose(space[:, 0, 0], expected, rtol=1e-12, atol=1e-5)
    np.testing.assert_allclose(space[:, 1, 1], 0.0, atol=1e-12 * np.abs(expected).max())
    sheet = Points(LAWS["neo-hookean"]("plane_stress"), len(STRETCH))
    stress = sheet.stress(diagonal(*np.log([STRETCH, lateral**0.5])))
    np.testing.assert_allclose(stress[:, 0, 0], expected, rtol=1e-12, atol=1e-5)
    np.testing.assert_allclose(stress[:, 1, 1], 0.0, atol=1e-12 * np.abs(expected).max())
    np.testing.assert_allclose(sheet.ask("thickness_stretch"), lateral**0.5, rtol=1e-13)


def test_neo_hookean_bar_held_across() -> None:
    squared = STRETCH**2
    lateral = (2.0 * MU + LAME) / (2.0 * MU + LAME * squared)
    stress = stress_of(LAWS["neo-hookean"]("plane_strain"), diagonal(*np.log([STRETCH, lateral**0.5])))
    np.testing.assert_allclose(stress[:, 0, 0], MU * (squared - lateral), rtol=1e-12, atol=1e-5)
    np.testing.assert_allclose(stress[:, 1, 1], 0.0, atol=1e-12 * np.abs(stress).max())


@pytest.mark.parametrize("assumption", ASSUMPTIONS)
def test_neo_hookean_simple_shear(assumption: Assumption) -> None:
    dim = 3 if assumption == "three_dimensional" else 2
    gradient = np.zeros((1, dim, dim))
    gradient[0, 0, 1] = 1.7
    stress = stress_of(LAWS["neo-hookean"](assumption), gradient)[0]
    expected = np.zeros((dim, dim))
    expected[0, 0], expected[0, 1], expected[1, 0] = MU * 1.7**2, MU * 1.7, MU * 1.7
    np.testing.assert_allclose(stress, expected, rtol=1e-14)


def test_neo_hookean_from_moduli() -> None:
    law = NeoHookean.from_moduli(MU, BULK, RHO, "plane_stress")
    assert (law.young, law.poisson) == (pytest.approx(E, rel=1e-14), pytest.approx(NU, rel=1e-14))
    assert law.lame == pytest.approx(BULK - 2.0 * MU / 3.0, rel=1e-13)


def test_nearly_incompressible_sheet() -> None:
    # The incompressible neo-Hookean bar has tau = mu (s^2 - 1/s); the rest is the compressibility, mu/lambda.
    law = NeoHookean(1.0e6, 0.4999, 1000.0, "plane_stress")
    stress = stress_of(law, diagonal(np.log([2.0]), np.log([2.0**-0.5])))
    assert stress[0, 0, 0] == pytest.approx(law.shear_modulus * (4.0 - 0.5), rel=1e-3)


# --- J2 plasticity ------------------------------------------------------------------------------------------------


def plastic_strain_in_tension(strain: float, saturation: float) -> float:
    """Plastic part of a logarithmic tensile strain, from E (e - p) = Y(p)."""
    if E * strain <= YIELD:
        return 0.0
    return float(
        brentq(
            lambda p: E * (strain - p) - YIELD - HARD * p + saturation * np.expm1(-RATE * p), 0.0, strain, xtol=1e-18
        )
    )


@pytest.mark.parametrize("saturation", [0.0, VOCE])
@pytest.mark.parametrize("assumption", ["three_dimensional", "plane_stress"])
def test_j2_bar_in_tension(assumption: Assumption, saturation: float) -> None:
    law = J2Plasticity(E, NU, RHO, YIELD, HARD, saturation, RATE, assumption)
    points = Points(law, 1)
    for strain in (1e-3, 2e-3, YIELD / E * 1.5, 0.01, 0.1, 0.7):
        plastic = plastic_strain_in_tension(strain, saturation)
        if saturation == 0.0:
            assert plastic == pytest.approx(max(0.0, (E * strain - YIELD) / (E + HARD)), rel=1e-12)
        tension = E * (strain - plastic)
        lateral = -NU * tension / E - 0.5 * plastic
        logarithms = [np.array([strain]), np.array([lateral]), np.array([lateral])][: points.dim]
        stress = points.stress(diagonal(*logarithms))[0]
        assert stress[0, 0] == pytest.approx(tension, rel=1e-11)
        assert abs(stress[1, 1]) < 1e-11 * E
        assert points.history[0, -1] == pytest.approx(plastic, rel=1e-10, abs=1e-18)
        assert points.ask("thickness_stretch")[0] == pytest.approx(
            np.exp(lateral) if assumption == "plane_stress" else 1.0, rel=1e-13
        )
        assert points.ask("strain_energy")[0] == pytest.approx(VOLUME * tension**2 / (2.0 * E), rel=1e-9)
        work = YIELD * plastic + 0.5 * HARD * plastic**2 + saturation * (plastic + np.expm1(-RATE * plastic) / RATE)
        assert points.ask("dissipated")[0] == pytest.approx(VOLUME * work, rel=1e-9, abs=1e-24)
    # Elastic unloading to zero stress leaves the plastic strain behind.
    left = [np.array([plastic]), np.array([-0.5 * plastic]), np.array([-0.5 * plastic])][: points.dim]
    np.testing.assert_allclose(points.stress(diagonal(*left)), 0.0, atol=1e-11 * E)
    assert points.ask("strain_energy")[0] < 1e-20 * E * VOLUME


@pytest.mark.parametrize("assumption", ASSUMPTIONS)
def test_j2_pure_shear(assumption: Assumption) -> None:
    strain = np.array([1e-3, 0.01, 0.3])
    points = Points(J2Plasticity(E, NU, RHO, YIELD, HARD, assumption=assumption), 3)
    points.ids = np.arange(3)
    logarithms = [strain, -strain, np.zeros(3)][: points.dim]
    stress = points.stress(diagonal(*logarithms))
    plastic = np.maximum(0.0, (2.0 * np.sqrt(3.0) * MU * strain - YIELD) / (3.0 * MU + HARD))
    shear = np.where(plastic > 0.0, (YIELD + HARD * plastic) / np.sqrt(3.0), 2.0 * MU * strain)
    np.testing.assert_allclose(stress[:, 0, 0], shear, rtol=1e-11)
    np.testing.assert_allclose(stress[:, 1, 1], -shear, rtol=1e-11)
    np.testing.assert_allclose(points.history[:, -1], plastic, rtol=1e-11)


class ExponentialIntegration:
    """F_p itself carried by matrix exponentials, without principal axes: another way to the same law."""

    def __init__(self) -> None:
        self.plastic, self.strain = np.eye(3), 0.0

    def stress(self, forward: Array) -> Array:
        elastic = forward @ np.linalg.inv(self.plastic)
        logarithm = 0.5 * np.real(logm(elastic.T @ elastic))
        deviator = logarithm - np.trace(logarithm) / 3.0 * np.eye(3)
        trial = 2.0 * MU * np.sqrt(1.5) * np.linalg.norm(deviator)

        def strength(strain: float) -> float:
            return float(YIELD + HARD * strain - VOCE * np.expm1(-RATE * strain))

        if trial > strength(self.strain):
            increment = brentq(lambda d: trial - 3.0 * MU * d - strength(self.strain + d), 0.0, trial / MU, xtol=1e-18)
            flow = increment * np.sqrt(1.5) * deviator / np.linalg.norm(deviator)
            self.plastic = expm(flow) @ self.plastic
            self.strain += increment
            elastic = forward @ np.linalg.inv(self.plastic)
        stretch = np.real(sqrtm(elastic.T @ elastic))
        turn = elastic @ np.linalg.inv(stretch)
        logarithm = np.real(logm(stretch))
        trace = np.trace(logarithm)
        tau = BULK * trace * np.eye(3) + 2.0 * MU * (logarithm - trace / 3.0 * np.eye(3))
        return np.asarray(turn @ tau @ turn.T)


def wander(steps: int, dim: int, seed: int, size: float) -> list[Array]:
    """Displacement gradients along a crooked path."""
    rng = np.random.default_rng(seed)
    forward, path = np.eye(dim), []
    drift = rng.standard_normal((dim, dim))
    for _ in range(steps):
        drift = 0.7 * drift + 0.7 * rng.standard_normal((dim, dim))
        forward = np.asarray(expm(size * drift)) @ forward
        path.append(forward - np.eye(dim))
    return path


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_j2_against_matrix_exponentials(seed: int) -> None:
    points, independent = Points(LAWS["j2"]("three_dimensional"), 1), ExponentialIntegration()
    for gradient in wander(30, 3, seed, 0.01):
        expected = independent.stress(np.eye(3) + gradient)
        np.testing.assert_allclose(points.stress(gradient[None])[0], expected, atol=1e-9 * YIELD, rtol=1e-9)
        assert points.history[0, -1] == pytest.approx(independent.strain, rel=1e-9)
    assert independent.strain > 0.1


@pytest.mark.parametrize("assumption", ASSUMPTIONS)
def test_j2_plastic_flow_keeps_the_volume(assumption: Assumption) -> None:
    points = Points(LAWS["j2"](assumption), 1)
    for gradient in wander(2000, points.dim, 7, 0.005):
        points.stress(gradient[None])
    a = points.history[0]
    order = [[0, 5, 4], [5, 1, 3], [4, 3, 2]]
    if points.dim == 3:
        metric = a[np.array(order)]
    else:
        metric = np.array([[a[0], a[2], 0.0], [a[2], a[1], 0.0], [0.0, 0.0, a[3]]])
    assert a[-1] > 4.0
    assert np.linalg.norm(metric) > 0.5
    assert np.linalg.det(np.eye(3) + metric) == pytest.approx(1.0, abs=1e-10)


@pytest.mark.parametrize("assumption", ASSUMPTIONS)
@pytest.mark.parametrize("poisson", [-0.9, 0.0, 0.3, 0.4999])
@pytest.mark.parametrize("hardening", [(0.0, 0.0, 0.0), (HARD, VOCE, RATE), (10.0 * E, 0.0, 0.0), (0.0, 2e9, 1e4)])
def test_j2_returns_from_anywhere_to_the_yield_surface(
    assumption: Assumption, poisson: float, hardening: tuple[float, float, float]
) -> None:
    law = J2Plasticity(E, poisson, RHO, YIELD, *hardening, assumption=assumption)
    points = Points(law, 300)
    rng = np.random.default_rng(11)
    # From just beyond yield to strains of order one, in one step.
    size = 10.0 ** rng.uniform(-2.3, -0.5, 300)[:, None, None]
    stress = points.stress(size * rng.standard_normal((300, points.dim, points.dim)))
    full = np.zeros((300, 3, 3))
    full[:, : points.dim, : points.dim] = stress
    if assumption == "plane_strain":
        change = np.linalg.det(np.eye(2) + displacement_gradient(points.rows, 2))
        full[:, 2, 2] = points.ask("stress_zz") * change
    deviator = full - np.trace(full, axis1=1, axis2=2)[:, None, None] / 3.0 * np.eye(3)
    mises = np.sqrt(1.5 * np.sum(deviator**2, axis=(1, 2)))
    plastic = points.history[points.ids, -1]
    strength = law.yield_strength(plastic)
    yielded = plastic > 0.0
    assert np.count_nonzero(yielded) > 200
    bound = 1e-12 * (np.abs(full).max(axis=(1, 2)) + E * 1e-3)
    np.testing.assert_array_less(np.abs(mises - strength)[yielded], bound[yielded])
    np.testing.assert_array_less(mises[~yielded], strength[~yielded] + bound[~yielded])


def test_j2_work_is_stored_or_dissipated() -> None:
    # A crooked path with load, turn and unload; the trapezoid's work misses what curves within a step.
    def gap(steps: int) -> float:
        points = Points(LAWS["j2"]("plane_strain"), 1)
        turn = np.linspace(0.0, 4.0, steps + 1)[:, None, None]
        path = 0.03 * turn * np.array([[0.5, 0.0], [0.0, -0.3]]) + 0.02 * np.sin(turn) * np.array(
            [[0.2, 1.0], [0.4, 0]]
        )
        work, last = 0.0, np.zeros((2, 2))
        for before, after in pairwise(path):
            nominal = points.stress(after[None])[0] @ np.linalg.inv(np.eye(2) + after).T
            work += VOLUME * float(np.sum(0.5 * (nominal + last) * (after - before)))
            last = nominal
        total = float(points.ask("strain_energy")[0] + points.ask("dissipated")[0])
        return abs(work - total) / total

    coarse, fine = gap(200), gap(3200)
    assert coarse < 2e-4
    assert fine < coarse / 100.0  # sixteen times the steps: between first order (16) and second (256), or better


def test_history_follows_the_id_not_the_row() -> None:
    points = Points(LAWS["j2"]("plane_strain"), 40)
    gradient = random_gradients(40, 2, 0.02)
    points.stress(gradient)
    order = np.random.default_rng(3).permutation(40)
    shuffled = Points(LAWS["j2"]("plane_strain"), 40)
    shuffled.history[:] = points.history
    shuffled.ids = points.ids[order]
    np.testing.assert_array_equal(shuffled.stress(1.3 * gradient[order]), points.stress(1.3 * gradient)[order])
    np.testing.assert_array_equal(shuffled.history, points.history)


# --- spectral decomposition ---------------------------------------------------------------------------------------


def test_spectral_decomposition() -> None:
    rng = np.random.default_rng(5)
    matrices = [size * (m + m.T) for size in (1e-12, 1.0, 1e6) for m in rng.standard_normal((50, 3, 3))]
    turn = random_rotation(3, 9)
    matrices += [turn @ np.diag(d) @ turn.T for d in ([1.0, 1.0, 1.0], [1.0, 1.0, 1.0 + 1e-15], [2.0, -1.0, -1.0])]
    matrices += [np.zeros((3, 3)), np.diag([3.0, 0.0, -1e-9])]
    for matrix in matrices:
        matrix = 0.5 * (matrix + matrix.T)
        values, vectors = matrix.copy(), np.empty((3, 3))
        decompose(values, vectors)
        scale = np.abs(matrix).max()
        np.testing.assert_allclose(vectors @ vectors.T, np.eye(3), atol=2e-15)
        np.testing.assert_allclose(vectors @ np.diag(np.diag(values)) @ vectors.T, matrix, atol=4e-15 * scale, rtol=0)
        np.testing.assert_allclose(np.sort(np.diag(values)), np.linalg.eigvalsh(matrix), atol=4e-15 * scale, rtol=0)


# --- the contract -------------------------------------------------------------------------------------------------


def test_material_of_the_contract_example() -> None:
    # The class printed in the module's documentation, run as it stands.
    text = str(contract.__doc__)
    names: dict[str, Any] = {**vars(contract), "Material": Material, "set_kirchhoff_stress": set_kirchhoff_stress}
    exec(textwrap.dedent(text[text.index("    class ") :]), names)
    law: Material = names["SaintVenantKirchhoff"]()
    points = Points(law, 20)
    gradient = random_gradients(20, 2, 0.1)
    stress = points.stress(gradient)
    expected = energy_slope(points, gradient) @ (np.eye(2) + gradient).transpose(0, 2, 1)
    np.testing.assert_allclose(stress, expected, rtol=0, atol=1e-9 * np.abs(stress).max())
    assert law.start_history(7).shape == (7, 0)
    np.testing.assert_array_equal(points.ask("dissipated"), 0.0)
    with pytest.raises(NotImplementedError, match="SaintVenantKirchhoff gives no stress_zz for plane_strain"):
        points.ask("stress_zz")


@pytest.mark.parametrize("assumption", ASSUMPTIONS)
@pytest.mark.parametrize("name", LAWS)
def test_a_point_turned_inside_out_is_named(name: str, assumption: Assumption) -> None:
    for bad in (-2.5, np.nan):
        points = Points(LAWS[name](assumption), 5)
        gradient = np.zeros((5, points.dim, points.dim))
        gradient[3, 0, 0] = bad
        with pytest.raises(MaterialError, match=f"no stress for point {points.ids[3]}: .*det F = ") as caught:
            points.stress(gradient)
        assert (caught.value.row, caught.value.point) == (3, points.ids[3])


def changed(name: str, value: object) -> Callable[[], object]:
    good: dict[str, Any] = dict(zip(
        ("young_1", "young_2", "young_3", "poisson_12", "poisson_13", "poisson_23", "shear_12", "shear_13", "shear_23",
         "density"), ORTHO, strict=True))  # fmt: skip
    return lambda: OrthotropicElastic(**{**good, name: value})


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: IsotropicElastic(-1.0, NU, RHO), "young = -1.0: .*above 0 Pa"),
        (lambda: IsotropicElastic(E, 0.5, RHO), "poisson = 0.5: must be above -1 and below 0.5"),
        (lambda: IsotropicElastic(E, float("nan"), RHO), "poisson = nan"),
        (lambda: IsotropicElastic(E, NU, 0.0), "density = 0.0: .*above 0 kg/m"),
        (lambda: IsotropicElastic(E, NU, RHO, "flat"), "assumption = 'flat': allowed are 'plane_stress'"),  # type: ignore[arg-type]
        (lambda: NeoHookean(E, -0.1, RHO), "poisson = -0.1: .*at least 0"),
        (lambda: NeoHookean.from_moduli(0.0, 1.0, RHO), "shear_modulus = 0.0"),
        (lambda: NeoHookean.from_moduli(3.0, 1.9, RHO), "bulk_modulus = 1.9: .*at least 2 Pa"),
        (lambda: J2Plasticity(E, NU, RHO, 0.0), "yield_stress = 0.0"),
        (lambda: J2Plasticity(E, NU, RHO, YIELD, -1.0), "hardening = -1.0: .*at least 0 Pa"),
        (lambda: J2Plasticity(E, NU, RHO, YIELD, 0.0, -1.0), "saturation = -1.0"),
        (lambda: J2Plasticity(E, NU, RHO, YIELD, 0.0, 1.0), "saturation_rate = 0"),
        (lambda: J2Plasticity(E, NU, RHO, YIELD, float("inf")), "hardening = inf"),
        (changed("young_2", 0.0), "young_2 = 0.0"),
        (changed("shear_13", -4.0), "shear_13 = -4.0"),
        (changed("density", float("nan")), "density = nan"),
        (changed("angle", float("inf")), "angle = inf"),
        (changed("poisson_12", 3.8), r"poisson_12 = 3.8: .*sqrt\(young_1/young_2\) = 3.74166"),
        (changed("poisson_23", -0.92), "poisson_23 = -0.92: .*0.912871"),
        (changed("poisson_13", 3.0), "poisson_12 = 0.28, poisson_13 = 3.0, poisson_23 = 0.4: .*not positive definite"),
    ],
)
def test_bad_input_is_named(make: Callable[[], object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make()
