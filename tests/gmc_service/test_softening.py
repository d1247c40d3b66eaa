"""Softening subcells: energy per area of crack against the fracture energy, and curves against closed forms."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from failing_cells import INF, fibre
from numpy.typing import NDArray

from gmc_service.cell import Cell
from gmc_service.evaluation import Answer, Evaluator
from gmc_service.mask_table import unpack_mask
from gmc_service.material import Criterion, Failure, Material, constant_material, isotropic_stiffness
from gmc_service.safe_energy import safe_energy

YOUNG, STRENGTH, ENERGY = 3e9, 60e6, 200.0
#: Above it an element of this material would snap back under uniaxial stress.
LONGEST = 2.0 * YOUNG * ENERGY / STRENGTH**2


def softening(poisson: float = 0.0, criterion: Criterion = "maximum_stress") -> Material:
    """A resin that stores the same energy under its strength in tension, compression or shear."""
    shear = STRENGTH / np.sqrt(2.0 * (1.0 + poisson))
    limits = np.array([STRENGTH, STRENGTH, shear])
    if criterion == "maximum_strain":
        limits /= np.array([YOUNG, YOUNG, 0.5 * YOUNG / (1.0 + poisson)])
    tension, compression, tangential = ((float(limit),) * 3 for limit in limits)
    failure = Failure(criterion, tension, compression, tangential)
    stiffness = isotropic_stiffness(YOUNG, poisson)
    return constant_material("resin", stiffness, failures=(failure,), fracture_energy=ENERGY)


def elastic(poisson: float = 0.0) -> Material:
    return constant_material("elastic", isotropic_stiffness(YOUNG, poisson))


def layered(heights: tuple[float, ...], phase: list[int]) -> Cell:
    """Rows of the resin (0) and of an elastic material with the same constants (1)."""
    return Cell(np.array(heights), np.ones(1), np.array(phase)[:, None], (softening(), elastic()), knock_down=1e-8)


def drive(evaluator: Evaluator, direction: NDArray[np.float64], lengths: NDArray[np.float64], end: float, steps: int):  # type: ignore[no-untyped-def]
    """Drive points, one for each element length, along a direction of strain; yield factor and answer."""
    points = len(lengths)
    failed = np.zeros((points, evaluator.failed_bytes), dtype=np.uint8)
    history = np.zeros((points, evaluator.history_values))
    for factor in np.linspace(0.0, end, steps + 1):
        answer = evaluator.evaluate(np.tile(factor * direction, (points, 1)), 300.0, failed, history, lengths)
        failed, history = answer.failed, answer.history
        yield factor, answer


def work(evaluator: Evaluator, direction: NDArray[np.float64], lengths: NDArray[np.float64], end: float, steps: int):  # type: ignore[no-untyped-def]
    """Work per volume done along a path, less what an unloading gives back; shape (points,)."""
    strains, stresses = [], []
    for factor, answer in drive(evaluator, direction, lengths, end, steps):
        strains.append(factor)
        stresses.append(answer.stress @ direction)
    return np.trapezoid(stresses, strains, axis=0) - 0.5 * stresses[-1] * strains[-1]


def axis(component: int) -> NDArray[np.float64]:
    return np.eye(6)[component]


@pytest.mark.parametrize("component", range(6))
def test_energy_per_area_does_not_depend_on_the_element(component: int) -> None:
    evaluator = Evaluator(Cell(np.ones(1), np.ones(1), np.array([[0]]), (softening(),), knock_down=1e-8))
    strength = STRENGTH if component < 3 else STRENGTH / np.sqrt(2.0)
    for length in np.array([0.02, 0.1, 0.3, 0.6, 0.9]) * LONGEST:
        spent = work(evaluator, axis(component), np.array([length]), 2.02 * ENERGY / (strength * length), 300)
        assert spent[0] * length == pytest.approx(ENERGY, rel=2e-3)


def test_stress_follows_the_straight_line() -> None:
    evaluator = Evaluator(Cell(np.ones(1), np.ones(1), np.array([[0]]), (softening(),), knock_down=1e-8))
    length = 0.3 * LONGEST
    first, last = STRENGTH / YOUNG, 2.0 * ENERGY / (STRENGTH * length)
    for factor, answer in drive(evaluator, axis(0), np.array([length]), 1.2 * last, 300):
        if factor <= first:
            expected = YOUNG * factor
        else:
            expected = max(STRENGTH * (last - factor) / (last - first), 1e-8 * YOUNG * factor)
        assert answer.stress[0, 0] == pytest.approx(expected, rel=1e-9, abs=1e-6)
        secant = answer.tangents[answer.tangent_index[0]]
        assert secant[0, 0] * factor == pytest.approx(answer.stress[0, 0], rel=1e-9, abs=1e-6)


@pytest.mark.parametrize("component", range(3))
def test_subdivided_subcells_are_one(component: int) -> None:
    coarse = layered((0.4, 0.6), [0, 1])
    fine = Cell(
        np.array([0.1, 0.2, 0.1, 0.5, 0.1]),
        np.array([0.3, 0.7]),
        np.repeat([[0], [0], [0], [1], [1]], 2, axis=1),
        coarse.materials,
        knock_down=1e-8,
    )
    direction = axis(component) + 0.2 * axis(5) + 0.1 * axis(3)
    lengths = np.array([0.3 * LONGEST])
    pairs = zip(*(drive(Evaluator(cell), direction, lengths, 0.06, 40) for cell in (coarse, fine)), strict=True)
    for (_, one), (_, other) in pairs:
        assert np.allclose(one.stress, other.stress, rtol=1e-8, atol=1.0)


def test_energy_of_a_part_of_the_section_is_its_area_fraction() -> None:
    cell = layered((0.3, 0.7), [0, 1])
    length = 0.2 * LONGEST
    last = 2.0 * ENERGY / (STRENGTH * length)
    spent = work(Evaluator(cell), axis(0), np.array([length]), 1.05 * last, 300)
    assert spent[0] * length == pytest.approx(0.3 * ENERGY, rel=2e-3)


@pytest.mark.parametrize("share", [0.1, 0.5, 0.9])
def test_a_crack_across_the_cell_spends_its_energy_once(share: float) -> None:
    """A layer in series softens over its share of the element; the curve is that of a homogeneous element."""
    evaluator = Evaluator(layered((share, 1.0 - share), [0, 1]))
    length = 0.5 * LONGEST
    first, last = STRENGTH / YOUNG, 2.0 * ENERGY / (STRENGTH * length)
    for factor, answer in drive(evaluator, axis(1), np.array([length]), 0.98 * last, 60):
        expected = YOUNG * factor if factor <= first else STRENGTH * (last - factor) / (last - first)
        assert answer.stress[0, 1] == pytest.approx(expected, rel=1e-6)
    spent = work(evaluator, axis(1), np.array([length]), 1.02 * last, 300)
    assert spent[0] * length == pytest.approx(ENERGY, rel=2e-3)


@pytest.mark.parametrize("criterion", ["maximum_stress", "maximum_strain", "tsai_hill", "hashin"])
def test_energy_under_several_stresses_at_once(criterion: Criterion) -> None:
    """Poisson's effect makes three stresses; the energy per area is still the fracture energy."""
    cell = Cell(np.ones(1), np.ones(1), np.array([[0]]), (softening(0.3, criterion),), knock_down=1e-8)
    evaluator = Evaluator(cell)
    direction = np.array([1.0, -0.2, 0.1, 0.05, 0.0, 0.2])
    for length in (0.05 * LONGEST, 0.2 * LONGEST):
        spent = work(evaluator, direction, np.array([length]), 4.0 * ENERGY / (STRENGTH * length), 600)
        assert spent[0] * length == pytest.approx(ENERGY, rel=1e-2)


