"""Points and grid: lattice and tabulated sweeps, threads, domains wider than a cell, shifted origins, lost points."""

from collections.abc import Sequence
from itertools import product
from typing import Any, get_args

import numpy as np
import pytest

from mpm_service import (
    Body,
    EdgeCondition,
    Grid,
    IsotropicElastic,
    MaterialPointSolver,
    NeoHookean,
    Scheme,
    SolverError,
    Traction,
    fill_rectangle,
    mapping,
    ordering,
    symmetry,
)
from mpm_service.material_points import HXX, HYY
from mpm_service.scheme import Integration, Interpolation

LAW = IsotropicElastic(1.0e9, 0.3, 1000.0)
C = LAW.pressure_wave_speed
BLOCK = fill_rectangle((0.0, 0.0), (8.0, 6.0), 1.0, 2, hole=((3.0, 2.0), (5.0, 4.0)))
GRID = Grid((-3.37, -3.21), 1.0, (16, 14))
TRANSFERS = [("flip", 1), ("pic", 1), ("xpic", 3), ("fmpm", 2)]


def shaken(
    body: Body, scheme: Scheme, grid: Grid = GRID, drift: Sequence[float] = (0.02, 0.013), **options: Any
) -> MaterialPointSolver:
    """Body with random velocities of a hundredth of the wave speed on top of a uniform one."""
    velocity = np.random.default_rng(1).normal(size=body.position.shape) * 1e-2 + drift
    return MaterialPointSolver(grid, body, LAW, 1.0, 0.15 / C, scheme=scheme, initial_velocity=velocity * C, **options)


def assert_alike(one: MaterialPointSolver, other: MaterialPointSolver, tolerance: float = 1e-12) -> None:
    for name in ("displacement", "velocity", "displacement_gradient", "stress"):
        a, b = getattr(one.points, name), getattr(other.points, name)
        np.testing.assert_allclose(a, b, rtol=0.0, atol=tolerance * np.abs(b).max(), err_msg=name)
    np.testing.assert_allclose(
        one.edge_reaction, other.edge_reaction, rtol=0.0, atol=tolerance * np.abs(other.edge_reaction).max(initial=0.0)
    )


def make_irregular(monkeypatch: pytest.MonkeyPatch, share: float = 1.0) -> None:
    """Let points be irregular near a share of all nodes."""
    sort = ordering.sort_points

    def sort_behind(
        rows: Any, ids: Any, row_of: Any, alive: Any, columns: Any, levels: Any, special: Any, *a: Any
    ) -> Any:
        special[: round(share * special.size)] = 1
        return sort(rows, ids, row_of, alive, columns, levels, special, *a)

    monkeypatch.setattr(ordering, "sort_points", sort_behind)


@pytest.mark.parametrize(
    ("interpolation", "integration"), list(product(get_args(Interpolation), get_args(Integration)))
)
def test_lattice_and_tabulated_sweeps_agree(
    interpolation: Interpolation, integration: Integration, monkeypatch: pytest.MonkeyPatch
) -> None:
    edges = [
        EdgeCondition("bottom", 1, (0.0, 1.0), (0.0, 0.01 * C)),
        EdgeCondition("left", 0, (0.0, 1.0), (0.0, 0.02 * C)),
    ]
    loads = [Traction("right", (1e5, 2e4))]
    for transfer, order in TRANSFERS:
        scheme = Scheme(interpolation, integration, transfer, order, period=2)  # type: ignore[arg-type]
        runs = []
        for irregular in (False, True):
            with monkeypatch.context() as patch:
                if irregular:
                    make_irregular(patch)
                solver = shaken(BLOCK, scheme, edge_conditions=edges, loads=loads)
                solver.advance(20)
            assert solver._mapping.regular == (0 if irregular else BLOCK.count)
            runs.append(solver)
        assert_alike(*runs)


