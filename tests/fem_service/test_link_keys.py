"""Keys on the link from the structure service to the micromechanics service, over TCP with CURVE on."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
import zmq
from test_laminate_service import bits, curve, request

import fem_service.service
from fem_service.service import LaminateService
from gmc_service.service import make_gmc
from protocol.errors import ProtocolError
from protocol.security import keys_of_link, make_keys
from protocol.server import running

pytestmark = pytest.mark.skipif(not zmq.has("curve"), reason="this libzmq has no CURVE")
LOOPBACK = "tcp://127.0.0.1:*"


@pytest.fixture(scope="module")
def keys(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("keys") / "own"
    make_keys(folder)
    return folder


@pytest.fixture(scope="module")
def locked(keys: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """Endpoint of a micromechanics service that takes clients with keys alone."""
    with running(make_gmc(tmp_path_factory.mktemp("cells")), LOOPBACK, keys=keys) as server:
        yield server.endpoint


def test_with_its_keys_the_link_works_and_changes_no_bit(laminate: LaminateService, locked: str, keys: Path) -> None:
    with running(make_gmc(keys.parent), f"ipc://{keys.parent}/open") as server:
        laminate.configure(request(server.endpoint))
        expected = [bits(made) for made in curve(laminate, 3)]
    laminate.link_keys = keys
    laminate.configure(request(locked))
    assert [bits(made) for made in curve(laminate, 3)] == expected


def test_without_keys_the_link_is_refused_and_named(
    laminate: LaminateService, locked: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(fem_service.service, "CONNECT_SECONDS", 2.0)
    with pytest.raises(ProtocolError, match=r"micromechanics: .*(keys|did not answer)") as caught:
        laminate.configure(request(locked))
    assert (caught.value.code, caught.value.report.field) == ("bad_field", "micromechanics")


def test_with_keys_of_others_the_link_is_refused_and_named(
    laminate: LaminateService, locked: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(fem_service.service, "CONNECT_SECONDS", 2.0)
    make_keys(tmp_path / "others")
    laminate.link_keys = tmp_path / "others"
    with pytest.raises(ProtocolError, match="micromechanics: ") as caught:
        laminate.configure(request(locked))
    assert (caught.value.code, caught.value.report.field) == ("bad_field", "micromechanics")


def test_a_folder_without_keys_is_named(laminate: LaminateService, locked: str, tmp_path: Path) -> None:
    laminate.link_keys = tmp_path / "nothing"
    with pytest.raises(ProtocolError, match=r"micromechanics: no secret key at .*nothing") as caught:
        laminate.configure(request(locked))
    assert caught.value.report.field == "micromechanics"


def test_a_service_in_clear_is_not_asked_in_clear_over_tcp(
    laminate: LaminateService, keys: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(fem_service.service, "CONNECT_SECONDS", 2.0)
    laminate.link_keys = keys
    with running(make_gmc(tmp_path), LOOPBACK) as server, pytest.raises(ProtocolError) as caught:
        laminate.configure(request(server.endpoint))
    assert caught.value.report.field == "micromechanics"


def test_a_socket_of_the_run_needs_no_keys(keys: Path) -> None:
    assert keys_of_link("ipc:///run/socket", keys) is None
    assert keys_of_link("tcp://127.0.0.1:5555", keys) == keys
    assert keys_of_link("tcp://127.0.0.1:5555", None) is None
