"""Transfers and integration schemes: their algebra from dense matrices, what they keep, what they dissipate."""

from itertools import product
from typing import Any, get_args

import numpy as np
import pytest

from mpm_service import (
    Damping,
    EdgeCondition,
    Grid,
    IsotropicElastic,
    MaterialPointSolver,
    NeoHookean,
    Scheme,
    fill_rectangle,
    fill_region,
)
from mpm_service.material_points import HXX, SXX
from mpm_service.scheme import HIGHEST_ORDER, Integration, Interpolation, Transfer
from mpm_service.shape_functions import shape_functions

LAW = IsotropicElastic(1.0e9, 0.3, 1000.0)
C = LAW.pressure_wave_speed
GRID = Grid((-3.37, -3.21), 1.0, (16, 14))
BLOCK = fill_rectangle((0.0, 0.0), (8.0, 6.0), 1.0, 2, hole=((3.0, 2.0), (5.0, 4.0)))
VELOCITY = (np.random.default_rng(1).normal(size=BLOCK.position.shape) * 1e-3 + [0.02, 0.013]) * C
COMBINATIONS = list(product(get_args(Interpolation), get_args(Integration)))
TRANSFERS: list[tuple[Transfer, int]] = [("flip", 1), ("pic", 1), ("xpic", 3), ("fmpm", 2), ("fmpm", 4)]


def block(scheme: Scheme, **options: Any) -> MaterialPointSolver:
    options = {"initial_velocity": VELOCITY} | options
    return MaterialPointSolver(GRID, BLOCK, LAW, 1.0, 0.1 / C, scheme=scheme, **options)


# ---- the algebra of the transfers --------------------------------------------------------------------------


def with_random_stress(solver: MaterialPointSolver) -> MaterialPointSolver:
    state = solver.state()
    rng = np.random.default_rng(5)
    state["rows"][:, HXX : HXX + 4] = 1e-3 * rng.normal(size=(BLOCK.count, 4))[state["ids"]]
    LAW.update_stress(state["rows"], state["ids"], np.zeros((BLOCK.count, 0)))
    solver.restore(state)
    return solver


@pytest.mark.parametrize("integration", ["musl", "usl"])
@pytest.mark.parametrize("interpolation", get_args(Interpolation))
def test_one_step_against_dense_matrices(interpolation: Interpolation, integration: Integration) -> None:
    """S, S+ and Q_k as matrices, from the public shape functions; schemes that update stress last share this step."""
    start = with_random_stress(block(Scheme(interpolation, integration, "flip")))
    half = np.full((BLOCK.count, 2), 0.25)
    if interpolation == "cpgimp":
        half = 0.25 * np.linalg.norm(start.points.deformation_gradient, axis=2)
    node, weight, gradient = shape_functions(GRID, start.points.position, half, interpolation)
    points = np.arange(BLOCK.count)[:, None]
    s, slope = np.zeros((BLOCK.count, GRID.node_count)), np.zeros((2, BLOCK.count, GRID.node_count))
    np.add.at(s, (points, node), weight)
    for axis in (0, 1):
        np.add.at(slope[axis], (points, node), gradient[:, :, axis])
    used = s.sum(axis=0) > 1e-30
    s, slope = s[:, used], slope[:, :, used]
    point_mass = start.points.mass
    mass = point_mass @ s
    back = (s * point_mass[:, None]).T / mass[:, None]
    xx, yy, xy = start.points.reference_volume * start.points.kirchhoff_stress.T
    force = -np.stack([xx @ slope[0] + xy @ slope[1], xy @ slope[0] + yy @ slope[1]], axis=1)
    old = back @ VELOCITY
    new = old + start.time_step * force / mass[:, None]

    def filtered(u: np.ndarray, k: int) -> np.ndarray:
        loss = np.eye(mass.size) - back @ s
        return sum(np.linalg.matrix_power(loss, j) @ u for j in range(k))

    expected = {
        ("flip", 1): VELOCITY + s @ (new - old),
        ("pic", 1): s @ new,
        ("xpic", 2): s @ (filtered(old, 2) + new - old),
        ("xpic", 5): s @ (filtered(old, 5) + new - old),
        ("fmpm", 2): s @ filtered(new, 2),
        ("fmpm", 3): s @ filtered(new, 3),
        ("fmpm", 6): s @ filtered(new, 6),
    }
    for (transfer, order), velocity in expected.items():
        solver = with_random_stress(block(Scheme(interpolation, integration, transfer, order)))  # type: ignore[arg-type]
        solver.advance(1)
        np.testing.assert_allclose(solver.points.velocity, velocity, rtol=0.0, atol=1e-12 * C, err_msg=transfer)
        carrier = filtered(new, order) if transfer == "fmpm" else new
        np.testing.assert_allclose(
            solver.points.displacement, solver.time_step * s @ carrier, rtol=0.0, atol=1e-13, err_msg=transfer
        )
    assert np.abs(expected["flip", 1] - VELOCITY).max() > 1e-5 * C  # the stress has acted