@pytest.mark.parametrize("interpolation", get_args(Interpolation))
def test_two_threads_agree_with_one(interpolation: Interpolation, monkeypatch: pytest.MonkeyPatch) -> None:
    """12000 points in three chunks and many strips; they travel over a cell between the first and the last sort."""
    monkeypatch.setattr(mapping, "WORTH_SHARING", 1)
    body = fill_rectangle((0.0, 0.0), (60.0, 50.0), 1.0, 2)
    grid = Grid((-3.37, -3.21), 1.0, (68, 58))
    for scheme in (
        Scheme(interpolation),
        Scheme(interpolation, "usavg", "flip"),
        Scheme(interpolation, "usl", "xpic", 2),
    ):
        runs = [shaken(body, scheme, grid, (0.35, 0.3), threads=threads) for threads in (1, 2)]
        for run in runs:
            run.advance(30)
        assert runs[0].points.displacement.min() > 1.2
        assert_alike(*runs)


def test_two_threads_with_irregular_points_agree_with_one(monkeypatch: pytest.MonkeyPatch) -> None:
    body = fill_rectangle((0.0, 0.0), (60.0, 50.0), 1.0, 2)
    grid = Grid((-3.37, -3.21), 1.0, (68, 58))
    make_irregular(monkeypatch, 0.4)
    monkeypatch.setattr(mapping, "WORTH_SHARING", 1)
    runs = [shaken(body, Scheme("cpgimp"), grid, threads=threads) for threads in (1, 2)]
    for run in runs:
        assert 4096 < run._mapping.regular < 0.8 * body.count
        run.advance(20)
    assert_alike(*runs)


# ---- mass on nodes -----------------------------------------------------------------------------------------


def node_masses(solver: MaterialPointSolver) -> np.ndarray:
    solver._integration.gather_state()
    return solver._integration.nodes.momentum[:, 0]


@pytest.mark.parametrize("interpolation", get_args(Interpolation))
def test_nodes_carry_mass_and_centre_of_the_points(interpolation: Interpolation) -> None:
    solver = shaken(BLOCK, Scheme(interpolation))
    for _ in range(4):
        solver.advance(25)
        mass = node_masses(solver)
        total = solver.points.mass.sum()
        assert mass.sum() == pytest.approx(total, rel=1e-14)
        centre = mass @ GRID.node_positions() / total
        np.testing.assert_allclose(centre, solver.points.mass @ solver.points.position / total, rtol=1e-13)


def stretched(stretch: float, material: Any, **options: Any) -> MaterialPointSolver:
    """One point a cell, stretched along x from the start as a uniform strip would be."""
    body = fill_rectangle((0.0, 0.0), (6.0, 4.0), 1.0, 1)
    solver = MaterialPointSolver(
        Grid((-4.3, -4.2), 1.0, (22, 13)),
        body,
        material,
        1.0,
        0.1 / material.pressure_wave_speed,
        scheme=Scheme("cpgimp", transfer="flip"),
        **options,
    )
    state = solver.state()
    row = state["rows"]
    row[:, 0] *= stretch
    row[:, HXX] = stretch - 1.0
    material.update_stress(row, state["ids"], np.zeros((body.count, material.history_size)))
    solver.restore(state)
    solver._sort()
    return solver


def test_domains_wider_than_a_cell_keep_the_partition() -> None:
    law = NeoHookean(1.0e9, 0.3, 1000.0)
    solver = stretched(1.8, law)
    assert solver._mapping.regular == 0
    mass = node_masses(solver)
    assert mass.sum() == pytest.approx(solver.points.mass.sum(), rel=1e-14)
    # Domains of 1.8 cells tile the strip, so nodes well inside carry 1 / 1.8 of a full node's mass in x.
    place = solver.grid.node_positions()
    inside = (place[:, 0] > 1.0) & (place[:, 0] < 9.8) & (place[:, 1] > 1.0) & (place[:, 1] < 3.0)
    assert inside.sum() == 9 * 2
    np.testing.assert_allclose(mass[inside], 1000.0 / 1.8, rtol=1e-13)
    solver.advance(200)
    momentum = solver.points.mass @ solver.points.velocity
    energies = solver.energies()
    assert energies.kinetic > 0.05 * energies.strain  # it springs back, as one piece
    assert np.abs(momentum).max() < 1e-12 * solver.points.mass.sum() * np.sqrt(
        2.0 * energies.kinetic / solver.points.mass.sum()
    )


