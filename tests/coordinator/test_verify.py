"""The command `verify`: which cases run, what is written, when it fails."""

from __future__ import annotations

import io
import json
import math
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from coordinator import verify
from coordinator.verify import UnknownCase, select, verify_cases
from protocol.verification import CannotRun, Case, Check


def good(folder: Path) -> list[Check]:
    (folder / "file").write_text("cases may write here")
    return [Check("length", 1.01, 1.0, 0.02, "a ruler", "m"), Check("loss", 3.0, 5.0, 0.0, "a bound", at_most=True)]


def bad(folder: Path) -> list[Check]:
    return [Check("speed", 1.2, 1.0, 0.1, "a clock", "m/s"), Check("rest", 0.0, 0.0, 1e-9, "zero")]


def not_finite(folder: Path) -> list[Check]:
    return [Check("stress", math.nan, 1.0, 0.1, "a gauge", "Pa")]


def missing(folder: Path) -> list[Check]:
    raise CannotRun("the optional engine is not installed")


CASES = [
    Case("solid", "good", "passes", good),
    Case("solid", "bad", "fails", bad, slow=True),
    Case("fluid", "missing", "cannot run", missing),
    Case("fluid", "nan", "is not finite", not_finite, slow=True),
]


@pytest.fixture(autouse=True)
def installed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(verify, "installed", lambda: CASES)


def answers(tmp_path: Path, *wanted: str) -> tuple[bool, list[dict[str, Any]], str]:
    """Run cases; return verdict, rows of the JSON file, and what was printed."""
    file, shown = tmp_path / "answer.json", io.StringIO()
    passed = verify_cases(wanted, file, console=Console(file=shown, width=240))

    def no_constant(name: str) -> None:
        raise AssertionError(f"{name} is no JSON")

    answer = json.loads(file.read_text(), parse_constant=no_constant)
    assert set(answer) == {"scalebridge", "machine", "cases"}
    return passed, answer["cases"], shown.getvalue()


def test_slow_cases_run_only_when_asked_for() -> None:
    assert [case.name for case in select([])] == ["missing", "good"]
    assert [case.name for case in select(["solid"])] == ["bad", "good"]
    assert [case.name for case in select(["fluid/nan", "solid/good", "solid"])] == ["nan", "good", "bad"]


def test_a_name_that_fits_no_case_lists_those_that_there_are() -> None:
    with pytest.raises(UnknownCase, match=r"no case 'solid/god'; there are fluid/missing, fluid/nan, solid/bad"):
        select(["solid/god"])


def test_each_quantity_is_a_row_with_error_and_verdict(tmp_path: Path) -> None:
    passed, rows, shown = answers(tmp_path, "solid/good")
    assert passed
    assert [row["quantity"] for row in rows] == ["length", "loss"]
    assert rows[0]["error"] == pytest.approx(0.01)
    assert rows[1]["error"] == 0.0
    keys = {
        "group",
        "case",
        "quantity",
        "value",
        "reference",
        "unit",
        "error",
        "tolerance",
        "passed",
        "seconds",
        "source",
    }
    assert all(set(row) == keys and row["passed"] is True for row in rows)
    assert "solid/good" in shown and "at most 5" in shown


def test_one_quantity_beyond_its_tolerance_fails_the_whole(tmp_path: Path) -> None:
    passed, rows, shown = answers(tmp_path, "solid")
    assert not passed
    assert {row["quantity"]: row["passed"] for row in rows} == {
        "speed": False, "rest": True, "length": True, "loss": True,
    }  # fmt: skip
    assert "FAILED" in shown


def test_a_case_that_cannot_run_is_a_row_with_its_reason_and_no_failure(tmp_path: Path) -> None:
    passed, rows, _ = answers(tmp_path)
    assert passed
    row = rows[0]
    assert (row["case"], row["passed"], row["reason"]) == ("missing", None, "the optional engine is not installed")
    assert "value" not in row


def test_a_value_that_is_not_finite_fails_and_is_null_in_json(tmp_path: Path) -> None:
    passed, rows, _ = answers(tmp_path, "fluid/nan")
    assert not passed
    assert (rows[0]["value"], rows[0]["error"], rows[0]["passed"]) == (None, None, False)


def test_a_value_that_is_not_finite_is_not_at_most_anything() -> None:
    assert not Check("ratio", math.nan, 1.0, 0.1, "a limit", at_most=True).passed
    assert not Check("count", math.nan, 0.0, 0.1, "a limit", at_most=True).passed


def test_cases_of_one_name_in_two_groups_have_folders_of_their_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folders: list[Path] = []

    def noted(folder: Path) -> list[Check]:
        assert list(folder.iterdir()) == []
        folders.append(folder)
        (folder / "taken").touch()
        return []

    monkeypatch.setattr(verify, "installed", lambda: [Case(group, "same", "", noted) for group in ("one", "two")])
    assert verify_cases([], None, console=Console(file=io.StringIO()))
    assert len(set(folders)) == 2
    assert not any(folder.exists() for folder in folders)


def test_what_cases_make_is_kept_where_asked_and_never_overwritten(tmp_path: Path) -> None:
    kept, console = tmp_path / "kept", Console(file=io.StringIO())
    assert verify_cases(["solid/good"], None, kept, console)
    assert (kept / "solid-good" / "file").read_text() == "cases may write here"
    with pytest.raises(FileExistsError, match="solid-good is there already; another folder than"):
        verify_cases(["fluid/missing", "solid/good"], None, kept, console)
    assert not (kept / "fluid-missing").exists()


def test_the_installed_cases_have_names_of_their_own(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.undo()
    names = [f"{case.group}/{case.name}" for case in verify.installed()]
    assert len(names) == len(set(names))
