"""Evaluation at many points against a slow one at one point, and its properties."""

from __future__ import annotations

import dataclasses
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from failing_cells import evaluate_slowly, random_cell, two_by_two
from numpy.typing import NDArray

import gmc_service.mask_table
from gmc_service import high_fidelity
from gmc_service.cell import Cell
from gmc_service.evaluation import Answer, Evaluator
from gmc_service.failed_cell import connected
from gmc_service.gmc_dense import homogenise
from gmc_service.mask_table import mask_bytes, pack_mask, unpack_mask
from gmc_service.material import Failure, Material, Plasticity, constant_material, isotropic_stiffness

NONE = np.zeros(1, dtype=np.uint8)


def ask(
    evaluator: Evaluator,
    strain: NDArray[np.float64],
    temperature: float = 300.0,
    failed: NDArray[np.uint8] | None = None,
) -> Answer:
    """Evaluate points that are intact unless masks are given."""
    if failed is None:
        failed = np.zeros((len(strain), evaluator.failed_bytes), dtype=np.uint8)
    return evaluator.evaluate(strain, temperature, failed, np.zeros((len(strain), evaluator.history_values)))


def strains(seed: int, count: int, size: float = 0.01) -> NDArray[np.float64]:
    """Random strains from none up to some times `size`."""
    random = np.random.default_rng(seed)
    return random.normal(size=(count, 6)) * size * random.uniform(0.0, 1.5, (count, 1))


def same(a: Answer, b: Answer) -> None:
    """Assert that two answers have the same bits."""
    assert np.array_equal(a.stress, b.stress)
    assert np.array_equal(a.failed, b.failed)
    assert np.array_equal(a.tangent_index, b.tangent_index)
    assert np.array_equal(a.tangents, b.tangents)


@pytest.mark.parametrize(
    "cell",
    [
        two_by_two(),
        two_by_two(heated=True),
        random_cell(1, 2, 3),
        random_cell(2, 3, 3),
        random_cell(3, 3, 2, coupled=True),
        random_cell(4, 3, 4, coupled=True),
    ],
    ids=["seed", "seed, heated", "2x3", "3x3, 9 bits", "coupled 3x2", "coupled 3x4"],
)
@pytest.mark.parametrize("temperature", [300.0, 370.0])
def test_answers_are_those_of_the_slow_evaluation(cell: Cell, temperature: float) -> None:
    evaluator = Evaluator(cell)
    random = np.random.default_rng(7)
    strain = strains(3, 120)
    before = random.random((120, cell.subcells)) < random.choice([0.0, 0.2], (120, 1))
    answer = ask(evaluator, strain, temperature, pack_mask(before))
    flags = unpack_mask(answer.failed, cell.subcells)
    assert len(answer.tangents) > 5
    for point in range(120):
        stress, failed, tangent = evaluate_slowly(cell, strain[point], temperature, before[point])
        assert flags[point].tolist() == failed.tolist()
        assert np.abs(answer.stress[point] - stress).max() < 1e-9 * max(np.abs(stress).max(), 1e3)
        own = answer.tangents[answer.tangent_index[point]]
        assert np.abs(own - tangent).max() < 1e-9 * np.abs(tangent).max()


def test_compact_and_dense_layouts_are_equal() -> None:
    cell = random_cell(2, 3, 3)
    compact, dense = Evaluator(cell), Evaluator(cell)
    dense._compact = False
    strain = strains(4, 2000)
    a, b = ask(compact, strain, 340.0), ask(dense, strain, 340.0)
    assert np.array_equal(a.failed, b.failed)
    assert np.array_equal(a.tangents, b.tangents)
    assert np.array_equal(a.tangent_index, b.tangent_index)
    assert np.abs(a.stress - b.stress).max() < 1e-13 * np.abs(a.stress).max()


def test_compiled_and_readable_tables_are_equal() -> None:
    """The dense method fills its table in plain Python, entry by entry; the reduced one compiled."""
    cell = random_cell(2, 3, 3)
    compiled, readable = Evaluator(cell), Evaluator(cell, "gmc_dense")
    strain = strains(4, 500)
    for temperature in (300.0, 340.0):
        a, b = ask(compiled, strain, temperature), ask(readable, strain, temperature)
        assert np.array_equal(a.failed, b.failed)
        assert np.array_equal(a.tangent_index, b.tangent_index)
        assert np.abs(a.tangents - b.tangents).max() < 1e-11 * np.abs(a.tangents).max()
        assert np.abs(a.stress - b.stress).max() < 1e-11 * np.abs(a.stress).max()


