"""The report of a laminate: one page that needs nothing else, for runs in every state, with numbers that are right."""

from __future__ import annotations

import base64
import io
import re
from pathlib import Path
from xml.etree import ElementTree

import matplotlib.image
import numpy as np
import pytest
from click.testing import CliRunner
from rich.console import Console
from small_laminate import PEAK, SCENE, small_laminate

from coordinator.cli import cli
from coordinator.interruption import Interrupted
from coordinator.laminate_report import make_laminate_report
from coordinator.laminate_results import LaminateResults
from coordinator.laminate_run import LaminateRun, measures_of
from coordinator.laminate_scene import load_laminate
from coordinator.launcher import ServiceDied
from coordinator.summary import Summary
from protocol.errors import ProtocolError


def summary(
    results: LaminateResults, status: str = "finished", reason: str = "the whole elongation is reached"
) -> Summary:
    return Summary(
        scene="small", title="Small <laminate>", status=status, reason=reason, steps=results.increments,  # type: ignore[arg-type]
        steps_asked=results.increments, wall_seconds=12.34, services={}, measures=measures_of(results),
        units={"peak_stress": "Pa"}, warnings=["the peak depends on the mesh"], events=results.events, versions={},
        seeds={}, command="scalebridge run small.toml --out runs/small",
    )  # fmt: skip


def page(folder: Path, results: LaminateResults, told: Summary | None) -> str:
    results.write(folder / "results.h5")
    if told is not None:
        told.write(folder)
    return make_laminate_report(folder).read_text(encoding="utf-8")


def images(text: str) -> list[tuple[str, bytes]]:
    found = re.findall(r'src="data:image/(png|svg\+xml);base64,([^"]*)"', text)
    assert len(found) == text.count("<img")
    return [(kind, base64.b64decode(data)) for kind, data in found]


def test_a_finished_run_shows_curve_maps_sequence_and_numbers(tmp_path: Path) -> None:
    results = small_laminate()
    text = page(tmp_path, results, summary(results))
    assert "It bears 450\u00a0MPa at 1\u00a0% elongation." in text and '"status" style' in text
    assert "Small &lt;laminate&gt;" in text and "<laminate>" not in text
    for title in (
        "Average traction against strain, load against displacement",
        "Ply 1 (0°) at x = 0.5 mm, y = 0.5 mm",
        "Ply 2 (90°) at x = 0.5 mm",
        "What has failed",
        "von Mises stress at 0.8 %",
        "Failed matrix at",
    ):
        assert f"<h3>{title}" in text, title
    assert "<h3>Failed fibre" not in text  # no frame after it
    assert all(event["sentence"] in text for event in results.events)
    assert "the peak depends on the mesh" in text and "LaminateResults.read" in text and "MDAnalysis" not in text
    numbers = dict(re.findall(r"<tr><td>([^<]*)</td><td class=n>([^<]*)</td>", text))
    assert numbers["Peak stress"] == "450" and numbers["Elongation at the peak"] == "1"
    assert numbers["Elongation at the first failure"] == "0.6"
    assert numbers["Stiffness at the start, hole included"] == "45"
    kinds = [kind for kind, _ in images(text)]
    assert kinds.count("png") == 2 and kinds.count("svg+xml") == 5
    for kind, data in images(text):
        if kind == "png":
            picture = matplotlib.image.imread(io.BytesIO(data))
            assert picture.shape[1] > 700 and np.ptp(picture[..., :3]) > 0.5
        else:
            assert ElementTree.fromstring(data).tag.endswith("svg")
    assert "<script" not in text and "http" not in re.sub(r'base64,[^"]*', "", text)


def test_curves_of_subcells_are_along_the_pull(tmp_path: Path) -> None:
    """Of a brick that has failed the axis ends where the stress does; a ply across the pull is turned."""
    results = small_laminate()
    watched = results.watched
    assert watched is not None
    macro, subcells = watched.stress_along_pull(0)
    assert macro == pytest.approx(1e8 * np.array([1, 2, 3, 4, 5, 1e-3]))
    assert subcells == pytest.approx(np.outer(macro, [1.6, 0.5, 0.1, 0.1]))
    assert watched.strain_along_pull(0) == pytest.approx(2e-3 * np.arange(1, 7))
    assert watched.strain_along_pull(1) == pytest.approx(2e-3 * np.arange(1, 7))  # its axis 2 lies along x
    assert watched.stress_along_pull(1)[0] == pytest.approx(1e8 * np.arange(1, 7))
    text = page(tmp_path, results, summary(results))
    assert "<h2>Microstructure" in text and "Brick 12; one point an increment.<" in text
    assert "<h2>Microstructure" not in page(tmp_path, small_laminate(watched=False), None)


