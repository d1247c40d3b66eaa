"""The command `verify`: cases with a known answer, as a table and as JSON."""

from __future__ import annotations

import json
import math
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from coordinator.machine import machine
from protocol.verification import CASES, CannotRun, Case, Check
from protocol.version import package_version


class UnknownCase(ValueError):
    """No installed package offers that case."""


@dataclass(frozen=True)
class Outcome:
    """One row of the answer; a case that cannot run, or broke down, has no check but a reason."""

    case: Case
    seconds: float
    check: Check | None = None
    reason: str = ""
    broke_down: bool = False

    @property
    def passed(self) -> bool | None:
        """True or False; None where the case could not run."""
        if self.check is None:
            return False if self.broke_down else None
        return self.check.passed

    def as_json(self) -> dict[str, Any]:
        """Return the row as the design states it."""
        row: dict[str, Any] = {"group": self.case.group, "case": self.case.name, "seconds": round(self.seconds, 3)}
        if self.check is None:
            return {**row, "passed": self.passed, "reason": self.reason}
        check = self.check
        return {
            **row,
            "quantity": check.quantity,
            "value": _finite(check.value),
            "reference": check.reference,
            "unit": check.unit,
            "error": _finite(check.error),
            "tolerance": check.tolerance,
            "passed": check.passed,
            "source": check.source,
        }


def verify_cases(
    wanted: Sequence[str], json_file: Path | None, kept: Path | None = None, console: Console | None = None
) -> bool:
    """Run cases, print a table, write JSON; return whether nothing failed.

    Parameters
    ----------
    wanted : sequence of str
        ``GROUP`` or ``GROUP/CASE``; all cases that are not slow where empty.
    json_file : Path, optional
        File for the answer.
    kept : Path, optional
        Folder for the pictures and tables that the cases make; without one they go with the end of the command.

    Raises
    ------
    UnknownCase
        Where a name fits no case; the message lists those that there are.
    FileExistsError
        Where `kept` has something of a wanted case already.
    """
    console = console or wide_console()
    cases = select(wanted)
    outcomes: list[Outcome] = []
    with tempfile.TemporaryDirectory(prefix="scalebridge-verify-") as folder:
        folders = {case: (kept or Path(folder)) / f"{case.group}-{case.name}" for case in cases}
        for place in folders.values():
            if place.exists():
                raise FileExistsError(f"{place} is there already; another folder than {kept} is needed")
        for case, place in folders.items():
            console.print(f"[dim]{case.group}/{case.name}: {case.summary}[/dim]", highlight=False)
            outcomes += run_case(case, place)
    console.print(_table(outcomes))
    if kept is not None:
        console.print(f"pictures and tables: {kept}", markup=False, soft_wrap=True)
    if json_file is not None:
        answer = {
            "scalebridge": package_version(),
            "machine": machine(),
            "cases": [outcome.as_json() for outcome in outcomes],
        }
        json_file.write_text(json.dumps(answer, indent=2, allow_nan=False) + "\n")
    return all(outcome.passed is not False for outcome in outcomes)


def wide_console() -> Console:
    """Return a console that does not squeeze tables into 80 columns where nobody reads along."""
    console = Console()
    return console if console.is_terminal else Console(width=160)


def run_case(case: Case, folder: Path) -> list[Outcome]:
    """Run one case in its folder."""
    folder.mkdir(parents=True)
    began = time.perf_counter()
    try:
        checks = case.run(folder)
    except CannotRun as error:
        return [Outcome(case, time.perf_counter() - began, reason=str(error))]
    except Exception as error:
        # One case that breaks down must not take the answers of the others with it.
        reason = f"{type(error).__name__}: {error}"
        return [Outcome(case, time.perf_counter() - began, reason=reason, broke_down=True)]
    seconds = time.perf_counter() - began
    return [Outcome(case, seconds, check) for check in checks]


def select(wanted: Sequence[str]) -> list[Case]:
    """Return the installed cases that the names mean, in a fixed order."""
    cases = sorted(installed(), key=lambda case: (case.group, case.name))
    if not wanted:
        return [case for case in cases if not case.slow]
    chosen = []
    for name in wanted:
        found = [case for case in cases if name in (case.group, f"{case.group}/{case.name}")]
        if not found:
            have = ", ".join(f"{case.group}/{case.name}" for case in cases)
            raise UnknownCase(f"no case {name!r}; there are {have}")
        chosen += [case for case in found if case not in chosen]
    return chosen


def installed() -> list[Case]:
    """Return the cases of all installed packages."""
    return [case for entry in metadata.entry_points(group=CASES) for case in entry.load()]


def _table(outcomes: Sequence[Outcome]) -> Table:
    table = Table(box=None, pad_edge=False)
    for name in ("case", "quantity", "value", "reference", "unit", "error", "tolerance", "seconds", ""):
        text = name in ("case", "quantity", "unit", "")
        table.add_column(name, justify="left" if text else "right", no_wrap=name != "quantity")
    for outcome in outcomes:
        name, seconds = f"{outcome.case.group}/{outcome.case.name}", f"{outcome.seconds:.1f}"
        if outcome.check is None:
            verdict = "[bold red]BROKE DOWN[/bold red]" if outcome.broke_down else "[yellow]not run[/yellow]"
            table.add_row(name, escape(outcome.reason), "", "", "", "", "", seconds, verdict)
            continue
        check = outcome.check
        limit = ("at most " if check.at_most else "") + f"{check.reference:.6g}"
        verdict = "[green]passed[/green]" if check.passed else "[bold red]FAILED[/bold red]"
        table.add_row(
            name, check.quantity, f"{check.value:.6g}", limit, check.unit, f"{check.error:.2g}",
            f"{check.tolerance:.2g}", seconds, verdict,
        )  # fmt: skip
    return table


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
