"""Case `coupling/stability`: where the exchange is stable, over weight, M and damper, and what the hard cases do.

The map is made with the exchange in one dimension (`coordinator.exchange_model`), 10^5 coupling steps a point, in the
proportions of graphene: a ring of 12 atoms and 3 cells, atoms stepped by 0.5 fs. A few of its points are held
against whole scenes.
"""

from __future__ import annotations

import math
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from coordinator.exchange_model import Model, advance, shaken
from coordinator.figures import BLUE, INK, ORANGE, RED, STYLE
from coordinator.handshake import (
    LARGEST_STIFFNESS,
    SMALL_STIFFNESS,
    STABILITY_LIMIT,
    HandshakeError,
    choose,
    exchange_number,
)
from coordinator.overlap_theory import exact_stiffness
from coordinator.results import Results
from coordinator.verification_cases import chain
from coordinator.verification_cases.runs import run_text
from coordinator.verification_cases.theory_1d import Scheme, elongation
from coordinator.weight_profile import WeightProfile
from protocol.arrays import FloatArray
from protocol.verification import Case, Check

STEPS = 100_000
#: Graphene: speed of sound, width of the ring, step of the atoms; the last one in units of width over speed.
SPEED, WIDTH, TIME_STEP = 20.9e3, 15e-10, 0.5e-15
UNIT_STEP = TIME_STEP * SPEED / WIDTH
ATOMS, CELLS = 12, 3
STEPS_PER_EXCHANGE = (1, 2, 4, 7, 10, 14, 20, 30, 40, 60)
WEIGHTS = (0.05, 0.08, 0.12, 0.17, 0.25, 0.35, 0.5, 0.7, 1.0)
EXPONENTS = (1.0, 2.0, 4.0, 6.0, 8.0, 12.0)
#: Springs of a continuum that keeps a hundredth of its stiffness, by the square of their exchange number.
SPRINGS = (0.1, 0.2, 0.36, 0.5, 0.65, 0.8, 1.1, 1.3)
#: No damper, and those of 0.2 and 0.05 ps.
DAMPING_TIMES = (None, 0.2e-12, 0.05e-12)
#: Energy at the end over that at the start, means of a tenth of the run each, above which it has grown.
GROWN = 1.02


@dataclass(frozen=True)
class Point:
    """One point of the map.

    Attributes
    ----------
    number : float
        Exchange number by theory.
    resonant : bool
        Whether vibrations of the atoms may meet one of the light continuum; see `may_resonate`.
    growth : float
        Energy at the end over that at the start; infinite where the run blew up.
    """

    number: float
    resonant: bool
    growth: float


