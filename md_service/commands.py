"""The command ``scalebridge sample``: builds samples, writes them as LAMMPS data files and draws them.

The command line loads this module for its help, so it imports nothing heavy; each command imports what it needs.
"""

from __future__ import annotations

import shlex
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeVar

import click
from click.core import ParameterSource

from md_service.quantities import Quantity, Value

if TYPE_CHECKING:
    from md_service.atoms import Atoms
    from md_service.force_fields import ForceField

Function = TypeVar("Function", bound=Callable[..., Any])

#: Element of each crystal; the names are those of the force fields' lattices.
CRYSTALS: Final = {"copper": "Cu", "aluminium": "Al", "argon": "Ar", "hexagonal": "Ar"}
LENGTH = Quantity("length", least=0.0)
NOT_PART_OF_THE_SAMPLE: Final = ("out", "picture")


@click.group(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
def sample() -> None:
    """Build a sample of atoms: a LAMMPS data file and a picture.

    Lengths and temperatures carry their unit, such as "52 angstrom" or "300 K".
    """


def _output(function: Function) -> Function:
    function = click.option(
        "--picture", type=click.Path(path_type=Path, dir_okay=False), metavar="FILE.png", help="Draw the sample."
    )(function)
    return click.option(
        "--out",
        required=True,
        type=click.Path(path_type=Path, dir_okay=False),
        metavar="FILE",
        help="Data file to write, .data or .data.gz.",
    )(function)


def _lattice(function: Function) -> Function:
    for option in (
        click.option("--spacing", type=LENGTH, help="Nearest-neighbour distance, instead of a force field's."),
        click.option("--temperature", type=Quantity("temperature", least=-1e-9), default="0 K", show_default=True,
                     help="At which the force field's nearest-neighbour distance is taken."),
        click.option("--force-field", metavar="NAME", help="Its nearest-neighbour distance is taken."),
    ):  # fmt: skip
        function = option(function)
    return function


@sample.command()
@click.option("--width", type=LENGTH, required=True, help="Along x.")
@click.option("--height", type=LENGTH, required=True, help="Along y.")
@_lattice
@click.option("--layers", type=click.IntRange(1), default=1, show_default=True)
@click.option("--orientation", type=click.Choice(["zigzag", "armchair"]), default="zigzag", show_default=True,
              help="Direction of the lattice along x; the faces of a crack are of this kind.")  # fmt: skip
@click.option("--stacking", type=click.Choice(["AB", "AA"]), default="AB", show_default=True)
@click.option("--crack", type=LENGTH, help="Length of a straight crack along x, from the left edge.")
@click.option("--crack-y", type=Quantity("length"), default="0 angstrom", show_default=True, help="Its height.")
@click.option("--crack-inside", is_flag=True, help="The crack lies in the middle, with both ends inside.")
@click.option("--periodic", is_flag=True, help="The sheet repeats along x and y.")
@_output
def graphene(
    width: Value,
    height: Value,
    force_field: str | None,
    temperature: Value,
    spacing: Value | None,
    layers: int,
    orientation: Any,
    stacking: Any,
    crack: Value | None,
    crack_y: Value,
    crack_inside: bool,
    periodic: bool,
    out: Path,
    picture: Path | None,
) -> None:
    """Graphene: one or more sheets, whole or with a straight crack."""
    from md_service.atoms import CrackCut
    from md_service.graphene import graphene as build

    _check_files(out, picture)
    distance, profile = _spacing("graphene", force_field, temperature, spacing)
    options: dict[str, Any] = {
        "spacing": distance, "layers": layers, "orientation": orientation, "stacking": stacking, "periodic": periodic,
    }  # fmt: skip
    cut = None
    if crack is not None:
        whole = build(width, height, **options).box
        length = float(crack)
        left = -0.5 * length if crack_inside else None
        cut = CrackCut(0.5 * length if crack_inside else float(whole.low[0]) + length, float(crack_y), left)
    elif crack_inside or _given("crack_y"):
        raise click.UsageError("--crack-inside and --crack-y say where a crack is: give its length by --crack, too")
    _finish(build(width, height, crack=cut, **options), profile, out, picture)


@sample.command()
@click.argument("material", type=click.Choice(list(CRYSTALS)))
@click.option("--width", type=LENGTH, required=True, help="Along x.")
@click.option("--height", type=LENGTH, required=True, help="Along y.")
@click.option("--depth", type=LENGTH, help="Along z; not for hexagonal, which is one layer.")
@_lattice
@click.option("--periodic/--free", default=True, show_default=True, help="Whether it repeats.")
@_output
def crystal(
    material: str,
    width: Value,
    height: Value,
    depth: Value | None,
    force_field: str | None,
    temperature: Value,
    spacing: Value | None,
    periodic: bool,
    out: Path,
    picture: Path | None,
) -> None:
    """A crystal: fcc copper, aluminium or argon, or one hexagonal layer of argon."""
    from md_service.crystals import fcc, hexagonal, whole_cells

    _check_files(out, picture)
    if (depth is None) != (material == "hexagonal"):
        raise click.UsageError("--depth is wanted for fcc crystals, and only for them: hexagonal is one layer")
    distance, profile = _spacing(material, force_field, temperature, spacing)
    if depth is None:
        built = hexagonal(distance, width, height, periodic=periodic)
    else:
        edge = 2.0**0.5 * distance
        nx, ny, nz = (whole_cells(size / edge) for size in (width, height, depth))
        if min(nx, ny, nz) < 1:
            raise click.UsageError(
                f"--width, --height and --depth hold {nx} x {ny} x {nz} cubes of {edge * 1e10:.3f} angstrom; at least "
                "one is needed along each"
            )
        built = fcc(CRYSTALS[material], distance, (nx, ny, nz), (periodic, periodic, periodic))
    _finish(built, profile, out, picture)


def _resin(function: Function) -> Function:
    for option in (
        click.option("--seed", type=click.IntRange(1), default=1, show_default=True, help="Of everything random."),
        click.option("--temperature", type=Quantity("temperature", least=0.0), default="300 K", show_default=True,
                     help="At which the sample is relaxed."),
        click.option("--conversion", type=click.FloatRange(0.0, 1.0), default=0.76, show_default=True,
                     help="Share of the epoxide groups that have reacted."),
    ):  # fmt: skip
        function = option(function)
    return function


@sample.command()
@click.option("--units", type=click.IntRange(1), required=True, help="Units of 2 DGEBF and 1 DETDA, 117 atoms each.")
@click.option("--aspect", type=click.FloatRange(0.0, min_open=True), default=1.0, show_default=True,
              help="Width of the box along x and y over its depth along z; above 1 a slab.")  # fmt: skip
@_resin
@_output
def epoxy(
    units: int, aspect: float, conversion: float, temperature: Value, seed: int, out: Path, picture: Path | None
) -> None:
    """Cross-linked EPON 862/DETDA epoxy in a periodic box."""
    from tempfile import TemporaryDirectory

    from md_service.epoxy import build_epoxy

    _check_files(out, picture)
    with TemporaryDirectory() as folder:
        built = build_epoxy(
            units,
            conversion=conversion,
            temperature=float(temperature),
            seed=seed,
            work_dir=Path(folder),
            progress=_say,
            aspect=aspect,
        )
    _finish(built, _profile("opls-aa"), out, picture)


@sample.command()
@click.argument("source", metavar="SAMPLE")
@click.option("--force-field", metavar="NAME", required=True)
@click.option("--time", type=Quantity("time", least=0.0), required=True, help="For which the atoms move.")
@click.option("--time-step", type=Quantity("time", least=0.0), help="Instead of the force field's own.")
@click.option("--temperature", type=Quantity("temperature", least=0.0), default="300 K", show_default=True)
@click.option("--density", type=Quantity("density", least=0.0), help="To which the box shrinks or grows.")
@click.option("--seed", type=click.IntRange(1), default=1, show_default=True, help="Of velocities and thermostat.")
@_output
def relaxed(
    source: str,
    force_field: str,
    time: Value,
    time_step: Value | None,
    temperature: Value,
    density: Value | None,
    seed: int,
    out: Path,
    picture: Path | None,
) -> None:
    """A periodic sample, moved on with another force field at constant volume or to a density.

    SAMPLE is a data file, or the name of a sample that comes with the package. Bonds and types of the sample are kept.
    """
    from tempfile import TemporaryDirectory

    from md_service.data_file import read_data_file
    from md_service.sample_relaxation import relaxed as relax
    from md_service.sample_source import shipped_samples

    _check_files(out, picture)
    path = shipped_samples().get(source, Path(source))
    if not path.is_file():
        raise click.BadParameter(f"there is no file {source!r}, and no sample of this name", param_hint="SAMPLE")
    atoms = read_data_file(path)[0]
    profile = _profile(force_field)
    with TemporaryDirectory() as folder:
        built = relax(
            atoms,
            profile,
            float(time),
            temperature=float(temperature),
            density=None if density is None else float(density),
            seed=seed,
            time_step=None if time_step is None else float(time_step),
            work_dir=Path(folder),
            progress=_say,
        )
    first = str(atoms.notes.get("command", source))
    _finish(replace(built, notes={**atoms.notes, "density": built.density, "built_by": first}),
            _profile("opls-aa") if atoms.topology is not None else profile, out, picture)  # fmt: skip


@sample.command()
@click.option("--width", type=LENGTH, required=True, help="Of the platelet, along x.")
@click.option("--height", type=LENGTH, required=True, help="Of the platelet, along y.")
@click.option("--weight-fraction", type=click.FloatRange(0.0, 1.0, min_open=True, max_open=True), default=0.02,
              show_default=True, help="Of the platelet; met by the nearest whole number of resin units.")  # fmt: skip
@_resin
@_output
def nanocomposite(
    width: Value,
    height: Value,
    weight_fraction: float,
    conversion: float,
    temperature: Value,
    seed: int,
    out: Path,
    picture: Path | None,
) -> None:
    """Cross-linked epoxy around a graphene platelet."""
    from tempfile import TemporaryDirectory

    from md_service.nanocomposite import build_nanocomposite

    _check_files(out, picture)
    with TemporaryDirectory() as folder:
        built = build_nanocomposite(
            float(width),
            float(height),
            weight_fraction,
            conversion,
            float(temperature),
            seed,
            work_dir=Path(folder),
            progress=_say,
        )
    _finish(built, _profile("opls-aa"), out, picture)


def recorded_command(context: click.Context) -> str:
    """The command line with which a sample is built again: what the user gave, and the seed.

    Parameters
    ----------
    context : click.Context
        Of the command that runs.
    """
    words = context.command_path.split()
    words[0] = "scalebridge"
    if words[1:2] != ["sample"]:
        words.insert(1, "sample")
    for parameter in context.command.params:
        name = parameter.name or ""
        value = context.params.get(name)
        by_user = context.get_parameter_source(name) not in (ParameterSource.DEFAULT, None)
        if name in NOT_PART_OF_THE_SAMPLE or value is None or not (by_user or name == "seed"):
            continue
        if isinstance(parameter, click.Argument):
            words.append(str(value))
        elif isinstance(value, bool):
            words.append(parameter.opts[0] if value else (parameter.secondary_opts or [""])[0])
        else:
            words += [parameter.opts[0], str(value)]
    return shlex.join(words)


def _given(name: str) -> bool:
    return click.get_current_context().get_parameter_source(name) is not ParameterSource.DEFAULT


def _say(text: str) -> None:
    click.echo(text, err=True)


def _check_files(out: Path, picture: Path | None) -> None:
    """Refuse files that could not be written, before a build that takes minutes."""
    if not out.name.endswith((".data", ".data.gz")):
        raise click.BadParameter(f"{str(out)!r} must end in .data or .data.gz", param_hint="--out")
    if picture is not None and picture.suffix != ".png":
        raise click.BadParameter(f"{str(picture)!r} must end in .png", param_hint="--picture")
    for option, path in (("--out", out), ("--picture", picture)):
        if path is not None and not path.parent.is_dir():
            raise click.BadParameter(f"there is no folder {str(path.parent)!r}", param_hint=option)


def _profile(name: str) -> ForceField:
    from md_service.force_fields import force_field

    return force_field(name)


def _spacing(
    material: str, force_field: str | None, temperature: float, spacing: float | None
) -> tuple[float, ForceField | None]:
    """Nearest-neighbour distance, m, and the force field if one was given."""
    from md_service.force_fields import FORCE_FIELDS

    profile = None if force_field is None else _profile(force_field)
    if spacing is not None:
        return float(spacing), profile
    if profile is None:
        known = ", ".join(sorted(name for name, one in FORCE_FIELDS.items() if material in one.materials))
        raise click.UsageError(f"the lattice needs --force-field or --spacing; force fields for {material}: {known}")
    return profile.spacing(material, float(temperature)), profile


def _finish(atoms: Atoms, profile: ForceField | None, out: Path, picture: Path | None) -> None:
    """Write the data file and the picture, and print what was built."""
    from md_service.data_file import write_data_file

    context = click.get_current_context()
    atoms = replace(atoms, notes={**atoms.notes, "command": recorded_command(context)})
    unit_style, atom_style = (profile.unit_style, profile.atom_style) if profile else ("metal", "atomic")
    write_data_file(out, atoms, unit_style, atom_style)
    if picture is not None:
        _draw(atoms, picture, str(context.info_name))
    for name, value in _table(atoms):
        click.echo(f"{name:<20} {value}")
    for path in (out, picture):
        if path is not None:
            click.echo(f"{'file':<20} {path} ({path.stat().st_size / 1000:.0f} kB)")


def _draw(atoms: Atoms, path: Path, kind: str) -> None:
    import numpy as np

    from md_service.sample_picture import draw_sample

    inside = atoms.notes.get("platelet_atoms")
    draw_sample(atoms, path, kind, None if inside is None else np.arange(len(atoms)) < int(inside))


def _table(atoms: Atoms) -> list[tuple[str, str]]:
    import numpy as np

    counts = np.bincount(atoms.kind, minlength=len(atoms.species))
    by_element: dict[str, int] = {}
    for element, count in zip(atoms.elements, counts.tolist(), strict=True):
        by_element[element] = by_element.get(element, 0) + count
    size = (atoms.box.high - atoms.box.low) * 1e10
    repeats = [axis for axis, periodic in zip("xyz", atoms.box.periodic, strict=True) if periodic]
    rows = [
        ("atoms", f"{len(atoms)} ({', '.join(f'{count} {name}' for name, count in sorted(by_element.items()))})"),
        ("box", " x ".join(f"{edge:.3f}" for edge in size) + " angstrom, "
         + (f"periodic along {', '.join(repeats)}" if repeats else "free on all sides")),
        ("density", f"{atoms.density / 1000.0:.4f} g/cm^3"),
    ]  # fmt: skip
    if atoms.spacing is not None:
        rows.append(("spacing", f"{atoms.spacing * 1e10:.5f} angstrom"))
    if atoms.crack is not None:
        left = atoms.box.low[0] if atoms.crack.left_x is None else atoms.crack.left_x
        rows.append(("crack", f"x = {left * 1e10:.3f} to {atoms.crack.tip_x * 1e10:.3f} angstrom, "
                     f"y = {atoms.crack.y * 1e10:.3f} angstrom"))  # fmt: skip
    for name, value in atoms.notes.items():
        if name not in ("material", "orientation", "layers", "density"):
            rows.append((name.replace("_", " "), f"{value:.5g}" if isinstance(value, float) else str(value)))
    return rows
