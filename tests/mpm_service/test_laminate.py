"""The law of laminates: lamination theory, failure of the cell in each ply, books of energy, and strips that break."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from laminate_cell import CELLS, LibraryCell, neat
from numpy.typing import NDArray

from gmc_service.cell import Cell
from gmc_service.cell_file import read_cell
from gmc_service.failure_path import failure_path
from gmc_service.material import Failure, constant_material, isotropic_stiffness
from mpm_service import (
    Constant,
    Damping,
    EdgeCondition,
    Grid,
    Laminate,
    MaterialPointSolver,
    Scheme,
    fill_rectangle,
    symmetry,
)
from mpm_service.laminate import IN_PLANE, OUT_OF_PLANE
from mpm_service.material import GRADIENT_2D, STRESS_2D, VOLUME_2D

DENSITY = 1600.0


@pytest.fixture(scope="module")
def cell() -> Cell:
    return neat()


def ply_stiffness(cell: Cell, angle: float) -> NDArray[np.float64]:
    """Reduced stiffness of a turned ply, from its engineering constants by the textbook's formulas (Jones)."""
    compliance = np.linalg.inv(LibraryCell(cell).stiffness)
    young_1, young_2, shear = 1.0 / compliance[0, 0], 1.0 / compliance[1, 1], 1.0 / compliance[5, 5]
    poisson = -compliance[0, 1] * young_1
    less = 1.0 - poisson**2 * young_2 / young_1
    q11, q22, q12, q66 = young_1 / less, young_2 / less, poisson * young_2 / less, shear
    c, s = np.cos(angle), np.sin(angle)
    b11 = q11 * c**4 + 2.0 * (q12 + 2.0 * q66) * s**2 * c**2 + q22 * s**4
    b22 = q11 * s**4 + 2.0 * (q12 + 2.0 * q66) * s**2 * c**2 + q22 * c**4
    b12 = (q11 + q22 - 4.0 * q66) * s**2 * c**2 + q12 * (s**4 + c**4)
    b66 = (q11 + q22 - 2.0 * q12 - 2.0 * q66) * s**2 * c**2 + q66 * (s**4 + c**4)
    b16 = (q11 - q12 - 2.0 * q66) * s * c**3 + (q12 - q22 + 2.0 * q66) * s**3 * c
    b26 = (q11 - q12 - 2.0 * q66) * s**3 * c + (q12 - q22 + 2.0 * q66) * s * c**3
    return np.array([[b11, b12, b16], [b12, b22, b26], [b16, b26, b66]])