def ask(
    evaluator: Evaluator, strain: NDArray[np.float64], before: Answer | None = None, length: float = 2e-4
) -> Answer:
    count = len(strain)
    failed = np.zeros((count, evaluator.failed_bytes), np.uint8) if before is None else before.failed
    history = np.zeros((count, evaluator.history_values)) if before is None else before.history
    return evaluator.evaluate(strain, 300.0, failed, history, np.full(count, length))


def composite(fibre_fails: bool = True) -> Cell:
    stiff = fibre() if fibre_fails else constant_material("fibre", isotropic_stiffness(276e9, 0.33))
    sizes = np.array([np.sqrt(0.6), 1.0 - np.sqrt(0.6)])
    return Cell(sizes, sizes, np.array([[0, 1], [1, 1]]), (stiff, softening(0.3)))


def test_unloading_is_secant_and_damage_stays() -> None:
    evaluator = Evaluator(composite())
    strain = np.random.default_rng(3).normal(size=(20, 6)) * 0.02
    loaded = ask(evaluator, strain)
    assert (loaded.history > 0.0).any(axis=1).sum() > 10
    unloaded = ask(evaluator, 0.5 * strain, loaded)
    assert np.array_equal(unloaded.history, loaded.history)
    assert np.allclose(unloaded.stress, 0.5 * loaded.stress, rtol=1e-9, atol=1e-3)
    again = ask(evaluator, strain, unloaded)
    assert np.allclose(again.stress, loaded.stress, rtol=1e-9, atol=1e-3)
    assert not ask(evaluator, np.zeros((20, 6)), loaded).stress.any()


