"""The commands ``scalebridge micro ...``: what a cell file holds, and what its homogenisation gives.

The command line loads this module for its help, so it imports nothing heavy; a command imports what it needs.
"""

from __future__ import annotations

import importlib
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from gmc_service.command_options import CELL_FILE, NEW_FILE, Temperature, told_mistakes
from gmc_service.component_order import COMPONENTS
from gmc_service.methods import METHODS

if TYPE_CHECKING:
    from gmc_service.effective_properties import EffectiveProperties

#: Commands in modules of their own, imported when they are asked for.
_ELSEWHERE = {"fail": "gmc_service.fail_command", "fields": "gmc_service.fields_command"}


class _Group(click.Group):
    """The commands of this module, and those that have one of their own."""

    def list_commands(self, context: click.Context) -> list[str]:
        """Names of all commands, sorted."""
        return sorted({*super().list_commands(context), *_ELSEWHERE})

    def get_command(self, context: click.Context, name: str) -> click.Command | None:
        """One command, loaded now."""
        if name in _ELSEWHERE:
            found: click.Command = getattr(importlib.import_module(_ELSEWHERE[name]), name)
            return found
        return super().get_command(context, name)


@click.group(cls=_Group, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
def micro() -> None:
    """Repeating unit cells: their effective constants, failure, pictures and constituents."""


@micro.command()
@click.argument("cell", type=CELL_FILE)
@click.option("--temperature", type=Temperature(), metavar="QUANTITY", help='Such as "80 degC". Default: stress-free.')
@click.option("--method", type=click.Choice(tuple(METHODS)), default="gmc", show_default=True)
@click.option("--json", "as_json", is_flag=True, help="Print JSON, in SI.")
@click.option("--card", type=NEW_FILE, metavar="FILE", help="Write a material card for Abaqus and CalculiX.")
@click.option(
    "--card-units", type=click.Choice(("mm", "m")), default="mm", show_default=True, help="mm, N, MPa, tonne; or SI."
)
def properties(
    cell: Path, temperature: float | None, method: str, as_json: bool, card: Path | None, card_units: str
) -> None:
    """Effective constants of a cell file.

    In the order of the table: Young's moduli, Poisson's ratios, shear moduli, thermal expansion, fractions, density.
    Axis 1 is the fibre direction.
    """
    from gmc_service.cell_file import read_cell
    from gmc_service.effective_properties import effective_properties

    with told_mistakes():
        read = read_cell(cell)
        found = effective_properties(read, method, temperature)
        if card is not None:
            from gmc_service.material_card import material_card

            text = material_card(
                read.name, found.stiffness, found.expansion, found.density, read.stress_free_temperature, card_units,
                comments=[f"Effective constants of {cell.name}: {read.title or read.name}",
                          f"Method {method}, {found.temperature:g} K"],
            )  # fmt: skip
            card.write_text(text, encoding="utf-8")
    click.echo(json.dumps(_plain(found), indent=2) if as_json else _table(found, read.title or read.name))
    if card is not None and not as_json:
        click.echo(f"card: {card}")


@micro.command()
@click.argument("cell", type=CELL_FILE)
@click.option("--out", type=NEW_FILE, metavar="FILE.png", help="Default: CELL.png in this folder.")
def show(cell: Path, out: Path | None) -> None:
    """Draw the cell of a cell file."""
    from gmc_service.cell_file import read_cell
    from gmc_service.picture import draw_cell

    with told_mistakes():
        read = read_cell(cell)
        path = out or Path(f"{read.name}.png")
        draw_cell(read, path, read.title or read.name)
    for material, fraction in zip(read.materials, read.phase_fractions(), strict=True):
        click.echo(f"{material.name}: {100.0 * fraction:.6g} %")
    click.echo(f"{read.rows} x {read.columns} subcells, picture: {path}")


@micro.command()
@click.argument("name", required=False)
def constituents(name: str | None) -> None:
    """List the shipped constituents, or show one with its source."""
    from gmc_service.constituents import constituent_entry, constituent_names

    with told_mistakes():
        if name is None:
            entries = {one: constituent_entry(one) for one in constituent_names()}
            width = max(len(one) for one in entries)
            for one, entry in entries.items():
                click.echo(f"{one:<{width}}  {entry['kind']}: {_moduli(entry)}")
            click.echo("\nscalebridge micro constituents NAME shows one with its source.")
            return
        _show_entry(name, constituent_entry(name))


def _moduli(entry: dict[str, Any]) -> str:
    keys = [key for key in ("E", "E1", "E2", "nu", "nu12") if key in entry]
    return ", ".join(f"{key} {entry[key][0] if isinstance(entry[key], list) else entry[key]}" for key in keys)


def _show_entry(name: str, entry: dict[str, Any]) -> None:
    from gmc_service.constituents import find_constituent

    click.echo(name)
    for key, value in entry.items():
        if key == "failure":
            for failure in value:
                limits = "; ".join(f"{part} {_written(failure[part])}" for part in failure if part != "criterion")
                click.echo(f"  failure        {failure['criterion']}: {limits}")
        elif key == "plasticity":
            click.echo(f"  plasticity     {', '.join(f'{part} {one}' for part, one in value.items())}")
        else:
            click.echo(f"  {key:<13}  {_written(value)}")
    try:
        find_constituent(name)
    except ValueError as error:
        click.echo("Incomplete; the cell file that uses it must give what is missing:")
        click.echo("\n".join(f"  {line}" for line in str(error).splitlines()))


def _written(value: Any) -> str:
    return ", ".join(str(one) for one in value) if isinstance(value, list) else str(value)


def _plain(found: EffectiveProperties) -> dict[str, Any]:
    """Numbers in SI, as JSON has them."""
    return {
        "method": found.method,
        "temperature": found.temperature,
        **{name: getattr(found.constants, name) for name in found.constants.__dataclass_fields__},
        **{f"alpha{axis + 1}": None if found.expansion is None else float(found.expansion[axis]) for axis in range(3)},
        "density": found.density,
        "fractions": found.fractions,
        "coupling": found.coupling,
        "stiffness": found.stiffness.tolist(),
        "expansion": None if found.expansion is None else found.expansion.tolist(),
        "order": COMPONENTS,
    }


def _table(found: EffectiveProperties, title: str) -> str:
    of = found.constants
    lines = [title, f"  method {found.method}, {found.temperature:g} K, axis 1 along the fibre"]
    for name in ("E11", "E22", "E33"):
        lines.append(f"  {name:<8}{getattr(of, name) / 1e9:>14.6g} GPa")
    for name in ("nu12", "nu13", "nu23"):
        lines.append(f"  {name:<8}{getattr(of, name):>14.6g}")
    for name in ("G12", "G13", "G23"):
        lines.append(f"  {name:<8}{getattr(of, name) / 1e9:>14.6g} GPa")
    for axis in range(3):
        if found.expansion is None:
            lines.append(
                f"  alpha{axis + 1}     not known: no thermal expansion of {', '.join(found.without_expansion)}"
            )
        else:
            lines.append(f"  alpha{axis + 1:<3}{found.expansion[axis] * 1e6:>14.6g} 1e-6/K")
    for name, fraction in found.fractions.items():
        lines.append(f"  fraction of {name}: {fraction:.12g}")
    if found.density is None:
        lines.append(f"  density       not known: none of {', '.join(found.without_density)}")
    else:
        lines.append(f"  density {found.density:>14.6g} kg/m3")
    if found.coupling > 1e-9:
        lines.append(
            f"  stretch and shear are tied (largest correlation {found.coupling:.3g}); --json has the stiffness"
        )
    return "\n".join(lines)
