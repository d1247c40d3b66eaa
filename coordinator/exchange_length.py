"""Choice of M, the atomistic steps in one exchange, from the standard error of the forces that it averages."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from coordinator.handshake import HandshakeError
from coordinator.region import Region
from coordinator.scene import Scene
from coordinator.wave_speed import courant_number
from protocol import continuum as c

#: M of the first trial.
FIRST_TRIAL = 10


def choose_steps_per_exchange(
    scene: Scene,
    regions: Sequence[Region],
    material: c.IsotropicMaterial,
    tell: Callable[[str], None] = lambda _: None,
) -> tuple[int, list[str]]:
    """Return M and what a user should know of it.

    M is raised until the scatter of one exchange's mean force on a volume cell, measured on the equilibrated atoms
    with anchors at rest, is at most `handshake.force_error`. For white noise the scatter falls with the root of M;
    a larger M also takes a larger weight and softer anchors with it, see `coordinator.handshake`.

    Parameters
    ----------
    scene : Scene
        With `handshake.force_error`.
    regions : sequence of Region
        Configured; joined and registered for each trial.
    material : IsotropicMaterial
        Of the continuum.
    tell : callable
        Told of each trial.

    Raises
    ------
    HandshakeError
        Where even the first trial would be unstable.
    """
    table = scene.handshake
    assert table is not None and table.force_error is not None
    most = table.most_steps_per_exchange
    steps = min(FIRST_TRIAL, most)
    while True:
        tried = scene.with_steps_per_exchange(steps)
        try:
            for region in regions:
                region.scene = tried
                region.join(material, courant_number(tried, material))
        except HandshakeError as error:
            if steps == min(FIRST_TRIAL, most):
                raise
            most, steps = steps - 1, max(1, steps // 2)
            if steps >= most:
                return most, [f"No M reaches handshake.force_error: above {most} the exchange is unstable ({error})"]
            continue
        tell(f"measure noise of the interface forces with M = {steps}")
        found = max(_scatter(region) for region in regions)
        if found <= table.force_error:
            return steps, []
        if steps >= most:
            return steps, [
                f"handshake.force_error of {table.force_error:.3g} N is not reached: with the largest M allowed,"
                f" {steps}, the error of a mean force is {found:.3g} N."
            ]
        steps = min(most, max(steps + 1, math.ceil(steps * (found / table.force_error) ** 2)))


def _scatter(region: Region) -> float:
    """Return the standard deviation of one exchange's mean force on a cell, root mean square over cells, N."""
    region.register()
    deviation = region.equilibrate().window_ivc_deviation[:, :2]
    return float(np.sqrt(np.mean(deviation**2)))
