"""Decks of Abaqus and CalculiX: what is read of them, and what is refused with its line or number."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fem_service.inp_deck import InpDeck, read_inp

DECK = """** Two blocks of nodes, as pre-processors write them
*Heading
 a deck, *with a star
*Part, name=PLATE
*Node, nset=LOWER
      1,   0.,  0.
      2,   1.,  0., 0.
      7,   1.,  1.D0, 0.
*NODE
 8, 0, 1,
 20, 2., 0., 0.
 21, 2., 1., 0.
*Element, type=T3D2
 1, 1, 2
*Element, type=CPE4R,
  elset=Left
 10, 1, 2, 7,
 8
*ELEMENT, TYPE=s4, ELSET="Right"
 30, 2, 20, 21, 7
*Elset, elset=Both
 Left, 30
*Elset, elset=Counted, generate
 10, 30, 20
*Elset, elset=both
 99
*Material, name=STEEL
*Elastic
 210000., 0.3
*Step
*Node print, nset=LOWER
 U
*Node file
 U
*End Step
"""


def read(text: str, folder: Path) -> InpDeck:
    path = folder / "plate.inp"
    path.write_text(text)
    return read_inp(path)


def test_blocks_sets_and_numbers_are_those_of_the_deck(tmp_path: Path) -> None:
    deck = read(DECK, tmp_path)
    assert deck.nodes.tolist() == [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [2, 0, 0], [2, 1, 0]]
    assert [(block.kind, block.labels.tolist(), block.nodes.tolist()) for block in deck.blocks] == [
        ("CPE4R", [10], [[0, 1, 2, 3]]),
        ("S4", [30], [[1, 4, 5, 2]]),
    ]
    assert {name: labels.tolist() for name, labels in deck.sets.items()} == {
        "LEFT": [10], "RIGHT": [30], "BOTH": [10, 30, 99], "COUNTED": [10, 30],
    }  # fmt: skip


def test_two_blocks_of_one_set_are_one_set(tmp_path: Path) -> None:
    deck = read(DECK.replace('"Right"', "Left"), tmp_path)
    assert deck.sets["LEFT"].tolist() == [10, 30]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("type=CPE4R", "type=CPS3", r"TYPE=CPS3 \(element 10\): only quadrilaterals of four nodes"),
        ("type=CPE4R", "type=S8R", "TYPE=S8R .* are read"),
        ("TYPE=s4", "TYPE=C3D20R", r"TYPE=C3D20R \(element 30\)"),
        ("2, 20, 21, 7", "2, 20, 21, 77", "element 30 has node 77, which is not given"),
        ("2, 20, 21, 7", "2, 20, 21, 7, 8", "line 20: element 30 of type S4 has more than 4 nodes"),
        ("2, 20, 21, 7", "2, 20, 21", "element 30 of type S4 has 3 nodes, not 4"),
        (" 30, 2, 20", " 10, 2, 20", "element 10 is given twice"),
        (" 8, 0, 1,", " 2, 0, 1,", "line 10: node 2 is given twice at different places"),
        (" 8, 0, 1,", " 8, 0, one,", "line 10: node 8 has coordinates 0, one"),
        ("10, 1, 2, 7,", "10, 1, 2.5, 7,", "line 17: '2.5' is no whole number"),
        (" Left, 30", " Middle, 30", "line 22: there is no element set Middle"),
        ("*Material", "*Include, input=more.inp\n*Material", r"\*INCLUDE is not followed"),
        ("*Material", "*Ngen\n1, 2, 1\n*Material", r"\*NGEN is not followed"),
        ("*Material", "*Instance, name=A\n5., 0., 0.\n*Material", r"line 28: \*INSTANCE moves a part"),
        ("nset=LOWER\n  ", "SYSTEM=C\n  ", r"\*NODE, SYSTEM=C: only Cartesian"),
    ],
)
def test_what_is_not_understood_is_refused_and_named(tmp_path: Path, old: str, new: str, message: str) -> None:
    assert old in DECK
    with pytest.raises(ValueError, match=message) as caught:
        read(DECK.replace(old, new, 1), tmp_path)
    assert str(caught.value).startswith(str(tmp_path / "plate.inp"))


def test_nodes_of_the_assembly_alone_are_reference_points(tmp_path: Path) -> None:
    """Abaqus/CAE numbers them from 1 again; nodes within an instance are those of the mesh."""
    part = "*Part, name=A\n*Node\n1, 0., 0.\n*End Part\n"
    instance = "*Assembly, name=B\n*Instance, name=A-1, part=A\n*Node\n2, 5., 0.\n*End Instance\n"
    deck = read(f"{part}{instance}*Node\n1, 9., 9.\n*End Assembly\n*Node\n3, 7., 0.\n", tmp_path)
    assert deck.nodes.tolist() == [[0, 0, 0], [5, 0, 0], [7, 0, 0]]


def test_a_mark_of_byte_order_is_no_part_of_the_first_keyword(tmp_path: Path) -> None:
    path = tmp_path / "plate.inp"
    path.write_bytes(b"\xef\xbb\xbf*NODE\r\n1, 2., 3.\r\n")
    assert read_inp(path).nodes.tolist() == [[2.0, 3.0, 0.0]]


def test_a_file_that_is_not_there_is_told(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"none\.inp: cannot be read: No such file"):
        read_inp(tmp_path / "none.inp")


def test_a_deck_of_nothing_holds_nothing(tmp_path: Path) -> None:
    deck = read("*HEADING\nempty\n", tmp_path)
    assert deck.nodes.shape == (0, 3) and not deck.blocks and not deck.sets
    np.testing.assert_array_equal(deck.nodes, np.zeros((0, 3)))
