"""Equilibria after a given dissipation: the path of a laminate that snaps back, where the load has to fall.

The load is an unknown as well. What closes the equations is the energy that an increment takes (Gutierrez, Commun.
Numer. Meth. Eng. 20 (2004) 19-29; Verhoosel, Remmers and Gutierrez, Int. J. Numer. Meth. Eng. 77 (2009) 1290-1321):
where damage unloads to the origin, the laminate holds F load / 2, so from (load_0, F_0) to (load, F) it takes

    (F_0 load - F load_0) / 2

That is always growing while something softens, whether the load rises or falls, and zero before: an increment goes on
until damage begins. It is exact for softening; what fails at once takes what it takes and cannot be controlled, so
nothing that has failed in an iteration is kept.
"""

from __future__ import annotations

import numpy as np

from fem_service.difference_tangent import differentiated
from fem_service.equilibrium import Aim, Equilibrium, NotConverged
from fem_service.quasi_static import QuasiStatic

#: Allowed error of the dissipation, relative.
_ACCURATE = 1e-6
#: Difference of secant and tangent stiffness over the secant, below which nothing softens but what balance left open.
_ELASTIC = 1e-5


def taken(start: Equilibrium, end: Equilibrium) -> float:
    """Energy that a laminate that unloads to the origin has taken from one equilibrium to another, J."""
    return 0.5 * (start.force * end.load - end.force * start.load)


def advance_by_dissipation(laminate: QuasiStatic, start: Equilibrium, dissipation: float) -> Equilibrium:
    """Find the equilibrium that has taken so much more energy; `start` stays as it is.

    Parameters
    ----------
    laminate : QuasiStatic
        Without viscosity.
    start : Equilibrium
        Under load.
    dissipation : float
        J.

    Raises
    ------
    NotConverged
        If there is none within the iterations.
    ValueError
        If the dissipation or the force is not positive or the laminate has a viscosity.
    """
    if not dissipation > 0.0:
        raise ValueError(f"dissipation is {dissipation}; it must be greater than 0")
    if laminate.viscosity:
        raise ValueError(f"viscosity is {laminate.viscosity}; it must be 0, since the load is not a time here")
    if not start.force > 0.0:
        raise ValueError(f"force is {start.force} at the start; it must be greater than 0: begin by the load")
    laminate.system.begin()
    load = start.load
    displacement = start.displacement.reshape(-1).copy()
    pulled = np.zeros_like(displacement)
    pulled[laminate.grips.freedoms] = laminate.grips.per_load
    for iteration in range(1, laminate.iterations + 1):
        laminate.watch(iteration)
        aim = Aim(start, load, 1.0)
        response = laminate.respond(displacement, start.points, aim)
        force = laminate.work_per_load(displacement, response, load)
        missing = dissipation - 0.5 * (start.force * load - force * start.load)
        worst = float(np.abs(response.force[laminate.system.free]).max(initial=0.0))
        if worst <= laminate.tolerance * response.largest and abs(missing) <= _ACCURATE * dissipation:
            return laminate.equilibrium(aim, displacement, response, iteration, worst / response.largest)
        matrix = laminate.stiffness(differentiated(laminate, displacement, response, start.points), secant=False)
        try:
            back = laminate.system.solve(matrix, -response.force)
            right = -(matrix @ pulled)
            if laminate.lever is not None:
                right += laminate.lever.push(len(displacement))
            forth = pulled + laminate.system.solve(matrix, right)
        except ValueError as error:
            raise NotConverged(f"no equilibrium near load {load:g}: {error}", iteration) from None
        # The force changes with the displacement, and with the load itself where there is a lever.
        by_back, by_forth = float(pulled @ (matrix @ back)), float(pulled @ (matrix @ forth))
        if laminate.lever is not None:
            by_back -= laminate.lever.stiffness * laminate.lever.moved(back.reshape(-1, 3))
            by_forth += laminate.lever.stiffness * (1.0 - laminate.lever.moved(forth.reshape(-1, 3)))
        softening = start.force - start.load * by_forth
        if abs(softening) > _ELASTIC * abs(start.force):
            change = (missing + 0.5 * start.load * by_back) / (0.5 * softening)
        else:
            # Forward until something does, by the load over which the force does as much work as is to be taken.
            change = dissipation / start.force
        displacement = displacement + back + change * forth
        load += change
        if not (np.isfinite(load) and np.isfinite(displacement).all()):
            break
    raise NotConverged(
        f"no equilibrium {dissipation:g} J beyond load {start.load:g} after {iteration} iterations; a smaller "
        "dissipation may help",
        iteration,
    )
