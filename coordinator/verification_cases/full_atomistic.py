"""Cases `coupling/full-atomistic...`: the coupled run against the same body of atoms alone."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from coordinator.compare import measured_properties, track
from coordinator.full_atomistic import isotropic_of
from coordinator.scene import load_scene
from coordinator.verification_cases.runs import run_text, shipped
from protocol.verification import CannotRun, Case, Check

SHIPPED_SCENES: Final = Path(__file__).resolve().parents[2] / "scenes"
#: Seeds of coupled runs beside the first, for the scatter of the load.
OTHER_SEEDS: Final = (2, 3)
#: Tips move by whole lattice constants.
ROUND_OFF: Final = 1e-6
#: Share of the time of the full atomistic run that the coupled one may take.
MOST_TIME: Final = 0.2


def compare(scene: Path, folder: Path, overrides: Sequence[str] = ()) -> dict[str, Any]:
    """Run the command `compare` as a user would, put its picture beside the folder, and return its answer.

    Raises
    ------
    RuntimeError
        Where it fails; the message is what it printed.
    """
    words = [sys.executable, "-m", "coordinator.cli", "compare", str(scene), "--full-atomistic", "--out", str(folder)]
    for override in overrides:
        words += ["--set", override]
    done = subprocess.run(words, capture_output=True, text=True, stdin=subprocess.DEVNULL, check=False)
    if done.returncode != 0:
        raise RuntimeError(f"the comparison in {folder} ended with status {done.returncode}:\n{done.stderr}")
    shutil.copyfile(folder / "compare.png", folder.with_suffix(".png"))
    found: dict[str, Any] = json.loads((folder / "compare.json").read_text())
    return found


def lattice(folder: Path) -> list[Check]:
    """Brittle lattice at 0 K: load at the first broken bond, and loads at which the tips are equally far."""
    folder.mkdir(parents=True, exist_ok=True)
    scene = folder / "brittle_lattice.toml"
    scene.write_text(shipped("brittle_lattice"), encoding="utf-8")
    found = compare(scene, folder / "brittle_lattice")
    return _loads(found, "the whole body as a lattice, same load, 0 K")


def graphene(folder: Path) -> list[Check]:
    """Graphene under a crack-tip field at 10 K: load at the first broken bond, crack tip, cost."""
    scene = SHIPPED_SCENES / "graphene_small.toml"
    if not scene.exists():
        raise CannotRun(f"{scene} is not there: run from a checkout")
    found = compare(scene, folder / "graphene_small")
    loads = [found["coupled"]["load_at_first_break"]]
    for seed in OTHER_SEEDS:
        loads.append(_first_break(scene, folder / f"seed_{seed}", seed))
    scatter = max(loads) - min(loads)
    source = (
        f"the whole body of atoms, {found['all_atom']['atoms']} of them, same load, damping and potential; loads of "
        f"{len(loads)} seeds of the coupled run are {', '.join(f'{load:.4g}' for load in loads)}"
    )
    checks = _loads(found, source)
    checks.append(Check("scatter of the load at the first broken bond over seeds", scatter, 0.0, 0.05, source))
    source = "wall and processor time of the full atomistic run, preparation included"
    return [
        *checks,
        Check("largest difference of crack tips at one load, lattice constants", found["tip_difference"], 1.0,
              ROUND_OFF, "the whole body of atoms, same load", at_most=True),
        Check("wall time of the coupled run over the full one", found["time_share"], MOST_TIME, 0.0, source,
              at_most=True),
        Check("processor time of the coupled run over the full one", found["processor_share"], MOST_TIME, 0.0, source,
              at_most=True),
    ]  # fmt: skip


def _loads(found: dict[str, Any], source: str) -> list[Check]:
    coupled, whole = found["coupled"], found["all_atom"]
    if coupled["load_at_first_break"] is None or whole["load_at_first_break"] is None:
        raise RuntimeError("no bond broke in one of the two runs; there is no load to compare")
    return [
        Check("load at the first broken bond", coupled["load_at_first_break"], whole["load_at_first_break"], 0.05,
              source),
        Check("largest difference of loads at one crack tip", found["tip_load_difference"], 0.05, 0.0, source,
              at_most=True),
        Check("largest difference of crack tips since the first broken bond, lattice constants",
              found["tip_difference_since_break"], 1.0, ROUND_OFF, source, at_most=True),
    ]  # fmt: skip


def _first_break(scene: Path, folder: Path, seed: int) -> float:
    """Run a scene coupled with another seed and return the load at its first broken bond."""
    override = f"run.seed={seed}"
    with run_text(scene.read_text(encoding="utf-8"), folder, [override]):
        pass
    material = isotropic_of(load_scene(scene), measured_properties(folder / "run"))
    run = track(load_scene(scene), material, folder / "run")
    row = run.first_break()
    if row is None:
        raise RuntimeError(f"no bond broke in the coupled run with seed {seed}")
    return float(run.load[row])


CASES = [
    Case("coupling", "full-atomistic-lattice", "brittle lattice at 0 K, coupled against the whole lattice", lattice),
    Case("coupling", "full-atomistic", "graphene under a crack-tip field, coupled against all atoms", graphene,
         slow=True),
]  # fmt: skip
