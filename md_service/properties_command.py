"""The command ``scalebridge properties``: measures a sample and writes what a micromechanics solver reads.

The command line loads this module for its help, so it imports nothing heavy; the command imports what it needs.
"""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING

import click

from md_service.quantities import Quantity, Value

if TYPE_CHECKING:
    from md_service.atoms import Atoms
    from md_service.properties import Progress, Properties


class _Words(click.ParamType):
    """Some of the known words, with commas between."""

    name = "words"

    def __init__(self, *known: str) -> None:
        self.known = known

    def convert(
        self, value: str | tuple[str, ...], param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[str, ...]:
        """Words of a text."""
        if isinstance(value, tuple):
            return value
        words = tuple(word.strip() for word in value.split(","))
        for word in words:
            if word not in self.known:
                self.fail(f"{word!r} is unknown; it must be some of {', '.join(self.known)}", param, ctx)
        return words


@click.command(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.argument("sample")
@click.option("--force-field", required=True, metavar="NAME", help="Profile: tersoff, opls-aa, eam-copper, ...")
@click.option(
    "--temperature",
    type=Quantity("temperature", least=-1e-9),
    default="300 K",
    show_default=True,
    help="0 K gives the static stiffness.",
)
@click.option(
    "--what",
    type=_Words("stiffness", "expansion", "tension"),
    default="stiffness",
    show_default=True,
    help="Of stiffness,expansion,tension.",
)
@click.option("--isotropic", is_flag=True, help="The material is isotropic: strain along the axes only.")
@click.option("--rate", type=Quantity("rate", least=0.0), default="5e9 1/s", show_default=True, help="Of tension.")
@click.option("--axis", type=click.Choice(["x", "y", "z"]), default="x", show_default=True, help="Of tension.")
@click.option(
    "--strain",
    type=click.FloatRange(0.0, 5.0, min_open=True),
    default=0.2,
    show_default=True,
    help="At which tension ends.",
)
@click.option("--time-step", type=Quantity("time", least=0.0), help="Instead of the force field's.")
@click.option("--seed", type=click.IntRange(1), default=1, show_default=True, help="Of velocities and thermostats.")
@click.option(
    "--kind",
    type=click.Choice(["isotropic", "transversely isotropic", "orthotropic", "plane"]),
    help="Of the constituent. Default: by sample.",
)
@click.option(
    "--out", type=click.Path(path_type=Path, dir_okay=False), metavar="FILE.toml", help="Constituent file to write."
)
@click.pass_context
def properties(
    context: click.Context,
    sample: str,
    force_field: str,
    temperature: Value,
    what: tuple[str, ...],
    isotropic: bool,
    rate: Value,
    axis: str,
    strain: float,
    time_step: Value | None,
    seed: int,
    kind: str | None,
    out: Path | None,
) -> None:  # fmt: skip
    """Measure material properties of SAMPLE: stiffness, density, thermal expansion, tension.

    SAMPLE is a LAMMPS data file or the name of a sample that comes with the package. All figures have standard
    errors. With --out they are written as a constituent of a composite.
    """
    from tempfile import TemporaryDirectory

    from md_service.errors import EngineError
    from md_service.properties import Tension, constituent, measure_properties
    from protocol.constituent import write_constituent

    if out is not None and not out.parent.is_dir():
        raise click.BadParameter(f"there is no folder {str(out.parent)!r}", param_hint="--out")
    atoms, path = _sample(sample)
    try:
        with TemporaryDirectory() as folder:
            measured = measure_properties(
                atoms,
                force_field,
                float(temperature),
                Path(folder),
                what=what,
                seed=seed,
                isotropic=isotropic,
                tension=Tension(rate=float(rate), axis=axis, strain=strain),
                time_step=None if time_step is None else float(time_step),
                progress=_progress(),
            )
        origin = _origin(context, path, atoms.notes)
        material = None if out is None else constituent(measured, _stem(path), kind, origin)
    except (ValueError, EngineError) as error:
        raise click.ClickException(str(error)) from error
    _print(measured)
    if out is not None and material is not None:
        write_constituent(out, material)
        click.echo(f"\nconstituent ({material.kind}): {out}")


def _sample(name: str) -> tuple[Atoms, Path]:
    """The sample and its file."""
    from md_service.data_file import read_data_file

    path = Path(name)
    if not path.is_file():
        shipped = {_stem(file): file for file in sorted(Path(__file__).with_name("data").glob("*.data*"))}
        if name not in shipped:
            known = ", ".join(shipped) or "none"
            raise click.BadParameter(f"{name!r} is no file; samples of the package: {known}", param_hint="SAMPLE")
        path = shipped[name]
    try:
        return read_data_file(path)[0], path
    except ValueError as error:
        raise click.ClickException(f"{path}: {error}") from error


def _stem(path: Path) -> str:
    return path.name.split(".data")[0]


def _origin(
    context: click.Context, path: Path, notes: dict[str, str | int | float]
) -> dict[str, str | int | float | bool]:
    """Where a constituent comes from: the sample's file, hash and making, the command, the versions."""
    from hashlib import sha256
    from importlib.metadata import version

    words = ["scalebridge", "properties"]
    left_out = ["out"] + ([] if "tension" in context.params["what"] else ["rate", "axis", "strain"])
    for parameter in context.command.params:
        value = context.params[str(parameter.name)]
        if isinstance(parameter, click.Argument):
            words.append(str(value))
        elif isinstance(value, bool):
            words += [parameter.opts[0]] if value else []
        elif value is not None and parameter.name not in left_out:
            words += [parameter.opts[0], ",".join(value) if isinstance(value, tuple) else str(value)]
    return {
        "sample": path.name,
        "sample_sha256": sha256(path.read_bytes()).hexdigest(),
        "command": shlex.join(words),
        "scalebridge": version("scalebridge"),
        "lammps": version("lammps"),
        **{f"sample_{key}": value for key, value in notes.items() if key in ("command", "seed")},
    }


def _progress() -> Progress | None:
    """A line on a terminal that tells how far a stage is; nothing where nobody looks."""
    import sys

    if not sys.stderr.isatty():
        return None

    def show(stage: str, done: int, total: int) -> None:
        end = "\n" if done >= total else ""
        click.echo(f"\r{stage:<10} {100 * done // total:3d} % of {total} steps{end}", err=True, nl=False)

    return show


def _print(measured: Properties) -> None:
    from md_service.properties import rows, tensor_block

    stiffness = measured.stiffness
    state = f"{measured.temperature:g} K" + ("" if stiffness.rate == 0.0 else f", {len(stiffness.seeds)} replicas")
    click.echo(f"{len(measured.atoms)} atoms, {measured.force_field}, {state}")
    if stiffness.rate > 0.0:
        click.echo(f"strain {stiffness.strain:g} at about {stiffness.rate:.1e} 1/s")
    if measured.tension is not None:
        click.echo(f"tension along {measured.tension.axis} at {measured.tension.rate:.1e} 1/s")
    click.echo("\n" + "\n".join(tensor_block(stiffness)))
    click.echo(f"\n{'quantity':<40} {'value':>12} {'std. error':>12}  unit")
    for row in rows(measured):
        error = "" if row.error != row.error else f"{row.error:12.2g}"
        click.echo(f"{row.quantity:<40} {row.value:12.5g} {error:>12}  {row.unit}")
