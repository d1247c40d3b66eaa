"""Cases of the anchors: their reaction, its reference, the load they hand over, its impulse."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from md_service.anchors import Anchors
from md_service.crystals import fcc
from md_service.engine import Engine
from md_service.force_fields import force_field
from md_service.graphene import graphene
from md_service.lammps_dynamics import LammpsDynamics
from md_service.statistics import estimate
from md_service.units import ENERGY, LENGTH, VELOCITY
from md_service.verification.framed_sheet import framed_sheet
from protocol.verification import Case, Check

_WINDOW: Final = 10


# Identity -------------------------------------------------------------------------------------------------------------


def _write_trajectory(dynamics: LammpsDynamics, path: Path) -> None:
    """Let LAMMPS write every step, with nothing of ours in between."""
    dynamics._system.session.commands(
        [
            f"dump every_step all custom 1 {path} id xu yu zu vx vy vz",
            "dump_modify every_step sort id format float %.17g",
        ]
    )


def _read_trajectory(path: Path, n_atoms: int) -> list[NDArray[np.float64]]:
    """Positions (m) and velocities (m/s) of each frame, shape (n, 6)."""
    lines = path.read_text().splitlines()
    scale = np.repeat([LENGTH, VELOCITY], 3)  # LAMMPS writes its own units
    return [
        np.array([line.split()[1:] for line in lines[start + 9 : start + 9 + n_atoms]], dtype=float) * scale
        for start in range(0, len(lines), n_atoms + 9)
    ]


def _reaction(
    frames: list[NDArray[np.float64]], anchors: Anchors, place: list[NDArray[np.float64]], speed: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Mean of k (r - a) - gamma (v_a - v), from the state before the first step on, N, shape (k, 3)."""
    each = [
        anchors.stiffness[:, None] * (frame[anchors.atom_id, :3] - at)
        - anchors.damping[:, None] * (speed - frame[anchors.atom_id, 3:])
        for frame, at in zip(frames, place, strict=True)
    ]
    # The first and the last moment count half, as the integrator's kicks have them.
    return np.asarray(np.trapezoid(each, axis=0) / (len(each) - 1))


def _identity(engine: Engine, dynamics: LammpsDynamics, path: Path, drift: NDArray[np.float64]) -> float:
    """Largest difference of reaction and trajectory over the largest reaction: at rest and in two windows."""
    anchors = engine.anchors
    assert anchors is not None
    start = anchors.position.copy()
    engine.equilibrate(100)
    _write_trajectory(dynamics, path)
    reference = engine.measure_reference(8, _WINDOW).anchor_force
    centre = start.mean(axis=0)
    speed = (start - centre) * 1e10 + drift
    time = _WINDOW * engine.time_step
    first, second = start + 0.01 * (start - centre), start + 0.01 * (start - centre) + time * speed
    got = [engine.advance(_WINDOW, first, speed), engine.advance(_WINDOW, second, speed)]
    frames = _read_trajectory(path, engine.n_atoms)
    frames = frames[len(frames) - 10 * _WINDOW - 1 :]
    at_rest = _reaction(frames[: 8 * _WINDOW + 1], anchors, [start] * (8 * _WINDOW + 1), 0.0 * speed)
    at_rest -= at_rest.mean(axis=0)  # a sample that is held gains no momentum
    worst = float(np.abs(reference - at_rest).max() / np.abs(at_rest).max())
    for w, (answer, at) in enumerate(zip(got, (first, second), strict=True)):
        passed = [(step * engine.time_step if anchors.moving else 0.0) for step in range(_WINDOW + 1)]
        place = [at + t * speed for t in passed]
        expected = _reaction(frames[(8 + w) * _WINDOW : (9 + w) * _WINDOW + 1], anchors, place, speed) - at_rest
        worst = max(worst, float(np.abs(answer.anchor_force - expected).max() / np.abs(expected).max()))
    return worst


def _copper(folder: Path, moving: bool) -> tuple[Engine, LammpsDynamics]:
    """A periodic block with anchors on every third atom, where atoms cross a face of the box all the time."""
    profile = force_field("eam-copper")
    atoms = fcc("Cu", profile.spacing("copper", 0.0), (4, 4, 4))
    # A layer of atoms lies in the face of the box.
    atoms = atoms.at(atoms.position - (atoms.position[:, 0].min() - atoms.box.low[0]) * np.array([1.0, 0.0, 0.0]))
    dynamics = LammpsDynamics(folder, profile, atoms, temperature=300.0, seed=4)
    engine = Engine(dynamics, temperature=300.0, force_field=profile)
    held = np.arange(0, len(atoms), 3)
    engine.register_anchors(
        held, atoms.position[held], np.full(len(held), 20.0), np.zeros(len(held), dtype=np.int64), 1e-13, moving=moving
    )
    return engine, dynamics