def test_batch_equals_single_points_whatever_the_split() -> None:
    cell = random_cell(2, 3, 3)
    strain = strains(5, 600)
    whole = ask(Evaluator(cell), strain)
    for parts in (2, 7, 600):
        evaluator = Evaluator(cell)  # with tables that grow in another order
        answers = [ask(evaluator, part) for part in np.array_split(strain, parts)[::-1]][::-1]
        assert np.array_equal(whole.stress, np.concatenate([a.stress for a in answers]))
        assert np.array_equal(whole.failed, np.concatenate([a.failed for a in answers]))
        tangents = np.concatenate([a.tangents[a.tangent_index] for a in answers])
        assert np.array_equal(whole.tangents[whole.tangent_index], tangents)
    same(whole, ask(evaluator, strain))


def test_tangents_are_distinct_and_in_order_of_first_use() -> None:
    answer = ask(Evaluator(random_cell(2, 3, 3)), strains(6, 3000))
    _, first = np.unique(answer.tangent_index, return_index=True)
    assert (np.diff(first) > 0).all() and len(first) == len(answer.tangents) > 10
    assert len({tangent.tobytes() for tangent in answer.tangents}) == len(answer.tangents)


def test_arguments_stay_as_they_are_and_may_be_read_only() -> None:
    evaluator = Evaluator(two_by_two())
    strain, failed, history = strains(1, 50, 0.02), np.zeros((50, 1), dtype=np.uint8), np.zeros((50, 0))
    kept = strain.copy()
    for array in (strain, failed, history):
        array.flags.writeable = False
    answer = evaluator.evaluate(strain, 300.0, failed, history)
    assert np.array_equal(strain, kept) and not failed.any() and answer.failed.any()
    same(answer, ask(evaluator, strain))


def test_unloading_and_loading_again_keep_what_has_failed() -> None:
    evaluator = Evaluator(two_by_two())
    along = np.array([[0.016, 0.0, 0.0, 0.0, 0.0, 0.0]])
    loaded = ask(evaluator, along)
    assert loaded.failed.tolist() == [[0b0110]]
    unloaded = ask(evaluator, 0.5 * along, failed=loaded.failed)
    assert unloaded.failed.tolist() == [[0b0110]]
    assert unloaded.stress[0] == pytest.approx(0.5 * loaded.stress[0], rel=1e-14)
    again = ask(evaluator, along, failed=unloaded.failed)
    assert np.array_equal(again.stress, loaded.stress)


def test_failure_follows_from_stress_of_temperature_alone() -> None:
    cell = two_by_two(heated=True)
    evaluator = Evaluator(cell)
    still = np.zeros((1, 6))
    assert not ask(evaluator, still, 300.0).failed.any()
    assert not ask(evaluator, still, 300.0).stress.any()
    cold = ask(evaluator, still, 2.0)
    expected = evaluate_slowly(cell, still[0], 2.0, np.zeros(4, dtype=bool))
    assert unpack_mask(cold.failed[0], 4).tolist() == expected[1].tolist()
    assert expected[1].any()


def test_each_temperature_has_its_own_stiffness() -> None:
    stiffness = np.array([isotropic_stiffness(4e9, 0.3), isotropic_stiffness(2e9, 0.3)])
    matrix = Material("soft when hot", np.array([200.0, 400.0]), stiffness, np.zeros((2, 6)))
    cell = Cell(np.ones(1), np.ones(1), np.array([[0]]), (matrix,))
    evaluator = Evaluator(cell)
    strain = strains(1, 4)
    for temperature, young in ((200.0, 4e9), (300.0, 3e9), (400.0, 2e9), (200.0, 4e9)):
        stress = ask(evaluator, strain, temperature).stress
        assert np.allclose(stress, strain @ isotropic_stiffness(young, 0.3), rtol=1e-12)
    with pytest.raises(ValueError, match="temperature is 401 K; the table of soft when hot goes from 200 to 400 K"):
        ask(evaluator, strain, 401.0)


def test_localised_fields_average_to_the_answer() -> None:
    cell = random_cell(2, 3, 3)
    evaluator = Evaluator(cell)
    strain = strains(9, 40)
    answer = ask(evaluator, strain, 350.0)
    stress, local = evaluator.localise(strain, 350.0, answer.failed, answer.history)
    shares = cell.volume_fractions()
    assert np.allclose(np.einsum("n,pni->pi", shares, stress), answer.stress, rtol=1e-9, atol=1.0)
    assert np.allclose(np.einsum("n,pni->pi", shares, local), strain, rtol=0.0, atol=1e-12)
    assert np.array_equal(
        evaluator.homogenised(350.0, answer.failed[3]).stiffness, answer.tangents[answer.tangent_index[3]]
    )


