"""Errors: the stable codes of the wire, the report that travels, and the exceptions on each side."""

from __future__ import annotations

import traceback
from typing import Literal, get_args

from pydantic import BaseModel, ConfigDict, Field

Code = Literal[
    "malformed_message",
    "version_mismatch",
    "role_mismatch",
    "unknown_type",
    "bad_field",
    "wrong_state",
    "unsupported",
    "message_too_large",
    "request_id_reused",
    "request_expired",
    "unknown_cell",
    "solver_failed",
    "aborted",
    "internal",
]
CODES: tuple[str, ...] = get_args(Code)

#: What each code means, for the specification.
MEANINGS: dict[str, str] = {
    "malformed_message": "the frames are no message: no msgpack map, a header key missing, frames unlike the table",
    "version_mismatch": "the two sides share no protocol version; the sentence names both ranges",
    "role_mismatch": "the client asked for another role than this service has",
    "unknown_type": "this role has no message of that type",
    "bad_field": "a field is missing, of the wrong type, shape or range; `field` is its path",
    "wrong_state": "the operation is not allowed in the state that the service is in",
    "unsupported": "the value is legal but this backend cannot do it; its capabilities say what it can",
    "message_too_large": "the message is larger than the limit that `hello` stated",
    "request_id_reused": "the id was used before for another request",
    "request_expired": "the id was answered before, and the answer is no longer kept",
    "unknown_cell": "role `micromechanics`: no definition is kept under that id; `register` it, ask again; since 1.4",
    "solver_failed": "the solver stopped: NaN, runaway, lost atoms; `step` says when",
    "aborted": "the operation was ended by `abort` or `shutdown`",
    "internal": "a defect of the service; the tail of its traceback is attached",
}

TRACEBACK_LINES = 12


class ErrorReport(BaseModel):
    """The body of an error reply."""

    model_config = ConfigDict(extra="ignore")

    code: str = Field(description="one of the codes below; stable, for programs")
    sentence: str = Field(description="what is wrong, naming field and value, for people")
    hint: str = Field(default="", description="what to try")
    origin: str = Field(default="", description="role and backend that answers")
    step: int | None = Field(default=None, description="step counter of the solver, where a solver failed")
    field: str = Field(default="", description="path of the field at fault, such as `body.upper` or `edges.0.times`")
    traceback_tail: str = Field(default="", description="last lines of the traceback, of `internal` only")

    def text(self) -> str:
        """Return one paragraph that a user can act on."""
        where = [part for part in (self.origin, f"field {self.field}" if self.field else "",
                                   f"step {self.step}" if self.step is not None else "") if part]  # fmt: skip
        text = f"{self.sentence} [{self.code}" + (f"; {', '.join(where)}]" if where else "]")
        return f"{text}\n  hint: {self.hint}" if self.hint else text


class ProtocolError(Exception):
    """An error with a stable code; a service raises it to answer, a client raises it on such an answer.

    Parameters
    ----------
    code : str
        One of `CODES`.
    sentence : str
        What is wrong, in one sentence that names field and value.
    hint, field, step, origin, traceback_tail
        See `SPEC.md`, section Errors.
    """

    def __init__(
        self,
        code: Code | str,
        sentence: str,
        *,
        hint: str = "",
        field: str = "",
        step: int | None = None,
        origin: str = "",
        traceback_tail: str = "",
    ) -> None:
        self.report = ErrorReport(
            code=code, sentence=sentence, hint=hint, field=field, step=step, origin=origin,
            traceback_tail=traceback_tail,
        )  # fmt: skip
        super().__init__(self.report.text())

    @property
    def code(self) -> str:
        """Return the stable code."""
        return self.report.code


class ConnectionProblem(Exception):
    """The other side cannot be reached or did not answer; base of the four kinds below."""


class DeadlineExpired(ConnectionProblem):
    """No answer within the deadline of the operation."""


class PeerLost(ConnectionProblem):
    """The connection broke and did not come back."""


class ServiceRestarted(ConnectionProblem):
    """The answer came from another session: the service was started anew and lost its state."""


class HandshakeRefused(ConnectionProblem):
    """The service refused the connection: wrong or missing CURVE keys."""


def traceback_tail(error: BaseException) -> str:
    """Return the last lines of the traceback of `error`."""
    lines = "".join(traceback.format_exception(error)).rstrip().splitlines()
    return "\n".join(lines[-TRACEBACK_LINES:])