def anchor_identity(folder: Path) -> list[Check]:
    """Reactions of held and moving anchors against every step of a trajectory that LAMMPS writes."""
    checks = []
    for moving in (False, True):
        kind = "moving" if moving else "held"
        sheet = framed_sheet(folder / f"sheet_{kind}", moving=moving)
        copper, of_copper = _copper(folder / f"copper_{kind}", moving)
        for what, engine, dynamics, drift in (
            ("graphene, free edges", sheet.engine, sheet.dynamics, np.zeros(3)),
            ("copper, periodic", copper, of_copper, np.array([2e3, 0.0, 0.0])),
        ):
            try:
                value = _identity(engine, dynamics, folder / f"{what.split(',')[0]}_{kind}.txt", drift)
            finally:
                engine.close()
            checks.append(
                Check(
                    f"reaction of {kind} anchors, {what}: largest difference over the largest force",
                    value,
                    0.0,
                    1e-12,
                    "mean of k (r - a) - gamma (v_a - v) over a trajectory dumped by LAMMPS at every step",
                )
            )
    return checks


# Baseline -------------------------------------------------------------------------------------------------------------


def baseline(folder: Path) -> list[Check]:
    """Without load nothing is left of the reaction once the reference is taken off."""
    windows = 1500
    sheet = framed_sheet(folder, seed=11)
    engine = sheet.engine
    engine.equilibrate(2000)
    reference = engine.measure_reference(windows, _WINDOW)
    still = np.zeros_like(sheet.anchor)
    series = np.array([engine.advance(_WINDOW, sheet.anchor, still).ivc_force for _ in range(windows)])
    engine.close()
    # Quadrants 1 and 3 are the right half, 2 and 3 the upper one.
    halves = np.stack([series[:, [1, 3], 0].sum(axis=1), series[:, [2, 3], 1].sum(axis=1)], axis=1)
    taken_off = np.array([reference.ivc_force[[1, 3], 0].sum(), reference.ivc_force[[2, 3], 1].sum()])
    interval = _WINDOW * engine.time_step
    half = estimate(halves, interval)
    cell = estimate(series, interval)
    # The reference is as long as the run, so it is as uncertain.
    half_error = np.sqrt(2.0) * half.standard_error
    in_errors = cell.mean / np.hypot(cell.standard_error, reference.ivc_standard_error)
    source = "zero, by the definition of the reference (Eq 87)"
    checks = [
        Check(
            f"root mean square over {what} of the mean reaction in standard errors",
            value,
            2.0,
            0.0,
            source,
            at_most=True,
        )
        for what, value in (
            ("right half along x and upper half along y", float(np.sqrt(np.mean((half.mean / half_error) ** 2)))),
            ("quadrants and components", float(np.sqrt(np.mean(in_errors**2)))),
        )
    ]
    checks.append(
        Check(
            "standard error of the halves over the pull of the free edges, which was taken off",
            float(np.max(half_error / np.abs(taken_off))),
            0.1,
            0.0,
            "the edges of a graphene sheet are under stress, so the reference is far from zero",
            at_most=True,
        )
    )
    return checks


# Patch ----------------------------------------------------------------------------------------------------------------

_STRAIN: Final = 0.01


def _tension_of_energy(folder: Path) -> float:
    """Force per length along x of a periodic sheet under the strain, at 0 K: no virial and no anchors in it, N/m."""
    profile = force_field("tersoff")
    cell = graphene(20e-10, 20e-10, spacing=profile.lattice_constant, periodic=True)
    energy, h = [], 1e-4
    for strain in (_STRAIN - h, _STRAIN + h):
        stretch = np.array([1.0 + strain, 1.0, 1.0])
        box = replace(cell.box, low=cell.box.low * stretch, high=cell.box.high * stretch)
        dynamics = LammpsDynamics(folder, profile, cell.at(cell.position * stretch, box), temperature=0.0, seed=0)
        dynamics.minimise(2000)
        energy.append(float(dynamics.virial_and_energy()[1].sum()))
        dynamics.close()
    width, height, _ = cell.box.high - cell.box.low
    return float((energy[1] - energy[0]) / (2.0 * h * width * height))


