"""The command `bench`: speed beside error, as a table, JSON and pictures."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict
from importlib import metadata
from pathlib import Path

from rich.table import Table

from coordinator.machine import machine
from coordinator.verify import wide_console
from protocol.verification import BENCHMARKS, Benchmark, BenchmarkRow

PICTURES = Path("runs") / "bench"


class UnknownBenchmark(ValueError):
    """No installed package offers that benchmark."""


def run_benchmarks(names: Sequence[str], json_file: Path | None) -> None:
    """Run benchmarks by name, all where none is named; print tables, write JSON.

    Raises
    ------
    UnknownBenchmark
        Where there is no such benchmark.
    """
    have = {entry.name: entry for entry in metadata.entry_points(group=BENCHMARKS)}
    unknown = [name for name in names if name not in have]
    if unknown:
        raise UnknownBenchmark(f"no benchmark {unknown[0]!r}; there are {', '.join(sorted(have))}")
    console = wide_console()
    answers = []
    for name in names or sorted(have):
        benchmark: Benchmark = have[name].load()
        folder = PICTURES / name
        folder.mkdir(parents=True, exist_ok=True)
        rows, pictures = benchmark.run(folder)
        console.print(f"[bold]{benchmark.name}[/bold]: {benchmark.summary}", highlight=False)
        console.print(_table(rows))
        for picture in pictures:
            console.print(f"picture: {picture}")
        answers.append(
            {
                "name": benchmark.name,
                "machine": machine(),
                "rows": [asdict(row) for row in rows],
                "pictures": [str(picture) for picture in pictures],
            }
        )
    if json_file is not None:
        json_file.write_text(json.dumps(answers[0] if len(answers) == 1 else answers, indent=2) + "\n")


def _table(rows: Sequence[BenchmarkRow]) -> Table:
    figures = list(dict.fromkeys(name for row in rows for name in row.figures))
    with_error = any(row.error is not None for row in rows)
    table = Table(box=None, pad_edge=False)
    for name in ("", "seconds", *(["error"] if with_error else []), *figures):
        table.add_column(name, justify="left" if not name else "right")
    for row in rows:
        cells = [row.label + (" (peer)" if row.peer else ""), f"{row.seconds:.4g}"]
        if with_error:
            cells.append("" if row.error is None else f"{row.error:.3g}")
        cells += [f"{row.figures[name]:.4g}" if name in row.figures else "" for name in figures]
        table.add_row(*cells)
    return table
