"""A structure service in this process and a real micromechanics service behind a real socket."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from fem_service.service import LaminateService
from gmc_service.service import make_gmc
from protocol.server import running


@pytest.fixture(scope="module")
def folder() -> Iterator[Path]:
    """A folder whose name is short enough for a socket in it."""
    with tempfile.TemporaryDirectory(prefix="scalebridge-") as name:
        yield Path(name)


@pytest.fixture(scope="module")
def cells(folder: Path) -> Iterator[str]:
    """Endpoint of a micromechanics service."""
    with running(make_gmc(folder), f"ipc://{folder}/cells") as server:
        yield server.endpoint


@pytest.fixture
def laminate() -> Iterator[LaminateService]:
    """A service without a laminate."""
    service = LaminateService()
    yield service
    service.close()