def law(evaluator: Evaluator, strain: NDArray[np.float64], answer: Answer) -> tuple[NDArray[np.float64], ...]:
    """Index of each softening subcell at the strain that the damaged cell gives it, and its damage by the law."""
    stress, local = evaluator.localise(strain, 300.0, answer.failed, answer.history)
    shares = evaluator.cell.volume_fractions()
    assert np.allclose(np.einsum("n,pni->pi", shares, stress), answer.stress, rtol=1e-9, atol=1.0)
    effective = local[:, 1:] @ isotropic_stiffness(YOUNG, 0.3)
    shear = np.sqrt(2.6) * np.abs(effective[..., 3:]).max(axis=-1)
    ratio = np.maximum(np.abs(effective[..., :3]).max(axis=-1), shear) / STRENGTH
    last = answer.history.reshape(len(strain), 3, 2)[..., 1]
    with np.errstate(divide="ignore", invalid="ignore"):
        damage = np.clip(1.0 - (last - ratio) / (ratio * (last - 1.0)), 0.0, 1.0 - 1e-4)
    return ratio, np.where(ratio < 1.0, 0.0, damage)


def test_no_subcell_carries_more_than_the_law_allows() -> None:
    evaluator = Evaluator(composite())
    strain = np.random.default_rng(4).normal(size=(60, 6)) * 0.012
    answer = ask(evaluator, strain)
    ratio, expected = law(evaluator, strain, answer)
    damage = answer.history.reshape(60, 3, 2)[..., 0]
    assert (damage > expected - 1e-9).all()
    assert (ratio > 1.0).sum() > 60
    assert (np.abs(damage - expected) < 1e-9).sum() > 120


def test_damage_of_a_path_is_that_of_the_largest_index_on_it() -> None:
    """In elements so short that no subcell snaps through, without failing fibres; but for the overshoot of a step."""
    evaluator = Evaluator(composite(fibre_fails=False))
    strain = np.random.default_rng(4).normal(size=(60, 6)) * 0.012
    answer, most = None, np.zeros((60, 3))
    for factor in np.linspace(0.0, 1.0, 41)[1:]:
        answer = ask(evaluator, factor * strain, answer, 2e-6)
        _, damage = law(evaluator, factor * strain, answer)
        most = np.maximum(most, damage)
    assert answer is not None
    found = answer.history.reshape(60, 3, 2)[..., 0]
    assert (found > 0.01).sum() > 60
    assert (found > most - 1e-9).all() and (found - most).max() < 0.01