def rows_of(gradient: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rows of a point table of volume 1 with displacement gradients (n, 4)."""
    rows = np.zeros((len(gradient), 16))
    rows[:, GRADIENT_2D : GRADIENT_2D + 4] = gradient
    rows[:, VOLUME_2D] = 1.0
    return rows


def stress_of(rows: NDArray[np.float64]) -> NDArray[np.float64]:
    return rows[:, STRESS_2D : STRESS_2D + 3]


@pytest.mark.parametrize("degrees", [[0], [30], [0, 90, 90, 0], [45, 0, -45, 90, 90, -45, 0, 45]])
def test_membrane_stiffness_is_that_of_lamination_theory(cell: Cell, degrees: list[float]) -> None:
    angles = np.radians(degrees)
    law = Laminate(LibraryCell(cell), angles, DENSITY)
    expected = np.mean([ply_stiffness(cell, angle) for angle in angles], axis=0)
    assert np.allclose(law.stiffness, expected, rtol=1e-12, atol=1e-12 * expected.max())
    strain = 1e-6 * np.array([[1.0, 0.3, -0.2]])
    rows = rows_of(np.array([[strain[0, 0], 0.5 * strain[0, 2], 0.5 * strain[0, 2], strain[0, 1]]]))
    history = law.start_history(1)
    law.update_stress(rows, np.arange(1), history)
    assert np.allclose(stress_of(rows), strain @ expected, rtol=0.0, atol=2e-6 * np.abs(strain @ expected).max())
    assert law.strain_energy(rows, np.arange(1), history)[0] == pytest.approx(0.5 * strain[0] @ expected @ strain[0])
    assert np.allclose(law.tangent(rows, np.arange(1), history)[0], expected, rtol=1e-12, atol=1e-12 * expected.max())


def test_plies_of_one_direction_are_kept_once(cell: Cell) -> None:
    law = Laminate(LibraryCell(cell), np.radians([0, 90, -90, 180, 45]), DENSITY)
    assert np.degrees(law.directions) == pytest.approx([0.0, 90.0, 45.0])
    expected = np.mean([ply_stiffness(cell, angle) for angle in np.radians([0, 90, 90, 0, 45])], axis=0)
    assert np.allclose(law.stiffness, expected, rtol=1e-12, atol=1e-12 * expected.max())


def test_wave_speed_is_that_along_the_stiffer_axis(cell: Cell) -> None:
    law = Laminate(LibraryCell(cell), [0.0], DENSITY)
    assert law.pressure_wave_speed == pytest.approx(np.sqrt(ply_stiffness(cell, 0.0)[0, 0] / DENSITY), rel=1e-12)


def test_failed_plies_have_no_stress_out_of_the_plane_and_nothing_left_to_fail(cell: Cell) -> None:
    """After any path the state is one that the cell itself, asked at the strain of each ply, finds at rest."""
    rng = np.random.default_rng(3)
    library = LibraryCell(read_cell(CELLS / "im7_epon862_oht.toml"))
    law = Laminate(library, np.radians([0.0, 50.0]), DENSITY)
    points = 200
    rows, ids, history = rows_of(np.zeros((points, 4))), np.arange(points), law.start_history(points)
    way = rng.normal(size=(points, 4))
    for _ in range(60):
        rows[:, GRADIENT_2D : GRADIENT_2D + 4] += 1e-3 * rng.random((points, 1)) * way
        law.update_stress(rows, ids, history)
    shares = law.failed_share(history)
    assert shares.min() == 0.0 and shares.max() == 1.0 and len(np.unique(shares)) > 2
    h = rows[:, GRADIENT_2D : GRADIENT_2D + 4]
    total = np.zeros((points, 3))
    for direction, angle in enumerate(law.directions):
        c, s = np.cos(angle), np.sin(angle)
        tensor = np.stack([h[:, 0], 0.5 * (h[:, 1] + h[:, 2]), 0.5 * (h[:, 1] + h[:, 2]), h[:, 3]], 1).reshape(-1, 2, 2)
        axes = np.array([[c, s], [-s, c]])
        turned = axes @ tensor @ axes.T
        plies = law._plies(history)[:, direction]
        strain = np.zeros((points, 6))
        strain[:, IN_PLANE] = np.stack([turned[:, 0, 0], turned[:, 1, 1], 2.0 * turned[:, 0, 1]], axis=1)
        strain[:, OUT_OF_PLANE] = np.einsum("nij,nj->ni", plies[:, :9].reshape(-1, 3, 3), strain[:, IN_PLANE])
        answer = library.evaluate(strain, plies[:, 18:].astype(np.uint8), np.zeros((points, 0)), np.ones(points))
        assert np.array_equal(answer.failed, plies[:, 18:])
        assert np.abs(answer.stress[:, OUT_OF_PLANE]).max() < 1e-9 * np.abs(answer.stress).max()
        own = answer.stress[:, IN_PLANE]
        stress = np.stack([own[:, 0], own[:, 2], own[:, 2], own[:, 1]], axis=1).reshape(-1, 2, 2)
        back = axes.T @ stress @ axes
        total += 0.5 * np.stack([back[:, 0, 0], back[:, 1, 1], back[:, 0, 1]], axis=1)
    forward = np.eye(2) + h.reshape(-1, 2, 2)
    nominal = np.stack([total[:, 0], total[:, 2], total[:, 2], total[:, 1]], axis=1).reshape(-1, 2, 2)
    kirchhoff = nominal @ forward.transpose(0, 2, 1)
    kirchhoff = 0.5 * (kirchhoff + kirchhoff.transpose(0, 2, 1))
    expected = np.stack([kirchhoff[:, 0, 0], kirchhoff[:, 1, 1], kirchhoff[:, 0, 1]], axis=1)
    assert np.allclose(stress_of(rows), expected, rtol=1e-10, atol=1e-10 * np.abs(expected).max())


def test_a_turned_laminate_under_turned_strain_fails_alike(cell: Cell) -> None:
    """Fibres at 30 degrees under a strain turned by as much: the same states, and the stress turned."""
    rng = np.random.default_rng(5)
    turn = np.radians(30.0)
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    points = 100
    way = rng.normal(size=(points, 2, 2))
    way = 0.5 * (way + way.transpose(0, 2, 1))
    found = []
    for turned in (False, True):
        law = Laminate(LibraryCell(cell), np.array([0.0, 0.5 * np.pi]) + turn * turned, DENSITY)
        rows, history = rows_of(np.zeros((points, 4))), law.start_history(points)
        for step in range(1, 40):
            gradient = 5e-4 * step * way
            if turned:
                gradient = rotation @ gradient @ rotation.T
            rows[:, GRADIENT_2D : GRADIENT_2D + 4] = gradient.reshape(-1, 4)
            law.update_stress(rows, np.arange(points), history)
        found.append(
            (law.failed_share(history), stress_of(rows).copy(), law.dissipated(rows, np.arange(points), history))
        )
    assert found[0][0].max() == 1.0
    assert np.array_equal(found[0][0], found[1][0])
    assert np.allclose(found[0][2], found[1][2], rtol=1e-9)
    plain = found[0][1][:, [0, 2, 2, 1]].reshape(-1, 2, 2)
    expected = (rotation @ plain @ rotation.T).reshape(-1, 4)[:, [0, 3, 1]]
    assert np.allclose(found[1][1], expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())


def test_work_is_what_is_stored_and_what_failures_took(cell: Cell) -> None:
    """The trapezoidal sum of stress times strain along a fine path, against the law's own two energies."""
    law = Laminate(LibraryCell(cell), [0.0, 0.5 * np.pi], DENSITY)
    steps = 400
    way = np.array([[0.024, 0.001, 0.001, -0.002]])
    rows, history, ids = rows_of(np.zeros((1, 4))), law.start_history(1), np.arange(1)
    # Nominal stress of the first Piola-Kirchhoff kind is what works on the gradient.
    work, before = 0.0, np.zeros(4)
    for step in range(1, steps + 1):
        rows[:, GRADIENT_2D : GRADIENT_2D + 4] = way * step / steps
        law.update_stress(rows, ids, history)
        forward = np.eye(2) + way.reshape(2, 2) * step / steps
        tau = stress_of(rows)[0, [0, 2, 2, 1]].reshape(2, 2)
        nominal = (tau @ np.linalg.inv(forward).T).reshape(4)
        work += 0.5 * (nominal + before) @ way[0] / steps
        before = nominal
    stored, lost = law.strain_energy(rows, ids, history)[0], law.dissipated(rows, ids, history)[0]
    assert law.failed_share(history).max() == 1.0
    assert lost > 0.5 * stored
    assert stored + lost == pytest.approx(work, rel=1e-9)


def strip(law: Laminate, speed: float, steps: int, rate: float) -> MaterialPointSolver:
    """A strip of 8 x 2 cells, 4 mm long, that is pulled along x from a start that moves with its ends."""
    size = 5e-4
    body = fill_rectangle((0.0, 0.0), (8 * size, 2 * size), size)
    grid = Grid((-3 * size, -3 * size), size, (15, 8))
    conditions = [symmetry("left"), symmetry("bottom"), EdgeCondition("right", 0, velocities=Constant(speed))]
    gradient = [[speed / (8 * size), 0.0], [0.0, 0.0]]
    time_step = 0.03 / (speed / (8 * size)) / steps
    return MaterialPointSolver(
        grid, body, law, 1e-3, time_step, conditions, damping=Damping(grid_rate=rate),
        initial_velocity_gradient=gradient,
    )  # fmt: skip


def pulled(law: Laminate, end: float) -> tuple[float, float]:
    """Highest nominal stress of a strip [Pa] and the strain there."""
    speed = 0.5
    solver = strip(law, speed, 8000, 1e5)
    section = 1e-3 * 1e-3
    best = (0.0, 0.0)
    while (strain := speed * solver.time / 4e-3) < end:
        solver.advance(8)
        best = max(best, (solver.edge_reaction[2] / section, strain))
    return best


@pytest.mark.parametrize("degrees", [0.0, 90.0])
def test_strip_breaks_at_the_strength_of_its_cell(cell: Cell, degrees: float) -> None:
    """Peak of a [0] and a [90] strip within 1 % of the cell's in uniaxial stress, which needs no step (GMC library)."""
    component = "eps11" if degrees == 0.0 else "eps22"
    path = failure_path(cell, component, 0.03, "free")
    along = path.stress[:, 0 if degrees == 0.0 else 1]
    strength, breaks = along.max(), path.strain[int(along.argmax())]
    stress, strain = pulled(Laminate(LibraryCell(cell), [np.radians(degrees)], DENSITY), 1.15 * breaks)
    assert stress == pytest.approx(strength, rel=0.01)
    assert strain == pytest.approx(breaks, rel=0.01)


def test_sparing_queries_changes_no_bit(cell: Cell) -> None:
    states, counts = [], []
    for spare in (True, False):
        law = Laminate(LibraryCell(cell, spare=spare), np.radians([0.0, 90.0, 45.0, -45.0]), DENSITY)
        solver = strip(law, 2.0, 3000, 0.0)
        solver.advance(1500)
        states.append(solver.state())
        counts.append((law.queried, law.spared, law.failed_share(solver.histories[0]).max()))
    assert counts[0][1] > 0 and counts[1][1] == 0 and counts[0][2] > 0.0
    assert all(np.array_equal(states[0][name], states[1][name]) for name in states[0])


def test_run_goes_on_bit_for_bit(cell: Cell) -> None:
    solver = strip(Laminate(LibraryCell(cell), np.radians([0.0, 90.0]), DENSITY), 2.0, 3000, 1e5)
    solver.advance(1000)
    kept = solver.state()
    solver.advance(500)
    other = strip(Laminate(LibraryCell(cell), np.radians([0.0, 90.0]), DENSITY), 2.0, 3000, 1e5)
    other.restore(kept)
    other.advance(500)
    one, two = solver.state(), other.state()
    assert other.materials[0].failed_share(other.histories[0]).max() > 0.0  # type: ignore[attr-defined]
    assert all(np.array_equal(one[name], two[name]) for name in one)


def test_books_of_a_strip_that_breaks_close(cell: Cell) -> None:
    """Kinetic, stored, damped, filtered and dissipated energy against the work of the edges."""
    law = Laminate(LibraryCell(cell), np.radians([0.0, 90.0]), DENSITY)
    solver = strip(law, 0.5, 8000, 1e5)
    start = solver.energies()

    def missing() -> tuple[float, float]:
        """What the books miss by, and what failures took, over the work."""
        end = solver.energies()
        held = end.kinetic + end.strain - start.kinetic - start.strain
        taken = end.damping_loss + end.dissipated + end.filter_loss
        return (held + taken) / end.edge_work - 1.0, end.dissipated / end.edge_work

    solver.advance(2400)  # the matrix of the 90 degree ply has failed
    rest, lost = missing()
    assert lost > 0.03 and abs(rest) < 1e-5
    solver.advance(3200)  # all has: what is left is stretched by a tenth, and the law is one of small strain
    rest, lost = missing()
    assert lost > 0.3 and abs(rest) < 5e-3


@pytest.mark.parametrize(
    ("changes", "word"),
    [
        ({"angles": []}, "angles"),
        ({"angles": [np.inf]}, "angles"),
        ({"density": 0.0}, "density"),
        ({"assumption": "plane_strain"}, "assumption"),
    ],
)
def test_bad_input_is_named(cell: Cell, changes: dict[str, object], word: str) -> None:
    given = {"cell": LibraryCell(cell), "angles": [0.0], "density": DENSITY, **changes}
    with pytest.raises(ValueError, match=f"^{word}"):
        Laminate(**given)  # type: ignore[arg-type]


def test_a_point_that_is_turned_inside_out_is_named(cell: Cell) -> None:
    law = Laminate(LibraryCell(cell), [0.0], DENSITY)
    rows = rows_of(np.array([[0.0, 0.0, 0.0, 0.0], [-1.5, 0.0, 0.0, 0.0]]))
    with pytest.raises(RuntimeError, match="Laminate has no stress for point 7"):
        law.update_stress(rows, np.array([3, 7]), law.start_history(8))


def angles_of(*degrees: float) -> Sequence[float]:
    return np.radians(degrees).tolist()


def test_knock_down_is_what_a_failed_ply_keeps(cell: Cell) -> None:
    """A [0] ply whose fibre and matrix have all failed keeps the knock-down factor of its intact stiffness."""
    soft = replace(cell, knock_down=1e-2)
    law = Laminate(LibraryCell(soft), angles_of(0.0), DENSITY)
    rows, history, ids = rows_of(np.zeros((1, 4))), law.start_history(1), np.arange(1)
    for step in range(1, 200):
        rows[0, GRADIENT_2D : GRADIENT_2D + 4] = 1e-3 * step * np.array([1.0, 0.5, 0.5, 1.0])
        law.update_stress(rows, ids, history)
    assert law.failed_share(history).min() == 1.0
    assert np.allclose(law.tangent(rows, ids, history)[0], 1e-2 * law.stiffness, rtol=1e-9, atol=1e-3)


@pytest.mark.parametrize("size", [8e-5, 4e-5])
def test_a_softening_bar_takes_its_fracture_energy_whatever_the_cell(size: float) -> None:
    """A bar with a weak column of cells: peak and energy are strength and fracture energy of what is left there.

    The bar is shorter than 2 E G / strength^2, so it breaks without snapping back; closed form.
    """
    young, strength, energy, weak, length = 3e9, 60e6, 200.0, 0.95, 0.32e-3
    limits = (strength, strength, strength)
    resin = constant_material(
        "resin", isotropic_stiffness(young, 0.0), fracture_energy=energy,
        failures=(Failure("maximum_stress", limits, limits, limits),),
    )  # fmt: skip
    law = Laminate(LibraryCell(Cell(np.ones(1), np.ones(1), np.zeros((1, 1), dtype=int), (resin,))), [0.0], 1200.0)
    cells, end = round(length / size), 3.6 * energy / strength
    body = fill_rectangle((0.0, 0.0), (length, 2 * size), size)
    middle = np.abs(body.position[:, 0] - (cells // 2 + 0.5) * size) < 0.5 * size
    body = replace(body, weight=np.where(middle, weak, 1.0))
    crossing = length / law.pressure_wave_speed
    steps = 20 * round(200 * crossing / (0.4 * size / law.pressure_wave_speed) / 20)
    speed = end / (200 * crossing)
    conditions = [symmetry("left"), symmetry("bottom"), symmetry("top")]
    solver = MaterialPointSolver(
        Grid((-3 * size, -3 * size), size, (cells + 7, 9)), body, law, 1e-3, 200 * crossing / steps,
        [*conditions, EdgeCondition("right", 0, velocities=Constant(speed))], scheme=Scheme(transfer="flip"),
        damping=Damping(grid_rate=0.2 / crossing), initial_velocity_gradient=[[speed / length, 0.0], [0.0, 0.0]],
    )  # fmt: skip
    section, peak = 2 * size * 1e-3, 0.0
    for _ in range(steps // 5):
        solver.advance(5)
        peak = max(peak, solver.edge_reaction[3] / section)
    assert peak == pytest.approx(weak * strength, rel=1e-2)
    assert solver.energies().dissipated == pytest.approx(weak * energy * section, rel=1e-3)
