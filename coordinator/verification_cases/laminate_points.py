"""Case `structure/material-points`: an open-hole laminate by material points against finite elements, same cell."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import shapely
from matplotlib.figure import Figure
from rich.console import Console

from coordinator.laminate_results import LaminateResults
from coordinator.laminate_run import run_laminate
from coordinator.results import Results
from coordinator.run import run_scene
from coordinator.vtkhdf import PointsFrame
from protocol.arrays import FloatArray
from protocol.verification import CannotRun, Case, Check

SCENES = Path(__file__).resolve().parents[2] / "scenes"
#: Elongation over length; nothing fails below 0.1 %.
STRAIN = 1e-4
WIDTH, THICKNESS, RADIUS = 4e-3, 1e-3, 1.5875e-3
POINTS_PER_CELL = 2
#: Edges of the grid's cells in the quarter plate, coarsest first [m].
CELLS = (2.5e-4, 1.25e-4, 6.25e-5)
#: Boxes (x from, to, y from, to) beside the hole over which the stress along the pull is averaged [m].
BOXES = {
    "0.5 mm beside the hole": (0.0, 0.5e-3, RADIUS, RADIUS + 0.5e-3),
    "1 mm beside the hole": (0.0, 1e-3, RADIUS, RADIUS + 1e-3),
    "in the middle of the ligament": (0.0, 1e-3, 2.5e-3, 3.5e-3),
}
#: Elements round a quarter of the hole, and from it to the square round it.
MESHES = ((16, 14), (32, 28), (48, 42))


def material_points(folder: Path) -> list[Check]:
    """Stiffness of the plate and stress round its hole: material points at rest, and elements on a fine mesh."""
    if not (SCENES / "oht_mpm.toml").exists():
        raise CannotRun(f"{SCENES} is not there: run from a checkout")
    elements = [_by_elements(folder / f"elements_{k}", mesh) for k, mesh in enumerate(MESHES)]
    points = [_by_points(folder / f"points_{k}", cell) for k, cell in enumerate(CELLS)]
    _draw(elements, points, folder / "material_points.png")
    fine, found = elements[-1], points[-1]
    source = f"fem_service, {MESHES[-1][0]} x {MESHES[-1][1]} elements a ply, the same cell in the same service"
    return [Check(name, found[name], fine[name], 0.02, source, unit="Pa") for name in fine]


def _by_points(folder: Path, cell: float) -> dict[str, float]:
    """Run the shipped scene, at rest under a small elongation; moduli and mean stresses [Pa]."""
    moved = f"{STRAIN * WIDTH!r} m"
    overrides = (
        f'continuum.cell_size="{cell!r} m"', f'continuum.time_step="{8e-5 * cell!r} s"', "run.steps=1",
        f'continuum.edges.2.displacements=["{moved}", "{moved}"]', "run.output_every=1",
        'continuum.initial_velocity="rest"', 'continuum.preload={method="static", tolerance=1e-8, max_steps=20}',
        f"continuum.points_per_cell={POINTS_PER_CELL}",
    )  # fmt: skip
    _expect(run_scene(SCENES / "oht_mpm.toml", folder, overrides=overrides, console=Console(quiet=True)), folder)
    with Results(folder / "results.h5") as results:
        assert results.points is not None
        frame = results.points.frame(0)
        force = float(results.series["edge_force"][0])
    side = cell / POINTS_PER_CELL
    means = {name: _mean(frame, box, side) for name, box in BOXES.items()}
    return {"stiffness of the plate": force / (WIDTH * THICKNESS) / STRAIN, **means}


def _mean(frame: PointsFrame, box: tuple[float, float, float, float], side: float) -> float:
    """Mean stress along x of the points in a box, each with what of its square lies in it and outside the hole."""
    start = frame.position - frame.displacement
    x = np.clip(np.minimum(start[:, 0] + side / 2, box[1]) - np.maximum(start[:, 0] - side / 2, box[0]), 0.0, None)
    y = np.clip(np.minimum(start[:, 1] + side / 2, box[3]) - np.maximum(start[:, 1] - side / 2, box[2]), 0.0, None)
    weight = x * y * frame.weight
    return float(weight @ frame.stress[:, 0] / weight.sum())


def _by_elements(folder: Path, mesh: tuple[int, int]) -> dict[str, float]:
    """Run the shipped laminate in one increment; the same quantities."""
    overrides = (
        f"mesh.around={mesh[0]}", f"mesh.radial={mesh[1]}", "mesh.growth=6.0",
        f"load.final_strain={STRAIN}", "load.first=1.0", "load.most=1.0", "output.fields_every=1",
    )  # fmt: skip
    _expect(
        run_laminate(SCENES / "oht_cross_ply.toml", folder, overrides=overrides, console=Console(quiet=True)), folder
    )
    results = LaminateResults.read(folder / "results.h5")
    modulus = results.series["stress"][-1] / results.series["strain"][-1]
    stress = results.frames[-1].stress[:, 0]
    corners = results.nodes[results.bricks]
    return {
        "stiffness of the plate": float(modulus),
        **{name: _mean_of_bricks(corners, stress, box) for name, box in BOXES.items()},
    }


def _mean_of_bricks(corners: FloatArray, stress: FloatArray, box: tuple[float, float, float, float]) -> float:
    """Mean of the stresses of bricks, each with the area of its face that lies in a box."""
    faces = shapely.polygons(corners[:, :4, :2])
    area = shapely.area(shapely.intersection(faces, shapely.box(box[0], box[2], box[1], box[3])))
    return float(area @ stress / area.sum())


def _expect(status: int, folder: Path) -> None:
    if status != 0:
        summary = json.loads((folder / "summary.json").read_text())
        raise RuntimeError(f"the run in {folder} failed: {summary['reason']}")


def _draw(elements: list[dict[str, float]], points: list[dict[str, float]], path: Path) -> None:
    """Draw the difference of each from the finest mesh against the size of elements and cells at the hole."""
    figure = Figure(figsize=(7.0, 3.6), layout="constrained")
    axes = figure.subplots()
    reference = elements[-1]
    for colour, name in zip(("#0072B2", "#E69F00", "#009E73", "#D55E00"), reference, strict=True):
        across = [0.5 * np.pi * RADIUS / mesh[0] * 1e3 for mesh in MESHES[:-1]]
        there = [100 * (found[name] / reference[name] - 1) for found in elements[:-1]]
        axes.plot(across, there, "s--", color=colour, markersize=4)
        away = [100 * (found[name] / reference[name] - 1) for found in points]
        axes.plot([1e3 * cell for cell in CELLS], away, "o-", color=colour, label=name)
    axes.axhspan(-2.0, 2.0, color="#8a94a0", alpha=0.15)
    axes.set(xlabel="cell of the grid, or element at the hole (mm)", ylabel="off the finest mesh (%)")
    axes.plot([], [], "s--", color="#8a94a0", label="elements")
    axes.legend(fontsize=8)
    figure.savefig(path, dpi=150)


CASES = [Case("structure", "material-points", "open-hole laminate: material points against elements", material_points)]
