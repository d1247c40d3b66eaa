"""From the frames of a request to the frames of its one reply.

A dispatcher knows nothing of sockets, so the in-process transport and ZeroMQ share it. The life of a
request id::

    new id ----> run it ----> keep its reply ----> later requests push the reply out
                                 |                          |
             same id again: send the kept reply    same id again: `request_expired`
"""

from __future__ import annotations

import time
import uuid
from collections import OrderedDict
from typing import Any

import msgpack
import psutil
from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from protocol.errors import ErrorReport, ProtocolError, traceback_tail
from protocol.frames import MAX_HEADER_BYTES, MAX_MESSAGE_BYTES, Envelope, Frame, decode, encode, size_of
from protocol.kinds import path_of
from protocol.messages import FIELD_RULE, Acknowledged, Empty, Hello, Message, Status, VersionRange, Welcome
from protocol.roles import CONTROL, ROLES, Operation
from protocol.service import Service
from protocol.version import NEWEST, OLDEST, Version, agree

#: Replies kept for requests that are sent again.
KEPT_REPLIES = 4
#: A reply above this size is kept only while it is the last one.
LARGE_REPLY_BYTES = 1 << 20
#: Ids remembered so that an old request is never run twice.
KEPT_IDS = 4096
#: Id of an error reply to a message whose own id could not be read.
UNKNOWN_ID = "?"


class Host:
    """A service with its session, its state, and a dispatcher for each of its two sockets.

    Parameters
    ----------
    service : Service
    max_message_bytes : int
        Larger messages are refused with an error.
    """

    def __init__(self, service: Service, max_message_bytes: int = MAX_MESSAGE_BYTES) -> None:
        self.service = service
        self.max_message_bytes = max_message_bytes
        self.session = uuid.uuid4().hex
        self.state = "new"
        self.stopping = False
        self.control_endpoint = ""
        self._process = psutil.Process()
        self.work = Dispatcher(self, ROLES[service.role].operations, keeps_state=True)
        self.control = Dispatcher(self, CONTROL, keeps_state=False)

    @property
    def origin(self) -> str:
        """Return who answers, for error reports."""
        return f"{self.service.role} {self.service.backend}"

    def perform(self, operation: str, request: Message) -> Message:
        """Run one operation and return its reply."""
        if isinstance(request, Hello):
            return self._welcome(request)
        if operation == "status":
            return self._status()
        if operation in ("abort", "shutdown"):
            running = self.service.activity.operation
            if operation == "shutdown":
                self.stopping = True
            self.service.activity.abort.set()
            return Acknowledged(operation=running)
        perform = getattr(self.service, operation, None)
        if perform is None:
            raise ProtocolError("unsupported", f"{self.origin} does not have {operation}", field="type")
        reply: Message = perform(request)
        return reply

    def _welcome(self, hello: Hello) -> Welcome:
        version = agree(Version(*hello.versions.oldest), Version(*hello.versions.newest))
        if version is None:
            raise ProtocolError(
                "version_mismatch",
                f"{hello.client} speaks versions {Version(*hello.versions.oldest)} to "
                f"{Version(*hello.versions.newest)}, {self.origin} speaks {OLDEST} to {NEWEST}",
                hint="install versions of both sides that share a protocol version",
                field="versions",
            )
        if hello.role != self.service.role:
            raise ProtocolError(
                "role_mismatch",
                f"{hello.client} wants the role {hello.role!r}, this service has the role {self.service.role!r}",
                field="role",
            )
        return Welcome(
            versions=VersionRange(oldest=OLDEST, newest=NEWEST),
            version=version,
            role=self.service.role,
            backend=self.service.backend,
            backend_version=self.service.backend_version,
            capabilities=self.service.capabilities(),
            units="SI",
            state=self.state,
            max_message_bytes=self.max_message_bytes,
            control_endpoint=self.control_endpoint,
        )

    def _status(self) -> Status:
        activity = self.service.activity
        return Status(
            state=self.state,
            step=self.service.step,
            operation=activity.operation,
            done=activity.done,
            total=activity.total,
            note=activity.note,
            operation_seconds=time.monotonic() - activity.began if activity.operation else 0.0,
            requests=activity.requests,
            memory_bytes=self._process.memory_info().rss,
        )


