"""The command `conformance`: what each check of the kit found, as a table."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console

from protocol.conformance import check_service
from protocol.conformance_kit import Check

_VERDICTS = {True: "[green]passed[/green]", False: "[bold red]FAILED[/bold red]", None: "[yellow]untried[/yellow]"}


def hold(endpoint: str, keys: Path | None, role: str | None, shutdown: bool) -> bool:
    """Hold a running service against the contract of its role; return whether every check passed."""
    console = Console()

    def show(check: Check) -> None:
        console.print(f"{_VERDICTS[check.passed]}  {check.seconds:6.2f} s  ", end="")
        console.print(check.name, markup=False, highlight=False, soft_wrap=True)
        if not check.passed and check.detail:
            console.print(f"                   {check.detail}", markup=False, highlight=False, soft_wrap=True)

    checks = check_service(endpoint, role=role, keys=keys, shutdown=shutdown, on_check=show)
    failed = sum(check.passed is False for check in checks)
    untried = sum(check.passed is None for check in checks)
    console.print(f"{len(checks)} checks, {failed} failed" + (f", {untried} not tried" if untried else ""))
    return bool(checks) and not failed