@pytest.mark.parametrize(("interpolation", "integration"), COMBINATIONS)
def test_fmpm_1_and_xpic_1_are_pic(interpolation: Interpolation, integration: Integration) -> None:
    """Also at faces that move and are held, and with damping."""
    edges = [EdgeCondition("bottom", 1, (0.0, 1.0), (0.0, 0.01 * C)), EdgeCondition("left", 0, (0.0,), (0.0,))]
    runs = []
    for transfer in ("pic", "xpic", "fmpm"):
        scheme = Scheme(interpolation, integration, transfer, 1)  # type: ignore[arg-type]
        runs.append(block(scheme, edge_conditions=edges, damping=Damping(0.002 * C, 0.001 * C)))
        runs[-1].advance(10)
    for run in runs[1:]:
        for name in ("velocity", "displacement", "stress"):
            reference = getattr(runs[0].points, name)
            found = getattr(run.points, name)
            np.testing.assert_allclose(found, reference, rtol=0.0, atol=1e-12 * np.abs(reference).max(), err_msg=name)


@pytest.mark.parametrize("transfer", [("pic", 1), ("xpic", 2), ("fmpm", 2)])
def test_steps_between_two_filtered_ones_are_flip(transfer: tuple[Transfer, int]) -> None:
    flip, periodic, filtering = (
        block(Scheme("ugimp", "musl", *choice)) for choice in (("flip", 1), (*transfer, 3), transfer)
    )
    flip.advance(2)
    periodic.advance(2)
    np.testing.assert_array_equal(periodic.points.velocity, flip.points.velocity)
    state = flip.state()
    state["configuration"] = filtering.state()["configuration"]
    filtering.restore(state)
    filtering.advance(1)
    periodic.advance(1)
    for name in ("velocity", "position", "stress"):
        np.testing.assert_array_equal(getattr(periodic.points, name), getattr(filtering.points, name))
    flip.advance(1)
    assert np.abs(flip.points.velocity - periodic.points.velocity).max() > 1e-6 * C
    assert [periodic.scheme.filters(step) for step in range(6)] == [False, False, True, False, False, True]


# ---- what is kept ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("interpolation", "integration"), COMBINATIONS)
def test_momentum_is_kept_to_round_off(interpolation: Interpolation, integration: Integration) -> None:
    for transfer, order in TRANSFERS:
        solver = block(Scheme(interpolation, integration, transfer, order))
        before = solver.points.mass @ solver.points.velocity
        # Points that cross cell lines leave near-empty nodes, which USL with linear functions does not stand.
        solver.advance(20 if (interpolation, integration) == ("linear", "usl") else 60)
        after = solver.points.mass @ solver.points.velocity
        assert np.abs(solver.points.stress).max() > 1e-5 * LAW.young
        scale = solver.points.mass @ np.abs(VELOCITY)
        assert np.abs(after - before).max() < 2e-14 * scale.max(), (transfer, order)


def spinning_disk(scheme: Scheme, turn: float) -> tuple[float, float, float]:
    """Share of angular momentum and energy that a free disk of radius 6 cells keeps, and its change of momentum."""
    radius, rim = 6.0, 0.05
    body = fill_region((0.0, 0.0), (14.0, 14.0), 1.0, lambda x: np.hypot(*(x - 7.0).T) < radius)
    law = NeoHookean(1.0e9, 0.3, 1000.0)
    speed = law.pressure_wave_speed
    arm = body.position - 7.0
    spin = rim * speed / radius
    solver = MaterialPointSolver(
        Grid((-2.2, -2.1), 1.0, (19, 19)),
        body,
        law,
        1.0,
        0.4 / speed,
        scheme=scheme,
        initial_velocity=spin * np.stack([-arm[:, 1], arm[:, 0]], axis=1),
    )

    def figures() -> tuple[float, float, np.ndarray]:
        x, v, mass = solver.points.position, solver.points.velocity, solver.points.mass
        energies = solver.energies()
        swing = mass @ (x[:, 0] * v[:, 1] - x[:, 1] * v[:, 0])
        return float(swing), energies.kinetic + energies.strain, mass @ v

    before = figures()
    solver.advance(round(2.0 * np.pi * turn / spin / solver.time_step))
    after = figures()
    drift = np.abs(after[2] - before[2]).max() / (solver.points.mass.sum() * rim * speed)
    return after[0] / before[0], after[1] / before[1], float(drift)


