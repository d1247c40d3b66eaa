"""What a service is: a role, a few words about itself, and one method for each operation of its role."""

from __future__ import annotations

import threading
import time
from abc import ABC, abstractmethod
from pathlib import Path
from typing import ClassVar

from protocol.errors import ProtocolError

Capabilities = dict[str, bool | int | float | str | list[str]]


class Activity:
    """What a service does now; written by the solver's thread, read by the control thread."""

    def __init__(self) -> None:
        self.operation = ""
        self.done = 0
        self.total = 0
        self.note = ""
        self.began = time.monotonic()
        self.requests = 0
        self.abort = threading.Event()

    def begin(self, operation: str) -> None:
        """Note that an operation began; an abort of an earlier one is forgotten."""
        self.done = self.total = 0
        self.note = ""
        self.began = time.monotonic()
        self.abort.clear()
        self.operation = operation

    def end(self) -> None:
        """Note that the operation ended."""
        self.operation = ""
        self.requests += 1

    def progress(self, done: int, total: int, note: str = "") -> None:
        """Report progress; a solver calls this at least once a second where it can.

        Raises
        ------
        ProtocolError
            `aborted`, where the client asked for it.
        """
        self.done, self.total, self.note = done, total, note
        if self.abort.is_set():
            raise ProtocolError("aborted", f"{self.operation} was aborted after {done} of {total}")


class Service(ABC):
    """Base of all services.

    A subclass has one method for each operation of its role (see `protocol.roles`), named like it, taking
    the request message and returning the reply message. `hello`, `status` and `shutdown` are answered for
    it. A method raises `ProtocolError` for what the client did wrong and for a solver that failed.
    """

    role: ClassVar[str]
    backend: ClassVar[str]
    backend_version: ClassVar[str]

    #: Folder with the CURVE keys for services that this one asks, see `protocol.security.keys_of_link`.
    link_keys: Path | None = None

    def __init__(self) -> None:
        self.activity = Activity()

    @abstractmethod
    def capabilities(self) -> Capabilities:
        """Return what this backend can do, for `hello`."""

    @property
    @abstractmethod
    def step(self) -> int:
        """Step counter of the solver."""

    def close(self) -> None:  # noqa: B027 - most services have nothing to release
        """Release what the service holds."""
