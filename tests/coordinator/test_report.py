"""The report: one page that needs nothing else, for runs in every state, with numbers that are right."""

from __future__ import annotations

import base64
import io
import re
from html.parser import HTMLParser
from pathlib import Path
from xml.etree import ElementTree

import matplotlib.image
import numpy as np
import pytest
from fake_run import PEAK_STRAIN, SCENES, SMALL_CRACK, write_fake_run

from coordinator.display_units import ATOMIC, units_of
from coordinator.field_figures import _bonds, applied_strain, inner_strain
from coordinator.report import j_at_first_break, make_report
from coordinator.results import Results, ResultsError, ResultsWriter
from coordinator.scene import load_scene
from coordinator.vtkhdf import von_mises

VOID = {"meta", "img", "br", "link"}


class _Page(HTMLParser):
    """Collects what the tests ask for, and holds that elements nest."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.images: list[tuple[str, bytes]] = []
        self.headings: list[str] = []
        self.titles: list[str] = []
        self._open: list[str] = []
        self.feed(text)
        assert self._open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        values = dict(attrs)
        assert tag not in ("script", "link", "iframe")
        if tag == "img":
            source = values["src"] or ""
            match = re.fullmatch(r"data:image/(png|svg\+xml);base64,(.*)", source)
            assert match is not None, "an image is not part of the page"
            self.images.append((match[1], base64.b64decode(match[2])))
            assert values["alt"]
        if tag not in VOID:
            self._open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self._open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self._open and self._open[-1] == "h2":
            self.headings.append(data)
        if self._open and self._open[-1] == "h3":
            self.titles.append(data)


def _page(folder: Path) -> tuple[str, _Page]:
    path = make_report(folder)
    assert path == folder / "report.html"
    text = path.read_text(encoding="utf-8")
    assert "http://" not in text and "https://" not in text
    return text, _Page(text)


@pytest.fixture(scope="module")
def crack_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_fake_run(tmp_path_factory.mktemp("crack"), overrides=SMALL_CRACK, steps=100)


@pytest.fixture(scope="module")
def patch_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_fake_run(tmp_path_factory.mktemp("patch"), "graphene_patch", steps=100)


def test_the_page_of_a_crack(crack_run: Path) -> None:
    text, found = _page(crack_run)
    for section in ("Scene", "Crack", "Stress", "Over time", "Key numbers", "Do it again"):
        assert section in found.headings
    for figure in (
        "The whole body", "A corner of the handshake", "Load", "Energies", "Temperature", "Interface force balance",
        "Interface force and its statistical error", "Wall time of a coupling step", "Wall time by service",
    ):  # fmt: skip
        assert figure in found.titles
    assert sum(title.startswith("Crack tip in the atoms") for title in found.titles) == 4
    assert len(found.images) == len(found.titles)
    for kind, data in found.images:
        if kind == "png":
            pixels = matplotlib.image.imread(io.BytesIO(data), format="png")
            assert min(pixels.shape[:2]) > 300 and np.std(pixels[..., :3]) > 0.02, "a picture is blank"
        else:
            assert ElementTree.fromstring(data).tag.endswith("svg")
    assert "The crack grew by 9.6\u00a0Å, 8 bonds broke." in text
    assert "airebo-sharp has no switching function" in text
    assert "scalebridge run graphene_crack.toml" in text
    # the scene as it was run: the file and what was changed
    assert "# A crack in graphene grows" in text and "# --set continuum.lower=[" in text


def test_j_at_the_first_broken_bond(crack_run: Path) -> None:
    with Results(crack_run / "results.h5") as results:
        found = j_at_first_break(results)
        first = int(np.flatnonzero(results.series["broken_bonds"])[0])
        assert found == results.series["j_boundary"][first]
        strain = results.series["applied_strain"][first]
    # broken bonds are round(20 (strain / peak - 0.6)): the first at 62.5 % of the peak, 63 of 100 steps
    assert strain == pytest.approx(0.63 * PEAK_STRAIN)


def test_the_page_of_a_patch_test(patch_run: Path) -> None:
    text, found = _page(patch_run)
    assert "Strain" in found.headings and "Crack" not in found.headings
    assert "Strain along y, applied 1 %" in found.titles and "Strain along y in a section" in found.titles
    assert "Of 1\u00a0% applied strain the atoms inside the handshake carry 1\u00a0%" in text
    with Results(patch_run / "results.h5") as results:
        strain = inner_strain(results)
        assert applied_strain(results) == pytest.approx(PEAK_STRAIN)
    assert strain is not None
    # noise 0.003 A over some 2000 atoms, 75 A wide: error of the slope about 3e-6
    assert strain.yy == pytest.approx(PEAK_STRAIN, abs=2e-5)
    assert strain.xx == pytest.approx(0.0, abs=2e-5)


def test_a_run_that_was_killed_has_a_page(tmp_path: Path) -> None:
    write_fake_run(tmp_path, overrides=SMALL_CRACK, steps=20, frames=3, status="running")
    assert not (tmp_path / "summary.json").exists()
    text, found = _page(tmp_path)
    assert "not finished" in text and "was killed" in text
    assert "Wall time by service" not in found.titles
    # the last of the 20 steps, M = 30 and 0.5 fs
    assert "Crack tip in the atoms, 0.3 ps" in found.titles
    assert [path.name for path in tmp_path.iterdir() if path.suffix == ".tmp"] == []


def test_a_scene_without_atoms_has_a_page(tmp_path: Path) -> None:
    scene = tmp_path / "alone.toml"
    lines = (Path(__file__).parents[2] / "scenes" / "graphene_patch.toml").read_text().split("[atomistic]")[0]
    material = (
        '[continuum.material]\nyoung = "830 GPa"\npoisson = 0.35\ndensity = "2.2 g/cm^3"\nthickness = "3.35 angstrom"\n'
    )
    scene.write_text(lines + material)
    write_fake_run(tmp_path, "alone", ["continuum.time_step=5 fs"], steps=20, frames=3, scenes=tmp_path)
    text, found = _page(tmp_path)
    assert "1\u00a0% strain was reached." in text
    assert "The whole body" in found.titles and "A corner of the handshake" not in found.titles
    assert "Temperature" not in found.titles


def test_a_run_without_a_step_has_a_page(tmp_path: Path) -> None:
    header = {
        "scene": {"name": "<b>", "title": "<script>alert(1)</script>", "text": "a < b", "overrides": [],
                  "resolved": {}},
        "versions": {}, "seeds": {}, "command": "run & go",
    }  # fmt: skip
    ResultsWriter(tmp_path / "results.h5", header).close("failed")
    text, found = _page(tmp_path)
    assert found.images == []
    assert "No step was made." in text and "written by another version" in text
    assert "&lt;script&gt;alert(1)" in text and "run &amp; go" in text and "a &lt; b" in text


def test_unknown_series_are_listed(tmp_path: Path) -> None:
    write_fake_run(tmp_path, overrides=SMALL_CRACK, steps=4, frames=2)
    writer = ResultsWriter.resume(tmp_path / "results.h5", 4)
    writer.row(5, {"time": 3e-14, "novelty": 12.5})
    writer.close("finished")
    text, found = _page(tmp_path)
    assert "Other series" in found.headings
    assert "<td>novelty</td><td></td><td class=n>12.5</td>" in text


def test_no_results_no_report(tmp_path: Path) -> None:
    with pytest.raises(ResultsError, match=r"results\.h5: cannot be read as results"):
        make_report(tmp_path)


def test_bonds_of_a_hexagon() -> None:
    angle = np.arange(6) * np.pi / 3
    ring = 1.4 * np.column_stack([np.cos(angle), np.sin(angle)])
    lines, lengths = _bonds(ring)
    assert lines.shape == (6, 2, 2)
    np.testing.assert_allclose(lengths, 1.4, rtol=1e-12)


def test_von_mises_of_simple_states() -> None:
    # uniaxial s, pure shear t, equal biaxial s
    states = np.array([[2.0, 0.0, 0.0], [0.0, 0.0, 1.0], [3.0, 3.0, 0.0]])
    np.testing.assert_allclose(von_mises(states), [2.0, np.sqrt(3.0), 3.0], rtol=1e-14)


def test_a_continuum_alone_is_told_in_engineering_units(tmp_path: Path) -> None:
    """Cracks of the continuum: their tips are drawn, their growth is the headline, their events are listed."""
    folder = write_fake_run(tmp_path, "edge_crack", ("run.steps=60",), steps=60, frames=3, status="running")
    with Results(folder / "results.h5") as results:
        header = {
            "scene": results.scene, "versions": results.versions, "seeds": results.seeds, "command": results.command,
        }  # fmt: skip
        series, steps = results.series, results.step
        frame = results.points.frame(2) if results.points else None
    assert frame is not None
    writer = ResultsWriter(folder / "results.h5", header)
    for row, step in enumerate(steps[1:], 1):
        grown = 0.25e-3 * max(0, row - 40)
        tip = {"length": 6e-3 + grown, "j": 2.5 * row, "k_1": 1e4 * row, "k_2": 10.0, "x": 5e-3, "y": 0.0}
        writer.row(
            int(step),
            {**{name: values[row] for name, values in series.items()}, **{f"tip_0_1_{k}": v for k, v in tip.items()}},
        )
        if row > 40:
            writer.event(int(step), {"kind": "growth", "step": row, "sentence": f"step {row}: the crack grew <again>"})
    for step in (0, 60):
        writer.points_frame(
            step, step * 2e-7, frame.position, frame.displacement, frame.velocity, frame.stress, frame.weight
        )
    writer.close("finished")
    text, page = _page(folder)
    assert "The crack grew by 5\u00a0mm." in text
    assert "Crack tips in the continuum" in page.titles
    assert any(re.fullmatch(r"Stress along y, the whole body, 12 µs", title) for title in page.titles), page.titles
    assert "12 µs" in text and "Å" not in text and " eV" not in text
    assert "Events" in page.headings and "All 20 are in results.h5" in text
    assert text.count("the crack grew &lt;again&gt;") == 20
    others = text[text.index("Other series") :]
    assert "x of the crack tip, crack 0, last end" in others and "dynamic J-integral" not in others


@pytest.mark.parametrize(
    ("overrides", "length", "time"),
    [
        ((), "mm", "µs"),
        (("continuum.upper.0=0.5 mm", "continuum.lower.1=-0.5 mm", "continuum.upper.1=0.5 mm"), "µm", "µs"),
        (("run.steps=60000",), "mm", "ms"),
    ],
)  # fmt: skip
def test_units_fit_the_scene(overrides: tuple[str, ...], length: str, time: str) -> None:
    units = units_of(load_scene(SCENES / "edge_crack.toml", overrides))
    assert (units.length[1], units.time[1], units.stress[1]) == (length, time, "MPa")
    assert units_of(load_scene(SCENES / "graphene_crack.toml")) is ATOMIC
