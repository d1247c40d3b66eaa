"""CURVE keys, and the rule which addresses need them."""

from __future__ import annotations

import ipaddress
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import urlsplit

import zmq
import zmq.auth

SERVER = "server"
CLIENT = "client"
AUTHORIZED = "authorized"


class SecurityError(Exception):
    """Keys are missing, unreadable, or an address needs them."""


@dataclass(frozen=True)
class KeyPair:
    """A CURVE key pair, Z85 text."""

    public: bytes
    secret: bytes


def make_keys(folder: Path) -> list[Path]:
    """Write a key pair for servers and one for clients into `folder`; return the files.

    A server lets in the clients whose public key lies in `folder/authorized`.

    Raises
    ------
    SecurityError
        Where keys are there already: they are never overwritten.
    """
    present = sorted(folder.glob("*.key*"))
    if present:
        raise SecurityError(f"{folder} already holds keys ({present[0].name}); remove them or name another folder")
    folder.mkdir(parents=True, exist_ok=True)
    folder.chmod(0o700)
    authorized = folder / AUTHORIZED
    authorized.mkdir(exist_ok=True)
    made = []
    for name in (SERVER, CLIENT):
        public, secret = zmq.auth.create_certificates(folder, name)
        Path(secret).chmod(0o600)
        made += [Path(public), Path(secret)]
    copy = authorized / f"{CLIENT}.key"
    copy.write_bytes((folder / f"{CLIENT}.key").read_bytes())
    return [*made, copy]


def load_pair(folder: Path, name: str) -> KeyPair:
    """Return the key pair `name` of `folder`.

    Raises
    ------
    SecurityError
        Where the file is missing or holds no secret key.
    """
    path = folder / f"{name}.key_secret"
    try:
        public, secret = zmq.auth.load_certificate(path)
    except (OSError, ValueError) as error:
        raise SecurityError(f"no secret key at {path} ({error}); make keys with `scalebridge keys {folder}`") from None
    if secret is None:
        raise SecurityError(f"{path} holds no secret key")
    return KeyPair(public, secret)


def load_public(folder: Path, name: str) -> bytes:
    """Return the public key `name` of `folder`.

    Raises
    ------
    SecurityError
        Where the file is missing.
    """
    path = folder / f"{name}.key"
    try:
        return zmq.auth.load_certificate(path)[0]
    except (OSError, ValueError) as error:
        raise SecurityError(f"no public key at {path} ({error})") from None


def is_local(endpoint: str) -> bool:
    """Return whether an endpoint can be reached from this machine alone."""
    parts = urlsplit(endpoint)
    if parts.scheme in ("ipc", "inproc"):
        return True
    host = (parts.hostname or "").strip("[]")
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False  # a name or a wildcard: may be anyone's


def keys_of_link(endpoint: str, keys: Path | None) -> Path | None:
    """Return the keys with which one service asks another at an endpoint.

    None where the endpoint is a Unix socket: a run makes it in its own folder, for its own processes alone, without
    keys. Any address over TCP is asked with the keys where there are some, never in clear because the peer is.
    """
    return None if urlsplit(endpoint).scheme == "ipc" else keys


def check_binding(endpoint: str, keys: Path | None, insecure_public: bool) -> None:
    """Refuse an address beyond this machine without keys.

    Raises
    ------
    SecurityError
        Where the address is public, no keys are given, and the user did not ask for it in plain words.
    """
    if keys is None and not insecure_public and not is_local(endpoint):
        raise SecurityError(
            f"{endpoint} can be reached from other machines, so it needs CURVE keys: make them with "
            "`scalebridge keys DIR` and give --keys DIR, or bind tcp://127.0.0.1:PORT, or say --insecure-public"
        )
