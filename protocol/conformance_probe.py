"""The conformance kit's line to a service: sends anything, and holds every answer against the general rules."""

from __future__ import annotations

import math
import time
import uuid
from typing import Any, TypeVar

import numpy as np
from pydantic import ValidationError

from protocol.channel import REFUSED, Channel
from protocol.dispatcher import UNKNOWN_ID
from protocol.errors import CODES, ErrorReport, ProtocolError
from protocol.frames import Envelope, Frame, decode, encode
from protocol.kinds import path_of
from protocol.messages import Message
from protocol.version import NEWEST, Version
from protocol.wrong_requests import names_field

Reply = TypeVar("Reply", bound=Message)


class Refuted(Exception):
    """The service broke the contract; the text says how."""


class NoAnswer(Refuted):
    """A request was not answered."""


class Probe:
    """One connection to one socket of a service.

    Parameters
    ----------
    channel : Channel
    deadline : float
        Seconds to wait for an answer.
    """

    def __init__(self, channel: Channel, deadline: float) -> None:
        self.channel = channel
        self.deadline = deadline
        self.session = ""
        self.run = "conformance"

    def ask_frames(self, frames: list[Frame], request_id: str, wait: float | None = None) -> list[Frame]:
        """Send frames and return the frames of the answer to `request_id` (or to an id that was not readable)."""
        self.channel.send(frames)
        return self.receive(request_id, self.deadline if wait is None else wait)

    def receive(self, request_id: str, wait: float) -> list[Frame]:
        """Return the frames of the next answer to `request_id`."""
        end = time.monotonic() + wait
        while time.monotonic() < end:
            frames = self.channel.receive(min(0.2, max(0.0, end - time.monotonic())))
            if frames is None:
                if REFUSED in self.channel.link_events():
                    raise NoAnswer("the service refused the connection: its keys and ours do not fit")
                continue
            try:
                answer = decode(frames[1:] if len(frames) > 1 and not len(frames[0]) else frames)
            except ProtocolError as error:
                raise Refuted(f"the answer is no message: {error.report.sentence}") from None
            if answer.id in (request_id, UNKNOWN_ID):
                return frames
        raise NoAnswer(f"no answer within {wait:g} s")

    def ask(
        self,
        operation: str,
        body: Message | dict[str, Any] | None = None,
        arrays: dict[str, np.ndarray] | None = None,
        *,
        request_id: str | None = None,
        step: int = 0,
        version: Version = NEWEST,
        wait: float | None = None,
    ) -> Envelope:
        """Send a request and return its answer after the checks that hold for every answer."""
        frames, name = self.request(operation, body, arrays, request_id=request_id, step=step, version=version)
        answer = decode(self.ask_frames(frames, name, wait))
        self.check_answer(answer, operation, name, step)
        return answer

    def request(
        self,
        operation: str,
        body: Message | dict[str, Any] | None = None,
        arrays: dict[str, np.ndarray] | None = None,
        *,
        request_id: str | None = None,
        step: int = 0,
        version: Version = NEWEST,
    ) -> tuple[list[Frame], str]:
        """Return the frames of a request and its id."""
        name = request_id or uuid.uuid4().hex
        if isinstance(body, Message):
            plain, arrays = body.plain_values(), body.array_values()
        else:
            plain = body or {}
        envelope = Envelope("request", operation, name, plain, arrays or {}, self.run, step=step, protocol=version)
        return encode(envelope), name

    def check_answer(self, answer: Envelope, operation: str, request_id: str, step: int) -> None:
        """Hold an answer to a readable request against what is true of all answers."""
        if answer.kind not in ("reply", "error"):
            raise Refuted(f"the answer to {operation} is of kind {answer.kind!r}, must be reply or error")
        for key, got, sent in (
            ("id", answer.id, request_id),
            ("type", answer.type, operation),
            ("run", answer.run, self.run),
            ("step", answer.step, step),
        ):
            if got != sent:
                raise Refuted(f"the answer to {operation} has {key} {got!r}, the request had {sent!r}")
        if not answer.session:
            raise Refuted(f"the answer to {operation} has no session")
        if self.session and answer.session != self.session:
            raise Refuted(f"the session changed from {self.session!r} to {answer.session!r} while the service ran")
        self.session = answer.session
        if not (math.isfinite(answer.seconds) and answer.seconds >= 0):
            raise Refuted(f"the answer to {operation} has seconds {answer.seconds}")

    def reply(self, operation: str, body: Message | None, kind: type[Reply], **named: Any) -> Reply:
        """Send a right request and return its reply as a checked message."""
        return read_reply(self.ask(operation, body, **named), kind)

    def close(self) -> None:
        """Close the connection."""
        self.channel.close()


def read_reply(answer: Envelope, kind: type[Reply]) -> Reply:
    """Return an answer as the message it must be."""
    if answer.kind == "error":
        report = error_report(answer)
        raise Refuted(f"{answer.type} was refused: {report.text()}")
    try:
        return kind.from_parts(answer.body, answer.arrays)
    except ValidationError as error:
        problem = error.errors()[0]
        path = ".".join(str(part) for part in path_of(problem["loc"]))
        raise Refuted(f"reply to {answer.type}: {path}: {problem['msg']}") from None


def error_report(answer: Envelope) -> ErrorReport:
    """Return the body of an error answer."""
    try:
        report = ErrorReport.model_validate(answer.body)
    except ValidationError as error:
        raise Refuted(f"the error body is wrong: {error.errors()[0]['msg']}") from None
    if report.code not in CODES:
        raise Refuted(f"the error code {report.code!r} is none of {', '.join(CODES)}")
    if not report.sentence:
        raise Refuted(f"the error {report.code} has no sentence")
    return report


def expect_error(answer: Envelope, codes: tuple[str, ...], fields: tuple[str, ...] = ()) -> ErrorReport:
    """Return the report of an answer that must be an error of one of `codes`, naming one of `fields`."""
    wanted = " or ".join(codes)
    if answer.kind != "error":
        raise Refuted(f"was accepted, must be answered with {wanted}")
    report = error_report(answer)
    if report.code not in codes:
        raise Refuted(f"was answered with {report.code}, must be {wanted}: {report.sentence}")
    if fields and not names_field(report.field, fields):
        raise Refuted(f"the error names the field {report.field!r}, must name {' or '.join(fields)}: {report.sentence}")
    return report


def difference(first: Envelope, second: Envelope) -> str:
    """Return where body or arrays of two answers differ in a bit, or an empty text."""
    if first.kind != second.kind:
        return f"one is a {first.kind}, the other a {second.kind}"
    if first.body != second.body:
        keys = [key for key in {**first.body, **second.body} if first.body.get(key) != second.body.get(key)]
        return f"{keys[0]} is {first.body.get(keys[0])!r} and {second.body.get(keys[0])!r}"
    if first.arrays.keys() != second.arrays.keys():
        return f"arrays are {sorted(first.arrays)} and {sorted(second.arrays)}"
    for name, array in first.arrays.items():
        other = second.arrays[name]
        if array.shape != other.shape or array.dtype != other.dtype or array.tobytes() != other.tobytes():
            return f"array {name} differs"
    return ""