def test_stretched_domains_under_their_own_traction_stay_at_rest() -> None:
    """Uniform stress in wide domains, held by the traction that belongs to it: nothing moves."""
    law = NeoHookean(1.0e9, 0.3, 1000.0)
    at_rest = stretched(1.8, law)
    tau = at_rest.points.kirchhoff_stress[0]
    # First Piola stress P = tau F^-T is the dead traction on each reference face.
    loads = [
        Traction("left", (-tau[0] / 1.8, 0.0)),
        Traction("right", (tau[0] / 1.8, 0.0)),
        Traction("bottom", (0.0, -tau[1])),
        Traction("top", (0.0, tau[1])),
    ]
    solver = stretched(1.8, law, loads=loads)
    solver.advance(50)
    assert np.abs(solver.points.velocity).max() < 1e-10 * C
    np.testing.assert_allclose(solver.points.kirchhoff_stress, np.broadcast_to(tau, (24, 3)), atol=1e-9 * tau[0])


def test_domain_wider_than_four_cells_is_a_solver_error() -> None:
    body = fill_rectangle((0.0, 0.0), (1.0, 1.0), 1.0, 1)
    law = NeoHookean(1.0e9, 0.3, 1000.0)
    solver = MaterialPointSolver(Grid((-6.3, -6.2), 1.0, (14, 14)), body, law, 1.0, 0.1 / C, scheme=Scheme("cpgimp"))
    state = solver.state()
    state["rows"][:, HXX] = 4.2  # a domain of 5.2 cells touches more than six nodes in a row
    solver.restore(state)
    solver._sort()
    with pytest.raises(SolverError, match=r"material point 0 at .* wider than four cells"):
        solver.advance(1)


def test_points_a_round_off_wider_than_a_cell_fit_the_table() -> None:
    """Cell sizes of body and grid may differ by round-off; a domain of a cell then reaches over both its cell lines."""
    wide = 1.0 + 8e-10
    for dimension in (2, 3):
        body = fill_rectangle((-3e-10,) * dimension, (-3e-10 + 2.0 * wide,) * dimension, wide, 1)
        grid = Grid((-2.0,) * dimension, 1.0, (6,) * dimension)
        law = IsotropicElastic(1.0e9, 0.3, 1000.0, "three_dimensional" if dimension == 3 else "plane_strain")
        solver = MaterialPointSolver(grid, body, law, 1.0, 0.1 / law.pressure_wave_speed)
        mass = node_masses(solver)
        assert mass.sum() == pytest.approx(solver.points.mass.sum(), rel=1e-14)
        solver._mapping.tabulate(0)
        table = solver._mapping._table
        if dimension == 3:
            assert table.entries.max() <= table.node.shape[1]


# ---- shifted origins ---------------------------------------------------------------------------------------

SHIFTS = [(0.0, 0.0), (0.37, 0.0), (-0.25, 0.37), (0.5, 0.5), (0.013, 0.999)]


@pytest.mark.parametrize("interpolation", get_args(Interpolation))
@pytest.mark.parametrize("shift", SHIFTS)
def test_rigid_motion_is_exact_wherever_the_origin_lies(interpolation: Interpolation, shift: Sequence[float]) -> None:
    """Uniform velocity over 2.2 cells: no stress, no change of velocity, the same displacement of all points."""
    grid = Grid((-3.0 + shift[0], -3.0 + shift[1]), 1.0, (18, 14))
    for transfer in ("flip", "fmpm"):
        speed = np.array([0.05, 0.021]) * C
        solver = MaterialPointSolver(
            grid,
            BLOCK,
            LAW,
            1.0,
            0.4 / C,
            scheme=Scheme(interpolation, transfer=transfer),  # type: ignore[arg-type]
            initial_velocity=np.broadcast_to(speed, BLOCK.position.shape),
        )
        solver.advance(110)
        np.testing.assert_allclose(solver.points.velocity, np.broadcast_to(speed, BLOCK.position.shape), rtol=1e-11)
        assert np.abs(solver.points.displacement - speed * solver.time).max() < 1e-11
        assert np.abs(solver.points.stress).max() < 1e-11 * LAW.young


