"""Energy release rates, stress intensities and growth of cracks against closed forms of fracture mechanics."""

import numpy as np
import pytest

from mpm_service import (
    Crack,
    EdgeCondition,
    Grid,
    IsotropicElastic,
    MaterialPointSolver,
    Ramp,
    Step,
    Traction,
    fill_rectangle,
    symmetry,
)
from mpm_service.crack_growth import CrackGrowth, GrowthLaw, jump_behind
from mpm_service.fracture import (
    FractureFields,
    Intensities,
    TipFrame,
    closure_force,
    crack_extension_angle,
    fields_around,
    intensities_from_opening,
    interaction_intensities,
    j_integral,
    plane_constants,
    rates_between,
    stress_ahead,
    tip_gradient,
    vcct,
)
from mpm_service.verification import edge_crack

E, NU, RHO = 1.0e9, 0.3, 1000.0
LAW = IsotropicElastic(E, NU, RHO, "plane_strain")


def williams(
    opening: float, sliding: float, plane_stress: bool = False, angle: float = 0.0
) -> tuple[FractureFields, TipFrame]:
    """Points of a lattice of unit cells, four a cell, in the singular field of a tip inside a cell."""
    _, shear, kappa = plane_constants(E, NU, plane_stress)
    lame = shear * (3.0 - kappa) / (kappa - 1.0)
    x = 0.25 + 0.5 * np.arange(-24, 24)
    place = np.stack([part.ravel() for part in np.meshgrid(x, x)], axis=1)
    tip = TipFrame(np.array([0.03, 0.1]), np.array([np.cos(angle), np.sin(angle)]))
    h = tip_gradient(tip.local(place), opening, sliding, shear, kappa)
    stress = lame * np.trace(h, axis1=1, axis2=2)[:, None, None] * np.eye(2) + shear * (h + h.transpose(0, 2, 1))
    h, stress = tip.axes.T @ h @ tip.axes, tip.axes.T @ stress @ tip.axes
    area = np.full(place.shape[0], 0.25)
    energy = 0.5 * np.sum(h * stress, axis=(1, 2)) * area
    return FractureFields(place, h, stress, energy, np.zeros_like(place), RHO * area, area, np.eye(2)), tip


MODES = [(1e6, 0.0), (0.0, 1e6), (1e6, -5e5)]


def test_the_singular_field_is_that_of_its_intensities() -> None:
    _, shear, kappa = plane_constants(E, NU, False)
    lame = shear * (3.0 - kappa) / (kappa - 1.0)

    def stress(place: np.ndarray) -> np.ndarray:
        h = tip_gradient(np.array([place]), 2.0, 3.0, shear, kappa)[0]
        return lame * np.trace(h) * np.eye(2) + shear * (h + h.T)

    ahead = stress([0.5, 0.0])
    assert ahead[1, 1] == pytest.approx(2.0 / np.sqrt(np.pi), rel=1e-12)
    assert ahead[0, 1] == pytest.approx(3.0 / np.sqrt(np.pi), rel=1e-12)
    for side in (1e-9, -1e-9):
        assert np.abs(stress([-0.5, side])[:, 1]).max() < 1e-7


@pytest.mark.parametrize("modes", MODES)
@pytest.mark.parametrize("plane_stress", [False, True])
@pytest.mark.parametrize("angle", [0.0, 0.7])
def test_release_rate_and_intensities_of_the_singular_field(
    modes: tuple[float, float], plane_stress: bool, angle: float
) -> None:
    fields, tip = williams(*modes, plane_stress, angle)
    effective = plane_constants(E, NU, plane_stress)[0]
    exact = (modes[0] ** 2 + modes[1] ** 2) / effective
    for inner, outer in ((2.0, 6.0), (3.0, 9.0)):
        assert j_integral(fields, tip, inner, outer) == pytest.approx(exact, rel=2e-3)
        found = interaction_intensities(fields, tip, inner, outer, E, NU, plane_stress)
        assert found == pytest.approx(modes, abs=2e-3 * 1e6)
    path = np.array([tip.position, tip.position - 20.0 * tip.direction])
    straight = j_integral(fields, tip, 2.0, 6.0)
    assert j_integral(fields, tip, 2.0, 6.0, line=path) == pytest.approx(straight, rel=1e-9)


