"""Case `coupling/wave`: a wave goes from the continuum into the atoms and out of them again on the far side.

A bell of displacement runs along a bar into a chain of atoms and on into the bar behind it. It is so much shorter
than the chain that its echoes from the two handshakes pass the same place one after the other, on their way back:
what each one holds of a wavelength, over what went in, is the reflected amplitude at that wavelength::

    |== bar ====== place ====|<- L ->|.... chain ....|<- L ->|==== place behind ====|
         bell -->     |          |                       |              |
                      |<-- into the atoms                |              |
                      |<---------------- out of the atoms|              |--> went through
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from coordinator.figures import BLUE, INK, STYLE
from coordinator.verification_cases import chain
from coordinator.verification_cases.runs import run_text
from coordinator.verification_cases.theory_1d import waves_at
from protocol.arrays import FloatArray
from protocol.verification import Case, Check

#: Wavelength in widths of the handshake, and the largest amplitude that may come back over that of the wave.
LIMITS = {5.0: 0.12, 10.0: 0.05, 20.0: 0.03, 50.0: 0.01}
#: Lengths in widths: of the bars, of the chain, from a handshake to the place where its waves are seen.
_LEFT, _RIGHT, _CHAIN, _AWAY = 20.0, 9.0, 10.0, 5.0
#: Where the bell has fallen to 1/e, in widths. At 5 widths of wavelength a third of its middle is left.
_BELL = 1.5


@dataclass(frozen=True)
class Waves:
    """Amplitudes at wavelengths over that of the wave that came, each of shape (wavelengths,)."""

    into: FloatArray
    """Reflected on the way into the atoms."""
    out: FloatArray
    """Reflected on the way out of them, over what arrived there and with what got back through."""
    through: FloatArray
    """Went on behind the atoms."""


def amplitudes(handshake: str, folder: Path, wavelengths: FloatArray) -> Waves:
    """Run a scene with lines of [handshake] and return amplitudes at wavelengths in widths of the handshake."""
    bar = chain.Bar(left=_LEFT, right=_RIGHT, chain=_CHAIN)
    bell, duration = chain.pulse("left", _BELL, 1e-13)
    absorbing = '\n[[continuum.edges]]\nkind = "absorbing"\nedge = "right"\n'
    unit = chain.WIDTH / chain.SPEED
    middle = 0.5 * duration / unit
    # Times in units of the way through one width: when the middle of each part passes.
    came = middle + _LEFT - _AWAY
    first, second = came + 2 * _AWAY, came + 2 * (_AWAY + _CHAIN)
    gate = 0.5 * (first + second) - 0.5
    steps = round((second + 6.0) * unit / bar.coupling_step)
    with run_text(bar.text(steps, 4, handshake, bell + absorbing), folder) as results:
        time, onwards, back = waves_at(results, bar.border - _AWAY * chain.WIDTH)
        late, behind, _ = waves_at(results, -bar.border + _AWAY * chain.WIDTH)
    kernel = np.exp(-2j * np.pi / wavelengths[:, None] * time / unit)

    def part(values: FloatArray, begin: float, stop: float) -> FloatArray:
        here = (time >= begin * unit) & (time < stop * unit)
        return np.asarray(np.abs(kernel @ np.where(here, values, 0.0)))

    sent = part(onwards, 0.0, came + 6.0)
    into = part(back, came + 3.0, gate) / sent
    # What comes out has passed the handshake of the entrance twice.
    out = part(back, gate, second + 6.0) / sent / (1.0 - into**2)
    assert np.array_equal(late, time)
    return Waves(into, out, part(behind, 0.0, second + 6.0) / sent)


SCHEMES = {"default": ("", BLUE), "seed": ('preset = "seed"', INK)}


def wave(folder: Path) -> list[Check]:
    """Reflected amplitudes of the default handshake within the limits, beside those of the dissertation's."""
    along = np.geomspace(3.0, 60.0, 60)
    wanted = np.array(list(LIMITS))
    found = {
        name: amplitudes(lines, folder / name, np.concatenate([wanted, along])) for name, (lines, _) in SCHEMES.items()
    }
    draw(folder / "wave.png", along, found)
    checks = []
    for k, (wavelength, limit) in enumerate(LIMITS.items()):
        for way, name in (("into", "into"), ("out of", "out")):
            value, plain = (float(getattr(found[scheme], name)[k]) for scheme in ("default", "seed"))
            quantity = f"reflected amplitude at {wavelength:g} widths, {way} the atoms (preset seed: {plain:.3f})"
            checks.append(Check(quantity, value, limit, 0.0, "limit set for the product", at_most=True))
    return checks


def draw(path: Path, along: FloatArray, found: dict[str, Waves]) -> None:
    """Draw reflected amplitudes over wavelength with the limits."""
    import matplotlib
    from matplotlib.figure import Figure

    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(6.4, 4.2), layout="constrained")
        axes = figure.subplots()
        for name, waves in found.items():
            colour = SCHEMES[name][1]
            axes.plot(along, waves.into[len(LIMITS) :], color=colour, label=f"{name}: into the atoms")
            axes.plot(along, waves.out[len(LIMITS) :], "--", color=colour, label=f"{name}: out of the atoms")
        axes.plot(list(LIMITS), list(LIMITS.values()), "v", color=INK, markersize=8, label="largest allowed")
        axes.set(xscale="log", yscale="log", xlabel="wavelength / width of the handshake", ylabel="reflected amplitude")
        ticks = (3, *(int(wavelength) for wavelength in LIMITS))
        axes.set_xticks(ticks, [str(tick) for tick in ticks])
        axes.set_xticks([], minor=True)
        axes.set_title("What a handshake sends back of a wave")
        axes.legend()
        figure.savefig(path)


CASES = [Case("coupling", "wave", "a wave from the continuum into a chain of atoms and out again", wave)]