@pytest.mark.parametrize(
    ("interpolation", "shift"),
    [(kind, shift) for kind in ("ugimp", "cpgimp", "bspline") for shift in SHIFTS] + [("linear", SHIFTS[0])],
)
def test_static_patch_test_wherever_the_origin_lies(interpolation: Interpolation, shift: Sequence[float]) -> None:
    """A uniform stress between four held faces stays as it is, at every point.

    Linear functions are exact where points sample cells evenly up to the face, so for the aligned grid alone. The
    tolerance is the round-off of the forces that cancel; that of cpGIMP is second order in the strain, since its
    domains have grown by the strain while the held faces have not moved.
    """
    grid = Grid((-3.0 + shift[0], -3.0 + shift[1]), 1.0, (17, 14))
    body = fill_rectangle((0.0, 0.0), (8.0, 6.0), 1.0)
    strain = 2e-7
    for integration, transfer in (("musl", "fmpm"), ("usl", "flip"), ("usavg", "xpic")):
        edges = [symmetry(edge) for edge in ("left", "right", "bottom", "top")]  # type: ignore[arg-type]
        solver = MaterialPointSolver(
            grid,
            body,
            LAW,
            1.0,
            0.15 / C,
            edges,
            scheme=Scheme(interpolation, integration, transfer),  # type: ignore[arg-type]
        )
        state = solver.state()
        state["rows"][:, [HXX, HYY]] = strain
        LAW.update_stress(state["rows"], state["ids"], np.zeros((body.count, 0)))
        solver.restore(state)
        before = solver.points.stress
        expected = 2.0 * (LAW.lame + LAW.shear_modulus) * strain
        np.testing.assert_allclose(before[:, :2], expected, rtol=1e-6)
        solver.advance(200)
        tolerance = strain if interpolation == "cpgimp" else 1e-14
        np.testing.assert_allclose(solver.points.stress, before, rtol=0.0, atol=tolerance * expected)
        assert np.abs(solver.points.displacement).max() < tolerance


#: Largest error of a point's stress over the stress, with the default scheme on the aligned grid and off it.
#: The nodal velocity at a face is the mean over points on one side only, wherever a node's cell is cut by the face.
DRIVEN = {"linear": (2e-6, None), "ugimp": (1e-7, 0.015), "cpgimp": (1e-13, 0.015), "bspline": (1e-7, 0.002)}


@pytest.mark.parametrize(
    ("interpolation", "shift"),
    [(kind, shift) for kind in ("ugimp", "cpgimp", "bspline") for shift in SHIFTS] + [("linear", SHIFTS[0])],
)
def test_driven_patch_test_within_discretisation(interpolation: Interpolation, shift: Sequence[float]) -> None:
    """A uniform strain rate through the faces gives every point the same strain."""
    grid = Grid((-3.0 + shift[0], -3.0 + shift[1]), 1.0, (17, 14))
    body = fill_rectangle((0.0, 0.0), (8.0, 6.0), 1.0)
    exx, eyy, steps = 2e-7, -1e-7, 60
    dt = 0.3 / C
    end = steps * dt
    edges = [
        EdgeCondition("left", 0, (0.0, end), (0.0, 0.0)),
        EdgeCondition("right", 0, (0.0, end), (0.0, 8.0 * exx)),
        EdgeCondition("bottom", 1, (0.0, end), (0.0, 0.0)),
        EdgeCondition("top", 1, (0.0, end), (0.0, 6.0 * eyy)),
    ]
    solver = MaterialPointSolver(
        grid,
        body,
        LAW,
        1.0,
        dt,
        edges,
        initial_velocity_gradient=[[exx / end, 0.0], [0.0, eyy / end]],
        scheme=Scheme(interpolation),
    )
    solver.advance(steps)
    lame, shear = LAW.lame, LAW.shear_modulus
    expected = [lame * (exx + eyy) + 2 * shear * exx, lame * (exx + eyy) + 2 * shear * eyy, 0.0]
    bound = DRIVEN[interpolation][0 if shift == SHIFTS[0] else 1]
    assert bound is not None
    assert np.abs(solver.points.stress - expected).max() < bound * expected[0]
    assert np.abs(solver.points.stress.mean(axis=0) - expected).max() < 0.1 * bound * expected[0] + 1e-12