def growth(model: Model, steps: int = STEPS) -> float:
    """Return mean energy over the last tenth of a run from random velocities over that of the first tenth."""
    energy = advance(model, shaken(model), steps).sum(axis=1)
    if len(energy) < steps:
        return math.inf
    return float(energy[-steps // 10 :].mean() / energy[: steps // 10].mean())


def may_resonate(number: float, coupling_step: float) -> bool:
    """Return whether atoms vibrate so fast that, seen once in a coupling step, they meet the light continuum.

    The chain's fastest angular frequency is twice the atoms in a width, in units of speed over width; a light node
    turns by 2 asin(N) in a step, and two vibrations of opposite sign of energy meet where both add up to a full turn.
    """
    return 2.0 * ATOMS * coupling_step + 2.0 * math.asin(min(number, 1.0)) > 2.0 * math.pi


def point(
    profile: WeightProfile, stiffness: float, steps_per_exchange: int, damping_time: float | None, steps: int
) -> Point:
    """Return a point of the map for springs of kappa L^2 / E = `stiffness`, the serial exchange.

    The continuum makes as many steps in an exchange as keep its Courant number below a half.
    """
    step = steps_per_exchange * UNIT_STEP
    damping = 0.0 if damping_time is None else WIDTH / (SPEED * damping_time)
    model = Model(
        profile, stiffness, step, steps_per_exchange, damping, cells=CELLS, atoms=ATOMS, continuum_length=1.0,
        atoms_length=0.5, continuum_steps=math.ceil(step * CELLS / 0.5),
    )  # fmt: skip
    number = exchange_number(stiffness, profile, 1.0, step, 1.0 / damping if damping else None)
    return Point(number, may_resonate(number, step), growth(model, steps))


def stability_maps(steps: int) -> list[list[list[Point]]]:
    """Return the points of all panels: constant weights, exponents, springs; each without and with dampers."""
    constant = [WeightProfile("constant", weight) for weight in WEIGHTS]
    power = [WeightProfile("power", 0.05, exponent) for exponent in EXPONENTS]
    massive = WeightProfile("power", 0.05, 8.0, SMALL_STIFFNESS)
    found = []
    for profiles in (constant, power):
        for time in DAMPING_TIMES:
            rows = [[point(one, exact_stiffness(one), m, time, steps) for m in STEPS_PER_EXCHANGE] for one in profiles]
            found.append(rows)
    for time in DAMPING_TIMES:
        rows = []
        for square in SPRINGS:
            bare = [4.0 * square / (m * UNIT_STEP) ** 2 for m in STEPS_PER_EXCHANGE]
            springs = [min(kappa, LARGEST_STIFFNESS) for kappa in bare]
            rows.append(
                [point(massive, kappa, m, time, steps) for kappa, m in zip(springs, STEPS_PER_EXCHANGE, strict=True)]
            )
        found.append(rows)
    return found


def stability(folder: Path, steps: int = STEPS) -> list[Check]:
    """Map of the exchange in one dimension, points of it in whole scenes, and the hard cases."""
    maps = stability_maps(steps)
    draw(folder / "stability.png", maps, steps)
    points = [one for each in maps for row in each for one in row]
    inside = [one.growth for one in points if one.number < STABILITY_LIMIT["serial"] and not one.resonant]
    met = [one.growth for one in points if one.number < STABILITY_LIMIT["serial"] and one.resonant]
    beyond = [one.growth for one in points if one.number > 1.2]
    source = "limit of theory: (Dt omega / 2)^2 + Dt / (2 W tau) < 1, no resonance; up to 0.9 of it runs are allowed"
    return [
        Check(f"energy after {steps} coupling steps over that before, largest of {len(inside)} points inside the limit",
              max(inside), GROWN, 0.0, source, at_most=True),
        Check(f"points inside the limit that grew by a resonance with the atoms, of {len(met)} where one is possible",
              float(sum(one > GROWN for one in met)), float(len(met)), 0.0, source, at_most=True),
        Check(f"points beyond 1.2 times the limit that did not blow up, of {len(beyond)}",
              float(sum(one < math.inf for one in beyond)), 0.0, 0.0, source),
        *_whole_scenes(folder),
        *_hard_cases(folder),
    ]  # fmt: skip


def draw(path: Path, maps: list[list[list[Point]]], steps: int) -> None:
    """Draw stable and unstable points with the limit of theory: constant weights, powers, springs by their number."""
    import matplotlib
    from matplotlib.figure import Figure

    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(9.6, 8.6), layout="constrained")
        axes = figure.subplots(3, 3, sharex=True, sharey="row")
        for number, each in enumerate(maps):
            panel = axes[number // 3, number % 3]
            rows = (WEIGHTS, EXPONENTS, SPRINGS)[number // 3]
            m, value = np.meshgrid(STEPS_PER_EXCHANGE, rows)
            grown = np.array([[one.growth for one in row] for row in each])
            theory = np.array([[one.number for one in row] for row in each])
            for chosen, colour, mark, label in (
                (grown <= GROWN, BLUE, "o", "stable"),
                ((grown > GROWN) & np.isfinite(grown), RED, "^", "grows"),
                (~np.isfinite(grown), RED, "x", "blows up"),
            ):
                panel.plot(m[chosen], value[chosen], mark, color=colour, label=label, markersize=4.5, linestyle="none")
            panel.contour(m, value, theory, [0.9, 1.0], colors=INK, linestyles=["--", "-"], linewidths=1.2)
            turn = [[float(one.resonant) for one in row] for row in each]
            panel.contour(m, value, turn, [0.5], colors=ORANGE, linestyles=":", linewidths=1.2)
            time = DAMPING_TIMES[number % 3]
            panel.set_title("no damper" if time is None else f"damping time {time * 1e12:g} ps")
            panel.set(xscale="log", yscale="log", xlim=(0.85, 72.0), ylim=(rows[0] / 1.2, rows[-1] * 1.2))
            panel.set_yticks(rows, [f"{row:g}" for row in rows])
            panel.minorticks_off()
            if number >= 6:
                panel.set_xticks(STEPS_PER_EXCHANGE, [str(m) for m in STEPS_PER_EXCHANGE])
                panel.set_xlabel("M (steps of 0.5 fs in an exchange)")
        axes[0, 0].set_ylabel("weight, constant")
        axes[1, 0].set_ylabel("exponent of the power from 0.05")
        axes[2, 0].set_ylabel("S of the springs, stiffness 0.01")
        axes[0, 0].legend(loc="lower right", frameon=True)
        figure.suptitle(
            f"{steps:,} coupling steps each. Exchange number by theory: 1 full, 0.9 dashed; right of dots a resonance"
            " is possible without damper",
            fontsize=9,
        )
        figure.savefig(path)


# --- whole scenes ----------------------------------------------------------------------------------------------------

#: The coordinator refuses what lies beyond the limit; this lets it run.
_WITHOUT_LIMIT = """
import sys
from coordinator import cli, handshake
handshake.STABILITY_LIMIT["serial"] = 10.0
sys.argv = ["scalebridge", "run", *sys.argv[1:]]
cli.main()
"""


def _chain_text(number: float, steps: int, steps_per_exchange: int = 10) -> str:
    """Return the scene of a bell in a bar that goes over into a chain, at weight 0.3 and an exchange number."""
    bar = chain.Bar(left=3.0, right=0.0, chain=3.0, steps_per_exchange=steps_per_exchange)
    bell, _ = chain.pulse("left", 0.5, 1e-13)
    weight = WeightProfile("constant", 0.3)
    kappa = 4.0 * number**2 * weight.weight * (chain.ring_width(weight) / (chain.SPEED * bar.coupling_step)) ** 2
    stiffness = chain.springs(weight, kappa)
    lines = f'profile = "constant"\nweight = {weight.weight}\nstiffness = "{stiffness:.12e} N/m"\n'
    return bar.text(steps, steps, lines, bell)


def _energy(results: Results) -> FloatArray:
    """Return the energy of continuum, atoms and springs after each step, J."""
    parts = ("continuum_kinetic", "continuum_strain", "atomistic_kinetic", "atomistic_potential", "spring_energy")
    return np.sum([results.series[part] for part in parts], axis=0)


def _whole_scenes(folder: Path) -> list[Check]:
    """Runs of a chain in a bar below the limit, at it, and beyond it with the refusal taken out."""
    source = "the bell brings energy in the first fifth, then nothing does; theory's limit is at 1"
    checks = []
    for number in (0.5, 0.85):
        with run_text(_chain_text(number, 1000), folder / f"whole{number}") as results:
            energy = _energy(results)
        held = float(energy[-200:].mean() / energy[300:500].mean())
        quantity = f"whole scene at an exchange number of {number}: energy at the end over that before"
        checks.append(Check(quantity, held, GROWN, 0.0, source, at_most=True))
    text = _chain_text(1.1, 1000)
    refused = ""
    try:
        run_text(text, folder / "refused")
    except RuntimeError as error:
        refused = str(error)
    named = "exchange number of 1.1, allowed is 0.9" in refused
    checks.append(Check("whole scene at 1.1 is refused, with the limit named", float(named), 1.0, 0.0, source))
    words = [
        sys.executable,
        "-c",
        _WITHOUT_LIMIT,
        str(folder / "refused" / "scene.toml"),
        "--out",
        str(folder / "beyond"),
    ]
    ended = subprocess.run(words, capture_output=True, text=True, stdin=subprocess.DEVNULL, check=False)
    with Results(folder / "beyond" / "results.h5") as results:
        energy = _energy(results)
    # Either the run was stopped by a service that saw what had run away, or the energy shows it.
    blown = ended.returncode != 0 or not energy[-1] < 1e6 * energy[: len(energy) // 2].max()
    checks.append(Check("the same run without the refusal blows up", float(blown), 1.0, 0.0, source))
    return checks


# --- hard cases ------------------------------------------------------------------------------------------------------


def _hard_cases(folder: Path) -> list[Check]:
    """M = 1 and M = 1000; springs 100 times as stiff and a hundredth of the default."""
    young, density = SPEED**2, 1.0  # only their ratio matters
    default = choose(young, density, WIDTH, 10 * TIME_STEP)

    def refusal(steps_per_exchange: int, stiffness: float | None) -> str:
        try:
            choose(young, density, WIDTH, steps_per_exchange * TIME_STEP, stiffness_density=stiffness, profile="power")
        except HandshakeError as error:
            return str(error)
        return ""

    limit = f"allowed is {STABILITY_LIMIT['serial']}"
    source = "hard cases: refused with the limit named, or run with the error stated"
    long, stiff = refusal(1000, None), refusal(10, 100.0 * default.stiffness_density)
    checks = [
        Check("M = 1000 is refused, with the limit and a stable step named",
              float(limit in long and "fs is stable" in long), 1.0, 0.0, source),
        Check("springs 100 times the default are refused, with the limit named", float(limit in stiff), 1.0, 0.0,
              source),
    ]  # fmt: skip
    soft = choose(
        young, density, WIDTH, 10 * TIME_STEP, stiffness_density=0.01 * default.stiffness_density, profile="power"
    )
    scheme = Scheme("a hundredth", soft.profile, soft.relative_stiffness, INK)
    measured = elongation(scheme, folder / "soft", transits=90.0)  # the softer, the slower
    checks.append(
        Check(f"springs of a hundredth: static error {measured:.3f} of a whole scene over that stated",
              measured / soft.static_error, 1.0, 0.05, "theory of two bars")
    )  # fmt: skip
    with run_text(_chain_text(0.3, 1000, steps_per_exchange=1), folder / "single") as results:
        energy = _energy(results)
    held = float(energy[-200:].mean() / energy[300:500].mean())
    checks.append(Check("M = 1: energy at the end over that before", held, GROWN, 0.0, source, at_most=True))
    return checks


CASES = [Case("coupling", "stability", "where the exchange is stable, and what hard choices do", stability, slow=True)]
