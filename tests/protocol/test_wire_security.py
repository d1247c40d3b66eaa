"""Keys: who is let in, who is not, and that nothing is served in the open by mistake."""

from __future__ import annotations

import ast
import shutil
import stat
import time
from pathlib import Path

import pytest
import zmq
from toy_services import TOYS
from wire_setup import wire

import protocol
from protocol.channel import ZmqChannel
from protocol.client import Client
from protocol.errors import DeadlineExpired, HandshakeRefused
from protocol.frames import Envelope, encode
from protocol.security import SecurityError, is_local, load_pair, load_public, make_keys
from protocol.server import Server, running

ROOMS = [Path(protocol.__file__).parent.parent / room for room in
         ("protocol", "coordinator", "mpm_service", "md_service", "benchmarks")]  # fmt: skip


def test_right_keys_are_let_in(tmp_path: Path) -> None:
    with wire("tcp_curve", tmp_path, TOYS["continuum"]()) as made:
        client = made.client()
        assert client.welcome is not None
        client.close()


def test_a_client_without_keys_gets_nothing(tmp_path: Path) -> None:
    with wire("tcp_curve", tmp_path, TOYS["continuum"]()) as made:
        assert made.server is not None
        with pytest.raises((HandshakeRefused, DeadlineExpired), match="continuum service"):
            Client.connect(made.server.endpoint, "continuum", deadline=1.5)
        assert made.service.activity.requests == 0


def test_a_client_with_another_pair_gets_nothing(tmp_path: Path) -> None:
    """Its pair is sound, and it knows the server's key, but it is not among the authorized."""
    with wire("tcp_curve", tmp_path, TOYS["continuum"]()) as made:
        assert made.server is not None
        stranger = tmp_path / "stranger"
        make_keys(stranger)
        shutil.copy(tmp_path / "keys" / "server.key", stranger / "server.key")
        with pytest.raises(HandshakeRefused, match="keys and ours do not fit"):
            Client.connect(made.server.endpoint, "continuum", keys=stranger, deadline=5)
        assert made.service.activity.requests == 0


def test_a_client_with_another_server_key_gets_nothing(tmp_path: Path) -> None:
    with wire("tcp_curve", tmp_path, TOYS["continuum"]()) as made:
        assert made.server is not None
        other = tmp_path / "other"
        make_keys(other)
        shutil.copy(tmp_path / "keys" / "client.key_secret", other / "client.key_secret")
        with pytest.raises((HandshakeRefused, DeadlineExpired), match="continuum service"):
            Client.connect(made.server.endpoint, "continuum", keys=other, deadline=1.5)
        assert made.service.activity.requests == 0


def test_a_bare_socket_gets_no_message_at_all(tmp_path: Path) -> None:
    with wire("tcp_curve", tmp_path, TOYS["continuum"]()) as made:
        assert made.server is not None
        for endpoint in (made.server.endpoint, made.host.control_endpoint):
            bare = zmq.Context.instance().socket(zmq.DEALER)
            bare.setsockopt(zmq.LINGER, 0)
            bare.connect(endpoint)
            bare.send_multipart(encode(Envelope("request", "status", "x", {})))
            assert bare.poll(700) == 0
            bare.close()


def test_a_public_address_without_keys_is_refused(tmp_path: Path) -> None:
    for endpoint in ("tcp://*:5555", "tcp://0.0.0.0:5555", "tcp://[::]:5555", "tcp://192.168.1.7:5555",
                     "tcp://example.org:5555", "tcp://eth0:*"):  # fmt: skip
        with pytest.raises(SecurityError, match="can be reached from other machines"):
            Server(TOYS["continuum"](), endpoint)
    keys = tmp_path / "keys"
    make_keys(keys)
    for options in ({"insecure_public": True}, {"keys": keys}):
        with running(TOYS["continuum"](), "tcp://0.0.0.0:*", **options) as server:
            port = server.endpoint.rsplit(":", 1)[1]
            client = Client.connect(f"tcp://127.0.0.1:{port}", "continuum", keys=options.get("keys"), deadline=5)
            assert client.control.hello(5).control_endpoint.startswith("tcp://0.0.0.0:")
            client.close()