class Turned:
    """Points of a lattice in the singular field, turned as a whole, as a solver shows them."""

    def __init__(self, fields: FractureFields, turn: np.ndarray, speed: float = 0.0) -> None:
        f = turn @ (np.eye(2) + fields.gradient)
        tau = turn @ fields.stress @ f.transpose(0, 2, 1)
        self.alive = np.ones(fields.area.size, dtype=bool)
        self.reference_position = fields.position
        self.displacement_gradient = f - np.eye(2)
        self.kirchhoff_stress = np.stack([tau[:, 0, 0], tau[:, 1, 1], tau[:, 0, 1]], axis=1)
        self.velocity = np.broadcast_to(turn @ [speed, 0.0], fields.position.shape)
        # The upper half lies in an overlap: its points stand for more than they carry.
        self.weight = np.where(fields.position[:, 1] > 0.0, 0.3, 1.0)
        self.stiffness = np.where(fields.position[:, 1] > 0.0, 0.2, 1.0)
        self.strain_energy = self.stiffness * fields.energy
        self.mass = self.weight * fields.mass
        self.reference_volume = self.stiffness * fields.area


def test_what_is_measured_does_not_see_a_rotation_of_the_whole() -> None:
    # P F^T must be symmetric, as it is for any material: take the stress of the singular field for P F^T.
    fields, tip = williams(1e4, 2e3)
    first = np.linalg.solve(np.eye(2) + fields.gradient, fields.stress).transpose(0, 2, 1)
    fields = fields._replace(stress=first)
    found = []
    for angle in (0.0, 0.5 * np.pi, 2.5):
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        gathered = fields_around(Turned(fields, turn), 1.0, tip.position, 10.0)
        later = fields_around(Turned(fields, turn, 3e-3), 1.0, tip.position, 10.0)
        rates = rates_between(gathered, later, 1e-3)
        found.append(
            [
                j_integral(gathered, tip, 2.0, 6.0, rates),
                *interaction_intensities(gathered, tip, 2.0, 6.0, E, NU, False, rates),
                *vcct(gathered, tip, 1e-4, 2e-4, 5.0),
                *stress_ahead(gathered, tip, 1.0, 0.3, 1.0),
            ]
        )
    np.testing.assert_allclose(found[1], found[0], rtol=1e-7)
    np.testing.assert_allclose(found[2], found[0], rtol=1e-7)


def test_rates_do_not_see_how_the_two_states_were_turned_back() -> None:
    fields, tip = williams(1e4, 0.0)
    turns = [np.array([[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]]) for a in (0.4, 0.5)]
    before, after = (fields_around(Turned(fields, turn, 2.0), 1.0, tip.position, 10.0) for turn in turns)
    rates = rates_between(before, after, 0.1)
    inside = np.hypot(*(fields.position - tip.position).T) <= 10.0
    f = (np.eye(2) + fields.gradient)[inside]
    np.testing.assert_allclose(after.rotation @ rates.gradient_rate, (turns[1] - turns[0]) @ f / 0.1, atol=1e-9)
    np.testing.assert_allclose(rates.acceleration[0], after.rotation.T @ (turns[1] - turns[0]) @ [20.0, 0.0], atol=1e-9)


def test_a_uniform_field_has_no_release_rate_whatever_the_line() -> None:
    fields, tip = williams(1e6, 0.0)
    gradient = np.array([[1e-3, 2e-4], [-3e-4, 2e-3]])
    stress = np.array([[1e6, 4e5], [4e5, 3e6]])
    count = fields.area.size
    uniform = fields._replace(
        gradient=np.broadcast_to(gradient, (count, 2, 2)),
        stress=np.broadcast_to(stress, (count, 2, 2)),
        energy=1e3 * fields.area,
    )
    bent = np.array([tip.position, tip.position - [3.0, 0.0], tip.position - [10.0, 5.0]])
    size = 6.0 * np.sum(np.abs(gradient)) * 3e6
    assert abs(j_integral(uniform, tip, 2.0, 6.0)) < 1e-3 * size
    assert abs(j_integral(uniform, tip, 2.0, 6.0, line=bent)) < 1e-2 * size


