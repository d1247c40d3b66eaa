"""The path of a laminate through snap-back: increments by the load, and where it softens by the energy that they take.

Increments by energy alone would be of any size while nothing softens, and increments by the load jump where the load
has to fall, so the two take turns (Verhoosel, Remmers and Gutierrez, Int. J. Numer. Meth. Eng. 77 (2009) 1290-1321).
"""

from __future__ import annotations

from dataclasses import dataclass

from fem_service.dissipation_control import advance_by_dissipation, taken
from fem_service.equilibrium import Equilibrium, NotConverged
from fem_service.increments import Increment, Steps, size_after
from fem_service.quasi_static import QuasiStatic

#: An increment by the load may take more than the energy of an increment by this part of it.
_NEAR = 1e-3


@dataclass(frozen=True, eq=False)
class PathIncrement(Increment):
    """One increment on the path.

    Attributes
    ----------
    by_dissipation : bool
        Whether it was made by the energy that it takes.
    """

    by_dissipation: bool = False


def next_on_path(
    laminate: QuasiStatic,
    start: Equilibrium,
    size: float,
    end: float,
    steps: Steps,
    dissipation: float,
    *,
    largest: float,
    by_dissipation: bool,
) -> PathIncrement:
    """Make the next increment, by the load or by the energy that it takes.

    A try by the load that takes more than the energy of an increment, or finds no equilibrium, is followed by one that
    takes that energy, whatever the load does. Where neither is found both are halved. After an increment by energy the
    next one is tried so first; a try in which the load would change by more than `largest` is none.

    Parameters
    ----------
    laminate : QuasiStatic
        Without viscosity; all that fails in it softens and unloads to the origin.
    start : Equilibrium
    size : float
        To try first, in units of the load.
    end : float
        Load beyond which it does not go.
    steps : Steps
    dissipation : float
        Energy of an increment, J.
    largest : float
        Change of the load in an increment.
    by_dissipation : bool
        Whether the last increment was made by its energy.

    Raises
    ------
    NotConverged
        If there is no equilibrium with the least increment either.
    """
    energy, size = dissipation, min(size, largest)
    unhalved = size
    iterations = halved = 0
    # From rest no energy can be prescribed: what is taken up to an equilibrium is measured against the load before it.
    ways = (False,) if start.force <= 0.0 else (True, False) if by_dissipation else (False, True)
    while True:
        for by_energy in ways:
            try:
                if by_energy:
                    found = advance_by_dissipation(laminate, start, energy)
                    fits = abs(found.load - start.load) <= largest and found.load <= end
                else:
                    reaches = start.load + size * (1.0 + 1e-9) >= end
                    found = laminate.advance(start, end if reaches else start.load + size)
                    fits = taken(start, found) <= dissipation * (1.0 + _NEAR)
            except NotConverged as error:
                iterations += error.iterations
                problem = str(error)
                continue
            iterations += found.iterations
            if fits:
                following = unhalved if by_energy else size_after(found, size, halved, steps)
                return PathIncrement(found, following, iterations, halved, by_energy)
            problem = f"an increment to load {found.load:g} takes {taken(start, found):.3g} J"
        halved += 1
        size, energy = 0.5 * size, 0.5 * energy
        if size < steps.least:
            raise NotConverged(
                f"{problem}; the increment is below the least, {steps.least:g}: a smaller least increment, a smaller"
                " dissipation or a finer mesh may help",
                iterations,
            )
