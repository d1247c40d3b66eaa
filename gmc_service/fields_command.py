"""The command ``scalebridge micro fields``: stress and strain of every subcell under a macroscopic load."""

from __future__ import annotations

import dataclasses
import json
import re
from pathlib import Path
from typing import TYPE_CHECKING, Final

import click
import numpy as np
from numpy.typing import NDArray

from gmc_service.command_options import CELL_FILE, NEW_FOLDER, Temperature, told_mistakes
from gmc_service.component_order import COMPONENTS
from gmc_service.methods import METHODS
from protocol.quantities import to_si

if TYPE_CHECKING:
    from gmc_service.cell_file import NamedCell
    from gmc_service.mixed_load import MixedLoad

_LOAD: Final = re.compile(rf"(eps|sig)({'|'.join(COMPONENTS)})=(.+)")
_ROWS: Final = 100  # subcells up to which the table has one row for each


def _loads(context: click.Context, option: click.Parameter, words: tuple[str, ...]) -> MixedLoad:
    from gmc_service.mixed_load import MixedLoad

    values, is_stress = np.zeros(6), np.ones(6, dtype=bool)
    given: set[str] = set()
    for word in words:
        match = _LOAD.fullmatch(word.strip())
        if match is None:
            raise click.BadParameter(f"{word!r}: it must be such as eps22=0.002 or sig11='100 MPa'")
        kind, component, text = match.groups()
        if component in given:
            raise click.BadParameter(f"{word!r}: component {component} is given twice")
        given.add(component)
        place = COMPONENTS.index(component)
        try:
            values[place] = to_si(text, "pressure") if kind == "sig" else float(text)
        except ValueError as error:
            raise click.BadParameter(f"{word!r}: {error}") from None
        is_stress[place] = kind == "sig"
    return MixedLoad(values, is_stress)


@click.command()
@click.argument("cell", type=CELL_FILE)
@click.option(
    "--load", "load", multiple=True, callback=_loads, metavar="eps22=0.002", help="May be given up to six times."
)
@click.option("--temperature", type=Temperature(), metavar="QUANTITY", help='Such as "80 degC". Default: stress-free.')
@click.option("--method", type=click.Choice(tuple(METHODS)), default="gmc", show_default=True)
@click.option("--json", "as_json", is_flag=True, help="Print JSON, in SI.")
@click.option("--out", type=NEW_FOLDER, help="Folder for a picture of each component.")
def fields(
    cell: Path, load: MixedLoad, temperature: float | None, method: str, as_json: bool, out: Path | None
) -> None:
    """Stress and strain of every subcell under a macroscopic load.

    A load is a strain, such as eps12=0.01 (engineering shear), or a stress, such as sig22="50 MPa". Components that
    are not given carry no stress. Nothing fails here; subcells that yield do.
    """
    from gmc_service.cell_file import read_cell

    with told_mistakes():
        _report(read_cell(cell), load, temperature, method, as_json, out)


def _report(
    cell: NamedCell, load: MixedLoad, temperature: float | None, method: str, as_json: bool, out: Path | None
) -> None:
    from gmc_service.evaluation import Evaluator
    from gmc_service.mixed_load import hold

    at = cell.stress_free_temperature if temperature is None else temperature
    cell.check_temperature(at)
    lasting = dataclasses.replace(
        cell, materials=tuple(dataclasses.replace(one, failures=(), fracture_energy=None) for one in cell.materials)
    )
    evaluator = Evaluator(lasting, method)
    failed = np.zeros((1, evaluator.failed_bytes), dtype=np.uint8)
    held = hold(evaluator, load, at, failed, np.zeros((1, evaluator.history_values)))
    stress, strain = evaluator.localise(held.strain[None], at, failed, held.answer.history)
    pictures = [] if out is None else _draw(cell, stress[0], strain[0], out)
    if as_json:
        found = {
            "order": COMPONENTS,
            "temperature": at,
            "strain": held.strain.tolist(),
            "stress": held.answer.stress[0].tolist(),
            "subcells": {
                "material": [cell.materials[phase].name for phase in cell.phase.reshape(-1)],
                "strain": strain[0].tolist(),
                "stress": stress[0].tolist(),
            },
            "pictures": [str(path) for path in pictures],
        }
        click.echo(json.dumps(found, indent=2))
        return
    click.echo(f"{cell.title or cell.name}\n  method {method}, {at:g} K")
    click.echo("  " + " " * 28 + "".join(f"{name:>12}" for name in COMPONENTS))
    click.echo(_line("macroscopic strain", held.strain))
    click.echo(_line("macroscopic stress, MPa", held.answer.stress[0] / 1e6))
    if cell.subcells <= _ROWS:
        for number, phase in enumerate(cell.phase.reshape(-1)):
            row, column = divmod(number, cell.columns)
            name = f"{cell.materials[phase].name[:12]} ({row}, {column})"
            click.echo(_line(f"{name} strain", strain[0, number]))
            click.echo(_line(f"{name} MPa", stress[0, number] / 1e6))
    else:
        for index, material in enumerate(cell.materials):
            own = stress[0, cell.phase.reshape(-1) == index] / 1e6
            click.echo(_line(f"{material.name[:12]} least MPa", own.min(axis=0)))
            click.echo(_line(f"{material.name[:12]} most MPa", own.max(axis=0)))
    for path in pictures:
        click.echo(f"  picture: {path}")


def _line(name: str, values: NDArray[np.float64]) -> str:
    largest = np.abs(values).max(initial=0.0)
    # What is zero but for rounding is shown as zero.
    return f"  {name:<28}" + "".join(f"{value if abs(value) > 1e-9 * largest else 0.0:>12.5g}" for value in values)


def _draw(cell: NamedCell, stress: NDArray[np.float64], strain: NDArray[np.float64], folder: Path) -> list[Path]:
    from gmc_service.picture import draw_cell

    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for place, component in enumerate(COMPONENTS):
        path = folder / f"{cell.name}_stress_{component}.png"
        title = f"{cell.title or cell.name}: stress {component}"
        draw_cell(cell, path, title, np.ascontiguousarray(stress[:, place] / 1e6), "MPa")
        paths.append(path)
    return paths
