"""SPEC.md is what the models say, and its example is what the code sends."""

from __future__ import annotations

import re

import msgpack
import pytest
from pydantic import BaseModel

from protocol import specification
from protocol.dispatcher import KEPT_IDS, KEPT_REPLIES
from protocol.errors import CODES, MEANINGS
from protocol.frames import MAX_HEADER_BYTES, MAX_MESSAGE_BYTES, ArrayEntry, Header, decode
from protocol.messages import Hello, Message, Part, Welcome, array_fields
from protocol.roles import CONTROL, ROLES
from protocol.server import HEARTBEAT_INTERVAL_MS, HEARTBEAT_TIMEOUT_MS
from protocol.version import NEWEST

TEXT = specification.SPEC.read_text(encoding="utf-8")


def test_generated_parts_are_up_to_date() -> None:
    assert specification.specification(TEXT) == TEXT, "run `python -m protocol.specification`"


def test_making_it_anew_replaces_what_someone_wrote_between_the_markers() -> None:
    spoilt = TEXT.replace("| `thickness` |", "| `thick` |").replace("7c3e", "beef")
    assert spoilt != TEXT
    assert specification.specification(spoilt) == TEXT


def test_missing_markers_are_an_error() -> None:
    with pytest.raises(ValueError, match="tables begin"):
        specification.specification(TEXT.replace("<!-- tables begin -->", ""))


def _all_models() -> list[type[BaseModel]]:
    return [*specification.messages(), *specification._parts(), Header, ArrayEntry]


@pytest.mark.parametrize("model", _all_models(), ids=lambda model: model.__name__)
def test_every_field_is_in_a_table_with_words_and_unit(model: type[BaseModel]) -> None:
    arrays = array_fields(model) if issubclass(model, Message) else {}
    for name, field in model.model_fields.items():
        unit, words = specification.unit_and_words(field.description)
        assert words, f"{model.__name__}.{name} has no description"
        assert re.search(rf"^\| `{name}` \|.*{re.escape(words)} \|$", TEXT, re.MULTILINE), f"{model.__name__}.{name}"
        kind = specification._type_text(field.annotation) if name not in arrays else "array"
        if kind in ("float", "list of float") or kind.endswith(" float"):
            assert unit, f"{model.__name__}.{name} has no unit"


def test_every_operation_code_and_state_is_in_a_table() -> None:
    assert set(MEANINGS) == set(CODES)
    for code in CODES:
        assert f"| `{code}` | {MEANINGS[code]} |" in TEXT
    states = set()
    for operations in (CONTROL, *(role.operations for role in ROLES.values())):
        for name, operation in operations.items():
            assert f"#### `{name}`" in TEXT
            states |= operation.allowed
    assert states == set(specification.STATES)


def test_constraints_reach_the_tables() -> None:
    rows = {
        "`poisson`": "> -1; < 0.5",
        "`points_per_cell`": ">= 1",
        "`assumption`": "one of `plane_stress`, `plane_strain`",
        "`times`": "length >= 2",
        "`damping_rate`": "default `0.0` | >= 0",
        "`stiffness`": "array `<f8` | (anchors,) | N/m",
    }
    for field, text in rows.items():
        assert any(text in line for line in TEXT.splitlines() if line.startswith(f"| {field} |")), field


def test_numbers_in_the_prose_are_those_of_the_code() -> None:
    prose = " ".join(TEXT.split("<!-- tables begin -->")[0].split())
    assert f"interval {HEARTBEAT_INTERVAL_MS} ms, timeout {HEARTBEAT_TIMEOUT_MS} ms" in prose
    assert f"the last {KEPT_REPLIES} replies" in prose and f"the last {KEPT_IDS} ids" in prose
    assert MAX_MESSAGE_BYTES == 2**30 and "(2^30 unless" in prose
    assert MAX_HEADER_BYTES == 16 << 20 and "at most 16 MiB" in prose
    assert TEXT.startswith(f"# The scalebridge protocol, version {NEWEST}")


def test_the_worked_example_decodes_to_messages() -> None:
    """What is printed as hexadecimal is read back by the code, and by msgpack alone."""
    blocks = re.findall(r"```text\n((?:[0-9a-f]{4}  .*\n)+)```", TEXT)
    assert len(blocks) == 2
    frames = [bytes.fromhex("".join(line[6:53] for line in block.splitlines())) for block in blocks]
    request, reply = (decode([frame]) for frame in frames)
    assert (request.kind, request.type, reply.kind, reply.type) == ("request", "hello", "reply", "hello")
    assert request.id == reply.id and request.run == reply.run
    assert Hello.from_parts(request.body, {}).role == Welcome.from_parts(reply.body, {}).role == "continuum"
    assert msgpack.unpackb(frames[0])["protocol"] == list(NEWEST)


def test_parts_are_all_found() -> None:
    named = {model.__name__ for model in specification._parts()}
    assert {"Rectangle", "Overlap", "EdgeCondition", "Sample", "CrackCut", "VersionRange"} <= named
    assert all(issubclass(model, Part) for model in specification._parts())
