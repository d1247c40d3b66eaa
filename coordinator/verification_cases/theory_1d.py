"""Case `coupling/theory-1d`: whole scenes of a chain against the theory of two overlapping bars.

Statics: a bar with a chain in its middle is pulled at both ends; from the strain far away follows by how much each
overlap is too long. Waves: a bell of displacement runs from the bar into the chain; what comes back over what went
in, frequency by frequency, is the reflected amplitude at all wavelengths from one run.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from coordinator.figures import BLUE, GREEN, INK, ORANGE, PURPLE, RED, STYLE
from coordinator.handshake import LARGEST_STIFFNESS, SMALL_STIFFNESS, SPRING_NUMBER, exchange_number
from coordinator.overlap_theory import exact_stiffness, scatter, static_error
from coordinator.results import Results
from coordinator.verification_cases import chain
from coordinator.verification_cases.runs import run_text
from coordinator.weight_profile import WeightProfile
from protocol.arrays import FloatArray
from protocol.verification import Case, Check

#: Allowed difference to theory: of the elongation in widths of the overlap times the strain, of the reflected amplitude
#: in amplitudes of the wave.
TOLERANCE = 0.02
WAVELENGTHS = (5.0, 10.0, 20.0, 50.0)
STIFF = 100.0


@dataclass(frozen=True)
class Scheme:
    """Profile and springs of one run."""

    label: str
    profile: WeightProfile
    stiffness: float
    colour: str

    @property
    def handshake(self) -> str:
        """Lines of [handshake]; of a power the exponent is the largest that is stable, here 8."""
        lines = [
            f'profile = "{self.profile.kind}"',
            f"weight = {self.profile.weight!r}",
            f'stiffness = "{chain.springs(self.profile, self.stiffness):.12e} N/m"',
        ]
        if self.profile.stiffness is not None:
            lines.append(f"stiffness_weight = {self.profile.stiffness!r}")
        return "\n".join(lines)

    @property
    def cells(self) -> int | None:
        """Cells of the grid in the overlap, where they matter: stiffness as mass has a limit of fine ones."""
        return None if self.profile.stiffness is None else chain.ATOMS // chain.ATOMS_OF_CELL

    def static_error(self, stiffness: float | None = None) -> float:
        """Return the static error by theory, or with other springs."""
        return static_error(self.profile, self.stiffness if stiffness is None else stiffness, self.cells)

    def reflection(self, wavelength: float) -> float:
        """Return the reflected amplitude by theory at a wavelength in widths of the overlap."""
        return scatter(self.profile, self.stiffness, wavelength, cells=self.cells).reflected


def _exact(label: str, profile: WeightProfile, colour: str) -> Scheme:
    return Scheme(label, profile, exact_stiffness(profile), colour)


FULL, HALF = WeightProfile("constant", 1.0), WeightProfile("constant", 0.5)
LINEAR, POWER = WeightProfile("linear", 0.05), WeightProfile("power", 0.05, 8.0)
MASSIVE = WeightProfile("power", 0.05, 8.0, SMALL_STIFFNESS)
WAVES = (
    Scheme(f"weight 1, stiff (κL²/E = {STIFF:g})", FULL, STIFF, INK),
    _exact("weight 1", FULL, RED),
    _exact("weight 0.5", HALF, ORANGE),
    _exact("linear from 0.05", LINEAR, GREEN),
    _exact("power 8 from 0.05", POWER, BLUE),
    Scheme("power 8, stiffness 0.01", MASSIVE, 250.0, PURPLE),
)
STATICS = (
    Scheme("weight 1", FULL, 1.5, RED),
    _exact("weight 1", FULL, RED),
    Scheme("weight 1", FULL, STIFF, RED),
    Scheme("weight 0.5", HALF, 3.0, ORANGE),
    Scheme("weight 0.5", HALF, 40.0, ORANGE),
    Scheme("power 8 from 0.05", POWER, 20.0, BLUE),
    _exact("power 8 from 0.05", POWER, BLUE),
    Scheme("power 8, stiffness 0.01", MASSIVE, 250.0, PURPLE),
)


def elongation(scheme: Scheme, folder: Path, transits: float = 28.0) -> float:
    """Return the static error of one overlap in a whole scene, in widths times the far strain.

    The body starts in uniform strain under the traction of its ends, atoms and all; what it stretches further until it
    is at rest, after so many transits of a wave through L, is what its two overlaps are too long.
    """
    bar = chain.Bar(left=1.5, right=1.5, chain=3.0)
    strain = 1e-4
    steps = round(transits * chain.WIDTH / chain.SPEED / bar.coupling_step)
    preload = '\n[continuum.preload]\nmethod = "static"\ntolerance = 1e-9\nmax_steps = 50\n'
    damper = f'damping_time = "{0.5 * chain.WIDTH / chain.SPEED:.9e} s"\n'
    text = bar.text(
        steps,
        steps,
        damper + scheme.handshake,
        chain.pulled(strain) + preload,
        damping_rate=0.8 * chain.SPEED / chain.WIDTH,
    )
    with run_text(text, folder) as results:
        assert results.points is not None  # of every run
        frame = results.points.frame(len(results.points) - 1)
    start, moved = (frame.position - frame.displacement)[:, 0], frame.displacement[:, 0]
    beyond = moved - strain * start
    right = start > (0.5 * bar.chain + 0.5) * chain.WIDTH
    left = start < -(0.5 * bar.chain + 0.5) * chain.WIDTH
    return float((beyond[right].mean() - beyond[left].mean()) / (2.0 * chain.ring_width(scheme.profile) * strain))


def reflection(scheme: Scheme, folder: Path, wavelengths: FloatArray) -> FloatArray:
    """Return reflected amplitudes in a whole scene at wavelengths in widths of the overlap, shape (wavelengths,)."""
    bar = chain.Bar(left=12.0, right=0.0, chain=7.0)
    bell, duration = chain.pulse("left", 1.5, 1e-13)
    transit = chain.WIDTH / chain.SPEED
    # Its middle passes the place of the measurement after 7 and, going back, after 17 transits more. Until 8 later
    # nothing else comes back, from the end of the chain or from that of the bar.
    onwards_at, back_at = 0.5 * duration + 7.0 * transit, 0.5 * duration + 17.0 * transit
    end = back_at + 8.0 * transit
    with run_text(bar.text(round(end / bar.coupling_step), 4, scheme.handshake, bell), folder) as results:
        time, onwards, back = waves_at(results, bar.border - 5.0 * chain.WIDTH)
    between = 0.5 * (onwards_at + back_at)
    # What rings on in the overlap is faded out, not cut off.
    fade = np.cos(0.5 * np.pi * np.clip((time - end) / (3.0 * transit) + 1.0, 0.0, 1.0)) ** 2
    kernel = np.exp(-2j * np.pi * chain.SPEED / (wavelengths[:, None] * chain.ring_width(scheme.profile)) * time)
    sent, returned = np.where(time < between, onwards, 0.0), np.where(time < between, 0.0, back * fade)
    return np.asarray(np.abs(kernel @ returned) / np.abs(kernel @ sent))


def waves_at(results: Results, place: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return time, s, and the parts of the velocity that run right and left, m/s, in the cell around a place, m."""
    points = results.points
    assert points is not None  # of every run
    first = points.frame(0)
    here = np.abs((first.position - first.displacement)[:, 0] - place) < 0.5 * chain.CELL
    velocity, stress = np.zeros(len(points)), np.zeros(len(points))
    for index in range(len(points)):
        frame = points.frame(index)
        velocity[index], stress[index] = frame.velocity[here, 0].mean(), frame.stress[here, 0].mean()
    of_stress = stress / (chain.DENSITY * chain.SPEED)
    return points.time, 0.5 * (velocity - of_stress), 0.5 * (velocity + of_stress)


