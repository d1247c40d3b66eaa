"""A run that never ran: a results file and summary with plausible fields, for tests of file and report.

The crack scene has the mode-I near field around its tip, the patch scene a uniform strain, so that
what the report computes from them is known in closed form.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from coordinator.interface import build_interface
from coordinator.results import Results, ResultsWriter
from coordinator.ring import rectangle_ring
from coordinator.scene import Scene, load_scene
from coordinator.summary import Summary, WallTime, measures_of

Array = NDArray[np.float64]
SCENES = Path(__file__).parents[2] / "scenes"
YOUNG, POISSON, THICKNESS, BOND = 830e9, 0.35, 3.35e-10, 1.40e-10
SMALL_CRACK = (
    'continuum.lower=["-102.5 angstrom", "-92.5 angstrom"]',
    'continuum.upper=["102.5 angstrom", "92.5 angstrom"]',
)
PEAK_STRAIN = 0.01


def graphene(scene: Scene) -> Array:
    """Positions of a sheet of the scene's extent, shape (atoms, 3), m; without the rows of a crack."""
    assert scene.atomistic is not None
    width, height = scene.atomistic.width, scene.atomistic.height
    across, along = np.sqrt(3.0) * BOND, 3.0 * BOND
    basis = np.array([[0.0, 0.0], [0.5 * across, 0.5 * BOND], [0.5 * across, 1.5 * BOND], [0.0, 2.0 * BOND]])
    columns, rows = int(width / across), int(height / along)
    i, j = np.meshgrid(np.arange(columns), np.arange(rows))
    cells = np.stack([i.ravel() * across, j.ravel() * along], axis=1)
    flat = (cells[:, None, :] + basis[None]).reshape(-1, 2)
    # a row of bonds along y lies across the middle, so that a crack there cuts two zigzag rows
    flat -= 0.5 * (flat.min(axis=0) + flat.max(axis=0)) + [0.0, 0.25 * BOND]
    if scene.crack is not None:
        gap = (np.abs(flat[:, 1] - scene.crack.y) < 0.8 * BOND) & (flat[:, 0] < scene.crack.tip_x)
        flat = flat[~gap]
    return np.column_stack([flat, np.zeros(len(flat))])


def material_points(scene: Scene) -> tuple[Array, Array]:
    """Positions, shape (points, 3), m, and weights of the material points."""
    low, high = np.array(scene.continuum.lower), np.array(scene.continuum.upper)
    step = scene.continuum.cell_size / scene.continuum.points_per_cell
    axes = [low[k] + step * (0.5 + np.arange(round((high[k] - low[k]) / step))) for k in (0, 1)]
    flat = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
    weight = np.ones(len(flat))
    corners = scene.overlap()
    if corners is not None:
        inner, outer = ([np.array(c) for c in rectangle] for rectangle in corners)
        weight[np.all((flat > outer[0]) & (flat < outer[1]), axis=1)] = 0.2
        keep = ~np.all((flat > inner[0]) & (flat < inner[1]), axis=1)
        flat, weight = flat[keep], weight[keep]
    return np.column_stack([flat, np.zeros(len(flat))]), weight


def fields(scene: Scene, flat: Array, strain: float) -> tuple[Array, Array]:
    """Displacement, shape (n, 3), m, and stress, shape (n, 3), Pa, at positions, shape (n, 3)."""
    displacement, stress = np.zeros((len(flat), 3)), np.zeros((len(flat), 3))
    modulus = YOUNG / (1 - POISSON**2)
    if scene.crack is None:
        displacement[:, 1] = strain * flat[:, 1]
        stress[:, 0], stress[:, 1] = POISSON * modulus * strain, modulus * strain
        return displacement, stress
    height = scene.continuum.upper[1] - scene.continuum.lower[1]
    intensity = np.sqrt(YOUNG * 0.5 * modulus * strain**2 * height)
    x, y = flat[:, 0] - scene.crack.tip_x, flat[:, 1] - scene.crack.y
    r, angle = np.maximum(np.hypot(x, y), 0.5 * BOND), np.arctan2(y, x)
    kappa, shear = (3 - POISSON) / (1 + POISSON), YOUNG / (2 * (1 + POISSON))
    near = intensity / (2 * shear) * np.sqrt(r / (2 * np.pi)) * (kappa - np.cos(angle))
    displacement[:, 0], displacement[:, 1] = near * np.cos(angle / 2), near * np.sin(angle / 2)
    front = intensity / np.sqrt(2 * np.pi * r) * np.cos(angle / 2)
    turn = np.sin(angle / 2) * np.sin(1.5 * angle)
    stress[:, 0], stress[:, 1] = front * (1 - turn), front * (1 + turn)
    stress[:, 2] = front * np.sin(angle / 2) * np.cos(1.5 * angle)
    return displacement, stress