def test_batch_equals_single_points_and_arguments_stay() -> None:
    evaluator = Evaluator(composite())
    strain = np.random.default_rng(5).normal(size=(40, 6)) * 0.012
    strain[::4] *= 0.05
    first = ask(evaluator, strain)
    kept = first.failed.copy(), first.history.copy()
    whole = ask(evaluator, 1.3 * strain, first)
    assert np.array_equal(first.failed, kept[0]) and np.array_equal(first.history, kept[1])
    lengths = np.full(1, 2e-4)
    for p in range(40):
        one = evaluator.evaluate(1.3 * strain[[p]], 300.0, first.failed[[p]], first.history[[p]], lengths)
        assert np.array_equal(one.stress[0], whole.stress[p])
        assert np.array_equal(one.history[0], whole.history[p])
        assert np.array_equal(one.failed[0], whole.failed[p])
        assert np.array_equal(one.tangents[0], whole.tangents[whole.tangent_index[p]])
    # Points at which nothing softens share the tangent of the intact cell.
    calm = ~whole.history.any(axis=1) & ~whole.failed.any(axis=1)
    assert calm.sum() >= 5 and len(set(whole.tangent_index[calm])) == 1


def test_fibres_fail_by_elimination_beside_a_softening_matrix() -> None:
    evaluator = Evaluator(composite())
    for along, failed in ((0.0189, False), (0.0191, True)):
        answer = ask(evaluator, np.array([[along, 0.0, 0.0, 0.0, 0.0, 0.0]]))
        assert unpack_mask(answer.failed[0], 4)[0] == failed
        assert (answer.history[0, ::2] > 0.0).all() or along < STRENGTH / YOUNG


def test_stored_energy_beyond_the_crack_fails_at_once() -> None:
    """Three equal stresses store more than one: the element is short enough for one stress, too long for three."""
    cell = Cell(np.ones(1), np.ones(1), np.array([[0]]), (softening(),))
    evaluator = Evaluator(cell)
    strain = np.array([[1.0, 1.0, 1.0, 0.0, 0.0, 0.0]]) * STRENGTH / YOUNG
    answer = evaluator.evaluate(
        1.001 * strain, 300.0, np.zeros((1, 1), np.uint8), np.zeros((1, 2)), np.array([0.9 * LONGEST])
    )
    assert answer.failed.tolist() == [[1]]
    assert answer.stress[0, 0] == pytest.approx(1e-4 * 1.001 * STRENGTH, rel=1e-9)


@pytest.mark.parametrize(
    ("lengths", "message"),
    [
        (None, "element_length is missing; resin has a fracture_energy"),
        (np.full(2, 1e-4), r"element_length has shape \(2,\); it must have \(3,\)"),
        (np.array([1e-4, 0.0, 1e-4]), r"element_length\[1\] is 0.0 m; it must be finite and greater than 0"),
        (np.array([1e-4, 1e-4, np.nan]), r"element_length\[2\] is nan m"),
        (
            np.array([1e-4, 1.001 * LONGEST, 1e-4]),
            rf"element_length\[1\] is {1.001 * LONGEST:g} m; the most is {LONGEST:.6g} m, 2 E G_c / strength\^2 of re",
        ),
    ],
)
def test_lengths_that_cannot_be_are_named(lengths: NDArray[np.float64] | None, message: str) -> None:
    evaluator = Evaluator(Cell(np.ones(1), np.ones(1), np.array([[0]]), (softening(),)))
    with pytest.raises(ValueError, match=message):
        evaluator.evaluate(np.zeros((3, 6)), 300.0, np.zeros((3, 1), np.uint8), np.zeros((3, 2)), lengths)


def test_damage_that_is_not_finite_is_refused() -> None:
    evaluator = Evaluator(composite())
    history = np.zeros((2, evaluator.history_values))
    history[1, 3] = np.nan
    with pytest.raises(ValueError, match=r"history\[1\] holds a value that is not finite"):
        evaluator.evaluate(np.zeros((2, 6)), 300.0, np.zeros((2, 1), np.uint8), history, np.full(2, 1e-4))