def theory_1d(folder: Path) -> list[Check]:
    """Static error and reflected amplitudes of whole scenes against theory."""
    source = "two elastic bars that overlap, joined by springs (coordinator.overlap_theory)"
    checks, lengths = [], []
    for number, scheme in enumerate(STATICS):
        lengths.append(elongation(scheme, folder / f"static{number}"))
        quantity = f"static error, {scheme.label}, springs {scheme.stiffness:.3g} E/L^2"
        away = lengths[-1] - scheme.static_error()
        checks.append(Check(f"{quantity}: {lengths[-1]:+.4f} less theory", away, 0.0, TOLERANCE, source, "L strain"))
    along = np.geomspace(3.0, 60.0, 40)
    curves = []
    for number, scheme in enumerate(WAVES):
        found = reflection(scheme, folder / f"wave{number}", np.concatenate([WAVELENGTHS, along]))
        curves.append(found[len(WAVELENGTHS) :])
        for wavelength, measured in zip(WAVELENGTHS, found, strict=False):
            wanted = scheme.reflection(wavelength)
            quantity = f"reflection at {wavelength:g} L, {scheme.label}: {measured:.4f} less theory {wanted:.4f}"
            checks.append(Check(quantity, float(measured - wanted), 0.0, TOLERANCE, source, "amplitude"))
    draw(folder / "theory_1d.png", np.array(lengths), along, curves)
    (folder / "schemes.md").write_text(scheme_table(), encoding="utf-8")
    return checks