def test_kinetic_terms_of_a_moving_field() -> None:
    """J of fields with known v, a, dH/dt: the two inertia terms are plain integrals of polynomials."""
    fields, tip = williams(0.0, 0.0)
    place = tip.local(fields.position)
    still = fields._replace(velocity=np.stack([np.full(place.shape[0], 2.0), np.zeros(place.shape[0])], axis=1))
    # Uniform velocity: T is uniform, its gradient with theta integrates to nothing.
    assert abs(j_integral(still, tip, 2.0, 6.0)) < 1e-3 * 0.5 * RHO * 4.0 * 2.0 * np.pi * 6.0
    # a = (1, 0) and H_11 = 1e-3: rho * 1e-3 times the integral of q, pi (in^2 + ...) by quadrature in r.
    r = np.linspace(0.0, 6.0, 60001)
    t = np.clip((r - 2.0) / 4.0, 0.0, 1.0)
    weight = float(np.trapezoid((1.0 - t * t * (3.0 - 2.0 * t)) * 2.0 * np.pi * r, r))
    stretched = fields._replace(gradient=np.broadcast_to([[1e-3, 0.0], [0.0, 0.0]], fields.gradient.shape))
    later = stretched._replace(velocity=stretched.velocity + np.array([0.5, 0.0]))
    rates = rates_between(stretched, later, 0.5)
    assert j_integral(stretched, tip, 2.0, 6.0, rates) == pytest.approx(RHO * 1e-3 * weight, rel=2e-3)
    # v = (2, 0) and dV = 0.3 / s: minus rho v V, same weight.
    faster = still._replace(gradient=still.gradient + 0.3 * np.array([[1.0, 0.0], [0.0, 0.0]]))
    rates = rates_between(still, faster, 1.0)
    kinetic = j_integral(still, tip, 2.0, 6.0, rates) - j_integral(still, tip, 2.0, 6.0)
    assert kinetic == pytest.approx(-RHO * 2.0 * 0.3 * weight, rel=2e-3)


def test_crack_closure_in_the_singular_field() -> None:
    for modes in MODES:
        fields, tip = williams(*modes, angle=0.7)
        length = 5.0
        effective = plane_constants(E, NU, False)[0]
        force = closure_force(fields, tip, length)
        exact = np.array(modes) * 4.0 / 3.0 * np.sqrt(length / (2.0 * np.pi))
        assert force == pytest.approx(exact, abs=0.02 * np.abs(exact).max())
        jump = 8.0 * np.array(modes) / effective * np.sqrt(length / (2.0 * np.pi))
        released = vcct(fields, tip, jump[0], jump[1], length)
        assert released == pytest.approx(np.array(modes) ** 2 / effective, abs=0.02 * 1e12 / effective)
        shared = intensities_from_opening(sum(np.array(modes) ** 2) / effective, jump[0], jump[1], E, NU, False)
        assert shared == pytest.approx(modes, rel=1e-12, abs=1e-3)


def test_faces_that_overlap_release_nothing_in_mode_one() -> None:
    fields, tip = williams(1e6, 0.0)
    assert vcct(fields, tip, -1e-6, 0.0, 5.0)[0] == 0.0


@pytest.mark.parametrize("modes", [(1.0, 0.0), (0.0, 1.0), (0.0, -1.0), (1.0, 1.0), (2.0, -1.0), (-1.0, 0.5)])
def test_the_angle_of_growth_has_the_largest_hoop_stress(modes: tuple[float, float]) -> None:
    """Against a search over all directions in the singular field itself."""
    _, shear, kappa = plane_constants(E, NU, False)
    lame = shear * (3.0 - kappa) / (kappa - 1.0)
    angles = np.linspace(-3.1, 3.1, 62001)
    h = tip_gradient(np.stack([np.cos(angles), np.sin(angles)], axis=1), *modes, shear, kappa)
    stress = lame * np.trace(h, axis1=1, axis2=2)[:, None, None] * np.eye(2) + shear * (h + h.transpose(0, 2, 1))
    across = np.stack([-np.sin(angles), np.cos(angles)], axis=1)
    hoop = np.einsum("ni,nij,nj->n", across, stress, across)
    assert crack_extension_angle(Intensities(*modes)) == pytest.approx(angles[np.argmax(hoop)], abs=2e-4)


