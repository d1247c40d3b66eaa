"""Layup notation against plies written out."""

from __future__ import annotations

import pytest

from coordinator.layup import read_layup


@pytest.mark.parametrize(
    ("text", "angles"),
    [
        ("[0]", (0,)),
        ("[0/90]", (0, 90)),
        ("[0/90]s", (0, 90, 90, 0)),
        ("[45/0/-45/90]2s", (45, 0, -45, 90, 45, 0, -45, 90, 90, -45, 0, 45, 90, -45, 0, 45)),
        ("[0_2/90]s", (0, 0, 90, 90, 0, 0)),
        ("[±45/0]s", (45, -45, 0, 0, -45, 45)),
        ("[+-30_2]", (30, -30, 30, -30)),
        ("[0/[45/-45]2/90]S", (0, 45, -45, 45, -45, 90, 90, -45, 45, -45, 45, 0)),
        (" [ 0 / 22.5 ] ", (0, 22.5)),
        ("[-0/90]s", (0, 90, 90, 0)),
    ],
)
def test_plies(text: str, angles: tuple[float, ...]) -> None:
    assert read_layup(text).angles == angles


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("", r"character 1 is the end where \[ must be"),
        ("0/90", r"character 1 is '0' where \[ must be"),
        ("[0/90", "character 6 is the end where / or ] must be"),
        ("[0//90]", r"character 4 is '/' where an angle in degrees or \[ must be"),
        ("[0/x]", "character 4 is 'x' where an angle"),
        ("[0/90]sT", "character 8 is 'T' where the end"),
        ("[0/135]", "holds the angle 135, allowed is -90 to 90"),
        ("[0/90]0s", "repeats 0 times"),
        ("[0_99999]", "repeats 99999 times"),
        ("[[0/90]999/0]999s", "repeats 999 times"),
        ("[0_10000]s", "has more plies than 10000"),
        ("[" * 40 + "0" + "]s" * 40, "has more plies than 10000"),
    ],
)
def test_mistakes_are_named(text: str, problem: str) -> None:
    with pytest.raises(ValueError, match=problem):
        read_layup(text)


def test_half_of_a_symmetric_layup() -> None:
    assert read_layup("[0/90]s").half() == (0, 90)
    with pytest.raises(ValueError, match="only a symmetric one"):
        read_layup("[0/90]").half()
    with pytest.raises(ValueError, match="middle ply lies across"):
        read_layup("[0/90/0]").half()