def test_an_angle_turns_stress_and_strain_back_to_the_pull() -> None:
    """A ply at 30 degrees under a known state, turned by the tensors themselves."""
    watched = small_laminate(1).watched
    assert watched is not None
    watched.angles[0] = 30.0
    c, s = np.cos(np.pi / 6), np.sin(np.pi / 6)
    axes = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])  # rows: axes of the ply in the laminate
    state = np.array([3.0, 1.0, 0.5, 0.2, -0.4, 0.7])
    tensor = state[[[0, 5, 4], [5, 1, 3], [4, 3, 2]]]
    watched.stress[0][0] = state
    watched.strain[0][0] = state * [1, 1, 1, 2, 2, 2]
    wanted = (axes.T @ tensor @ axes)[0, 0]
    assert watched.stress_along_pull(0)[0] == pytest.approx([wanted], rel=1e-12)
    assert watched.strain_along_pull(0) == pytest.approx([wanted], rel=1e-12)


def test_energy_of_viscosity_is_a_key_number(tmp_path: Path) -> None:
    results = small_laminate()
    results.series["work"], results.series["viscous_energy"] = [2.0] * 6, [0.1] * 6
    numbers = dict(
        re.findall(r"<tr><td>([^<]*)</td><td class=n>([^<]*)</td>", page(tmp_path, results, summary(results)))
    )
    assert numbers["Of that taken by the viscosity of cohesive layers"] == "5" and numbers["Work of the ends"] == "2"
    results.series["viscous_energy"] = [0.0] * 6
    assert "viscosity" not in page(tmp_path, results, summary(results)).split("Key numbers")[1].split("Do it again")[0]


def test_cohesive_layers_have_a_figure(tmp_path: Path) -> None:
    results = small_laminate(cohesive=True)
    assert "<h3>Plies that came apart" in page(tmp_path, results, summary(results))


@pytest.mark.parametrize("increments", [0, 1, 4])
def test_a_run_that_failed_or_goes_on_has_a_page(tmp_path: Path, increments: int) -> None:
    results = small_laminate(increments)
    text = page(tmp_path, results, summary(results, "failed", "failed after increment 4: <gone>"))
    assert "failed after increment 4: &lt;gone&gt;" in text
    assert ("No increment was made." in text) == (increments == 0)
    assert ("has not reached its peak" in text) == (increments > 0)
    (tmp_path / "summary.json").unlink()
    again = page(tmp_path, results, None)
    assert "not finished" in again and "was killed" in again


def test_measures_are_those_of_the_series() -> None:
    results = small_laminate()
    found = measures_of(results)
    assert found["peak_stress"] == pytest.approx(PEAK) and found["strain_at_peak"] == 0.01
    assert found["first_failure_strain"] == pytest.approx(0.006)
    assert found["failed_points"] == 10 + 20 + 30 + 40 + 96
    asked, spared = sum(results.series["queried"]), sum(results.series["spared"])
    assert found["queries_spared"] == spared / (asked + spared)
    assert found["residual_max"] == pytest.approx(6e-8)
    assert all(value is None for value in measures_of(small_laminate(0)).values())


def test_the_command_report_makes_the_page_of_a_laminate(tmp_path: Path) -> None:
    small_laminate().write(tmp_path / "results.h5")
    result = CliRunner().invoke(cli, ["report", str(tmp_path)])
    assert result.exit_code == 0 and result.output.strip() == str(tmp_path / "report.html")


@pytest.mark.parametrize(
    ("error", "status", "code", "said", "resumes"),
    [
        (None, "finished", 0, "the whole elongation is reached", False),
        (Interrupted(), "interrupted", 130, "stopped", True),
        (ServiceDied("the structure service is gone"), "failed", 1, "the structure service is gone", True),
        (ProtocolError("solver_failed", "no equilibrium"), "failed", 1, "no equilibrium", False),
        (OSError("no space left"), "failed", None, "no space left", False),
    ],
)
def test_however_a_run_ends_its_summary_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: Exception | None, status: str, code: int | None, said: str,
    resumes: bool,
) -> None:  # fmt: skip
    run = LaminateRun(
        load_laminate(SCENE), tmp_path / "run", "scalebridge run it", resume=False, attached={}, keys=None,
        console=Console(quiet=True),
    )  # fmt: skip

    def ends(*_: object) -> str:
        run._results = small_laminate(3)
        if error is not None:
            raise error
        return "the whole elongation is reached"

    monkeypatch.setattr(run, "_run", ends)
    if code is None:
        with pytest.raises(OSError, match=said):
            run.execute()
    else:
        assert run.execute() == code
    told = Summary.read(tmp_path / "run")
    assert told is not None and (told.status, told.steps) == (status, 3)
    assert said in told.reason and ("scalebridge run it --resume" in told.reason) == resumes
    assert LaminateResults.read(tmp_path / "run" / "results.h5").increments == 3