def test_pure_sliding_kinks_by_the_known_angle() -> None:
    assert np.degrees(crack_extension_angle(Intensities(0.0, 1.0))) == pytest.approx(-70.5288, abs=1e-4)


def test_stress_ahead_is_that_of_a_uniform_field_in_any_direction() -> None:
    fields, tip = williams(1e6, 0.0)
    stress = np.array([[1e6, 4e5], [4e5, 3e6]])
    uniform = fields._replace(stress=np.broadcast_to(stress, fields.stress.shape))
    across = np.array([-np.sin(0.4), np.cos(0.4)])
    found = stress_ahead(uniform, tip, 1.0, 0.4, 1.0)
    assert found[0] == pytest.approx(across @ stress @ across, rel=1e-12)
    assert found[1] == pytest.approx(np.array([np.cos(0.4), np.sin(0.4)]) @ stress @ across, rel=1e-12)


def test_a_ring_that_does_not_fit_is_refused() -> None:
    fields, tip = williams(1e6, 0.0)
    with pytest.raises(ValueError, match="does not lie in the body"):
        j_integral(fields, tip, 2.0, 18.0)
    with pytest.raises(ValueError, match="another crack tip"):
        j_integral(fields, tip, 2.0, 6.0, other_tips=[[4.0, 0.0]])
    with pytest.raises(ValueError, match="inner < outer"):
        j_integral(fields, tip, 6.0, 6.0)
    mixed = fields._replace(area=fields.area * np.where(fields.position[:, 0] > 0.0, 1.6, 0.4))
    with pytest.warns(UserWarning, match="different size"):
        j_integral(mixed, tip, 2.0, 6.0)


def test_an_edge_crack_under_tension_against_tada() -> None:
    """The coarsest of the case mpm/edge-crack."""
    run = edge_crack.run_edge_crack(5)
    assert edge_crack.tada_release_rate() == pytest.approx(89.466, abs=1e-3)
    assert run.release_rate[0] == pytest.approx(edge_crack.tada_release_rate(), rel=0.04)
    assert run.contour_spread < 0.015
    assert run.intensities.opening == pytest.approx(edge_crack.tada_intensity(), rel=0.02)
    assert abs(run.intensities.sliding) < 1e-3 * run.intensities.opening


def test_a_suddenly_loaded_crack_against_freund() -> None:
    """Step waves from above and below meet at a half-infinite crack: K grows with the square root of time."""
    nu, half = 0.25, 20
    law = IsotropicElastic(E, nu, RHO, "plane_strain")
    c = law.pressure_wave_speed
    time_step = 0.4 / c
    pull = 1e4
    solver = MaterialPointSolver(
        Grid((-3.0, -half - 3.0), 1.0, (2 * half + 6, 2 * half + 7)),
        fill_rectangle((0.0, -float(half)), (2.0 * half, half + 1.0), 1.0),
        law,
        1.0,
        time_step,
        [symmetry("left"), symmetry("right")],
        [Crack(((-2.0, 0.5), (float(half), 0.5)))],
        loads=[Traction("top", (0.0, pull), Step()), Traction("bottom", (0.0, -pull), Step())],
    )
    growth = CrackGrowth(solver, interval=5)
    arrival = (half + 0.5) / c
    measured, exact = [], []
    while (solver.time - arrival) * c < 32.0:
        growth.advance(5)
        since = (solver.time - arrival) * c
        if since > 12.0:
            # Freund (1990), Sec 2.5, for a relieved stress of twice that of each wave.
            intensity = 2.0 * 2.0 * pull * np.sqrt((1.0 - 2.0 * nu) * since / np.pi) / (1.0 - nu)
            exact.append((1.0 - nu**2) / E * intensity**2)
            measured.append(growth.tips[0].release_rate)
    ratio = np.array(measured) / np.array(exact)
    assert ratio.mean() == pytest.approx(1.0, abs=0.04)
    assert np.abs(ratio - 1.0).max() < 0.10


