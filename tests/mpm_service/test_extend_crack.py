"""Cracks that someone outside extends, in the open and through an overlap."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cracked_plate import MM, SPEED, advance, extend, field, service_of

from mpm_service.service import ReferenceService, make_service
from protocol import continuum as c
from protocol.errors import ProtocolError
from protocol.messages import Empty, RestoreRequest

# --- extension -----------------------------------------------------------------------------------------------------


def test_an_extended_crack_is_one_that_was_stated_with_these_corners() -> None:
    """Through ring, hole and ring, with a kink; the same bits as from the start."""
    corners = [(-4.2 * MM, 0.7 * MM), (9.1 * MM, -0.4 * MM)]
    whole = [(-17 * MM, 0.2 * MM), (-11.3 * MM, 0.2 * MM), *corners]
    one, other = service_of(), service_of(cracks=[c.CrackLine(points=whole)])
    reply = extend(one, *corners)
    assert [tip.position for tip in reply.tips] == [pytest.approx(corners[-1])]
    assert advance(one, 120).tips == advance(other, 120).tips
    for name in ("position", "velocity", "stress"):
        np.testing.assert_array_equal(field(one, name), field(other, name))


def test_a_line_may_grow_at_its_first_point_too() -> None:
    inner = [(8 * MM, 2.3 * MM), (11 * MM, 2.3 * MM)]
    one = service_of(cracks=[c.CrackLine(points=inner)])
    other = service_of(cracks=[c.CrackLine(points=[(7 * MM, 6 * MM), *inner])])
    reply = extend(one, (7 * MM, 6 * MM), end=0)
    assert [tip.end for tip in reply.tips] == [0, 1]
    assert advance(one, 80).tips == advance(other, 80).tips
    np.testing.assert_array_equal(field(one, "stress"), field(other, "stress"))


def test_points_and_anchors_below_a_cut_feel_nothing_of_what_is_above() -> None:
    """The crack is extended through the overlap to the right edge: from then on the halves are two bodies."""
    service = service_of()
    place = np.array([[sx * 5 * MM, 0.2 * MM + sy * 0.1 * MM, 0.0] for sx in (-1, 1) for sy in (-1, 1)])
    service.register(
        c.ContinuumRegister(
            anchor_position=place, anchor_ivc=np.array([0, 0, 1, 1]),
            ivc_lower=np.array([[-6.0, -5, -1], [4, -5, -1]]) * MM, ivc_upper=np.array([[-4.0, 5, 1], [6, 5, 1]]) * MM,
        )
    )  # fmt: skip
    extend(service, (15 * MM, 0.2 * MM))
    moved = advance(service, 300).anchor_displacement
    # The forerunner of a front, of the other sign, presses the closed faces for a moment.
    assert np.all(np.abs(moved[[0, 2]]) < 0.01 * moved[[1, 3], 1].min())
    assert np.all(moved[[1, 3], 1] > 0.5 * SPEED * 300 * 2.5e-7)


def test_a_crack_extended_in_mid_run_cuts_from_the_next_step_on() -> None:
    """Under the first front, in tension: no momentum passes a cut that is extended to the far edge."""
    service = service_of()
    advance(service, 50)
    below = field(service, "position")[:, 1] < 0.15 * MM
    weight = field(service, "weight")[below]
    extend(service, (15 * MM, 0.2 * MM))

    def momentum() -> np.ndarray:
        return (weight[:, None] * field(service, "velocity")[below]).sum(axis=0)

    before = momentum()
    assert before[1] > 0.0
    advance(service, 20)
    # Free on all sides, it keeps its momentum; that of the uncut plate nearly doubles meanwhile.
    np.testing.assert_allclose(momentum(), before, atol=1e-3 * before[1])
    service = service_of()
    advance(service, 70)
    assert momentum()[1] > 1.8 * before[1]


def test_a_checkpoint_after_an_extension_goes_on_with_the_same_bits() -> None:
    measured = [c.CrackLine(points=[(-17 * MM, 0.2 * MM), (-11.3 * MM, 0.2 * MM)], measure_every=20)]
    one, other = service_of(cracks=measured), service_of(cracks=measured)
    advance(one, 18)
    extend(one, (0.0, 0.4 * MM))
    saved = one.checkpoint(Empty())
    other.restore(RestoreRequest(step=saved.step, state=saved.state))
    extend(one, (9 * MM, 0.4 * MM))
    extend(other, (9 * MM, 0.4 * MM))
    advance(one, 62)
    advance(other, 62)
    for name, value in one.checkpoint(Empty()).state.items():
        np.testing.assert_array_equal(other.checkpoint(Empty()).state[name], value, err_msg=name)
    assert advance(one, 1).tips == advance(other, 1).tips


BRANCH = c.CrackLine(points=[(-13 * MM, -6 * MM), (-13 * MM, 0.2 * MM)])
ALONG = c.CrackLine(points=[(8 * MM, 0.2 * MM), (12 * MM, 0.2 * MM)])
START = c.CrackLine(points=[(-17 * MM, 0.2 * MM), (-11.3 * MM, 0.2 * MM)])


@pytest.mark.parametrize(
    ("request_", "wrong", "words"),
    [
        ({"points": [(-9 * MM, 0.2 * MM), (16 * MM, 0.0)]}, "points", "outside the body"),
        ({"points": [(-12 * MM, 0.2 * MM)]}, "points", "turns straight back"),
        ({"points": [(-11.3 * MM, 0.2 * MM)]}, "points", "coincide"),
        ({"points": [(-9 * MM, 4 * MM), (-12 * MM, 4 * MM), (-12 * MM, -4 * MM)]}, "points", "meet each other"),
        ({"points": [(9 * MM, 0.2 * MM)]}, "points", "meets crack 2"),
        ({"points": [(-9 * MM, 0.2 * MM), (10 * MM, -1 * MM), (10 * MM, 1 * MM)]}, "points", "meets crack 2"),
        ({"crack": 3, "points": [(-9 * MM, 0.2 * MM)]}, "crack", "there are 3 cracks"),
        ({"end": 0, "points": [(-9 * MM, 0.2 * MM)]}, "end", "not inside the body"),
        ({"crack": 1, "end": 1, "points": [(-9 * MM, 3 * MM)]}, "end", "no tip"),
    ],
)
def test_an_extension_that_makes_no_sense_is_refused_and_changes_nothing(
    request_: dict[str, Any], wrong: str, words: str
) -> None:
    service = service_of(cracks=[START, BRANCH, ALONG])
    before = service.checkpoint(Empty()).state
    with pytest.raises(ProtocolError, match=words) as caught:
        extend(service, *request_.pop("points"), **request_)
    assert caught.value.report.code == "bad_field" and caught.value.report.field == wrong
    for name, value in service.checkpoint(Empty()).state.items():
        np.testing.assert_array_equal(before[name], value, err_msg=name)


def test_a_body_without_cracks_has_none_to_extend() -> None:
    with pytest.raises(ProtocolError, match="no cracks") as caught:
        extend(service_of(cracks=[]), (0.0, 0.0))
    assert caught.value.report.field == "crack"


def test_only_a_service_that_can_do_it_names_it() -> None:
    assert make_service(Path()).capabilities()["operations"] == ["extend_crack"]
    assert ReferenceService().capabilities()["operations"] == []