@pytest.mark.parametrize(
    ("endpoint", "local"),
    [
        ("ipc:///tmp/x", True), ("tcp://127.0.0.1:1", True), ("tcp://127.3.2.1:*", True), ("tcp://localhost:1", True),
        ("tcp://[::1]:1", True), ("tcp://127.0.0.1.example.org:1", False), ("tcp://localhost.example.org:1", False),
        ("tcp://10.0.0.1:1", False), ("tcp://*:1", False),
    ],
)  # fmt: skip
def test_which_addresses_are_local(endpoint: str, local: bool) -> None:
    assert is_local(endpoint) is local


def test_keys_are_private_and_never_overwritten(tmp_path: Path) -> None:
    folder = tmp_path / "keys"
    made = make_keys(folder)
    assert {path.name for path in made} == {"server.key", "server.key_secret", "client.key", "client.key_secret"}
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    for name in ("server", "client"):
        assert stat.S_IMODE((folder / f"{name}.key_secret").stat().st_mode) == 0o600
        assert load_pair(folder, name).public == load_public(folder, name)
    before = {path: path.read_bytes() for path in made}
    with pytest.raises(SecurityError, match="already holds keys"):
        make_keys(folder)
    (folder / "server.key").unlink()
    with pytest.raises(SecurityError, match="already holds keys"):
        make_keys(folder)
    assert all(path.read_bytes() == text for path, text in before.items() if path.exists())


def test_missing_keys_name_the_file(tmp_path: Path) -> None:
    with pytest.raises(SecurityError, match=r"no secret key at .*client\.key_secret"):
        Client.connect("tcp://127.0.0.1:1", "continuum", keys=tmp_path)
    with pytest.raises(SecurityError, match=r"server\.key_secret"):
        Server(TOYS["continuum"](), "tcp://127.0.0.1:*", keys=tmp_path)


def test_no_pickle_and_no_code_from_the_wire() -> None:
    """No module of ours imports a serialiser that runs code, or evaluates text."""
    forbidden_modules = {"pickle", "cPickle", "_pickle", "dill", "cloudpickle", "shelve", "marshal", "joblib"}
    forbidden_calls = {"eval", "exec", "compile", "__import__"}
    forbidden_methods = {"recv_pyobj", "send_pyobj", "dump", "dumps"}
    files = [path for room in ROOMS for path in room.rglob("*.py")]
    assert len(files) > 30
    for path in files:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"), str(path))):
            where = f"{path}:{getattr(node, 'lineno', 0)}"
            if isinstance(node, ast.Import):
                assert not forbidden_modules & {alias.name.split(".")[0] for alias in node.names}, where
            elif isinstance(node, ast.ImportFrom):
                assert (node.module or "").split(".")[0] not in forbidden_modules, where
            elif isinstance(node, ast.Call):
                function = node.func
                if isinstance(function, ast.Name):
                    assert function.id not in forbidden_calls, where
                elif isinstance(function, ast.Attribute):
                    owner = function.value.id if isinstance(function.value, ast.Name) else ""
                    assert function.attr not in forbidden_methods or owner == "json", where
                for keyword in node.keywords:
                    is_true = isinstance(keyword.value, ast.Constant) and keyword.value.value is True
                    assert not (keyword.arg == "allow_pickle" and is_true), where


def test_a_client_refused_before_it_sends_does_not_wait_for_ever(tmp_path: Path) -> None:
    """After a refusal libzmq leaves the socket without a pipe; a send that waits for one never ends."""
    with wire("tcp_curve", tmp_path, TOYS["continuum"]()) as made:
        assert made.server is not None
        channel = ZmqChannel(made.server.endpoint)
        time.sleep(0.5)
        began = time.monotonic()
        client = Client(channel, "continuum")
        with pytest.raises(HandshakeRefused):
            client.hello(5.0)
        assert time.monotonic() - began < 2.0
        client.close()


def test_a_refused_client_learns_it_soon(tmp_path: Path) -> None:
    with wire("tcp_curve", tmp_path, TOYS["continuum"]()) as made:
        assert made.server is not None
        stranger = tmp_path / "stranger"
        make_keys(stranger)
        shutil.copy(tmp_path / "keys" / "server.key", stranger / "server.key")
        began = time.monotonic()
        with pytest.raises(HandshakeRefused):
            Client.connect(made.server.endpoint, "continuum", keys=stranger, deadline=60)
        assert time.monotonic() - began < 3.0
