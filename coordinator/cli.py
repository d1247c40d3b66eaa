"""The command line. Imports what a command needs only when that command runs, so that help is at once there."""

from __future__ import annotations

import sys
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path

import click

DIRECTORY = click.Path(path_type=Path, file_okay=False)
EXISTING_FILE = click.Path(path_type=Path, exists=True, dir_okay=False)
NEW_FILE = click.Path(path_type=Path, dir_okay=False)

#: Entry points through which other packages add commands: the command's name, and a click command in a module that is
#: cheap to import.
COMMANDS = "scalebridge.commands"


class CommandLine(click.Group):
    """The commands of this room, and those that installed packages announce as entry points."""

    def list_commands(self, context: click.Context) -> list[str]:
        """Names of all commands, sorted."""
        return sorted({*super().list_commands(context), *_announced()})

    def get_command(self, context: click.Context, name: str) -> click.Command | None:
        """One command, loaded now; none of an installed package replaces one of this room."""
        own = super().get_command(context, name)
        point = _announced().get(name)
        return _loaded(point) if own is None and point is not None else own


@cache
def _announced() -> dict[str, EntryPoint]:
    return {point.name: point for point in entry_points(group=COMMANDS)}


def _loaded(point: EntryPoint) -> click.Command:
    """The command of an entry point, or one that says why there is none, so that the others go on working."""
    try:
        command = point.load()
    except Exception as error:  # whatever a broken package raises while it is imported
        reason = f"{type(error).__name__}: {error}"
    else:
        if isinstance(command, click.Command):
            return command
        reason = f"it is no click command but {type(command).__name__}"
    package = point.dist.name if point.dist else "an unknown package"

    def explain() -> None:
        raise click.ClickException(f"command {point.name!r} of {package} ({point.value}) cannot be loaded: {reason}")

    return click.Command(
        point.name,
        callback=explain,
        short_help=f"(cannot be loaded: {reason})",
        # Whatever follows the name, the reason is said.
        context_settings={"ignore_unknown_options": True, "allow_extra_args": True, "allow_interspersed_args": False},
        add_help_option=False,
    )


