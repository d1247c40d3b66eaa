"""Cases `mpm/...` of `scalebridge verify`: figures of the material point solver against known answers."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from protocol.verification import Case, Check

from ..scheme import Scheme
from . import bar_wave, beam, convergence, free_vibration, large_deformation, rigid, stability, transition
from .beam_theory import bernoulli_deflection, timoshenko_deflection

DEFAULT = Scheme()
FLIP = Scheme(transfer="flip")
EXACT_ZERO = "closed form: rigid motion has no stress"


def beam_under_harmonic_force(folder: Path) -> list[Check]:
    """Deflection of the beam against plane stress elasticity, for three force scalings."""
    runs = {c: beam.run_beam(force_scaling=c) for c in (0.0, 0.25, 0.6)}
    beam.draw_beam(runs, folder / "beam.png")
    exact = runs[0.0].exact
    largest = np.abs(exact).max()
    theory = "sine series in plane stress elasticity, the exact solution of the modelled problem"
    checks = [
        Check("largest error of the deflection over the largest deflection", runs[0.0].error, 0.005, 0.0, theory,
              at_most=True),
    ]  # fmt: skip
    for name, deflection, limit in (
        ("Timoshenko", timoshenko_deflection(beam.BEAM, runs[0.0].time), 0.005),
        ("Euler-Bernoulli (Eq 49)", bernoulli_deflection(beam.BEAM, runs[0.0].time), 0.20),
    ):
        error = float(np.abs(deflection - exact).max() / largest)
        checks.append(
            Check(f"{name} theory's own error on this beam", error, limit, 0.0, theory, at_most=True),
        )
    checks += [
        Check(f"the same with force scaling c = {c:g} (Eq 45)", runs[c].error, 0.005, 0.0,
              "the same solution with a density larger by 1/(1 - c)", at_most=True)
        for c in (0.25, 0.6)
    ]  # fmt: skip
    return checks


def bar_with_a_step(folder: Path) -> list[Check]:
    """Front of a stress step along a graphene bar."""
    wave = bar_wave.run_bar_wave()
    bar_wave.draw_bar_wave(
        {"uGIMP, FMPM(2)": wave, "uGIMP, FLIP": bar_wave.run_bar_wave(FLIP)}, folder / "bar_wave.png"
    )
    return [
        Check("speed of the front at half height", wave.speed, bar_wave.wave_speed(), 0.004,
              "sqrt(E/rho) (Eq 50)", unit="m/s"),
        Check("overshoot behind the front", wave.front.overshoot, 0.01, 0.0,
              "a step has none; limit set for the product", at_most=True),
        Check("rise from 10 to 90 % after 150 cells", wave.rise_in_cells, 7.0, 0.0,
              "a step has none; limit set for the product", unit="cells", at_most=True),
        Check("mean stress from a tenth of the way to ten cells behind the front", plateau(wave), 1.0, 0.002,
              "equilibrium: the traction"),
    ]  # fmt: skip


def plateau(wave: bar_wave.BarWave) -> float:
    """Mean stress behind the front over the traction."""
    cell = bar_wave.LENGTH / bar_wave.CELLS
    behind = (wave.place > 0.1 * wave.front.place) & (wave.place < wave.front.place - 10.0 * cell)
    return float(wave.stress[behind].mean())


def vibrating_bar(folder: Path) -> list[Check]:
    """Frequency and energy of the first axial mode."""
    vibration = free_vibration.run_free_vibration()
    free_vibration.draw_free_vibration(vibration, folder / "free_vibration.png")
    return [
        Check("frequency of mode 1", vibration.frequency, vibration.exact_frequency, 0.0004,
              "closed form c/(4 L)", unit="Hz"),
        Check("energy lost over ten periods", 1.0 - vibration.energy_kept, 0.003, 0.0,
              "a free bar loses none; limit set for the product", at_most=True),
        Check("energy gained over ten periods", vibration.energy_kept - 1.0, 0.001, 0.0,
              "a free bar gains none", at_most=True),
    ]  # fmt: skip


SHAPES = ("linear", "ugimp", "cpgimp", "bspline")
UPDATES = ("musl", "usl", "usf", "usavg")


def manufactured(folder: Path) -> list[Check]:
    """Order of every shape function and update scheme on a manufactured solution, and their error for seconds."""
    schemes = [Scheme(interpolation=shape, integration=update) for shape in SHAPES for update in UPDATES]
    schemes.append(Scheme(transfer="flip"))
    rows = convergence.convergence_table(schemes)
    convergence.draw_convergence(rows, folder / "convergence.png")
    convergence.write_table(rows, folder / "convergence.csv")
    return [
        Check("order short of 1.8 in displacement, default scheme",
              max(0.0, 1.8 - convergence.order_of(rows, convergence.label_of(DEFAULT))), 0.0, 0.0,
              "manufactured solution; Wallstedt and Guilkey 2008"),
        *(
            Check(f"order, {convergence.label_of(scheme)}",
                  convergence.order_of(rows, convergence.label_of(scheme)), 2.0, 0.1,
                  "manufactured solution; linear elements are of second order")
            for scheme in schemes
            if scheme.interpolation != "linear"
        ),
    ]  # fmt: skip


def rigid_motion(folder: Path) -> list[Check]:
    """Stress of bodies that move rigidly."""
    checks = []
    for shape in SHAPES:
        stress, off = rigid.translate(Scheme(interpolation=shape))
        checks.append(
            Check(f"stress over E, translation over cell lines, {shape}", stress, 1e-12, 0.0, EXACT_ZERO, at_most=True)
        )
        checks.append(
            Check(f"place after translation, {shape}", off, 1e-11, 0.0, "velocity times time", "cells", at_most=True)
        )
    stress, added = rigid.translate_across_levels(DEFAULT)
    spun, small = rigid.spin(), rigid.spin(rigid.SMALL_STRAIN)
    centrifugal = "plane stress disk under centrifugal force, (3 + nu)/8 rho w^2 R^2, doubled by the sudden start"
    return [
        *checks,
        Check("stress over E, through a finer level and out", stress, 1e-12, 0.0, EXACT_ZERO, at_most=True),
        Check("points added by splits on the way", float(added > 0), 1.0, 0.0, "points enter finer cells"),
        Check("stress over E, translation with a crack", rigid.translate_with_crack(DEFAULT), 1e-12, 0.0, EXACT_ZERO,
              at_most=True),
        Check("stress over E, neo-Hookean disk turned by a right angle", rigid.turned(0.5 * np.pi), 1e-12, 0.0,
              EXACT_ZERO, at_most=True),
        Check("false stress over E at once, small-strain disk turned by 0.1",
              rigid.turned(0.1, rigid.SMALL_STRAIN, steps=0), rigid.false_stress(0.1), 1e-9,
              "closed form (1 - cos)/(1 - nu): the small-strain law is not objective"),
        Check("stress of a freely spinning disk over the largest physical one", spun.stress_ratio, 1.0, 0.0,
              centrifugal, at_most=True),
        Check("the same with the small-strain law: not objective, far above one",
              float(small.stress_ratio > 10.0), 1.0, 0.0, "the false strain of Eq 25 is 1 - cos(angle)"),
    ]  # fmt: skip


def large_motion(folder: Path) -> list[Check]:
    """Spinning disk and tensile bar."""
    disks = {"uGIMP, FMPM(2)": large_deformation.run_disk(), "uGIMP, FLIP": large_deformation.run_disk(FLIP)}
    large_deformation.draw_disk(disks, folder / "disk.png")
    bars = {shape: large_deformation.run_tensile_bar(Scheme(interpolation=shape)) for shape in ("cpgimp", "ugimp")}
    large_deformation.draw_bars(bars, folder / "tensile_bar.png")
    run = disks["uGIMP, FMPM(2)"]
    return [
        Check("cell lines a rim point crosses, short of 1000", max(0.0, 1000.0 - run.crossings), 0.0, 0.0, "counted"),
        *(
            check
            for label, disk in disks.items()
            for check in (
                Check(f"momentum: largest change over m v, {label}", disk.momentum_error, 1e-11, 0.0,
                      "conserved", at_most=True),
                Check(f"angular momentum: loss, {label}", float(1.0 - disk.angular_momentum[-1]), 0.0, 0.01,
                      "conserved"),
                Check(f"energy: change, {label}", float(disk.energy[-1] - 1.0), 0.0, 0.02, "conserved"),
            )
        ),
        Check("axial stress at stretch 2, worst point, cpgimp", bars["cpgimp"].stress_error, 0.0, 0.02,
              "closed form, neo-Hookean in plane strain"),
        Check("widest gap over even spacing at stretch 2, cpgimp", bars["cpgimp"].spread, 1.0, 0.02,
              "uniform stretch"),
    ]  # fmt: skip


def wave_through_transition(folder: Path) -> list[Check]:
    """Reflection at a 2:1 change of cell size."""
    refined, plain = transition.run_transition(20.0), transition.run_transition(20.0, refined=False)
    transition.draw_transition(refined, plain, 20.0, folder / "transition.png")
    return [
        Check("reflected amplitude, wavelength 20 coarse cells", refined.reflected, 0.01, 0.0,
              "none in the continuum; limit set for the product", at_most=True),
    ]  # fmt: skip


def hard_conditions(folder: Path) -> list[Check]:
    """Energy of shaken bodies in hard conditions, and a body at rest for a million steps."""
    runs = stability.hard_runs()
    stability.draw_shaken(runs, folder / "stability.png")
    stressed, empty = stability.rest(1_000_000, 1e-3), stability.rest(10_000, 0.0)
    bound = "energy of the start; the time scheme's own swing is within 2 %"
    return [
        *(Check(f"largest energy over the first, {label}", run.peak, 1.02, 0.0, bound, at_most=True)
          for label, run in runs.items()),
        Check("time step above the limit is refused and the limit named", float(stability.refusal_names_limit()), 1.0,
              0.0, "contract of the solver"),
        Check("stress change over the stress, 1e6 steps in equilibrium", stressed.stress_change, 1e-9, 0.0,
              "equilibrium stays", at_most=True),
        Check("steps done at rest", float(stressed.steps), 1e6, 0.0, "counted"),
        Check("speed over wave speed, 1e4 steps without stress", empty.speed, 0.0, 0.0, "nothing moves"),
    ]  # fmt: skip


CASES = [
    Case("mpm", "beam", "simply supported beam under a harmonic force (Fig 2.6)", beam_under_harmonic_force),
    Case("mpm", "bar-wave", "a step of stress along a graphene bar (Fig 2.9)", bar_with_a_step),
    Case("mpm", "free-vibration", "ten periods of an axial mode", vibrating_bar),
    Case("mpm", "convergence", "order and time of every shape function and update", manufactured),
    Case("mpm", "rigid", "rigid motion leaves no stress", rigid_motion),
    Case("mpm", "large-deformation", "a spinning disk and a bar at stretch 2", large_motion),
    Case("mpm", "transition", "a wave through a 2:1 change of cell size", wave_through_transition),
    Case("mpm", "stability", "conditions that make solvers run away", hard_conditions, slow=True),
]
