"""Figures of a continuum whose material is a laminate: its curve, and where which constituent of which plies failed."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from coordinator.display_units import units_of
from coordinator.field_figures import body_window, spacing_of
from coordinator.figures import BLUE, INK, RED, WIDTH, Picture, picture
from coordinator.results import Results
from coordinator.scene import Scene
from coordinator.vtkhdf import PointsFrame
from protocol.arrays import FloatArray


def ply_pictures(results: Results, scene: Scene) -> list[Picture]:
    """Draw the stress over the whole section against the strain, and maps of failure near the peak and at the end."""
    points = results.points
    if points is None or not len(points) or not points.frame(len(points) - 1).failed:
        return []
    curve = pull_curve(results, scene)
    if curve is None:
        return [_maps(points.frame(len(points) - 1), scene, "at the end")]
    strain, stress = curve
    peak = results.step[int(np.argmax(stress))]
    near = int(np.argmin(np.abs(points.step - peak)))
    found = [_curve_picture(results, strain, stress), _maps(points.frame(near), scene, "near the peak")]
    if near != len(points) - 1:
        found.append(_maps(points.frame(len(points) - 1), scene, "at the end"))
    return found


def pull_curve(results: Results, scene: Scene) -> tuple[FloatArray, FloatArray] | None:
    """Strain, and force over the whole section across the pull, Pa; None where the material has no plies or no pull."""
    axis, material = scene.continuum.pull_axis, scene.continuum.material
    if axis is None or material is None or material.law != "laminate" or len(results.step) < 2:
        return None
    width = scene.continuum.upper[1 - axis] - scene.continuum.lower[1 - axis]
    series = results.series
    return series["applied_strain"], series["edge_force"] / (width * material.whole_thickness)


def _curve_picture(results: Results, strain: FloatArray, stress: FloatArray) -> Picture:
    figure = Figure(figsize=(WIDTH, 3.2), layout="constrained")
    axes = figure.subplots()
    axes.plot(100 * strain, stress / 1e6, color=BLUE)
    axes.set(xlabel="elongation over length (%)", ylabel="force over whole section (MPa)")
    told: dict[int, list[str]] = {}
    for event in results.events:
        if event["kind"] == "failure":
            words = event["sentence"].split(" plies")[0].replace(" fails first in the ", ", ").replace(" degree", "°")
            told.setdefault(event["step"], []).append(words)
    for step, words in told.items():
        row = min(int(np.searchsorted(results.step, step)), len(strain) - 1)
        axes.plot(100 * strain[row], stress[row] / 1e6, "o", color=RED, markersize=4)
        axes.annotate(
            "\n".join(words), (100 * strain[row], stress[row] / 1e6), xytext=(9, -11), textcoords="offset points",
            fontsize=7.5, color=INK, va="top",
        )  # fmt: skip
    caption = (
        f"Highest stress {stress.max() / 1e6:.4g} MPa. Dots: first failure of each material in plies of each angle."
    )
    return picture(figure, "Stress against strain", caption)


def _maps(frame: PointsFrame, scene: Scene, when: str) -> Picture:
    """Draw a map for each direction and material."""
    unit, name = units_of(scene).length
    window = body_window(scene)
    columns = min(2, len(frame.failed))
    rows = -(-len(frame.failed) // columns)
    side = (WIDTH - 1.2) / columns
    extent = [window[k][1] - window[k][0] for k in (0, 1)]
    figure = Figure(figsize=(WIDTH, rows * (side * extent[1] / extent[0] + 0.45)), layout="constrained")
    grid = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)
    flat = frame.position[:, :2] / unit
    size = (72.0 * side / extent[0] * spacing_of(scene, frame) / unit) ** 2
    for axes in grid.flat[len(frame.failed) :]:
        axes.set_visible(False)
    drawn = None
    for axes, (words, share) in zip(grid.flat, frame.failed.items(), strict=False):
        drawn = axes.scatter(
            *flat.T, c=100 * share, s=size, marker="s", linewidths=0, vmin=0.0, vmax=100.0, cmap="magma_r"
        )
        angle, material = words.split(" ", 1)
        axes.set(title=f"{material}, {angle}° plies", aspect="equal", xlim=window[0], ylim=window[1])
        axes.grid(visible=False)
    for axes in grid[-1]:
        axes.set_xlabel(f"x ({name})")
    for axes in grid[:, 0]:
        axes.set_ylabel(f"y ({name})")
    assert drawn is not None  # there is at least one material
    figure.colorbar(drawn, ax=list(grid.flat), label="failed subcells (%)", shrink=0.8)
    time, word = units_of(scene).time
    caption = (
        f"Step {frame.step}, {frame.time / time:.3g} {word}; share of the material's subcells, true displacements."
    )
    return picture(figure, f"What has failed, {when}", caption, raster=True)
