"""Cracked sheets pulled apart."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from md_service.atoms import CrackCut
from md_service.bonds import BondReport
from md_service.engine import Engine
from md_service.force_fields import force_field
from md_service.fracture_guard import FractureGuard
from md_service.graphene import graphene
from md_service.lammps_dynamics import LammpsDynamics
from md_service.results import Advance

BOND = 1.3985e-10  # of airebo at 300 K
WINDOW = 10


@dataclass
class Pulled:
    answers: list[Advance]
    reports: list[BondReport]
    released: list[float]


def pulled_apart(name: str, folder: Path, strain: float, windows: int = 160) -> Pulled:
    """Cracked sheet, pulled along y at its upper and lower margins at 300 K."""
    atoms = graphene(34e-10, 34e-10, spacing=BOND, crack=CrackCut(-3e-10))
    margin = np.flatnonzero(np.abs(atoms.position[:, 1]) > 12e-10)
    anchor = atoms.position[margin]
    field = force_field(name)
    dynamics = LammpsDynamics(folder, field, atoms, temperature=300.0, seed=1)
    engine = Engine(dynamics, temperature=300.0, force_field=field)
    guard = FractureGuard(field, atoms)
    engine.register_anchors(margin, anchor, np.full(len(margin), 80.0), (anchor[:, 1] > 0).astype(np.int64), 5e-14)
    engine.equilibrate(200)
    engine.measure_reference(8, WINDOW)
    pulled = Pulled([], [], [])
    for i in range(windows):
        factor = 1.0 + strain * i / windows
        pulled.answers.append(engine.advance(WINDOW, anchor * [1.0, factor, 1.0], np.zeros_like(anchor)))
        pulled.reports.append(guard.report(dynamics.position()))
        pulled.released.append(guard.released_energy)
    engine.close()
    return pulled


def test_crack_grows_with_the_sharp_cutoff(tmp_path: Path) -> None:
    pulled = pulled_apart("airebo-sharp", tmp_path, 0.16)
    first, last = pulled.reports[0], pulled.reports[-1]
    assert first.broken == 0
    assert last.broken >= 5
    assert last.tip_x > first.tip_x + 8e-10
    assert max(np.diff([report.tip_x for report in pulled.reports])) < 8e-10  # it runs, it does not jump
    # Torn apart, the sheet carries little of what it carried.
    load = [answer.ivc_force[0, 1] for answer in pulled.answers]
    assert abs(np.mean(load[-10:])) < 0.5 * max(load)


def test_crack_sticks_with_the_default_cutoff(tmp_path: Path) -> None:
    last = pulled_apart("airebo", tmp_path, 0.16).reports[-1]
    assert last.broken == 0
    assert last.sticking > 0
    assert "stick at 1.70 A" in last.warning


def test_far_above_the_load_of_growth_nothing_explodes_and_cuts_give_the_stated_energy(tmp_path: Path) -> None:
    # Nearly three times as fast and far as the crack needs; an atom that runs away is an EngineError.
    pulled = pulled_apart("airebo-sharp", tmp_path, 0.40)
    broken = np.array([report.broken for report in pulled.reports])
    assert broken[-1] >= 10
    # 15 bonds of 3.7 eV are 500 K of heat in these 470 atoms, and the pulling does as much; the cut with a window of
    # 1e-4 A ended at a million K.
    assert max(answer.temperature for answer in pulled.answers) < 2000.0
    # Energy that came from nowhere: what is not the work of anchors and thermostats. While the crack runs through the
    # sheet each bond brings as much; of ends that are torn off at last each brings less.
    gained = np.array([a.potential_energy + a.kinetic_energy - a.anchor_work for a in pulled.answers])
    gained -= gained[0]
    running = broken <= 7
    per_bond, _ = np.polyfit(broken[running], gained[running], 1)
    cut_energy = pulled.released[-1] / broken[-1]
    assert broken[running].max() >= 5
    assert np.abs(gained[broken == 0]).max() < 0.6 * cut_energy
    # Less than where halves are parted rigidly, since the neighbours of the bond give way.
    assert 0.75 * cut_energy < per_bond < cut_energy
