"""Runs of several processes: the small scene, and runs that several tests look at."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
from small_runs import SHORT, StartsRuns

from coordinator.kill_resume import SCENE, run_through
from coordinator.run_process import RunProcess


@pytest.fixture
def start() -> Iterator[StartsRuns]:
    with ExitStack() as stack:

        def started(scene: Path, folder: Path, *words: str) -> RunProcess:
            return stack.enter_context(RunProcess(scene, folder, *words))

        yield started


@pytest.fixture(scope="session")
def small_scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A sheet of about 750 atoms at 300 K in a small body."""
    path = tmp_path_factory.mktemp("scene") / "small_sheet.toml"
    path.write_text(SCENE)
    return path


@pytest.fixture(scope="session")
def left_alone(small_scene: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a run of the small scene that nobody disturbed."""
    folder = tmp_path_factory.mktemp("alone") / "run"
    run_through(small_scene, folder, *SHORT)
    return folder


@pytest.fixture(scope="session")
def continuum_scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The body of the small scene without atoms."""
    text = SCENE[: SCENE.index("[atomistic]")].replace("[continuum]\n", '[continuum]\ntime_step = "5 fs"\n')
    path = tmp_path_factory.mktemp("scene") / "continuum_alone.toml"
    path.write_text(text)
    return path
