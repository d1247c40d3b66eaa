"""The exchange over our own wire: `protocol.client.Client` to a small continuum service in its own process.

`python -m benchmarks.service_echo ENDPOINT [KEYS]` is that service.
"""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from benchmarks.lane import DirectLane, helper_process
from protocol.arrays import FloatArray
from protocol.client import Client
from protocol.continuum import (
    ContinuumAdvance,
    ContinuumAdvanced,
    ContinuumConfigure,
    ContinuumConfigured,
    IsotropicMaterial,
    Rectangle,
)
from protocol.server import Server
from protocol.service import Capabilities, Service

#: The service solves nothing, so any legal problem will do.
PROBLEM = ContinuumConfigure(
    assumption="plane_strain",
    thickness=1.0,
    body=Rectangle(lower=(0.0, 0.0), upper=(1.0, 1.0)),
    cell_size=1.0,
    points_per_cell=1,
    material=IsotropicMaterial(young=1.0, poisson=0.3, density=1.0),
    time_step=0.1,
)


class EchoContinuum(Service):
    """A continuum whose anchors stand where the forces point: it costs nothing, so the wire alone is timed."""

    role = "continuum"
    backend = "echo"
    backend_version = "1"

    def __init__(self) -> None:
        super().__init__()
        self._step = 0

    @property
    def step(self) -> int:
        """Steps since `configure`."""
        return self._step

    def capabilities(self) -> Capabilities:
        """Nothing beyond `configure` and `advance`."""
        return {"fields": [], "dimension": 2}

    def configure(self, request: ContinuumConfigure) -> ContinuumConfigured:
        """Set the step counter to zero."""
        self._step = 0
        return ContinuumConfigured(
            courant_number=request.time_step,
            stable_time_step=1.0,
            cells=1,
            position=np.full((1, 3), 0.5),
            weight=np.ones(1),
        )

    def advance(self, request: ContinuumAdvance) -> ContinuumAdvanced:
        """Return the forces: their first half of rows as displacements, the second as velocities."""
        force = request.ivc_force if request.ivc_force is not None else np.zeros((0, 3))
        half = len(force) // 2
        self._step += request.steps
        return ContinuumAdvanced(
            step=self._step,
            anchor_displacement=force[:half],
            anchor_velocity=force[half : 2 * half],
            edge_force=np.zeros(0),
            edge_displacement=np.zeros(0),
            kinetic_energy=0.0,
            strain_energy=0.0,
            edge_work=0.0,
            interface_work=0.0,
            damping_loss=0.0,
            points_lost=0,
        )


class ServiceLane(DirectLane):
    """One `advance`: n x 3 forces up, n/2 x 3 displacements and n/2 x 3 velocities back.

    Models are built and checked on both sides in both directions, as in a run.
    """

    def __init__(self, label: str, client: Client) -> None:
        self.label = label
        self._client = client
        client.call("configure", PROBLEM, ContinuumConfigured)

    def trip(self, values: FloatArray) -> tuple[FloatArray, ...]:
        """Advance one step under `values` (shape (n, 3), n even) and return displacements and velocities."""
        answer = self._client.call("advance", ContinuumAdvance(steps=1, ivc_force=values), ContinuumAdvanced, step=1)
        return answer.anchor_displacement, answer.anchor_velocity


@contextlib.contextmanager
def service_lane(label: str, endpoint: str, keys: Path | None = None) -> Iterator[ServiceLane]:
    """Start the service as a process of its own and connect to it; with CURVE where `keys` are given."""
    arguments = [endpoint] if keys is None else [endpoint, str(keys)]
    with helper_process("benchmarks.service_echo", *arguments) as bound:
        client = Client.connect(bound, "continuum", keys=keys, run="bench")
        try:
            yield ServiceLane(label, client)
        finally:
            client.close()


def serve(endpoint: str, keys: Path | None) -> None:
    """Serve until the process that started this one is gone."""
    server = Server(EchoContinuum(), endpoint, keys=keys, parent=os.getppid())
    server.run(on_ready=lambda bound: print(bound, flush=True))


if __name__ == "__main__":
    serve(sys.argv[1], Path(sys.argv[2]) if len(sys.argv) > 2 else None)