def strip(growth: GrowthLaw | None, rate: float, line: float = 7.5) -> MaterialPointSolver:
    """Clamped strip of 44 x 15 cells, cracked along half of its middle, pulled apart at a steady rate."""
    return MaterialPointSolver(
        Grid((-4.0, -4.0), 1.0, (52, 23)),
        fill_rectangle((0.0, 0.0), (44.0, 15.0), 1.0),
        LAW,
        1.0,
        0.5 / LAW.pressure_wave_speed,
        [
            EdgeCondition("top", 0, (0.0,), (0.0,)),
            EdgeCondition("bottom", 0, (0.0,), (0.0,)),
            EdgeCondition("top", 1, (0.0, 1.0), (0.0, rate)),
            EdgeCondition("bottom", 1, (0.0, 1.0), (0.0, -rate)),
        ],
        [Crack(((-2.0, line), (22.0, line)), growth=growth)],
        damping=0.05 * LAW.pressure_wave_speed,
    )


RATE = 1e-7 * LAW.pressure_wave_speed


def strip_release_rate(time: float) -> float:
    """Rivlin and Thomas: the energy of the uniform strip ahead, per area of its crack."""
    strain = 2.0 * RATE * time / 15.0
    return 0.5 * LAW.wave_modulus * strain**2 * 15.0


def test_a_strip_tears_when_its_energy_per_area_is_the_toughness() -> None:
    toughness = strip_release_rate(1500 * 0.5 / LAW.pressure_wave_speed)
    solver = strip(GrowthLaw(toughness), RATE)
    growth = CrackGrowth(solver, interval=20)
    events = growth.advance(1800)
    first = events[0]
    assert first.release_rate >= toughness
    assert first.release_rate == pytest.approx(toughness, rel=0.03)
    assert strip_release_rate(first.time) == pytest.approx(toughness, rel=0.04)
    assert first.intensity_opening == pytest.approx(np.sqrt(toughness * E / (1.0 - NU**2)), rel=0.02)
    assert abs(first.release_sliding) < 1e-3 * first.release_rate
    assert first.grown == pytest.approx(0.5)
    # It runs on in its plane: J of a strip does not fall as the crack grows.
    assert len(events) >= 4
    assert solver.cracks is not None
    line = solver.cracks.line(0)
    assert line[-1, 0] == pytest.approx(22.0 + 0.5 * len(events), rel=1e-3)
    assert np.abs(line[:, 1] - 7.5).max() < 0.05
    assert solver.cracks.tips[0].length == pytest.approx(events[-1].length + 0.5, rel=1e-6)


def test_a_crack_sleeps_until_the_saved_stress_is_reached() -> None:
    toughness = strip_release_rate(400 * 0.5 / LAW.pressure_wave_speed)
    seen = CrackGrowth(strip(GrowthLaw(toughness, "straight"), RATE), interval=20)
    first = seen.advance(600)[0]
    # Behind the atoms: the same strip with little toughness, woken by the stress that was saved.
    waker = GrowthLaw(0.1 * toughness, "straight", start_stress=first.hoop_stress)
    events = CrackGrowth(strip(waker, RATE), interval=20).advance(600)
    assert events[0].woken
    assert events[0].step == first.step
    assert not any(event.woken for event in events[1:])
    assert events[0].grown == pytest.approx(0.5)


def test_a_growing_crack_goes_on_exactly_after_a_restart() -> None:
    law = GrowthLaw(strip_release_rate(200 * 0.5 / LAW.pressure_wave_speed), "straight")
    whole = CrackGrowth(first := strip(law, RATE), interval=10)
    events = whole.advance(240)
    saved, grown = first.state(), whole.state()
    late = whole.advance(60)
    assert events and late
    again = CrackGrowth(second := strip(law, RATE), interval=10)
    second.restore(saved)
    again.restore(grown)
    assert again.advance(60) == late