def test_longest_element_of_a_layer_is_longer_by_its_share() -> None:
    cell = layered((0.25, 0.75), [0, 1])
    only_across = constant_material(
        "resin",
        isotropic_stiffness(YOUNG, 0.0),
        failures=(Failure("maximum_stress", (INF, STRENGTH, INF)),),
        fracture_energy=ENERGY,
    )
    cell = Cell(cell.heights, cell.widths, cell.phase, (only_across, elastic()))
    with pytest.raises(ValueError, match=rf"the most is {4.0 * LONGEST:.6g} m, .* of resin in 22 tension"):
        Evaluator(cell).evaluate(
            np.zeros((1, 6)), 300.0, np.zeros((1, 1), np.uint8), np.zeros((1, 2)), np.array([4.1 * LONGEST])
        )


def test_cells_that_cannot_soften_are_refused() -> None:
    bare = constant_material("bare", isotropic_stiffness(YOUNG, 0.3), fracture_energy=1.0)
    with pytest.raises(ValueError, match="fracture_energy of bare is of no use"):
        Evaluator(Cell(np.ones(1), np.ones(1), np.array([[0]]), (bare,)))
    one = np.array([[0]])
    with pytest.raises(ValueError, match="after_failure is 'floor'; a cell with fracture_energy takes gmc"):
        Evaluator(Cell(np.ones(1), np.ones(1), one, (softening(),), after_failure="floor"))
    with pytest.raises(ValueError, match="method is 'gmc_dense'; a cell with fracture_energy takes gmc"):
        Evaluator(Cell(np.ones(1), np.ones(1), one, (softening(),)), "gmc_dense")


def reduced(cell: Cell) -> Cell:
    """The same cell; its materials reduce their strength in long elements."""
    return dataclasses.replace(
        cell, materials=tuple(dataclasses.replace(one, reduces_strength=True) for one in cell.materials)
    )


@pytest.mark.parametrize("component", range(6))
@pytest.mark.parametrize("length", [1.5, 4.0, 30.0])
def test_a_long_element_has_the_strength_that_its_energy_allows(component: int, length: float) -> None:
    """It fails at sqrt(2 E G_c / l), Bazant and Oh, and what it then held is G_c for its area."""
    evaluator = Evaluator(reduced(Cell(np.ones(1), np.ones(1), np.array([[0]]), (softening(),), knock_down=1e-8)))
    lengths = np.array([length * LONGEST])
    modulus = YOUNG if component < 3 else 0.5 * YOUNG
    strength = np.sqrt(2.0 * modulus * ENERGY / lengths[0])
    assert strength < STRENGTH / (1.0 if component < 3 else np.sqrt(2.0))
    below, above = (
        ask_at(evaluator, factor * strength / modulus * axis(component), lengths) for factor in (0.999, 1.001)
    )
    assert below.stress[0, component] == pytest.approx(0.999 * strength, rel=1e-9)
    assert not below.failed.any() and not below.history.any()
    assert above.failed.tolist() == [[1]]
    spent = work(evaluator, axis(component), lengths, 1.05 * strength / modulus, 2000)
    assert spent[0] * lengths[0] == pytest.approx(ENERGY, rel=3e-3)


def ask_at(evaluator: Evaluator, strain: NDArray[np.float64], lengths: NDArray[np.float64]) -> Answer:
    return evaluator.evaluate(
        strain[None], 300.0, np.zeros((1, 1), np.uint8), np.zeros((1, evaluator.history_values)), lengths
    )


def test_a_reduced_strength_leaves_shorter_elements_as_they_are() -> None:
    cell = composite()
    strain = np.random.default_rng(6).normal(size=(40, 6)) * 0.012
    short = 0.9 * LONGEST
    one, other = (ask(Evaluator(each), strain, length=short) for each in (cell, reduced(cell)))
    for name in ("stress", "failed", "history", "tangents", "tangent_index"):
        assert np.array_equal(getattr(one, name), getattr(other, name)), name
    assert (one.history > 0.0).any()


def test_points_of_long_elements_that_hold_share_the_intact_tangent() -> None:
    evaluator = Evaluator(reduced(composite()))
    strain = np.random.default_rng(7).normal(size=(40, 6)) * 1e-4
    answer = ask(evaluator, strain, length=20.0 * LONGEST)
    assert len(answer.tangents) == 1 and not answer.failed.any()
    assert np.array_equal(answer.stress, ask(evaluator, strain, length=0.5 * LONGEST).stress)