@pytest.mark.parametrize("interpolation", ["ugimp", "cpgimp"])
def test_flip_keeps_angular_momentum_and_energy_of_a_spinning_disk(interpolation: Interpolation) -> None:
    """A quarter turn of about 470 steps; points cross cells. The law says 1; regression: 0.9796 and 1.0003.

    The spin that is missing is in the shear of the outermost cells, where lumped masses sit off the points' centre.
    """
    swing, energy, drift = spinning_disk(Scheme(interpolation, transfer="flip"), 0.25)
    assert swing == pytest.approx(0.9796, abs=0.003)
    assert abs(energy - 1.0) < 0.005
    assert drift < 1e-13


def vibration_energies(scheme: Scheme) -> np.ndarray:
    """Energy of a confined bar of 20 cells after each half period of mode 1 over that at the start."""
    length, courant = 20.0, 0.4
    body = fill_rectangle((0.0, 0.0), (length, 2.0), 1.0)
    mode = np.sin(0.5 * np.pi * body.position[:, 0] / length)
    edges = [EdgeCondition(e, a, (0.0,), (0.0,)) for e, a in (("left", 0), ("bottom", 1), ("top", 1))]  # type: ignore[arg-type]
    solver = MaterialPointSolver(
        Grid((-3.0, -3.0), 1.0, (26, 8)),
        body,
        LAW,
        1.0,
        courant / C,
        edges,
        scheme=scheme,
        initial_velocity=np.stack([1e-5 * C * mode, np.zeros(body.count)], axis=1),
    )
    start = solver.energies().kinetic
    out = []
    for _ in range(12):
        solver.advance(round(2.0 * length / courant))
        energies = solver.energies()
        out.append((energies.kinetic + energies.strain) / start)
    return np.array(out)


@pytest.mark.parametrize("interpolation", get_args(Interpolation))
def test_flip_keeps_and_filters_take_energy_monotonically(interpolation: Interpolation) -> None:
    flip = vibration_energies(Scheme(interpolation, transfer="flip"))
    assert np.abs(flip - 1.0).max() < 2e-3
    pic, fmpm = (vibration_energies(Scheme(interpolation, transfer=name)) for name in ("pic", "fmpm"))  # type: ignore[arg-type]
    for energy in (pic, fmpm):
        assert np.all(np.diff(np.concatenate([[1.0], energy])) < 0.0)
    assert pic[-1] < 0.9
    assert fmpm[-1] > 0.99


# ---- choosing a scheme -------------------------------------------------------------------------------------


def test_default_is_ugimp_musl_fmpm_2() -> None:
    assert Scheme() == Scheme("ugimp", "musl", "fmpm", 2, 1)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"interpolation": "cubic"}, "Scheme.interpolation = 'cubic': allowed are linear, ugimp, cpgimp, bspline"),
        ({"integration": "rk4"}, "Scheme.integration = 'rk4': allowed are musl"),
        ({"transfer": "apic"}, "Scheme.transfer = 'apic': allowed are fmpm"),
        ({"order": 0}, "Scheme.order = 0: a whole number from 1 to 20"),
        ({"order": HIGHEST_ORDER + 1}, "Scheme.order = 21"),
        ({"order": 1.5}, "Scheme.order = 1.5"),
        ({"period": 0}, "Scheme.period = 0"),
        ({"period": True}, "Scheme.period = True"),
    ],
)
def test_bad_scheme_is_named(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Scheme(**options)


def test_stress_column_is_the_one_the_dense_test_reads() -> None:
    solver = with_random_stress(block(Scheme()))
    state = solver.state()
    np.testing.assert_array_equal(state["rows"][:, SXX], solver.points.kirchhoff_stress[state["ids"], 0])
