"""A run that is saved and one that is restored from the file go on alike, to the bit."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from md_service.crystals import fcc
from md_service.engine import Engine
from md_service.ensembles import Ensemble
from md_service.force_fields import force_field
from md_service.lammps_dynamics import LammpsDynamics
from protocol.verification import Case, Check

_FIELDS = ("position", "velocity", "mean_position", "mean_velocity", "virial", "energy", "stress")


def _block(folder: Path, seed: int, ensemble: Ensemble | None, moving: bool) -> Engine:
    """A periodic block of copper with a third of its atoms on anchors, some of them passive."""
    profile = force_field("eam-copper")
    atoms = fcc("Cu", profile.spacing("copper", 0.0), (4, 4, 4))
    engine = Engine(LammpsDynamics(folder, profile, atoms, temperature=300.0, seed=seed), temperature=300.0)
    held = np.arange(0, len(atoms), 3)
    engine.register_anchors(
        held,
        atoms.position[held],
        np.full(len(held), 20.0),
        np.arange(len(held)) % 4,
        1e-13,
        kind=(np.arange(len(held)) % 8 == 0).astype(np.int64),
        moving=moving,
    )
    if ensemble is not None:
        engine.equilibrate(60, ensemble=ensemble, keep_ensemble=True)
    else:
        engine.equilibrate(60)
    return engine


def _unequal(folder: Path, ensemble: Ensemble | None, moving: bool) -> int:
    """Numbers that differ between both runs, after the save, in all answers and fields."""
    through, resumed = (
        _block(folder / name, seed, ensemble, moving) for name, seed in (("through", 5), ("resumed", 9))
    )
    assert through.anchors is not None
    place = through.anchors.position.copy()
    through.collect_fields(True)
    through.measure_reference(8, 10)
    speed = np.full_like(place, 50.0)
    for i in range(3):
        through.advance(10, place * (1.0 + 1e-3 * i), speed)
    state: dict[str, Any] = {**through.state()}
    np.savez(folder / "state.npz", **state)
    with np.load(folder / "state.npz") as saved:
        resumed.restore({name: saved[name] for name in saved.files})
    different = int(through.step != resumed.step)
    for window in (10, 10, 7, 10):
        a, b = (engine.advance(window, place * 1.002, speed) for engine in (through, resumed))
        for name, value in vars(a).items():
            different += int(
                np.sum(~np.equal(value, getattr(b, name)) & ~(np.isnan(value) & np.isnan(getattr(b, name))))
            )
    one, other = through.fields(_FIELDS), resumed.fields(_FIELDS)
    different += sum(int(np.sum(one[name] != other[name])) for name in _FIELDS)
    for engine in (through, resumed):
        engine.close()
    return different


def _equal_under_other_noise(folder: Path) -> int:
    """Velocities that are equal in two runs from one state whose thermostats have unequal seeds."""
    engine = _block(folder, 5, None, moving=False)
    assert engine.anchors is not None
    place = engine.anchors.position.copy()
    engine.measure_reference(8, 10)
    state, velocity = engine.state(), []
    for seed in (5.0, 6.0):
        state["counters"][1] = seed
        engine.restore(state)
        engine.advance(10, place, 0.0 * place)
        velocity.append(engine.fields(["velocity"])["velocity"])
    carried = engine.anchors.atom_id[engine.anchors.passive]
    engine.close()
    return int(np.sum(np.delete(velocity[0] == velocity[1], carried, axis=0)))


def checkpoint(folder: Path) -> list[Check]:
    """Save and restore in mid-run, with the noise of each thermostat, held and moving anchors, and a barostat."""
    checks = []
    runs: list[tuple[str, Ensemble | None, bool]] = [
        ("damper of the anchors, held", None, False),
        ("damper of the anchors, moving", None, True),
        ("langevin", Ensemble("langevin", 300.0), False),
        ("nose-hoover", Ensemble("nose-hoover", 300.0), False),
        ("berendsen", Ensemble("berendsen", 300.0), False),
        ("andersen", Ensemble("andersen", 300.0, 5e-14), False),
        ("nose-hoover with pressure", Ensemble("nose-hoover", 300.0, pressure=0.0), False),
    ]
    for i, (what, ensemble, moving) in enumerate(runs):
        (folder / str(i)).mkdir()
        value = _unequal(folder / str(i), ensemble, moving)
        checks.append(
            Check(
                f"numbers that differ after a restore, thermostat: {what}",
                float(value),
                0.0,
                0.0,
                "the run that was saved and went on; energies, forces, work, positions, velocities, virials",
            )
        )
    checks.append(
        Check(
            "velocities that are equal after 10 steps under other noise",
            float(_equal_under_other_noise(folder / "noise")),
            0.0,
            0.0,
            "none: the noise reaches every atom, so the figures above see it",
        )
    )
    return checks


CASES = [Case("md", "checkpoint", "save and restore in mid-run with each thermostat, bit for bit", checkpoint)]