def test_a_cell_of_676_subcells() -> None:
    random = np.random.default_rng(0)
    base = two_by_two()
    phase = (random.random((26, 26)) < 0.5).astype(np.int64)
    cell = Cell(random.uniform(0.5, 1.5, 26), random.uniform(0.5, 1.5, 26), phase, base.materials)
    evaluator = Evaluator(cell)
    assert evaluator.failed_bytes == mask_bytes(676) == 85
    strain = strains(2, 12, 0.01)
    answer = ask(evaluator, strain)
    flags = unpack_mask(answer.failed, 676)
    assert 0 < flags.sum() < flags.size
    assert not np.unpackbits(answer.failed, axis=1, bitorder="little")[:, 676:].any()
    # After the cascade no intact subcell is at its limit, by the dense answer of the final state.
    for point in (0, 5, 11):
        factor = np.where(flags[point], cell.knock_down, 1.0)
        stiffness = cell.stiffness_at(300.0) * factor[:, None, None]
        stress, local = evaluator.localise(strain[[point]], 300.0, answer.failed[[point]], answer.history[[point]])
        assert np.allclose(stress[0], np.einsum("nij,nj->ni", stiffness, local[0]))
        matrix = (cell.phase.reshape(-1) == 1) & ~flags[point]
        assert (stress[0, matrix, :3] < 118.67e6).all()
        assert (np.abs(stress[0, matrix, 3:]) < 118.67e6 / np.sqrt(3.0)).all()
        assert (local[0, (cell.phase.reshape(-1) == 0) & ~flags[point], 0] < 0.019).all()
        mean = np.einsum("n,ni->i", cell.volume_fractions(), stress[0])
        assert np.allclose(mean, answer.stress[point], rtol=1e-9, atol=1e-3)


def test_a_small_table_gives_the_same_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    cell = random_cell(2, 3, 3)
    strain = strains(11, 4000)
    whole = ask(Evaluator(cell), strain)
    assert len(whole.tangents) > 12
    monkeypatch.setattr(gmc_service.mask_table, "TABLE_BYTES", 1)
    monkeypatch.setattr(gmc_service.mask_table, "LEAST_ENTRIES", 8)
    evaluator = Evaluator(cell)
    same(whole, ask(evaluator, strain))
    same(whole, ask(evaluator, strain))
    table = evaluator._tables[300.0]
    assert table.snapshot.count <= table.limit == 8
    assert table.snapshot.generation > 2


def test_threads_that_ask_at_once_get_the_same_answers(monkeypatch: pytest.MonkeyPatch) -> None:
    cell = random_cell(2, 3, 3)
    parts = [strains(seed, 1500) for seed in range(8)]
    alone = [ask(Evaluator(cell), part, 300.0 + 10.0 * (k % 2)) for k, part in enumerate(parts)]
    monkeypatch.setattr(gmc_service.mask_table, "TABLE_BYTES", 1)
    monkeypatch.setattr(gmc_service.mask_table, "LEAST_ENTRIES", 16)
    evaluator = Evaluator(cell)
    with ThreadPoolExecutor(4) as pool:
        together = list(pool.map(lambda k: ask(evaluator, parts[k], 300.0 + 10.0 * (k % 2)), range(8)))
    for a, b in zip(alone, together, strict=True):
        same(a, b)


def test_tables_of_many_temperatures_are_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    evaluator = Evaluator(two_by_two(heated=True))
    monkeypatch.setattr("gmc_service.evaluation.CACHE_BYTES", 200_000)
    strain = strains(1, 20)
    first = ask(evaluator, strain, 250.0)
    for temperature in np.linspace(260.0, 340.0, 60):
        ask(evaluator, strain, float(temperature))
    assert 1 < len(evaluator._tables) < 30
    assert 250.0 not in evaluator._tables and 340.0 in evaluator._tables
    same(first, ask(evaluator, strain, 250.0))