def _patch(folder: Path, height: float, frame: bool) -> tuple[float, float, float, float]:
    """Strains along x and y inside, pull on the right half (N) and true height (m) of a sheet under the strain.

    With a frame of anchors the sheet has free edges all around; else anchors at the left and right alone, and it
    repeats along y.
    """
    profile = force_field("tersoff")
    atoms = graphene(104e-10, height, spacing=profile.lattice_constant, periodic=not frame)
    if not frame:
        atoms = replace(atoms, box=replace(atoms.box, periodic=(False, True, False)))
    depth = np.minimum(atoms.position - atoms.position.min(axis=0), atoms.position.max(axis=0) - atoms.position)
    atom_id = np.flatnonzero(depth[:, : 2 if frame else 1].min(axis=1) < 15e-10)
    anchor = atoms.position[atom_id]
    dynamics = LammpsDynamics(folder, profile, atoms, temperature=0.0, seed=0)
    engine = Engine(dynamics, temperature=0.0)
    stiffness = np.full(len(atom_id), 20.0 * ENERGY / LENGTH**2)
    engine.register_anchors(atom_id, anchor, stiffness, (anchor[:, 0] > 0.0).astype(np.int64))
    engine.equilibrate(4000)
    at_rest = dynamics.position()
    engine.measure_reference(8, 1)
    pulled, still = anchor * [1.0 + _STRAIN, 1.0, 1.0], np.zeros_like(anchor)
    # A window hands the new places over; then the atoms find theirs by minimisation.
    engine.advance(1, pulled, still)
    engine.equilibrate(4000)
    moved = dynamics.position() - at_rest
    pull = -float(engine.advance(1, pulled, still).ivc_force[1, 0])
    engine.close()
    inside = (np.abs(at_rest[:, 0]) < 30e-10) & (np.abs(at_rest[:, 1]) < 0.3 * height)
    along, across = (float(np.polyfit(at_rest[inside, a], moved[inside, a], 1)[0]) for a in (0, 1))
    return along, across, pull, float(atoms.box.high[1] - atoms.box.low[1])


def anchor_patch(folder: Path) -> list[Check]:
    """A strain that anchors impose arrives inside, and the reaction is stress times width.

    Free edges are stiffer than the sheet and carry 1.9 % of the load of the framed sheet; two framed sheets of
    unequal height have the same edges, so the difference is free of them, and a sheet without edges has none.
    """
    tension = _tension_of_energy(folder / "cell")
    along, across, pull, height = _patch(folder / "framed", 104e-10, frame=True)
    _, _, lower_pull, lower = _patch(folder / "lower", 70e-10, frame=True)
    _, _, strip_pull, strip = _patch(folder / "strip", 30e-10, frame=False)
    source = f"slope of the energy of a periodic sheet at {_STRAIN:.0%} strain, times the height"
    held = "strain of the anchors"
    return [
        Check("strain along x inside a frame of anchors", along, _STRAIN, 1e-3, held),
        Check("strain along y inside a frame of anchors", across, 0.0, 2e-3 * _STRAIN, held),
        Check("reaction of half a sheet without edges", strip_pull, tension * strip, 2e-3, source, "N"),
        Check(
            f"reaction of half a framed sheet, difference of heights of {height * 1e10:.0f} and {lower * 1e10:.0f} A",
            pull - lower_pull,
            tension * (height - lower),
            2e-3,
            source,
            "N",
        ),
    ]


# Impulse --------------------------------------------------------------------------------------------------------------


def impulse(folder: Path) -> list[Check]:
    """Without dampers the momentum of the atoms changes by the impulse of the anchors and nothing else."""
    sheet = framed_sheet(folder, damping_time=None)
    engine = sheet.engine
    engine.equilibrate(500)
    reference = engine.measure_reference(8, _WINDOW).anchor_force
    mass = engine.atoms.atom_mass
    momentum = mass @ engine.fields(["velocity"])["velocity"]
    total = np.zeros(3)
    for jump in range(1, 11):
        away = sheet.anchor + 0.1 * jump * np.array([0.3e-10, -0.2e-10, 0.1e-10])
        answer = engine.advance(_WINDOW, away, np.zeros_like(away))
        total -= _WINDOW * engine.time_step * (answer.anchor_force + reference).sum(axis=0)
    momentum_after = mass @ engine.fields(["velocity"])["velocity"]
    engine.close()
    return [
        Check(
            f"impulse of the anchors along {axis} over {10 * _WINDOW} steps",
            float(total[a]),
            float(momentum_after[a] - momentum[a]),
            1e-6,
            "change of the momentum of all atoms",
            "N s",
        )
        for a, axis in enumerate("xyz")
    ]


CASES = [
    Case(
        "md",
        "anchor-identity",
        "reaction of held and moving anchors against an independent trajectory",
        anchor_identity,
    ),
    Case("md", "baseline", "no reaction of an unloaded sheet with free edges once the reference is off", baseline),
    Case(
        "md", "anchor-patch", "1 % strain by anchors: strain inside, reaction against stress times width", anchor_patch
    ),
    Case("md", "impulse", "impulse of the reaction against the change of momentum", impulse),
]