def write_fake_run(
    folder: Path,
    scene_name: str = "graphene_crack",
    overrides: Sequence[str] = (),
    steps: int = 200,
    frames: int = 5,
    status: str = "finished",
    noise: float | None = None,
    scenes: Path = SCENES,
) -> Path:
    """Write `results.h5` and, unless `status` is "running", `summary.json`; return the folder."""
    rng = np.random.default_rng(7)
    if noise is None:  # about what carbon does in its plane at 300 K and at 1 K
        noise = 0.003e-10 if scene_name == "graphene_patch" else 0.05e-10
    scene = load_scene(scenes / f"{scene_name}.toml", overrides)
    versions = {"scalebridge": "0.1.0", "numpy": np.__version__, "lammps": "22Jul2025"}
    command = f"scalebridge run {scene_name}.toml"
    header = {
        "scene": {
            "name": scene.name, "title": scene.title, "text": scene.text, "overrides": list(scene.overrides),
            "resolved": scene.model_dump(mode="json"),
        },
        "versions": versions, "seeds": {"run": scene.run.seed}, "command": command,
    }  # fmt: skip
    writer = ResultsWriter(folder / "results.h5", header)
    points, weight = material_points(scene)
    atoms, interface = None, None
    corners = scene.overlap()
    if scene.atomistic is not None and scene.handshake is not None and corners is not None:
        atoms = graphene(scene)
        tip_y = scene.crack.y if scene.crack else None
        ring = rectangle_ring(corners[0], *np.array(corners[1]), list(scene.handshake.sides))
        interface = build_interface(atoms, ring, scene.handshake.ivc_size, tip_y)
        count = len(atoms)
        writer.atoms(np.arange(1, count + 1), np.full(count, 6), np.full(count, 1.9944e-26), atoms)
        writer.interface(
            interface.ivc_lower, interface.ivc_upper, atoms[interface.anchor], interface.anchor_ivc, *corners
        )
    every = max(1, steps // max(1, frames - 1))
    force = np.zeros(0)
    for step in range(steps + 1):
        time, strain = step * scene.time_step, PEAK_STRAIN * step / steps
        if step % every == 0:
            shift, stress = fields(scene, points, strain)
            writer.points_frame(step, time, points + shift, shift, shift * 1e12, stress, weight)
            if atoms is not None:
                moved = atoms + fields(scene, atoms, strain)[0] + rng.normal(0.0, noise, atoms.shape)
                writer.atoms_frame(step, time, moved)
        if interface is not None:
            centre = 0.5 * (interface.ivc_lower + interface.ivc_upper)
            force = 5e-9 * strain / PEAK_STRAIN * centre / np.abs(centre).max()
            writer.ivc_row(step, force + rng.normal(0, 1e-10, centre.shape), np.full(centre.shape, 1e-10))
        writer.row(step, _row(scene, step, time, strain, force, rng, atoms is not None))
    writer.close("running" if status == "running" else status)
    if status != "running":
        with Results(folder / "results.h5") as results:
            measures, units = measures_of(results)
        Summary(
            scene=scene.name, title=scene.title, status=status, reason="all steps done", steps=steps,
            steps_asked=scene.run.steps, wall_seconds=63.0,
            services={
                "continuum": WallTime(computing=20.0, sending=1.2, waiting=41.0),
                **({"atomistic": WallTime(computing=40.0, sending=0.8, waiting=22.0)} if atoms is not None else {}),
            },
            measures=measures, units=units, warnings=["airebo-sharp has no switching function: C-C bonds end at 2 A"],
            versions=versions, seeds={"run": scene.run.seed}, command=command,
        ).write(folder)  # fmt: skip
    return folder


def _row(
    scene: Scene, step: int, time: float, strain: float, force: Array, rng: np.random.Generator, atoms: bool
) -> dict[str, float]:
    body = np.subtract(scene.continuum.upper, scene.continuum.lower)
    modulus = YOUNG / (1 - POISSON**2)
    energy = 0.5 * modulus * strain**2 * body[0] * body[1] * THICKNESS
    values = {
        "time": time, "continuum_kinetic": 0.02 * energy, "continuum_strain": 0.9 * energy,
        "continuum_edge_work": 1.01 * energy, "continuum_interface_work": -0.09 * energy,
        "continuum_damping_loss": 0.0, "applied_strain": strain, "edge_force": modulus * strain * body[0] * THICKNESS,
        "courant": 0.2, "seconds_continuum": 0.1 + 0.01 * rng.random(),
    }  # fmt: skip
    if scene.crack is not None:
        values["j_boundary"] = 0.5 * modulus * strain**2 * body[1]
    if atoms:
        grown = max(0.0, strain - 0.6 * PEAK_STRAIN) / PEAK_STRAIN
        values |= {
            "atomistic_potential": 0.08 * energy, "atomistic_kinetic": 1e-17, "spring_energy": 0.01 * energy,
            "anchor_work": 0.09 * energy, "residual_interface": 0.0101 * energy, "temperature": 300 + 8 * rng.normal(),
            "handshake_temperature": 300 + 12 * rng.normal(), "force_sum_x": 1e-10 * rng.normal(),
            "force_sum_y": 1e-10 * rng.normal(), "force_balance": 1e-15 * rng.random(),
            "ivc_force_rms": float(np.sqrt(np.mean(force[:, :2] ** 2))) + 1e-10, "ivc_error_rms": 1e-10,
            "longest_bond": 1.5e-10 + 20e-10 * strain, "seconds_atomistic": 0.2 + 0.02 * rng.random(),
            "seconds_exchange": 0.01,
        }  # fmt: skip
        if scene.crack is not None:
            values["crack_tip"] = round(grown * 20) * 1.2e-10
            values["broken_bonds"] = float(round(grown * 20))
    return values
