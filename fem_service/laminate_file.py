"""A laminate of bricks from a deck of Abaqus or CalculiX: element sets are its plies."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
import scipy.sparse
import scipy.sparse.csgraph
from numpy.typing import NDArray

from fem_service.hexahedron import Hexahedra, InvertedElement
from fem_service.inp_deck import InpDeck, read_inp
from fem_service.laminate_mesh import LaminateMesh

#: The same brick, counted so that each of its faces in turn is the lower one.
_TURNED: Final = np.array(
    [
        [0, 1, 2, 3, 4, 5, 6, 7],
        [4, 7, 6, 5, 0, 3, 2, 1],
        [0, 4, 5, 1, 3, 7, 6, 2],
        [3, 2, 6, 7, 0, 1, 5, 4],
        [0, 3, 7, 4, 1, 2, 6, 5],
        [1, 5, 6, 2, 0, 4, 7, 3],
    ]
)


def read_laminate(path: Path, plies: Sequence[tuple[str, float]], unit: float) -> LaminateMesh:
    """Read a laminate whose plies lie on each other along z and share the nodes between them.

    Parameters
    ----------
    path : Path
    plies : sequence of (str, float)
        Element set and angle, rad, of each ply, from the lowest up.
    unit : float
        Metres of the file's unit of length.

    Returns
    -------
    LaminateMesh
        Without cohesive layers. Nodes of no brick are dropped, the lowest is at z = 0; bricks are in the order of the
        deck, each counted from its lower face.

    Raises
    ------
    ValueError
        If the deck cannot be read (see `fem_service.inp_deck.read_inp`), a set is missing, a brick is in none or in two
        of the sets, a ply does not lie above the one before, a brick is inverted, or the mesh is of several pieces;
        elements are named by their number in the deck.
    """
    deck = read_inp(path)
    try:
        return _laminate(deck, plies, unit)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def _laminate(deck: InpDeck, plies: Sequence[tuple[str, float]], unit: float) -> LaminateMesh:
    bricks = [block for block in deck.blocks if block.nodes.shape[1] == 8]
    if not bricks:
        raise ValueError("holds no bricks of eight nodes")
    labels = np.concatenate([block.labels for block in bricks])
    used, place = np.unique(np.concatenate([block.nodes for block in bricks]), return_inverse=True)
    nodes = unit * deck.nodes[used]
    nodes[:, 2] -= nodes[:, 2].min()
    elements = place.reshape(-1, 8).astype(np.int64)
    turned = elements[:, _TURNED]  # brick, way, node
    heights = nodes[turned[:, :, 4:], 2].mean(axis=2) - nodes[turned[:, :, :4], 2].mean(axis=2)
    elements = np.ascontiguousarray(turned[np.arange(len(turned)), heights.argmax(axis=1)])
    try:
        Hexahedra(nodes, elements)
    except InvertedElement as error:
        raise ValueError(
            f"element {labels[error.element]} is inverted or flat: its nodes must go counterclockwise round one face, "
            "as they are seen from the opposite one, and then round that"
        ) from None
    _check_one_piece(len(nodes), elements, labels)
    ply = _plies(deck, labels, [name for name, _ in plies])
    _check_order(nodes[elements][:, :, 2].mean(axis=1), ply, [name for name, _ in plies])
    return LaminateMesh(
        nodes=np.ascontiguousarray(nodes),
        bricks=elements,
        ply=ply,
        layers=np.zeros((0, 8), dtype=np.int64),
        interface=np.zeros(0, dtype=np.int64),
        angles=np.array([angle for _, angle in plies], dtype=np.float64),
    )


def _check_one_piece(count: int, bricks: NDArray[np.int64], labels: NDArray[np.int64]) -> None:
    first, others = np.repeat(bricks[:, :1], 7, axis=1).reshape(-1), bricks[:, 1:].reshape(-1)
    links = scipy.sparse.coo_matrix((np.ones(len(first)), (first, others)), shape=(count, count))
    _, piece = scipy.sparse.csgraph.connected_components(links, directed=False)
    if piece.max():
        other = int(np.argmax(piece[bricks[:, 0]] != piece[bricks[0, 0]]))
        raise ValueError(
            f"the mesh is of {piece.max() + 1} pieces: element {labels[other]} does not hang together with element "
            f"{labels[0]}; nodes at one place must be one node"
        )


def _plies(deck: InpDeck, labels: NDArray[np.int64], names: Sequence[str]) -> NDArray[np.int64]:
    ply = np.full(len(labels), -1, dtype=np.int64)
    for number, name in enumerate(names):
        if name.upper() not in deck.sets:
            raise ValueError(f"there is no element set {name}; there are {', '.join(sorted(deck.sets)) or 'none'}")
        inside = np.isin(labels, deck.sets[name.upper()])
        if not inside.any():
            raise ValueError(f"the element set {name} holds no brick")
        twice = inside & (ply >= 0)
        if twice.any():
            row = int(np.argmax(twice))
            raise ValueError(f"element {labels[row]} is in the sets {names[ply[row]]} and {name}; it is in one ply")
        ply[inside] = number
    if (ply < 0).any():
        raise ValueError(f"element {labels[int(np.argmax(ply < 0))]} is in none of the sets {', '.join(names)}")
    return ply


def _check_order(middle: NDArray[np.float64], ply: NDArray[np.int64], names: Sequence[str]) -> None:
    heights = np.bincount(ply, middle) / np.bincount(ply)
    wrong = np.flatnonzero(np.diff(heights) <= 0.0)
    if len(wrong):
        lower, upper = names[wrong[0]], names[wrong[0] + 1]
        raise ValueError(f"ply {upper} does not lie above {lower}; plies are named from the lowest z up")
