"""A worker without a solver that ends when it is told: python mortal_worker.py --bind ENDPOINT --folder F --parent PID.

`die` in the folder above ends it when it is asked to evaluate, as long as that file stands; `die_once` ends the one
worker that can take it away; `stillborn` ends it when it starts.
Strains of which the first is negative always end it.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from pathlib import Path

import numpy as np

from protocol import micromechanics as m
from protocol.errors import ProtocolError
from protocol.server import Server
from protocol.service import Capabilities, Service


class MortalWorker(Service):
    """Answers twice the strain as stress."""

    role = "micromechanics"
    backend = "mortal"
    backend_version = "1"

    def __init__(self, folder: Path) -> None:
        super().__init__()
        self.folder = folder
        self.cells: set[str] = set()

    @property
    def step(self) -> int:
        return 0

    def capabilities(self) -> Capabilities:
        return {"criteria": [], "after_failure": []}

    def register(self, request: m.RegisterCell) -> m.CellRegistered:
        self.cells.add("c")
        with (self.folder / "registered.txt").open("a") as file:
            file.write("one\n")
        return m.CellRegistered(cell="c", subcells=1, failed_bytes=1, history_values=0, material_fraction=np.ones(1))

    def evaluate(self, request: m.EvaluateRequest) -> m.Evaluated:
        if request.cell not in self.cells:
            raise ProtocolError("unknown_cell", f"no cell {request.cell!r}", field="cell")
        points = len(request.strain)
        if points and (request.strain[0, 0] < 0 or (self.folder / "die").exists() or self._taken("die_once")):
            print("the end is near", flush=True)
            os._exit(7)
        if request.temperature == 77.0:
            for _ in range(200):
                self.activity.progress(0, 1, "slow")
                time.sleep(0.05)
        return m.Evaluated(
            stress=2.0 * request.strain, failed=np.zeros((points, 1), np.uint8), history=np.zeros((points, 0)),
            new_failures=0,
        )  # fmt: skip

    def _taken(self, name: str) -> bool:
        try:
            (self.folder / name).unlink()
        except FileNotFoundError:
            return False
        return True


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--bind")
    parser.add_argument("--folder", type=Path)
    parser.add_argument("--parent", type=int)
    options = parser.parse_args()
    above = options.folder.parent.parent
    if (above / "stillborn").exists():
        sys.exit("no luck")
    Server(MortalWorker(above), options.bind, parent=options.parent).run()


if __name__ == "__main__":
    main()
