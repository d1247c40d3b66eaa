"""Results of a small laminate that no service made, for tests of the file and the report."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from coordinator.laminate_results import SERIES, Frame, LaminateResults
from coordinator.laminate_scene import load_laminate
from coordinator.watched_places import WatchedPlaces

SCENE = Path(__file__).parents[2] / "scenes" / "oht_cross_ply.toml"
PEAK = 4.5e8
INCREMENTS = 6


def small_laminate(increments: int = INCREMENTS, cohesive: bool = False, watched: bool = True) -> LaminateResults:
    """Two plies of 4 x 3 bricks; the stress peaks at the fifth increment, the upper matrix fails from the third.

    Of two watched bricks the first breaks at the last increment.
    """
    scene = load_laminate(SCENE)
    x, y, z = (np.linspace(0.0, extent, count) for extent, count in ((4e-3, 5), (3e-3, 4), (5e-4, 3)))
    number = np.arange(3 * 4 * 5).reshape(3, 4, 5)  # by z, y, x
    nodes = np.stack(np.meshgrid(x, y, z, indexing="ij"), axis=-1).transpose(2, 1, 0, 3).reshape(-1, 3)
    corners = [number[:, :-1, :-1], number[:, :-1, 1:], number[:, 1:, 1:], number[:, 1:, :-1]]
    bricks = np.stack([*(c[:-1] for c in corners), *(c[1:] for c in corners)], axis=-1).reshape(-1, 8).astype(np.int64)
    results = LaminateResults(
        scene={
            "name": "small", "title": "Small <laminate>", "text": scene.text, "overrides": ["load.most=0.1"],
            "resolved": scene.model_dump(mode="json"), "command": "scalebridge run small.toml --out runs/small",
        },
        materials=["fibre", "matrix"],
        angles=np.array([0.0, 90.0]),
        nodes=np.ascontiguousarray(nodes),
        bricks=bricks,
        ply=np.repeat(np.arange(2), 12).astype(np.int64),
        section=3e-6,
        versions={"scalebridge": "0.7"},
        watched=_watched() if watched else None,
    )  # fmt: skip
    chance = np.random.default_rng(3)
    for step in range(1, increments + 1):
        strain = 0.002 * step
        stress = PEAK * strain / 0.01 if step < 6 else 0.2 * PEAK
        values = {name: float(chance.integers(1, 9)) for name in SERIES}
        values |= {
            "load": step / 6,
            "strain": strain,
            "stress": stress,
            "force": stress * 3e-6,
            "residual": 1e-8 * step,
        }
        for name, series in results.series.items():
            series.append(values[name])
        if results.watched is not None:
            borne = np.array([step if step < 6 else 1e-3, step])
            results.watched.strain.append(2e-3 * step * np.eye(2, 6))
            results.watched.stress.append(1e8 * borne[:, None] * np.eye(2, 6))
            results.watched.subcells.append(1e8 * np.einsum("w,n,wi->wni", borne, [1.6, 0.5, 0.1, 0.1], np.eye(2, 6)))
        failures = np.zeros((2, 2), dtype=np.int64)
        failures[1, 1] = 10 * (step - 2) if step > 2 else 0
        failures[0, 0] = 96 if step == 6 else 0
        results.new_failures.append(failures)
        results.layer_damage.append(np.array([0.1 * step]) if cohesive else np.zeros(0))
        for ply, material in zip(*np.nonzero(failures), strict=True):
            if not any(
                event["ply"] == ply and event["material"] == results.materials[material] for event in results.events
            ):
                name = results.materials[material]
                results.events.append(
                    {"step": step, "strain": strain, "stress": stress, "ply": int(ply), "material": name,
                     "sentence": f"{name} fails first in ply {ply + 1} at increment {step}"}
                )  # fmt: skip
        if step % 2 == 0:
            failed = np.zeros((24, 2))
            failed[12:, 1] = step / 6
            results.frames.append(
                Frame(step, strain, chance.normal(size=(60, 3)), 1e8 * chance.normal(size=(24, 6)), failed)
            )
    return results


def _watched() -> WatchedPlaces:
    """A brick of each ply; a cell of a fibre and three subcells of matrix."""
    return WatchedPlaces(
        bricks=np.array([0, 12]),
        centres=np.array([[5e-4, 5e-4, 1.25e-4], [5e-4, 5e-4, 3.75e-4]]),
        angles=np.array([0.0, 90.0]),
        plies=np.array([0, 1]),
        materials=np.array([0, 1, 1, 1]),
        shares=np.array([0.58, 0.14, 0.07, 0.21]),
    )
