"""The notched bar with a cell of fibres at random places, as a user runs it, and with its ordered twin."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from small_runs import StartsRuns

from coordinator.laminate_results import LaminateResults

pytestmark = [pytest.mark.slow, pytest.mark.timeout(300), pytest.mark.xdist_group("two-scale-notch")]

SCENE = Path(__file__).parents[2] / "scenes" / "two_scale_notch.toml"
COARSE = [f"mesh.{name}" for name in ("around=8", "radial=6", "beyond=3")] + ["load.most=0.04"]
RADIUS, ROOT = 2e-3, 4e-3  # of the notch, and half of the bar between its notches, m


def pulled(start: StartsRuns, folder: Path, *settings: str) -> LaminateResults:
    run = start(SCENE, folder, *(word for setting in (*COARSE, *settings) for word in ("--set", setting)))
    assert run.wait(250) == 0, run.printed
    assert "depends on the mesh" in (folder / "report.html").read_text()
    return LaminateResults.read(folder / "results.h5")


def test_places_of_fibres_decide_when_the_bar_breaks(start: StartsRuns, tmp_path: Path) -> None:
    random = pulled(start, tmp_path / "random")
    ordered = pulled(start, tmp_path / "ordered", "micromechanics.cell=cells/glass_epoxy_square.toml")
    # A cell of the random packing begins to fail at 0.359 % across its fibres, one of the square packing at 0.279 %
    # (`scalebridge micro fail`), and does not break at once: the bar does as its cells do.
    first = [results.events[0]["strain"] for results in (random, ordered)]
    assert first[0] > 1.2 * first[1]
    assert max(random.series["stress"]) > 1.05 * max(ordered.series["stress"])
    for results in (random, ordered):
        assert results.events[0]["material"] == "matrix"
        assert results.new_failures[-1][0][0] == 0  # no fibre: the crack runs beside them
        last = results.frames[-1]
        broken = results.nodes[results.bricks[last.failed[:, 1] > 0.9]].mean(axis=1)
        assert len(broken) and np.abs(broken[:, 0]).max() < 0.5 * RADIUS  # across the smallest section
        assert broken[:, 1].min() < 0.2 * ROOT and broken[:, 1].max() > 0.9 * ROOT  # all of it
