"""Yielding subcells against closed forms of layers, laws of plasticity, and derivatives."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from gmc_service.cell import Cell
from gmc_service.gmc_reduced import homogenise
from gmc_service.material import Failure, Material, Plasticity, constant_material, isotropic_stiffness
from gmc_service.plastic_cell import PlasticCell

ALUMINIUM = isotropic_stiffness(70e9, 0.3)
SHEAR = ALUMINIUM[5, 5]


def metal(yield_stress: float, hardening: float, **more: object) -> Material:
    plastic = Plasticity(yield_stress, hardening)
    return dataclasses.replace(constant_material("metal", ALUMINIUM), plasticity=plastic, **more)


def layers(*materials: Material) -> Cell:
    """Equal layers on top of each other along axis 2."""
    count = len(materials)
    return Cell(np.ones(count), np.ones(1), np.arange(count).reshape(count, 1), materials)


def fibre_cell(hardening: float = 1e9) -> Cell:
    side = 0.6**0.5
    sizes = np.array([side, 1.0 - side])
    boron = constant_material("boron", isotropic_stiffness(400e9, 0.2), (5e-6, 5e-6, 5e-6))
    matrix = dataclasses.replace(
        constant_material("aluminium", ALUMINIUM, (23e-6, 23e-6, 23e-6)), plasticity=Plasticity(200e6, hardening)
    )
    return Cell(sizes, sizes, np.array([[0, 1], [1, 1]]), (boron, matrix))


def walk(cell: Cell, path: np.ndarray, temperature: float = 300.0) -> tuple[np.ndarray, np.ndarray]:
    """Stresses along a path of strains from rest, and the history at its end."""
    plastic = PlasticCell(cell, "gmc")
    history, failed = np.zeros((1, cell.subcells, 7)), np.zeros((1, cell.subcells), bool)
    stresses = []
    for strain in path:
        answer = plastic.evaluate(strain[None], temperature, failed, history)
        failed, history = answer.failed, answer.history
        stresses.append(answer.stress[0])
    return np.array(stresses), history[0]


def along(component: int, values: np.ndarray) -> np.ndarray:
    path = np.zeros((len(values), 6))
    path[:, component] = values
    return path


def shear_law(strain: np.ndarray, yield_stress: float, hardening: float) -> np.ndarray:
    """Shear stress of one material at a shear strain: bilinear, yielding at the tensile yield stress over sqrt 3."""
    limit = yield_stress / np.sqrt(3.0)
    slope = 1.0 / (1.0 / SHEAR + 3.0 / hardening) if hardening else 0.0
    return np.where(SHEAR * strain < limit, SHEAR * strain, limit + slope * (strain - limit / SHEAR))


def test_layers_sheared_in_their_plane_share_the_strain() -> None:
    gamma = np.linspace(0.0, 0.03, 16)
    stress, _ = walk(layers(metal(100e6, 2e9), metal(300e6, 0.0)), along(4, gamma))
    wanted = 0.5 * (shear_law(gamma, 100e6, 2e9) + shear_law(gamma, 300e6, 0.0))
    assert np.abs(stress[:, 4] - wanted).max() < 1e-9 * wanted.max()


def test_layers_sheared_across_share_the_stress() -> None:
    tau = np.linspace(0.0, 250e6, 26)
    laws = ((100e6, 2e9), (300e6, 5e9))

    def strain_of(stress: np.ndarray, yield_stress: float, hardening: float) -> np.ndarray:
        over = np.maximum(stress - yield_stress / np.sqrt(3.0), 0.0)
        return stress / SHEAR + 3.0 * over / hardening

    gamma = 0.5 * (strain_of(tau, *laws[0]) + strain_of(tau, *laws[1]))
    stress, _ = walk(layers(*(metal(*law) for law in laws)), along(5, gamma))
    assert np.abs(stress[:, 5] - tau).max() < 1e-8 * tau.max()


def test_uniaxial_strain_of_an_ideally_plastic_body_keeps_only_its_bulk_modulus() -> None:
    strain = np.linspace(0.0, 0.02, 11)
    stress, _ = walk(layers(metal(200e6, 0.0)), along(0, strain))
    bulk = 70e9 / (3.0 * (1.0 - 0.6))
    first = 200e6 / (2.0 * SHEAR)  # where 2 G strain reaches the yield stress
    wanted = np.where(strain < first, (bulk + 4.0 / 3.0 * SHEAR) * strain, bulk * strain + 2.0 / 3.0 * 200e6)
    assert np.abs(stress[:, 0] - wanted).max() < 1e-9 * wanted.max()


def test_unloading_is_elastic_and_the_plastic_strain_stays() -> None:
    cell = fibre_cell()
    loaded, history = walk(cell, along(0, np.linspace(0.0, 0.01, 5)))
    both, unloaded = walk(cell, along(0, np.append(np.linspace(0.0, 0.01, 5), [0.0099, 0.0096])))
    assert history[1:, 6].min() > 1e-4
    assert np.array_equal(unloaded, history)
    elastic = homogenise(cell.heights, cell.widths, cell.stiffness_at(300.0), cell.expansion_at(300.0)).stiffness
    assert np.abs((loaded[-1] - both[-1]) - elastic[:, 0] * 0.0004).max() < 1e-6 * np.abs(loaded[-1]).max()


def test_plastic_strain_is_without_volume_and_the_stress_on_the_surface() -> None:
    cell = fibre_cell()
    path = np.linspace(0.0, 1.0, 9)[:, None] * np.array([0.004, -0.007, 0.002, 0.01, -0.004, 0.006])
    _, history = walk(cell, path)
    assert np.abs(history[:, :3].sum(axis=1)).max() < 1e-15
    assert not history[0].any()  # the fibre does not yield
    plastic = PlasticCell(cell, "gmc")
    stress, strain = plastic.localise(path[-1:], 300.0, np.zeros((1, 4), bool), history[None])
    matrix = stress[0, 1:]
    deviator = matrix[:, :3] - matrix[:, :3].mean(axis=1, keepdims=True)
    equivalent = np.sqrt(1.5 * (deviator**2).sum(axis=1) + 3.0 * (matrix[:, 3:] ** 2).sum(axis=1))
    assert np.abs(equivalent - (200e6 + 1e9 * history[1:, 6])).max() < 1e-6 * 200e6
    # Strains of the subcells have the macroscopic mean.
    assert np.abs(cell.volume_fractions() @ strain[0] - path[-1]).max() < 1e-12


@pytest.mark.parametrize("hardening", [0.0, 1e7, 1e9])
def test_the_tangent_is_the_derivative(hardening: float) -> None:
    cell = fibre_cell(hardening)
    plastic = PlasticCell(cell, "gmc")
    end = np.array([0.004, -0.007, 0.002, 0.01, -0.004, 0.006])
    history, failed = np.zeros((1, 4, 7)), np.zeros((1, 4), bool)
    history = plastic.evaluate(0.5 * end[None], 300.0, failed, history).history
    tangent = plastic.evaluate(end[None], 300.0, failed, history).tangents[0]
    size = 1e-7
    sides = np.array([end + sign * size * np.eye(6) for sign in (1.0, -1.0)]).reshape(12, 6)
    many = plastic.evaluate(sides, 300.0, np.zeros((12, 4), bool), np.repeat(history, 12, axis=0)).stress
    difference = (many[:6] - many[6:]).T / (2.0 * size)
    # Ideal plasticity has no tangent with an inverse; there it is that of a hardening of 1e-6 of the modulus.
    assert np.abs(tangent - difference).max() < (1e-7 if hardening else 3e-6) * np.abs(difference).max()
    assert np.abs(tangent - tangent.T).max() < 1e-9 * np.abs(tangent).max()


def test_smaller_steps_come_to_one_answer() -> None:
    cell = fibre_cell()
    end = np.array([0.0, 0.01, 0.0, 0.0, 0.0, 0.0])
    turn = np.array([0.0, 0.01, 0.0, 0.01, 0.0, 0.01])

    def final(steps: int) -> np.ndarray:
        shares = np.linspace(0.0, 1.0, steps + 1)[1:, None]
        return walk(cell, np.concatenate([shares * end, end + shares * (turn - end)]))[0][-1]

    finest = final(64)
    errors = [np.abs(final(steps) - finest).max() for steps in (2, 4, 8)]
    # Implicit Euler: first order, so the error halves at least nearly with the step.
    assert errors[0] > errors[1] > errors[2]
    assert errors[2] < 0.4 * errors[0]


def test_equation_89_holds_with_the_plastic_strain_of_the_composite() -> None:
    cell = fibre_cell()
    plastic = PlasticCell(cell, "gmc")
    elastic = homogenise(cell.heights, cell.widths, cell.stiffness_at(350.0), cell.expansion_at(350.0))
    strain = np.array([[0.002, -0.006, 0.003, 0.004, 0.0, -0.005]])
    answer = plastic.evaluate(strain, 350.0, np.zeros((1, 4), bool), np.zeros((1, 4, 7)))
    plastic_strain = plastic.mean_plastic_strain(350.0, answer.history)
    assert np.abs(plastic_strain).max() > 1e-3
    wanted = elastic.stiffness @ (strain[0] - plastic_strain[0] - 50.0 * elastic.expansion)
    assert np.abs(answer.stress[0] - wanted).max() < 1e-9 * np.abs(wanted).max()


def test_cooling_yields_the_matrix_that_the_fibre_holds() -> None:
    cell = fibre_cell()
    plastic = PlasticCell(cell, "gmc")
    # 299 K colder, with the length of the fibre: along it the matrix would shrink by 0.54 % more.
    strain = -299.0 * np.array([[5e-6, 15e-6, 15e-6, 0.0, 0.0, 0.0]])
    answer = plastic.evaluate(strain, 1.0, np.zeros((1, 4), bool), np.zeros((1, 4, 7)))
    assert answer.history[0, 1:, 6].min() > 1e-4
    assert not answer.history[0, 0].any()
    stress, local = plastic.localise(strain, 1.0, np.zeros((1, 4), bool), answer.history)
    assert stress[0, 1:, 0].min() > 0.0
    fractions = cell.volume_fractions()
    assert np.abs(fractions @ stress[0] - answer.stress[0]).max() < 1e-6 * np.abs(answer.stress).max()
    assert np.abs(fractions @ local[0] - strain[0]).max() < 1e-12


def test_a_subcell_fails_while_it_yields() -> None:
    limit = Failure("maximum_strain", tension=(0.01, np.inf, np.inf))
    cell = layers(metal(100e6, 1e9, failures=(limit,)), metal(100e6, 1e9))
    stress, _ = walk(cell, along(0, np.array([0.005, 0.0099, 0.0101])))
    intact, _ = walk(layers(metal(100e6, 1e9), metal(100e6, 1e9)), along(0, np.array([0.005, 0.0099, 0.0101])))
    assert np.allclose(stress[:2], intact[:2], rtol=1e-12)
    assert stress[2, 0] < 0.6 * intact[2, 0]


def test_batch_equals_points_one_by_one_and_arguments_stay() -> None:
    cell = fibre_cell()
    plastic = PlasticCell(cell, "gmc")
    random = np.random.default_rng(2)
    strain, failed, history = random.normal(size=(20, 6)) * 0.01, np.zeros((20, 4), bool), np.zeros((20, 4, 7))
    kept = strain.copy()
    many = plastic.evaluate(strain, 300.0, failed, history)
    assert np.array_equal(strain, kept) and not history.any() and not failed.any()
    for point in range(20):
        one = plastic.evaluate(strain[point : point + 1], 300.0, failed[:1], history[:1])
        assert np.array_equal(one.stress[0], many.stress[point])
        assert np.array_equal(one.tangents[0], many.tangents[point])


def test_without_yielding_it_is_the_elastic_cell() -> None:
    cell = fibre_cell()
    strain = np.array([[1e-4, 2e-4, -1e-4, 1e-4, 0.0, 3e-4]])
    answer = PlasticCell(cell, "gmc").evaluate(strain, 310.0, np.zeros((1, 4), bool), np.zeros((1, 4, 7)))
    elastic = homogenise(cell.heights, cell.widths, cell.stiffness_at(310.0), cell.expansion_at(310.0))
    wanted = elastic.stiffness @ (strain[0] - 10.0 * elastic.expansion)
    assert not answer.history.any()
    assert np.abs(answer.stress[0] - wanted).max() < 1e-10 * np.abs(wanted).max()
    assert np.abs(answer.tangents[0] - elastic.stiffness).max() < 1e-10 * np.abs(elastic.stiffness).max()


def test_what_it_cannot_do_is_named() -> None:
    with pytest.raises(ValueError, match="method is 'mori_tanaka'"):
        PlasticCell(fibre_cell(), "mori_tanaka")
    with pytest.raises(ValueError, match="after_failure is 'floor'"):
        PlasticCell(dataclasses.replace(fibre_cell(), after_failure="floor"), "gmc")
    with pytest.raises(ValueError, match="fracture_energy of metal"):
        PlasticCell(layers(metal(1e8, 0.0, fracture_energy=100.0)), "gmc")
    skewed = dataclasses.replace(metal(1e8, 0.0), stiffness=isotropic_stiffness(3.45e9, 0.35, 1.0e9)[None])
    with pytest.raises(ValueError, match="metal has plasticity, so its stiffness must be isotropic"):
        PlasticCell(layers(skewed), "gmc")
    with pytest.raises(ValueError, match=r"strain\[0\] is"):
        PlasticCell(fibre_cell(), "gmc").evaluate(
            np.full((1, 6), np.nan), 300.0, np.zeros((1, 4), bool), np.zeros((1, 4, 7))
        )