def draw(path: Path, lengths: FloatArray, along: FloatArray, curves: list[FloatArray]) -> None:
    """Draw theory as lines and whole scenes as marks, statics beside waves."""
    import matplotlib
    from matplotlib.figure import Figure

    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(9.6, 4.0), layout="constrained")
        left, right = figure.subplots(1, 2)
        stiffness = np.geomspace(1.0, 1000.0, 60)
        drawn: set[str] = set()
        for scheme, measured in zip(STATICS, lengths, strict=True):
            if scheme.label not in drawn:
                theory = [scheme.static_error(kappa) for kappa in stiffness]
                left.plot(stiffness, theory, color=scheme.colour, label=scheme.label)
            drawn.add(scheme.label)
            left.plot(scheme.stiffness, measured, "o", color=scheme.colour, markersize=5)
        left.axhline(0.0, color=INK, linewidth=0.7)
        left.set(xscale="log", xlabel="κ L² / E at the outer border", ylabel="static error / (L ε)", ylim=(-0.6, 0.9))
        left.set_title("Length of the overlap in statics")
        left.legend()
        for scheme, curve in zip(WAVES, curves, strict=True):
            theory = [scheme.reflection(wavelength) for wavelength in along]
            right.plot(along, theory, color=scheme.colour, label=scheme.label)
            right.plot(along[::3], curve[::3], "o", color=scheme.colour, markersize=4)
        right.set(xscale="log", yscale="log", xlabel="wavelength / L", ylabel="reflected amplitude", ylim=(1e-3, 1.0))
        right.set_xticks([3, 5, 10, 20, 50], ["3", "5", "10", "20", "50"])
        right.minorticks_off()
        right.set_title("Reflection (lines theory, marks whole scenes)")
        right.legend()
        figure.savefig(path)


# --- which scheme ----------------------------------------------------------------------------------------------------

#: The example of the table: graphene, a ring of 15 Angstrom or 3 cells, atoms stepped by 0.5 fs.
_SPEED, _WIDTH, _STEP, _DAMPING_TIME, _CELLS = 20.9e3, 15e-10, 0.5e-15, 0.2e-12, 3
_EXCHANGES = (5, 10, 20, 30)


def scheme_table() -> str:
    """Return the table of schemes by theory, as Markdown: what it reflects, and its exchange numbers."""
    rows = [("weight 1, stiff springs (preset seed)", FULL, 1000.0, False), ("weight 1", FULL, None, False)]
    rows += [(f"constant {w:g}", WeightProfile("constant", w), None, False) for w in (0.5, 0.3, 0.2, 0.15, 0.1)]
    rows += [("linear", LINEAR, None, False), ("cubic", WeightProfile("cubic", 0.05), None, False)]
    rows += [(f"power {p:g}", WeightProfile("power", 0.05, p), None, False) for p in (2.0, 4.0, 6.0, 8.0)]
    rows += [("constant 0.5, damper", HALF, None, True), ("power 8, damper", POWER, None, True)]
    for m in (5, 10, 14):
        step = m * _STEP * _SPEED / _WIDTH
        kappa = min(4.0 * SPRING_NUMBER**2 / step**2, LARGEST_STIFFNESS)
        rows.append((f"power 8, stiffness 0.01, springs for M = {m}", MASSIVE, kappa, False))
    head = ["scheme", "mean weight", "κL²/E", "static error"]
    head += [f"R at {wavelength:g} L" for wavelength in WAVELENGTHS] + [f"N at M = {m}" for m in _EXCHANGES]
    lines = ["| " + " | ".join(head) + " |", "| --- |" + " --- |" * (len(head) - 1)]
    damping = _WIDTH / (_SPEED * _DAMPING_TIME)
    for label, profile, given, damped in rows:
        kappa = exact_stiffness(profile) if given is None else given
        cells = None if profile.stiffness is None else _CELLS
        error = round(static_error(profile, kappa, cells), 3) + 0.0  # no minus zero
        row = [label, f"{profile.mean:.3f}", f"{kappa:.4g}", f"{error:.3f}"]
        for wavelength in WAVELENGTHS:
            reflected = scatter(profile, kappa, wavelength, damping if damped else 0.0, cells).reflected
            row.append(f"{100 * reflected:.1f} %")
        for m in _EXCHANGES:
            # In units of L and c: modulus and density are one.
            step = m * _STEP * _SPEED / _WIDTH
            number = exchange_number(kappa, profile, 1.0, step, 1.0 / damping if damped else None)
            row.append(f"{number:.2f}" if number < 0.9 else f"{number:.2f}, unstable")
        lines.append("| " + " | ".join(row) + " |")
    return "\n".join(lines) + "\n"


CASES = [
    Case("coupling", "theory-1d", "a chain in a bar against the theory of two overlapping bars", theory_1d, slow=True)
]
