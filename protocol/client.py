"""A client of one service: sends a request, waits for its one reply, repeats it if the link broke.

Exactly once, from the client's side::

    send(id) --reply(id)--> done
       |--link broke, link back--> send(id) again: the service runs it once, and answers from its cache
       |--link broke, not back within the grace--> PeerLost
       |--deadline--> DeadlineExpired
       |--reply of another session--> ServiceRestarted
"""

from __future__ import annotations

import time
import uuid
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from pydantic import ValidationError

from protocol.channel import CONNECTED, DISCONNECTED, REFUSED, Channel, ZmqChannel
from protocol.dispatcher import UNKNOWN_ID, bad_field
from protocol.errors import (
    DeadlineExpired,
    ErrorReport,
    HandshakeRefused,
    PeerLost,
    ProtocolError,
    ServiceRestarted,
)
from protocol.frames import MAX_MESSAGE_BYTES, Envelope, Frame, decode, encode, size_of
from protocol.messages import Empty, Hello, Message, VersionRange, Welcome, newer_fields
from protocol.roles import CONTROL, ROLES, Operation
from protocol.version import NEWEST, OLDEST, Version, package_version

#: Seconds between two looks at the link and at `watch`.
LOOK_SECONDS = 0.1
#: Seconds that a broken link may take to come back.
LINK_GRACE_SECONDS = 5.0

#: Requests of `call_each` that are on their way at once: one in work, one whose reply is read, others that wait.
IN_FLIGHT = 4

Reply = TypeVar("Reply", bound=Message)


@dataclass
class Timing:
    """Where the time of a client's calls went, s."""

    sending: float = 0.0
    computing: float = 0.0
    waiting: float = 0.0


