"""One service as a process: the command `serve`."""

from __future__ import annotations

import contextlib
import logging
import os
import signal
import sys
from pathlib import Path

from protocol.backend import find
from protocol.server import Server, end_with


def serve_role(
    role: str,
    backend_name: str | None,
    endpoint: str,
    *,
    ranks: int,
    keys: Path | None,
    link_keys: Path | None,
    insecure_public: bool,
    max_message_bytes: int,
    folder: Path,
    parent: int | None,
    workers: int | None = None,
    executor: str | None = None,
) -> None:
    """Serve a role until a client asks to shut down, or SIGINT or SIGTERM comes.

    With several ranks, this process becomes the launcher of the ranks, each of which runs this function
    again with one rank. With workers or an executor, it becomes the front of processes that share its work.

    Raises
    ------
    BackendError, SecurityError
    """
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(name)s: %(message)s", stream=sys.stdout)
    backend = find(role, backend_name)
    if ranks > 1:
        words = [*backend.launch_words(ranks), sys.executable, "-m", "coordinator.cli"]
        arguments = sys.argv[1:]
        place = arguments.index("--ranks") if "--ranks" in arguments else None
        if place is not None:
            del arguments[place : place + 2]
        arguments = [word for word in arguments if not word.startswith("--ranks=")]
        os.execvp(words[0], [*words, *arguments])
    if parent is not None:
        # From here on, and on every rank: a service that is still being made, or follows rank 0, has no server.
        end_with(parent)
    folder.mkdir(parents=True, exist_ok=True)
    if workers is None and executor is None:
        service = backend.make(folder)
    else:
        words = [sys.executable, "-m", "coordinator.cli", "serve", role, "--backend", backend.name]
        limit = ["--max-message-bytes", str(max_message_bytes)]
        service = backend.make_front(folder, [*words, *limit], workers, executor)
    service.link_keys = link_keys or keys
    server = Server(
        service, endpoint, keys=keys, insecure_public=insecure_public, max_message_bytes=max_message_bytes
    )  # fmt: skip
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: server.stop())
    with contextlib.suppress(KeyboardInterrupt):
        server.run(lambda bound: print(f"{role} ({backend.name}) listens at {bound}", flush=True))