def test_an_inclined_crack_kinks_by_the_largest_hoop_stress() -> None:
    """A crack at 45 degrees in a plate under tension has K_I = K_II in size, so it kinks by 53.13 degrees."""
    half, a = 24, 5.0
    c = LAW.pressure_wave_speed
    reach = a / np.sqrt(2.0)
    solver = MaterialPointSolver(
        Grid((-half - 3.0, -half - 3.0), 1.0, (2 * half + 6, 2 * half + 6)),
        fill_rectangle((-float(half), -float(half)), (float(half), float(half)), 1.0),
        LAW,
        1.0,
        0.5 / c,
        cracks=[Crack(((0.13 - reach, 0.21 - reach), (0.13 + reach, 0.21 + reach)), growth=GrowthLaw(1e-9))],
        damping=0.04 * c,
        loads=[
            Traction("top", (0.0, 1e4), Ramp(150.0 / c, smooth=True)),
            Traction("bottom", (0.0, -1e4), Ramp(150.0 / c, smooth=True)),
        ],
    )
    solver.advance(496)
    growth = CrackGrowth(solver, interval=4)
    events = growth.advance(4)
    assert [(event.crack, event.end) for event in events] == [(0, 0), (0, 1)]
    for event in events:
        # Both tips turn towards the horizontal, to the right as seen out of the crack: K_II is positive.
        assert np.degrees(event.angle) == pytest.approx(-53.13, abs=4.0)
        assert event.intensity_sliding == pytest.approx(event.intensity_opening, rel=0.12)
        # K_I = K_II = sigma sqrt(pi a)/2 in an infinite plate
        assert event.intensity_opening == pytest.approx(0.5e4 * np.sqrt(np.pi * a), rel=0.12)
    assert solver.cracks is not None
    line = solver.cracks.line(0)
    assert line.shape == (4, 2)
    bend = np.degrees(np.arctan2(*(line[3] - line[2])[::-1]))
    assert bend == pytest.approx(45.0 - 53.13, abs=4.0)


def test_release_rate_of_a_bent_crack_does_not_depend_on_the_ring() -> None:
    """The virtual extension follows the crack: rings that hold the bend agree with one that does not."""
    c = LAW.pressure_wave_speed
    line = ((-2.0, 15.5), (16.0, 15.5), (20.0, 18.0))
    solver = MaterialPointSolver(
        Grid((-3.0, -3.0), 1.0, (46, 46)),
        fill_rectangle((0.0, 0.0), (40.0, 40.0), 1.0),
        LAW,
        1.0,
        0.5 / c,
        cracks=[Crack(line)],
        damping=0.05 * c,
        loads=[
            Traction("top", (0.0, 1e4), Ramp(150.0 / c, smooth=True)),
            Traction("bottom", (0.0, -1e4), Ramp(150.0 / c, smooth=True)),
        ],
    )
    solver.advance(800)
    assert solver.cracks is not None
    tip = solver.cracks.tips[0]
    fields = fields_around(solver.points, 1.0, tip.reference, 12.0)
    frame = TipFrame(tip.reference, tip.reference_direction)
    path = solver.cracks.line(0)[::-1]
    inside = j_integral(fields, frame, 1.0, 4.5)
    for ring in ((1.0, 4.5), (2.0, 8.0), (6.0, 12.0)):
        assert j_integral(fields, frame, *ring, line=path) == pytest.approx(inside, rel=0.03)
    assert jump_behind(solver.cracks, tip, 3.0)[0] > 0.0


@pytest.mark.parametrize(
    "values", [{"toughness": 0.0}, {"toughness": 1.0, "increment": -1.0}, {"toughness": 1.0, "direction": "up"}]
)
def test_a_growth_law_that_makes_no_sense_is_refused(values: dict) -> None:
    with pytest.raises(ValueError, match=f"GrowthLaw.{list(values)[-1]}"):
        GrowthLaw(**values)