def test_no_points_are_an_answer_too() -> None:
    answer = ask(Evaluator(two_by_two()), np.zeros((0, 6)))
    assert answer.stress.shape == (0, 6) and answer.tangents.shape == (0, 6, 6)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"strain": np.zeros((2, 5))}, r"strain has shape \(2, 5\); it must have \(points, 6\)"),
        ({"strain": np.full((2, 6), np.nan)}, r"strain\[0\] is \[nan, .*every component must be finite"),
        ({"strain": np.full((2, 6), np.inf)}, "every component must be finite"),
        ({"failed": np.zeros((1, 1), np.uint8)}, r"failed has shape \(1, 1\); it must have \(2, 1\)"),
        ({"failed": np.zeros((2, 1), np.int64)}, "failed has type int64; it must be uint8"),
        ({"failed": np.array([[0], [16]], np.uint8)}, r"failed\[1\] is \[16\]; bits beyond the 4 subcells must be 0"),
        ({"history": np.zeros((2, 3))}, r"history has shape \(2, 3\); it must have \(2, 0\)"),
        ({"temperature": float("nan")}, "temperature is nan K"),
        ({"temperature": -1.0}, "temperature is -1.0 K; it must be finite and 0 or greater"),
    ],
)
def test_bad_input_is_named(change: dict[str, object], message: str) -> None:
    evaluator = Evaluator(two_by_two())
    arguments: dict[str, object] = {
        "strain": np.zeros((2, 6)),
        "temperature": 300.0,
        "failed": np.zeros((2, 1), np.uint8),
        "history": np.zeros((2, 0)),
    }
    with pytest.raises(ValueError, match=message):
        evaluator.evaluate(**(arguments | change))  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=message):
        evaluator.localise(**(arguments | change))  # type: ignore[arg-type]
    assert not ask(evaluator, np.zeros((2, 6))).failed.any()
    with pytest.raises(ValueError, match="method is 'fem'"):
        Evaluator(two_by_two(), "fem")


def test_a_bit_beyond_the_subcells_is_refused_by_every_kind_of_cell() -> None:
    base = two_by_two()
    energy = {"fracture_energy": 100.0}
    for change in ({}, energy, {"plasticity": Plasticity(4e7)}):
        matrix = dataclasses.replace(base.materials[1], **change)  # type: ignore[arg-type]
        evaluator = Evaluator(dataclasses.replace(base, materials=(base.materials[0], matrix)))
        failed, history = np.array([[16]], np.uint8), np.zeros((1, evaluator.history_values))
        with pytest.raises(ValueError, match=r"failed\[0\] is \[16\]; bits beyond the 4 subcells must be 0"):
            evaluator.evaluate(np.zeros((1, 6)), 300.0, failed, history, np.full(1, 1e-6))
        with pytest.raises(ValueError, match=r"failed\[0\] is \[16\]; bits beyond the 4 subcells must be 0"):
            evaluator.homogenised(300.0, failed[0])


def test_a_material_without_allowables_never_fails() -> None:
    cell = Cell(np.ones(1), np.ones(1), np.array([[0]]), (constant_material("steel", isotropic_stiffness(2e11, 0.3)),))
    strain = strains(1, 10, 1.0)
    answer = ask(Evaluator(cell), strain)
    assert not answer.failed.any()
    assert np.allclose(answer.stress, strain @ isotropic_stiffness(2e11, 0.3), rtol=1e-12)


def test_equal_subcells_fail_together() -> None:
    weak = constant_material(
        "weak", isotropic_stiffness(3e9, 0.3), failures=(Failure("maximum_stress", tension=(1e7, 1e7, 1e7)),)
    )
    cell = Cell(np.array([0.3, 0.7, 0.1]), np.array([0.2, 0.9]), np.zeros((3, 2), dtype=np.int64), (weak,))
    evaluator = Evaluator(cell)
    at_limit = 1e7 / isotropic_stiffness(3e9, 0.3)[0, 0]
    for factor, failed in ((1.0 - 1e-8, 0), (1.0, 6), (1.0 + 1e-12, 6)):
        answer = ask(evaluator, np.array([[at_limit * factor, 0.0, 0.0, 0.0, 0.0, 0.0]]))
        assert unpack_mask(answer.failed, 6).sum() == failed


