"""Nodes, elements and element sets of a deck of Abaqus or CalculiX (`.inp`).

The deck's own numbers of elements are kept, so that an error can name them. meshio reads such decks too, but drops
the numbers, refuses plane strain elements, forgets all nodes but those of the last ``*NODE`` and confuses the sets of
several ``*ELEMENT`` blocks (5.3.5), so this is done here.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

#: Corners of the elements that are read, by the pattern of their type; the first that fits counts.
_CORNERS: Final = (
    (re.compile(r"(S|CPS|CPE|CPEG|M3D|SFM3D|R3D)4(?!\d)"), 4),
    (re.compile(r"(C3D|SC)8(?!\d)"), 8),
)
#: Elements without area: they bear no part of a laminate and are passed over.
_LINES: Final = re.compile(r"(T2D|T3D|B2|B3|R2D2|RB|SPRING|MASS|DASHPOT|CONN)")
#: Keywords that make or move nodes and elements in ways that are not followed here.
_REFUSED: Final = ("NGEN", "NFILL", "NCOPY", "NMAP", "ELGEN", "ELCOPY", "SYSTEM", "INCLUDE")


@dataclass(frozen=True, eq=False)
class ElementBlock:
    """Elements of one type.

    Attributes
    ----------
    kind : str
        Type as in the deck, such as ``C3D8``.
    labels : ndarray of int64, shape (elements,)
        Their numbers in the deck.
    nodes : ndarray of int64, shape (elements, corners)
        Rows of `InpDeck.nodes`, in the order of the deck.
    """

    kind: str
    labels: NDArray[np.int64]
    nodes: NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class InpDeck:
    """What a deck says of its mesh.

    Attributes
    ----------
    nodes : ndarray of float, shape (nodes, 3)
        In the deck's unit.
    blocks : list of ElementBlock
        With four or eight corners.
    sets : dict of str to ndarray of int64
        Numbers of the elements of each set; names in capitals.
    """

    nodes: NDArray[np.float64]
    blocks: list[ElementBlock]
    sets: dict[str, NDArray[np.int64]]


def read_inp(path: Path) -> InpDeck:
    """Read a deck.

    Raises
    ------
    ValueError
        If the file cannot be read, a line is not what its keyword asks for, a number is given twice, a node is
        missing, an element is of a type that is not read, or the deck generates, moves or includes parts of its mesh.
    """
    try:
        text = path.read_text(encoding="utf-8-sig", errors="replace")
    except OSError as error:
        raise ValueError(f"{path}: cannot be read: {error.strerror}") from None
    reader = _Reader()
    try:
        for keyword, options, rows in _blocks(text):
            reader.take(keyword, options, rows)
        return reader.deck()
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


#: A data line: its number in the file and its values.
_Row = tuple[int, list[str]]


def _blocks(text: str) -> Iterator[tuple[str, dict[str, str], list[_Row]]]:
    """Keywords in capitals, their options with names in capitals, and their data lines."""
    keyword, options, rows = "", {}, []  # type: str, dict[str, str], list[_Row]
    open_line = ""
    for number, raw in enumerate(text.splitlines(), 1):
        line = raw.strip()
        if not line or line.startswith("**"):
            continue
        if not (line.startswith("*") or open_line):
            rows.append((number, [word.strip() for word in line.rstrip(",").split(",")]))
            continue
        open_line += line
        if line.endswith(","):  # the options go on in the next line
            continue
        yield keyword, options, rows
        first, *others = open_line.split(",")
        keyword, rows, open_line = " ".join(first[1:].upper().split()), [], ""
        options = {name.strip().upper(): value.strip().strip('"') for name, _, value in map(_parted, others)}
    yield keyword, options, rows


def _parted(option: str) -> tuple[str, str, str]:
    return option.partition("=")


class _Reader:
    """Gathers what the keywords bring."""

    def __init__(self) -> None:
        self._nodes: dict[int, list[float]] = {}
        self._elements: list[tuple[str, list[list[int]]]] = []
        self._known: set[int] = set()
        self._sets: dict[str, list[int]] = {}
        self._within: set[str] = set()

    def take(self, keyword: str, options: dict[str, str], rows: list[_Row]) -> None:
        if keyword in _REFUSED:
            raise ValueError(f"*{keyword} is not followed; write the nodes and elements themselves into one file")
        if keyword == "INSTANCE" and rows:
            raise ValueError(f"line {rows[0][0]}: *INSTANCE moves a part; only one part that stays in place is read")
        if keyword in ("ASSEMBLY", "INSTANCE"):
            self._within.add(keyword)
        elif keyword.startswith("END "):
            self._within.discard(keyword.removeprefix("END "))
        if keyword == "NODE" and self._within == {"ASSEMBLY"}:
            return  # reference points, which have numbers of their own
        if keyword == "NODE":
            self._take_nodes(options, rows)
        elif keyword == "ELEMENT":
            self._take_elements(options, rows)
        elif keyword == "ELSET":
            self._take_set(options, rows)

    def _take_nodes(self, options: dict[str, str], rows: list[_Row]) -> None:
        if options.get("SYSTEM", "R").upper() not in ("R", "RECTANGULAR"):
            raise ValueError(f"*NODE, SYSTEM={options['SYSTEM']}: only Cartesian coordinates are read")
        for number, words in rows:
            label = _whole(number, words[0])
            try:
                place = [float(word.replace("D", "E").replace("d", "e") or 0.0) for word in words[1:4]]
            except ValueError:
                raise ValueError(f"line {number}: node {label} has coordinates {', '.join(words[1:4])}") from None
            place += [0.0] * (3 - len(place))
            if self._nodes.setdefault(label, place) != place:
                raise ValueError(f"line {number}: node {label} is given twice at different places; one part is read")

    def _take_elements(self, options: dict[str, str], rows: list[_Row]) -> None:
        kind = options.get("TYPE", "").upper()
        if _LINES.match(kind):
            return
        corners = next((count for pattern, count in _CORNERS if pattern.match(kind)), None)
        if corners is None:
            first = f" (element {rows[0][1][0]})" if rows else ""
            raise ValueError(
                f"*ELEMENT, TYPE={kind}{first}: only quadrilaterals of four nodes (S4, CPS4, CPE4, M3D4) and bricks of "
                "eight (C3D8, SC8R) are read, with or without further letters"
            )
        found: list[list[int]] = []
        for number, words in rows:  # an element may go on in the next line
            numbers = [_whole(number, word) for word in words]
            if found and len(found[-1]) <= corners:
                found[-1] += numbers
            else:
                found.append(numbers)
            if len(found[-1]) > corners + 1:
                raise ValueError(f"line {number}: element {found[-1][0]} of type {kind} has more than {corners} nodes")
        if found and len(found[-1]) <= corners:
            raise ValueError(f"element {found[-1][0]} of type {kind} has {len(found[-1]) - 1} nodes, not {corners}")
        for label, *_ in found:
            if label in self._known:
                raise ValueError(f"element {label} is given twice; one part is read")
            self._known.add(label)
        self._elements.append((kind, found))
        if options.get("ELSET"):
            self._sets.setdefault(options["ELSET"].upper(), []).extend(label for label, *_ in found)

    def _take_set(self, options: dict[str, str], rows: list[_Row]) -> None:
        found = self._sets.setdefault(options.get("ELSET", "").upper(), [])
        for number, words in rows:
            if "GENERATE" in options:
                first, last, step = [*(_whole(number, word) for word in words), 1][:3]
                found.extend(range(first, last + 1, step))
                continue
            for word in words:
                if word.lstrip("-").isdecimal():
                    found.append(int(word))
                elif word.upper() in self._sets:
                    found.extend(self._sets[word.upper()])
                else:
                    raise ValueError(f"line {number}: there is no element set {word} so far")

    def deck(self) -> InpDeck:
        labels = list(self._nodes)
        row = {label: place for place, label in enumerate(labels)}
        blocks = []
        for kind, elements in self._elements:
            for label, *nodes in elements:
                missing = next((node for node in nodes if node not in row), None)
                if missing is not None:
                    raise ValueError(f"element {label} has node {missing}, which is not given")
            table = np.array(elements, dtype=np.int64).reshape(len(elements), -1)
            if len(table):
                rows = [[row[node] for node in nodes] for _, *nodes in elements]
                blocks.append(ElementBlock(kind, table[:, 0].copy(), np.array(rows, dtype=np.int64)))
        return InpDeck(
            nodes=np.array([self._nodes[label] for label in labels]).reshape(-1, 3),
            blocks=blocks,
            sets={name: np.unique(np.array(found, dtype=np.int64)) for name, found in self._sets.items()},
        )


def _whole(line: int, word: str) -> int:
    try:
        return int(word)
    except ValueError:
        raise ValueError(f"line {line}: {word!r} is no whole number") from None