class Client:
    """Speaks to one service.

    Parameters
    ----------
    channel : Channel
    role : str
        Role that the service must have.
    run : str
        Id of the run, for the service's log.
    watch : callable, optional
        Called about ten times a second while waiting; may raise to end the wait, for instance because
        the service's process has died.
    """

    def __init__(self, channel: Channel, role: str, *, run: str = "", watch: Callable[[], None] | None = None) -> None:
        self.role = role
        self.timing = Timing()
        self.welcome: Welcome | None = None
        self._channel = channel
        self._control: Client | None = None
        self._operations: dict[str, Operation] = ROLES[role].operations
        self._run = run
        self._watch = watch
        self._session = ""
        self._name = uuid.uuid4().hex
        self._requests = 0
        self._version = NEWEST
        self._max_message_bytes = MAX_MESSAGE_BYTES

    @classmethod
    def connect(
        cls,
        endpoint: str,
        role: str,
        *,
        keys: Path | None = None,
        run: str = "",
        watch: Callable[[], None] | None = None,
        deadline: float = 60.0,
    ) -> Client:
        """Connect to a service, wait until it is ready, agree on a version.

        Raises
        ------
        ConnectionProblem
            Where nobody answers within `deadline` seconds, or the keys do not fit.
        ProtocolError
            Where versions or roles do not match; the sentence names both sides.
        """
        client = cls(ZmqChannel(endpoint, keys), role, run=run, watch=watch)
        try:
            client.hello(deadline)
        except BaseException:
            client.close()
            raise
        return client

    def hello(self, deadline: float | None = None) -> Welcome:
        """Exchange versions; must be the first call."""
        hello = Hello(
            versions=VersionRange(oldest=OLDEST, newest=NEWEST),
            role=self.role,
            client=f"scalebridge {package_version()}",
        )
        self.welcome = self.call("hello", hello, Welcome, deadline=deadline)
        self._version = Version(*self.welcome.version)
        self._max_message_bytes = self.welcome.max_message_bytes
        return self.welcome

    def offers(self, operation: str) -> bool:
        """Return whether the service has an operation: some are optional, some came with a later version."""
        known = self._operations[operation]
        if not known.optional:
            return True
        offered = self.welcome.capabilities.get("operations") if self.welcome is not None else None
        return known.since <= self._version and isinstance(offered, list) and operation in offered

    def watch_with(self, watch: Callable[[], None]) -> None:
        """Set what is called about ten times a second while waiting; it may raise to end the wait."""
        self._watch = watch

    @property
    def control(self) -> Client:
        """Client of the control socket: `status`, `abort`, `shutdown` while the solver computes."""
        if self._control is None:
            if self.welcome is None:
                raise RuntimeError("say hello before asking for the control socket")
            self._control = Client(self._channel.control(self.welcome.control_endpoint), self.role, run=self._run)
            self._control._operations = CONTROL
            self._control._session = self._session
        return self._control

    def call(
        self,
        operation: str,
        request: Message | None,
        reply: type[Reply],
        *,
        step: int = 0,
        deadline: float | None = None,
    ) -> Reply:
        """Send a request and return its reply.

        Parameters
        ----------
        operation : str
            Type of the message, such as ``"advance"``.
        request : Message or None
            None for an operation without fields.
        reply : type of Message
            Type of the reply.
        step : int
            Step counter of the run.
        deadline : float, optional
            Seconds to wait; by default that of the operation.

        Raises
        ------
        ProtocolError
            The error that the service answered; or, before anything is sent, `message_too_large`, or `unsupported`
            where the request holds what the agreed version of the protocol does not know.
        ConnectionProblem
            See the module's state diagram.
        """
        began = time.perf_counter()
        request_id, frames = self._framed(operation, request if request is not None else Empty(), step)
        self._channel.send(frames)
        sent = time.perf_counter()
        answer = self._await(request_id, operation, [frames], deadline)
        received = time.perf_counter()
        result = self._read(answer, operation, reply)
        self.timing.sending += sent - began + time.perf_counter() - received
        self.timing.computing += answer.seconds
        self.timing.waiting += max(0.0, received - sent - answer.seconds)
        return result

    def call_each(
        self, operation: str, requests: Iterable[Message], reply: type[Reply], *, deadline: float | None = None
    ) -> Iterator[Reply]:
        """Send requests one behind another and yield their replies in order.

        The next request is there when the service has answered one, so that neither waits for the wire. For operations
        without effect on the service's state alone: after a broken link one may be run twice.

        Parameters
        ----------
        operation : str
        requests : iterable of Message
        reply : type of Message
        deadline : float, optional
            Seconds to wait for each reply; by default that of the operation.

        Raises
        ------
        ProtocolError, ConnectionProblem
            As `call`; what is on its way then is passed over.
        """
        waiting: deque[tuple[Message, str, list[Frame]]] = deque()

        def send(request: Message) -> None:
            began = time.perf_counter()
            waiting.append((request, *self._framed(operation, request, 0)))
            self._channel.send(waiting[-1][2])
            self.timing.sending += time.perf_counter() - began

        def next_reply() -> Reply:
            began = time.perf_counter()
            answer = self._await(waiting[0][1], operation, [frames for _, _, frames in waiting], deadline)
            while answer.kind == "error" and answer.body.get("code") == "request_expired":
                # The link broke, and the service keeps only the last of large replies: all are asked anew.
                for _ in range(len(waiting)):
                    send(waiting.popleft()[0])
                answer = self._await(waiting[0][1], operation, [frames for _, _, frames in waiting], deadline)
            received = time.perf_counter()
            waiting.popleft()
            result = self._read(answer, operation, reply)
            self.timing.sending += time.perf_counter() - received
            self.timing.computing += answer.seconds
            self.timing.waiting += max(0.0, received - began - answer.seconds)
            return result

        for request in requests:
            send(request)
            if len(waiting) == IN_FLIGHT:
                yield next_reply()
        while waiting:
            yield next_reply()

    def _framed(self, operation: str, message: Message, step: int) -> tuple[str, list[Frame]]:
        """Return id and frames of a new request, after the checks that need no service."""
        if not self.offers(operation):
            raise ProtocolError("unsupported", f"the {self.role} service does not have {operation}", field="type")
        unknown = newer_fields(message, self._version) if self._version < NEWEST else []
        if unknown:
            raise ProtocolError(
                "unsupported",
                f"{operation}: {', '.join(unknown)} came with a later version of the protocol than {self._version},"
                f" which the {self.role} service speaks: it would ignore it",
                field=unknown[0],
            )
        self._requests += 1
        request_id = f"{self._name}-{self._requests:x}"
        frames = encode(
            Envelope(
                "request", operation, request_id, message.plain_values(), message.array_values(), self._run,
                self._session, step, protocol=self._version,
            )
        )  # fmt: skip
        size = size_of(frames)
        if size > self._max_message_bytes:
            raise ProtocolError(
                "message_too_large",
                f"the request {operation} has {size} bytes, the {self.role} service takes at most "
                f"{self._max_message_bytes}",
            )
        return request_id, frames

    def _read(self, answer: Envelope, operation: str, reply: type[Reply]) -> Reply:
        """Return the message of an answer, or raise its error."""
        if answer.kind == "error":
            raise _raised(answer)
        try:
            return reply.from_parts(answer.body, answer.arrays)
        except ValidationError as error:
            raise bad_field(error, f"reply of the {self.role} service to {operation}") from None

    def _await(
        self, request_id: str, operation: str, unanswered: Sequence[list[Frame]], deadline: float | None
    ) -> Envelope:
        """Return the reply to the first of the unanswered requests; see the state diagram above."""
        wait = self._operations[operation].deadline if deadline is None else deadline
        end = time.monotonic() + wait
        broken_since: float | None = None
        while True:
            now = time.monotonic()
            raw = self._channel.receive(min(LOOK_SECONDS, max(0.0, end - now)))
            if raw is not None:
                answer = decode(raw)
                if answer.id in (request_id, UNKNOWN_ID):
                    self._check_session(answer.session)
                    return answer
                continue  # a second copy of an older reply
            for event in self._channel.link_events():
                if event == REFUSED:
                    raise HandshakeRefused(
                        f"the {self.role} service refused the connection: its CURVE keys and ours do not fit"
                    )
                if event == DISCONNECTED and broken_since is None:
                    broken_since = time.monotonic()
                elif event == CONNECTED and broken_since is not None:
                    broken_since = None
                    for frames in unanswered:
                        self._channel.send(frames)
            if self._watch is not None:
                self._watch()
            now = time.monotonic()
            if broken_since is not None and operation != "hello" and now - broken_since > LINK_GRACE_SECONDS:
                raise PeerLost(f"the link to the {self.role} service broke during {operation} and did not come back")
            if now >= end:
                raise DeadlineExpired(f"the {self.role} service did not answer {operation} within {wait:g} s")

    def _check_session(self, session: str) -> None:
        if self._session and session and session != self._session:
            raise ServiceRestarted(f"the {self.role} service was started anew and has lost its state")
        self._session = self._session or session

    def close(self) -> None:
        """Close the channels; the service goes on."""
        if self._control is not None:
            self._control.close()
            self._control = None
        self._channel.close()


def _raised(answer: Envelope) -> ProtocolError:
    report = ErrorReport.model_validate({"code": "internal", "sentence": "no sentence", **answer.body})
    return ProtocolError(
        report.code, report.sentence, hint=report.hint, field=report.field, step=report.step, origin=report.origin,
        traceback_tail=report.traceback_tail,
    )  # fmt: skip