def test_shear_stiffness_after_a_failure() -> None:
    """Plain GMC loses G23 with one subcell; with the floor it stays near the finite elements' value."""
    mask = np.array([0b1000], dtype=np.uint8)  # the matrix corner, 5 % of the area
    shear = {
        rule: Evaluator(two_by_two(rule)).homogenised(300.0, mask).stiffness[3, 3]
        for rule in ("gmc", "floor", "high_fidelity")
    }
    intact = Evaluator(two_by_two()).homogenised(300.0, NONE).stiffness[3, 3]
    share = two_by_two().volume_fractions()[3]
    corner = isotropic_stiffness(2.963e9, 0.36)[3, 3]
    series = 1.0 / (1.0 / intact + share * (1e4 - 1.0) / corner)
    assert shear["gmc"] == pytest.approx(series, rel=1e-9)
    assert shear["gmc"] < 1e-3 * intact
    assert shear["floor"] == pytest.approx(shear["high_fidelity"], rel=0.2)
    beside = np.array([0b0010], dtype=np.uint8)  # the matrix on one side of the fibre, 17 %
    floor, fine = (
        Evaluator(two_by_two(r)).homogenised(300.0, beside).stiffness[3, 3] for r in ("floor", "high_fidelity")
    )
    assert floor == pytest.approx(fine, rel=0.2)


def test_high_fidelity_answers_once_something_has_failed() -> None:
    cell = two_by_two("high_fidelity")
    evaluator = Evaluator(cell)
    strain = np.array([[0.005, 0.0, 0.0, 0.001, 0.0, 0.0], [0.0, 0.008, 0.0, 0.001, 0.0, 0.0]])
    answer = ask(evaluator, strain)
    assert not answer.failed[0].any() and answer.failed[1].any()
    plain = Evaluator(two_by_two())
    assert np.allclose(answer.stress[0], ask(plain, strain[:1]).stress[0], rtol=1e-12, atol=1e-6)
    factor = np.where(unpack_mask(answer.failed[1], 4), cell.knock_down, 1.0)[:, None, None]
    fine = high_fidelity.homogenise(cell.heights, cell.widths, cell.stiffness_at(300.0) * factor, np.zeros((4, 6)))
    assert np.allclose(answer.stress[1], fine.stiffness @ strain[1], rtol=1e-9, atol=1.0)
    stress, _ = evaluator.localise(strain, 300.0, answer.failed, answer.history)
    assert np.allclose(np.einsum("n,pni->pi", cell.volume_fractions(), stress), answer.stress, rtol=1e-6, atol=1e3)


@pytest.mark.parametrize(
    ("there", "expected"),
    [
        (["11", "11"], True),
        (["11", "10"], True),  # one row and one column remain
        (["10", "10"], False),  # a column: cut off from its neighbours along axis 3
        (["11", "00"], False),
        (["10", "01"], False),  # corners do not hold
        (["1"], True),
        (["0"], False),
        (["110", "011", "101"], False),  # a stair that closes on itself in one direction
        (["111", "100", "100"], True),
        (["011", "110", "100", "111"], True),
    ],
)
def test_intact_part_that_connects_a_cell(there: list[str], expected: bool) -> None:
    grid = np.array([[letter == "1" for letter in row] for row in there])
    for turned in (grid, grid.T, np.roll(grid, 1, axis=0), np.roll(grid, 1, axis=1)):
        assert connected(turned) == expected


def test_floor_keeps_the_fields_consistent_and_falls_where_the_cell_is_cut() -> None:
    cell = two_by_two("floor")
    evaluator = Evaluator(cell)
    for mask in range(16):
        failed = unpack_mask(np.array([mask], dtype=np.uint8), 4)
        answer = evaluator.homogenised(300.0, np.array([mask], dtype=np.uint8))
        assert np.linalg.eigvalsh(answer.stiffness)[0] > 0.0
        mean = np.einsum("n,nij->ij", cell.volume_fractions(), answer.concentration)
        assert np.allclose(mean, np.eye(6), atol=1e-10)
        strain = np.random.default_rng(mask).normal(size=(1, 6)) * 1e-3
        stress, _ = evaluator.localise(strain, 300.0, np.array([[mask]], np.uint8), np.zeros((1, 0)))
        assert np.allclose(np.einsum("n,pni->pi", cell.volume_fractions(), stress), strain @ answer.stiffness)
        assert np.allclose(stress[0, :, 3], stress[0, 0, 3], rtol=1e-9)
        # A row or a column of two intact subcells each way: only the masks of one failed subcell, and none, have it.
        whole = failed.sum() <= 1
        stiffness = cell.stiffness_at(300.0) * np.where(failed, cell.knock_down, 1.0)[:, None, None]
        plain = homogenise(cell.heights, cell.widths, stiffness, cell.expansion_at(300.0)).stiffness[3, 3]
        if whole and mask:
            assert 5.0 * plain < answer.stiffness[3, 3] < evaluator.homogenised(300.0, NONE).stiffness[3, 3]
        else:
            assert answer.stiffness[3, 3] == pytest.approx(plain, rel=1e-9)