class Dispatcher:
    """Answers requests of one socket, each exactly once.

    Parameters
    ----------
    host : Host
    operations : dict of str to Operation
        What this socket takes.
    keeps_state : bool
        Whether operations of this socket are the solver's work, which is timed and moves the state.
    """

    def __init__(self, host: Host, operations: dict[str, Operation], *, keeps_state: bool) -> None:
        self._host = host
        self._operations = operations
        self._keeps_state = keeps_state
        self._replies: OrderedDict[str, tuple[tuple[str, int], list[Frame]]] = OrderedDict()
        self._answered: OrderedDict[str, None] = OrderedDict()

    def handle(self, frames: list[Frame]) -> list[Frame]:
        """Return the reply to a request, an error reply where it cannot be served. Never raises."""
        request: Envelope | None = None
        try:
            request = self._read(frames)
            kept = self._kept_reply(request)
            if kept is not None:
                return kept
        except ProtocolError as error:
            return self._error_frames(error, request or _readable(frames))
        except Exception as error:
            return self._error_frames(_defect(error), request)
        began = time.perf_counter()
        try:
            reply = self._run(request)
            answer = encode(
                Envelope(
                    "reply", request.type, request.id, reply.plain_values(), reply.array_values(), request.run,
                    self._host.session, request.step, time.perf_counter() - began,
                )
            )  # fmt: skip
            if size_of(answer) > self._host.max_message_bytes:
                raise ProtocolError(
                    "message_too_large",
                    f"the reply to {request.type} has {size_of(answer)} bytes, the limit is "
                    f"{self._host.max_message_bytes}",
                    hint="ask for less at once or start the service with a larger limit",
                )
        except ProtocolError as error:
            answer = self._error_frames(error, request)
        except Exception as error:
            answer = self._error_frames(_defect(error), request)
        self._keep(request, answer)
        return answer

    def _read(self, frames: list[Frame]) -> Envelope:
        """Return the decoded request after the checks that need no model."""
        size = size_of(frames)
        if size > self._host.max_message_bytes:
            raise ProtocolError(
                "message_too_large",
                f"the message has {size} bytes, the limit is {self._host.max_message_bytes}",
                hint="`hello` states the limit as max_message_bytes",
            )
        request = decode(frames)
        if request.kind != "request":
            raise ProtocolError(
                "malformed_message",
                f"a service takes messages of kind 'request', not {request.kind!r}",
                field="kind",
            )
        if request.type != "hello" and request.protocol.major != NEWEST.major:
            raise ProtocolError(
                "version_mismatch",
                f"the message is of protocol {request.protocol}, {self._host.origin} speaks {OLDEST} to {NEWEST}",
                field="protocol",
            )
        return request

    def _kept_reply(self, request: Envelope) -> list[Frame] | None:
        """Return the reply that the id already has, or None for a new id."""
        if request.id in self._replies:
            what, answer = self._replies[request.id]
            if what != (request.type, request.step):
                raise ProtocolError(
                    "request_id_reused",
                    f"id {request.id} was used for {what[0]} at step {what[1]}, now for {request.type} at step "
                    f"{request.step}",
                    field="id",
                )
            return answer
        if request.id in self._answered:
            raise ProtocolError(
                "request_expired",
                f"id {request.id} was answered before and its reply is no longer kept",
                field="id",
            )
        return None

    def _keep(self, request: Envelope, answer: list[Frame]) -> None:
        # A large reply is kept only until the next request: four checkpoints would hold four times the state.
        last = next(reversed(self._replies), None)
        if last is not None and size_of(self._replies[last][1]) > LARGE_REPLY_BYTES:
            del self._replies[last]
        self._replies[request.id] = ((request.type, request.step), answer)
        self._answered[request.id] = None
        if len(self._replies) > KEPT_REPLIES:
            self._replies.popitem(last=False)
        if len(self._answered) > KEPT_IDS:
            self._answered.popitem(last=False)

    def _run(self, request: Envelope) -> Message:
        """Check the request against its model and the state, perform it, move the state."""
        host = self._host
        operation = self._operations.get(request.type)
        if operation is None:
            raise ProtocolError(
                "unknown_type",
                f"{host.origin} has no message {request.type!r} on this socket; it has {', '.join(self._operations)}",
                field="type",
            )
        try:
            message = operation.request.from_parts(request.body, request.arrays)
        except ValidationError as error:
            raise bad_field(error, request.type) from None
        if host.state not in operation.allowed:
            raise ProtocolError(
                "wrong_state",
                f"{request.type} is not allowed in state {host.state!r}, only in "
                f"{', '.join(sorted(operation.allowed))}",
            )
        if not self._keeps_state:
            return host.perform(request.type, message)
        host.service.activity.begin(request.type)
        try:
            reply = host.perform(request.type, message)
        except ValidationError as error:
            # The service built a reply that breaks its own model: in practice a NaN out of the solver.
            self._state_is_lost(operation)
            problem = bad_field(error, f"reply to {request.type}")
            raise ProtocolError(
                "solver_failed", problem.report.sentence, field=problem.report.field, step=host.service.step
            ) from None
        except ProtocolError as error:
            if error.code in ("solver_failed", "aborted", "internal"):
                self._state_is_lost(operation)
            raise
        except Exception:
            self._state_is_lost(operation)
            raise
        finally:
            host.service.activity.end()
        if operation.leads_to is not None:
            host.state = operation.leads_to
        return reply

    def _state_is_lost(self, operation: Operation) -> None:
        """Note that an operation which works on the solver's state ended half way; others leave it alone."""
        if operation.leads_to is not None:
            self._host.state = "new" if operation.leads_to == "configured" else "failed"

    def _error_frames(self, error: ProtocolError, request: Envelope | None) -> list[Frame]:
        report: ErrorReport = error.report
        if not report.origin:
            report = report.model_copy(update={"origin": self._host.origin})
        return encode(
            Envelope(
                "error", request.type if request else "", request.id if request else UNKNOWN_ID, report.model_dump(),
                run=request.run if request else "", session=self._host.session, step=request.step if request else 0,
            )
        )  # fmt: skip


