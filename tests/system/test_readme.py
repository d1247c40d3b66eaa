"""Every command of the README runs as it stands there."""

import contextlib
import os
import re
import shlex
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
#: Commands that end within seconds; the others are run by the slow test.
QUICK = ("check", "backends", "micro", "export")
#: make sets up an environment of its own; a fresh clone is its test, see CONTRIBUTING.
MAKE = ("make run", "make test")


def commands() -> list[str]:
    """Return the commands of the README's shell blocks, without their comments."""
    blocks = re.findall(r"```sh\n(.*?)```", (ROOT / "README.md").read_text(), flags=re.DOTALL)
    lines = [line.split("#")[0].strip() for block in blocks for line in block.splitlines()]
    return [line for line in lines if line]


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """A folder with the scenes where the README's commands expect them."""
    (tmp_path / "scenes").symlink_to(ROOT / "scenes")
    return tmp_path


def words(command: str) -> list[str]:
    """Return a command's words with the program of this environment."""
    name, *rest = shlex.split(command)
    assert name == "scalebridge", f"the README has a command that this test does not know: {command}"
    return [str(Path(sys.executable).parent / "scalebridge"), *rest]


def test_readme_has_commands_and_make_targets_exist() -> None:
    found = commands()
    assert set(MAKE) <= set(found)
    assert sum(command.startswith("scalebridge") for command in found) >= 8
    makefile = (ROOT / "Makefile").read_text()
    for target in MAKE:
        assert re.search(rf"^{target.split()[1]}:", makefile, flags=re.MULTILINE)


@pytest.mark.parametrize("command", [c for c in commands() if c.split()[1] in QUICK])
def test_quick_commands_succeed(command: str, checkout: Path) -> None:
    done = subprocess.run(words(command), cwd=checkout, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip()


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_all_commands_succeed_in_order(checkout: Path) -> None:
    with contextlib.ExitStack() as services:
        for command in commands():
            if command in MAKE:
                continue
            if " serve " in command:
                services.enter_context(served(words(command), checkout))
                continue
            done = subprocess.run(words(command), cwd=checkout, capture_output=True, text=True, check=False)
            assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"
    assert (checkout / "runs" / "graphene_patch" / "report.html").exists()


@contextlib.contextmanager
def served(command: list[str], folder: Path) -> Iterator[None]:
    """Run a service until the block ends, ready when it says where it listens."""
    log = folder / "serve.log"
    with log.open("wb") as file:
        process = subprocess.Popen(command, cwd=folder, stdout=file, stderr=file, env={**os.environ})
    try:
        deadline = time.monotonic() + 60
        while "listens at" not in log.read_text():
            assert process.poll() is None and time.monotonic() < deadline, log.read_text()
            time.sleep(0.1)
        yield
    finally:
        process.terminate()
        process.wait(30)
