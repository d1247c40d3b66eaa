"""The command ``scalebridge micro fail``: failure events of a cell under a growing strain."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from gmc_service.command_options import CELL_FILE, NEW_FILE, NEW_FOLDER, Temperature, told_mistakes
from gmc_service.component_order import COMPONENTS
from gmc_service.methods import METHODS

if TYPE_CHECKING:
    from gmc_service.cell import Cell
    from gmc_service.failure_path import FailurePath

_PATHS = tuple(f"eps{component}" for component in COMPONENTS)


@click.command()
@click.argument("cell", type=CELL_FILE)
@click.option("--path", "component", type=click.Choice(_PATHS), required=True, help="Strain that grows.")
@click.option("--to", "end", type=float, default=0.05, show_default=True, help="Strain at the end; < 0 compresses.")
@click.option(
    "--others",
    type=click.Choice(("held", "free")),
    default="held",
    show_default=True,
    help="The other strains are held at zero; or the other stresses are zero.",
)
@click.option("--temperature", type=Temperature(), metavar="QUANTITY", help='Such as "80 degC". Default: stress-free.')
@click.option("--method", type=click.Choice(tuple(METHODS)), default="gmc", show_default=True)
@click.option("--json", "json_file", type=NEW_FILE, metavar="FILE", help="Write events and curves, in SI.")
@click.option("--out", type=NEW_FOLDER, default=Path(), metavar="DIR",
              help="Folder of the picture CELL_PATH.png. Default: this one.")  # fmt: skip
def fail(
    cell: Path,
    component: str,
    end: float,
    others: Any,
    temperature: float | None,
    method: str,
    json_file: Path | None,
    out: Path,
) -> None:
    """Failure events of a cell file under one growing strain.

    Prints the strain of each event, which subcells fail and by what, and the macroscopic stress before and after; draws
    macroscopic and subcell stress against strain. Subcells are (row, column), rows along axis 2, columns along axis 3.
    """
    from gmc_service.cell_file import read_cell
    from gmc_service.failure_path import failure_path
    from gmc_service.failure_plots import draw_failure_path

    with told_mistakes():
        read = read_cell(cell)
        at = read.stress_free_temperature if temperature is None else temperature
        read.check_temperature(at)
        found = failure_path(read, component, end, others, at, method)
        out.mkdir(parents=True, exist_ok=True)
        picture = out / f"{read.name}_{component}.png"
        title = read.title or read.name
        draw_failure_path(read, found, component, picture, f"{title}, {component} driven, others {others}")
        if json_file is not None:
            json_file.write_text(json.dumps(_plain(read, found, component, others), indent=2) + "\n", encoding="utf-8")
    click.echo(f"{title}\n{_table(read, found, component, others, end)}\npicture: {picture}")


def _table(cell: Cell, path: FailurePath, component: str, others: str, end: float) -> str:
    k = _PATHS.index(component)
    what = "other strains zero" if others == "held" else "other stresses zero"
    lines = [f"{component} from 0 to {end:g}, {what}; stress {component[3:]} in MPa"]
    for event in path.events:
        lines.append(
            f"  {component} = {event.strain:.10g}: stress {event.before[k] / 1e6:.6g} before, "
            f"{event.after[k] / 1e6:.6g} after"
        )
        for number, stage in enumerate(event.stages):
            then = "  then " if number else "       "
            for (material, criterion, by), subcells in _grouped(stage).items():
                places = [f"({n // cell.columns},{n % cell.columns})" for n in subcells]
                shown = " ".join(places) if len(places) <= 8 else f"{' '.join(places[:8])} and {len(places) - 8} more"
                lines.append(f"  {then}{material}, {criterion}, {by}: {shown}")
    if not path.events:
        lines.append("  nothing fails")
    return "\n".join(lines)


def _grouped(stage: Any) -> dict[tuple[str, str, str], list[int]]:
    groups: dict[tuple[str, str, str], list[int]] = {}
    for cause in stage:
        groups.setdefault((cause.material, cause.criterion, cause.component), []).append(cause.subcell)
    return groups


def _plain(cell: Cell, path: FailurePath, component: str, others: str) -> dict[str, Any]:
    """Events and curves as JSON has them, in SI."""
    return {
        "path": component,
        "others": others,
        "order": COMPONENTS,
        "events": [
            {
                "strain": event.strain,
                "stages": [
                    [
                        {
                            "subcell": [cause.subcell // cell.columns, cause.subcell % cell.columns],
                            "material": cause.material,
                            "criterion": cause.criterion,
                            "component": cause.component,
                        }
                        for cause in stage
                    ]
                    for stage in event.stages
                ],
                "stress_before": event.before.tolist(),
                "stress_after": event.after.tolist(),
            }
            for event in path.events
        ],
        "curve": {
            "strain": path.macroscopic_strain.tolist(),
            "stress": path.stress.tolist(),
            "subcell_stress": path.subcell_stress.tolist(),
        },
    }