def bad_field(error: ValidationError, what: str) -> ProtocolError:
    """Return a `bad_field` error that names the first problem of a validation, and counts the others."""
    problems = error.errors(include_url=False)
    first = problems[0]
    # A rule between several fields is raised by the whole; it knows which field to name.
    path = _path(first) or what
    value = first.get("input")
    shown = (
        ""
        if isinstance(value, dict | BaseModel) or value is None or hasattr(value, "shape")
        else f" (got {_short(value)})"
    )
    sentence = f"{what}: {path}: {first['msg']}{shown}"
    if len(problems) > 1:
        others = sorted({_path(problem) for problem in problems[1:]})
        sentence += f"; also wrong: {', '.join(others)}"
    return ProtocolError("bad_field", sentence, field=path)


def _defect(error: Exception) -> ProtocolError:
    """Return what is told of an exception that nobody foresaw."""
    return ProtocolError(
        "internal", f"{type(error).__name__}: {error}", traceback_tail=traceback_tail(error),
        hint="this is a defect of the service; please report it with the traceback",
    )  # fmt: skip


def _path(problem: ErrorDetails) -> str:
    """Return the path of the field that a validation error is about."""
    rule = (problem["ctx"]["field"],) if problem["type"] == FIELD_RULE else ()
    return ".".join(str(part) for part in (*path_of(problem["loc"]), *rule))


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


def _readable(frames: list[Frame]) -> Envelope | None:
    """Return the header of a message that is otherwise wrong, so that its sender knows which one it was."""
    try:
        return decode([_without_arrays(frames[0])])
    except Exception:
        return None


def _without_arrays(frame: Frame) -> bytes:
    if memoryview(frame).nbytes > MAX_HEADER_BYTES:
        raise ValueError("too large to look into")
    header = msgpack.unpackb(memoryview(frame), strict_map_key=True)
    packed: bytes = msgpack.packb({**header, "body": {}, "arrays": []})
    return packed


__all__ = ["KEPT_REPLIES", "UNKNOWN_ID", "Dispatcher", "Empty", "Host", "bad_field"]