def test_no_energy_is_safe_where_the_strength_depends_on_the_element() -> None:
    assert safe_energy(composite(), "gmc", 300.0) > 0.0
    assert safe_energy(reduced(composite()), "gmc", 300.0) == 0.0


def test_a_softening_subcell_has_failed_where_its_history_says_so() -> None:
    """A solver keeps the bits of a try that went too far; with the history of the start the damage comes back."""
    evaluator = Evaluator(composite(fibre_fails=False))
    strain = np.tile(0.012 * axis(1), (2, 1))
    start = ask(evaluator, strain)
    assert start.history.any() and not start.failed.any()
    beyond = ask(evaluator, 20.0 * strain, start)
    assert beyond.failed.any()
    tried = dataclasses.replace(start, failed=beyond.failed)
    back, expected = ask(evaluator, 1.01 * strain, tried), ask(evaluator, 1.01 * strain, start)
    for name in ("stress", "failed", "history", "tangents"):
        assert np.array_equal(getattr(back, name), getattr(expected, name)), name
    # With its own history it stays failed.
    assert np.array_equal(ask(evaluator, 0.1 * strain, beyond).failed, beyond.failed)


def test_damages_that_creep_settle_on_the_closed_form() -> None:
    """A layer in an element just short of its limit: each round of the repetition leaves 0.999 of the error."""
    evaluator = Evaluator(layered((0.3, 0.7), [0, 1]))
    length = 0.999 * LONGEST
    first, last = STRENGTH / YOUNG, 2.0 * ENERGY / (STRENGTH * length)
    for part in (0.2, 0.5, 0.8):
        factor = first + part * (last - first)
        answer = evaluator.evaluate(
            factor * axis(1)[None], 300.0, np.zeros((1, 1), np.uint8), np.zeros((1, 2)), np.array([length])
        )
        assert answer.stress[0, 1] == pytest.approx(STRENGTH * (1.0 - part), rel=1e-5)


def test_a_matrix_that_fails_at_once_beside_a_softening_fibre() -> None:
    """The repetition goes on by the failures of the matrix alone."""
    tough = dataclasses.replace(fibre(), fracture_energy=1e5)
    brittle = dataclasses.replace(softening(0.3), fracture_energy=None)
    cell = dataclasses.replace(composite(), materials=(tough, brittle))
    answer = ask(Evaluator(cell), 0.05 * axis(1)[None])
    assert unpack_mask(answer.failed[0], 4).tolist() == [False, True, True, True]
    assert not answer.history.any()


def test_a_matrix_without_energy_beside_fibres_with_one_fails_as_in_a_cell_that_softens_nowhere() -> None:
    brittle = dataclasses.replace(softening(), fracture_energy=None)
    strong = dataclasses.replace(fibre(), fracture_energy=1e5)
    phase = np.array([[0, 1], [1, 1]])
    mixed, sudden = (
        Evaluator(Cell(np.array([0.7, 0.3]), np.array([0.7, 0.3]), phase, (one, brittle), knock_down=1e-4))
        for one in (strong, fibre())
    )
    assert mixed.history_values > 0 and sudden.history_values == 0
    across = np.array([0.0, 1.0, 0.0, 0.0, 0.0, 0.0])
    found = drive(mixed, across, np.array([1e-4]), 0.03, 30)
    broken = 0
    for (_, soft), (_, hard) in zip(found, drive(sudden, across, np.array([1e-4]), 0.03, 30), strict=True):
        np.testing.assert_array_equal(soft.failed, hard.failed)
        np.testing.assert_allclose(soft.stress, hard.stress, rtol=1e-9, atol=1e-3)
        tangents = soft.tangents[soft.tangent_index], hard.tangents[hard.tangent_index]
        np.testing.assert_allclose(*tangents, rtol=1e-9, atol=1e-9 * np.abs(tangents[1]).max())
        broken = int(unpack_mask(soft.failed, 4).sum())
    assert broken == 3  # all of the matrix