@click.group(cls=CommandLine, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.version_option(package_name="scalebridge")
@click.option("--debug", is_flag=True, help="Show tracebacks.")
@click.pass_context
def cli(context: click.Context, debug: bool) -> None:
    """Concurrent multiscale mechanics: solvers as processes, coupled over a small protocol."""
    context.obj = debug


@cli.command()
@click.argument("scene", type=EXISTING_FILE)
@click.option("--out", type=DIRECTORY, help="Folder of the run. Default: runs/SCENE.")
@click.option("--resume", is_flag=True, help="Go on from the last checkpoint of the folder.")
@click.option("--set", "overrides", multiple=True, metavar="KEY=VALUE", help="Change a value of the scene.")
@click.option("--attach", "attached", multiple=True, metavar="ROLE=ENDPOINT", help="Use a service that runs already.")
@click.option("--keys", type=DIRECTORY, help="Folder with the keys for attached services.")
def run(
    scene: Path,
    out: Path | None,
    resume: bool,
    overrides: tuple[str, ...],
    attached: tuple[str, ...],
    keys: Path | None,
) -> None:
    """Run a scene; leaves results.h5, summary.json and report.html in the folder of the run."""
    from coordinator.scene_kind import is_laminate

    folder = out or Path("runs") / scene.stem
    where = _pairs("--attach", attached)
    if is_laminate(scene):
        from coordinator.laminate_run import run_laminate as start
    else:
        from coordinator.run import run_scene as start
    sys.exit(start(scene, folder, resume=resume, overrides=overrides, attached=where, keys=keys))


@cli.command()
@click.argument("scene", type=EXISTING_FILE)
@click.option("--full-atomistic", is_flag=True, required=True, help="Against the whole body as atoms alone.")
@click.option("--out", type=DIRECTORY, help="Folder of both runs. Default: runs/compare-SCENE.")
@click.option("--set", "overrides", multiple=True, metavar="KEY=VALUE", help="Change a value of the scene.")
@click.option("--force", is_flag=True, help="However many atoms that are.")
def compare(scene: Path, full_atomistic: bool, out: Path | None, overrides: tuple[str, ...], force: bool) -> None:
    """Run a scene coupled and all-atom; tabulate error and cost."""
    from coordinator.compare import compare_scene

    compare_scene(scene, out or Path("runs") / f"compare-{scene.stem}", overrides=overrides, force=force)


@cli.command()
@click.argument("scene", type=EXISTING_FILE)
@click.option("--set", "overrides", multiple=True, metavar="KEY=VALUE", help="Change a value of the scene.")
def check(scene: Path, overrides: tuple[str, ...]) -> None:
    """Validate a scene; say what would start, sizes, time steps and the estimated cost."""
    from coordinator.scene_kind import is_laminate

    if is_laminate(scene):
        from coordinator.laminate_check import describe_laminate
        from coordinator.laminate_scene import load_laminate

        click.echo(describe_laminate(load_laminate(scene, overrides)))
        return
    from coordinator.check import describe
    from coordinator.scene import load_scene

    click.echo(describe(load_scene(scene, overrides)))


@cli.command()
@click.argument("role")
@click.option("--backend", help="Name of the backend. Default: the first of the role.")
@click.option("--bind", "endpoint", default="tcp://127.0.0.1:*", show_default=True, metavar="ENDPOINT")
@click.option("--ranks", type=click.IntRange(1), default=1, show_default=True, help="MPI ranks.")
@click.option("--workers", type=click.IntRange(1), help="Processes that share each query (micromechanics).")
@click.option("--executor", metavar="dask://HOST:PORT", help="Cluster that shares each query (micromechanics).")
@click.option("--keys", type=DIRECTORY, help="Folder with keys; turns CURVE on.")
@click.option("--link-keys", type=DIRECTORY, help="Folder with keys for services that this one asks. Default: --keys.")
@click.option("--insecure-public", is_flag=True, help="Bind an address beyond this machine without keys.")
@click.option("--max-message-bytes", type=click.IntRange(1 << 12), default=1 << 30, show_default=True)
@click.option("--folder", type=DIRECTORY, default=Path("."), help="Working folder of the service.")
@click.option("--parent", type=int, help="End when this process is gone.")
def serve(
    role: str,
    backend: str | None,
    endpoint: str,
    ranks: int,
    workers: int | None,
    executor: str | None,
    keys: Path | None,
    link_keys: Path | None,
    insecure_public: bool,
    max_message_bytes: int,
    folder: Path,
    parent: int | None,
) -> None:
    """Serve a ROLE: continuum, atomistic, micromechanics or structure."""
    from coordinator.serve import serve_role

    serve_role(
        role, backend, endpoint, ranks=ranks, keys=keys, link_keys=link_keys, insecure_public=insecure_public,
        max_message_bytes=max_message_bytes, folder=folder, parent=parent, workers=workers, executor=executor,
    )  # fmt: skip


@cli.command()
def backends() -> None:
    """List installed backends by role."""
    from protocol.backend import installed

    for backend in sorted(installed().values(), key=lambda one: (one.role, one.name)):
        parallel = "serial and MPI" if backend.launcher else "one process"
        click.echo(f"{backend.role:<14} {backend.name:<14} {backend.summary} ({parallel})")


@cli.command()
@click.argument("endpoint")
@click.option("--keys", type=DIRECTORY, help="Folder with keys.")
@click.option("--role", help="Role that the service must have. Default: the one it has.")
@click.option("--shutdown", is_flag=True, help="Also check that it shuts down, last of all.")
def conformance(endpoint: str, keys: Path | None, role: str | None, shutdown: bool) -> None:
    """Hold a running service against the contract of its role; what it held before is lost."""
    from coordinator.conformance_table import hold

    sys.exit(0 if hold(endpoint, keys, role, shutdown) else 1)


@cli.command()
@click.argument("folder", type=DIRECTORY)
def keys(folder: Path) -> None:
    """Make CURVE keys in FOLDER, for addresses beyond this machine."""
    from protocol.security import make_keys

    for path in make_keys(folder):
        click.echo(path)
    click.echo(f"serve with --keys {folder}; copy the folder without server.key_secret to the client's machine")


@cli.command()
@click.argument("folder", type=click.Path(path_type=Path, exists=True, file_okay=False))
def report(folder: Path) -> None:
    """Make report.html again from the results in FOLDER."""
    from coordinator.scene_kind import holds_laminate

    if holds_laminate(folder):
        from coordinator.laminate_report import make_laminate_report as make
    else:
        from coordinator.report import make_report as make
    click.echo(make(folder))


@cli.command()
@click.argument("scene", type=EXISTING_FILE)
@click.option("--inp", "file", type=NEW_FILE, required=True, help="Deck of CalculiX and Abaqus to write.")
@click.option("--set", "overrides", multiple=True, metavar="KEY=VALUE", help="Change a value of the scene.")
def export(scene: Path, file: Path, overrides: tuple[str, ...]) -> None:
    """Write the mesh, plies, elastic constants and grips of a laminate scene for other codes."""
    from coordinator.laminate_export import export_laminate

    for note in export_laminate(scene, file, overrides):
        click.echo(note)


@cli.command()
@click.argument("cases", nargs=-1, metavar="[GROUP[/CASE]]...")
@click.option("--json", "json_file", type=NEW_FILE, help="Write the answers to a file.")
@click.option("--out", "kept", type=DIRECTORY, help="Keep the pictures and tables that the cases make in this folder.")
def verify(cases: tuple[str, ...], json_file: Path | None, kept: Path | None) -> None:
    """Run cases with a known answer; print value, reference, error, tolerance, seconds."""
    from coordinator.verify import verify_cases

    sys.exit(0 if verify_cases(cases, json_file, kept) else 1)


@cli.command()
@click.argument("names", nargs=-1, metavar="[NAME]...")
@click.option("--json", "json_file", type=NEW_FILE, help="Write the rows to a file.")
def bench(names: tuple[str, ...], json_file: Path | None) -> None:
    """Measure speed beside error."""
    from coordinator.bench import run_benchmarks

    run_benchmarks(names, json_file)


def _pairs(option: str, values: tuple[str, ...]) -> dict[str, str]:
    pairs = {}
    for value in values:
        key, equals, rest = value.partition("=")
        if not (key and equals and rest):
            raise click.BadParameter(f"{value!r} is not of the form ROLE=ENDPOINT", param_hint=option)
        pairs[key] = rest
    return pairs


def main() -> None:
    """Run the command line; errors that a user can act on are shown without a traceback."""
    debug = "--debug" in sys.argv
    try:
        cli(standalone_mode=False)
    except click.exceptions.Exit as exit_:
        sys.exit(exit_.exit_code)
    except click.ClickException as error:
        error.show()
        sys.exit(error.exit_code)
    except (click.Abort, KeyboardInterrupt):
        click.echo("stopped", err=True)
        sys.exit(130)
    except Exception as error:
        if debug:
            raise
        click.echo(f"error: {error}", err=True)
        sys.exit(1)


if __name__ == "__main__":
    main()