@pytest.mark.parametrize("interpolation", get_args(Interpolation))
def test_vibration_does_not_depend_on_the_origin(interpolation: Interpolation) -> None:
    """Frequency of a confined bar of 20 cells, fixed at one end, from closed form; for each place of the grid."""
    length = 20.0
    frequencies = []
    for shift in SHIFTS:
        body = fill_rectangle((0.0, 0.0), (length, 2.0), 1.0)
        edges = [EdgeCondition(e, a, (0.0,), (0.0,)) for e, a in (("left", 0), ("bottom", 1), ("top", 1))]  # type: ignore[arg-type]
        mode = np.sin(0.5 * np.pi * body.position[:, 0] / length)
        solver = MaterialPointSolver(
            Grid((-3.0 + shift[0], -3.0 + shift[1]), 1.0, (29, 10)),
            body,
            LAW,
            1.0,
            0.4 / C,
            edges,
            scheme=Scheme(interpolation, transfer="flip"),
            initial_velocity=np.stack([1e-5 * C * mode, np.zeros(body.count)], axis=1),
        )
        signal = []
        for _ in range(round(2.2 * 4.0 * length / 0.4)):
            solver.advance(1)
            signal.append(float(mode @ solver.points.displacement[:, 0]))
        values = np.array(signal)
        up = np.flatnonzero((values[:-1] < 0.0) & (values[1:] >= 0.0))
        crossing = up - values[up] / (values[up + 1] - values[up])
        frequencies.append(4.0 * length / (0.4 * (crossing[1] - crossing[0])) if crossing.size > 1 else 0.0)
    assert np.abs(np.array(frequencies) - 1.0).max() < 0.01


# ---- points that leave -------------------------------------------------------------------------------------


@pytest.mark.parametrize("interpolation", get_args(Interpolation))
def test_lost_points_are_counted_and_the_rest_goes_on(interpolation: Interpolation) -> None:
    """A body thrown at the border at 45 degrees: what is within a cell of it at a sort is lost, the rest goes on."""
    body = fill_rectangle((0.0, 0.0), (6.0, 6.0), 1.0)
    grid = Grid((-2.3, -2.4), 1.0, (14, 14))
    solver = MaterialPointSolver(
        grid,
        body,
        LAW,
        1.0,
        0.4 / C,
        scheme=Scheme(interpolation, transfer="flip"),
        initial_velocity=np.full(body.position.shape, 0.1 * C),
    )
    lost = [0]
    for _ in range(20):
        solver.advance(10)
        lost.append(solver.points_lost)
        alive = solver.points.alive
        assert solver.points_lost == np.count_nonzero(~alive)
        # Sorting comes after half a cell of way at the latest, so nothing alive is much nearer than half a cell.
        assert np.all(solver.points.position[alive] < grid.upper - 0.5)
        assert np.all(solver.points.position[alive] >= grid.lower + 1.0)
        reference = body.position[~alive] + 0.1 * C * solver.time
        assert np.all((reference > grid.upper - 1.0).any(axis=1))
    assert lost == sorted(lost)
    assert 0 < lost[-1] < body.count
    solver.advance(2000)
    assert solver.points_lost == body.count
    assert solver.energies().kinetic == 0.0
