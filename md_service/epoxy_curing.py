"""Cross-linking of epoxide groups by amines, by distance.

A reaction opens an epoxide ring at its CH2, bonds this to the nitrogen, and moves one of the nitrogen's hydrogens to
the ring's oxygen. Primary and secondary amines react alike. Reactions come in stages: the closest pairs react, their
bonds are pulled shut with growing stiffness, everything moves on for a while, and all types are found anew.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from md_service.atoms import Atoms
from md_service.epoxy_relaxation import CONTACT_STYLES, HOT, STEP, ResinRun
from md_service.epoxy_rings import aromatic_rings, crossings, nearest_image, periodic_tree, speared_rings
from md_service.epoxy_typing import BondGraph, bonds_of, graph_of, retyped
from md_service.errors import EngineError

STAGES: Final = 8  # in which the conversion is reached, if partners are near
FIRST_REACH: Final = 5e-10  # m, between N and C that may react
REACH_STEP: Final = 0.5e-10  # m, by which the reach grows where no partners are left
LAST_REACH: Final = 10e-10  # m
_NEW_BOND = "CT-NT"
_STIFFENING = (0.01, 0.03, 0.1, 0.3, 1.0)
_PULL_STEPS = 50  # at each stiffness
_LONGEST = 0.35e-10  # m, of a new bond beyond its length when it is shut
_BOND_LENGTH = 1.448e-10  # m
_OH_LENGTH = 0.945e-10  # m
_MOVING_TIME = 0.6e-12  # s, between stages


@dataclass(frozen=True)
class Reaction:
    """Rows of the atoms that take part: nitrogen, one of its hydrogens, epoxide CH2, epoxide oxygen."""

    nitrogen: int
    hydrogen: int
    carbon: int
    oxygen: int


def epoxide_groups(graph: BondGraph) -> list[tuple[int, int]]:
    """CH2 and oxygen of each epoxide ring; of two CH2, the first."""
    groups = []
    for oxygen in range(len(graph.elements)):
        if graph.is_epoxide_oxygen(oxygen):
            carbon = max(graph.neighbours[oxygen], key=graph.hydrogens)
            groups.append((carbon, oxygen))
    return groups


def cross_links(graph: BondGraph) -> int:
    """Number of bonds between an amine and a carbon with four neighbours."""
    return sum(
        len(graph.neighbours[other]) == 4
        for atom, element in enumerate(graph.elements)
        if element == "N"
        for other in graph.of_element(atom, "C")
    )


def conversion_of(atoms: Atoms) -> float:
    """Share of the epoxide groups that have reacted with an amine."""
    graph = graph_of(atoms)
    reacted = cross_links(graph)
    return reacted / (reacted + len(epoxide_groups(graph)))


def cure(
    atoms: Atoms, conversion: float, seed: int, work_dir: Path, progress: Callable[[str], None] | None = None
) -> Atoms:
    """React epoxide groups with amines until a share of the groups has reacted.

    Parameters
    ----------
    atoms : Atoms
        A melt of monomers, or a resin that is to be cured further.
    conversion : float
        Share of all epoxide groups, met to the nearest group.
    seed : int
    work_dir : Path
    progress : callable, optional
        Given a line of text after each stage.

    Raises
    ------
    ValueError
        If the conversion is not between 0 and 1, or there are too few groups or amine hydrogens for it.
    EngineError
        If no partners are left within `LAST_REACH`.
    """
    graph = graph_of(atoms)
    done = cross_links(graph)
    groups = done + len(epoxide_groups(graph))
    hydrogens = sum(graph.hydrogens(atom) for atom, element in enumerate(graph.elements) if element == "N")
    if not 0.0 <= conversion <= 1.0:
        raise ValueError(f"conversion is {conversion}; it must lie between 0 and 1")
    target = round(conversion * groups)
    if target - done > hydrogens:
        raise ValueError(f"a conversion of {conversion} needs {target - done} amine hydrogens, there are {hydrogens}")
    per_stage = max(1, -(-(target - done) // STAGES))
    reach, stage = FIRST_REACH, 0
    refused: set[tuple[int, int]] = set()
    while done < target:
        stage += 1
        reactions = _partners(atoms, reach, min(per_stage, target - done), refused)
        cured = _pulled_shut(react(atoms, reactions), reactions, seed + stage, work_dir) if reactions else None
        if cured is None:
            # Either nothing is near enough, or bonds of this stage went wrong: then these pairs are not tried again.
            refused.update((reaction.nitrogen, reaction.carbon) for reaction in reactions)
            if not reactions:
                if reach > LAST_REACH:
                    raise EngineError(
                        f"no amine is within {reach * 1e10:.1f} A of an epoxide at {done} of {target} bonds"
                    )
                reach += REACH_STEP
            atoms = _moved_on(atoms, seed + stage, work_dir)
            continue
        atoms, done = cured, done + len(reactions)
        if progress is not None:
            progress(f"cured {done} of {target} groups, {reach * 1e10:.1f} A")
    return atoms


def react(atoms: Atoms, reactions: list[Reaction]) -> Atoms:
    """Change the bonds of reacting atoms and put the moved hydrogens at their oxygens; other atoms stay in place."""
    bonds = {(min(a, b), max(a, b)) for a, b in bonds_of(atoms).tolist()}
    position = atoms.position.copy()
    for reaction in reactions:
        n, h, c, o = reaction.nitrogen, reaction.hydrogen, reaction.carbon, reaction.oxygen
        bonds -= {(min(n, h), max(n, h)), (min(c, o), max(c, o))}
        bonds |= {(min(n, c), max(n, c)), (min(o, h), max(o, h))}
        away = position[o] - position[c]
        position[h] = position[o] + _OH_LENGTH * away / np.linalg.norm(away)
    return retyped(atoms, np.array(sorted(bonds), dtype=np.int64), position)


def _partners(atoms: Atoms, reach: float, most: int, refused: set[tuple[int, int]]) -> list[Reaction]:
    """The closest pairs that may react, each atom at most once, none through a ring."""
    graph = graph_of(atoms)
    groups = epoxide_groups(graph)
    nitrogen = np.array([i for i, element in enumerate(graph.elements) if element == "N" and graph.hydrogens(i)])
    if not len(nitrogen) or not groups:
        return []
    carbon = np.array([group[0] for group in groups])
    pairs = _within(atoms, nitrogen, carbon, reach)
    free = [pair for pair in pairs.tolist() if (pair[0], pair[1]) not in refused]
    segments = np.array(free, dtype=np.int64).reshape(-1, 2)
    through = {segment for segment, _ in crossings(atoms.position, atoms.box, segments, aromatic_rings(graph))}
    oxygen_of = dict(groups)
    used: set[int] = set()
    chosen: list[Reaction] = []
    for n, c in free:
        if len(chosen) == most:
            break
        if (n, c) in through or n in used or c in used:
            continue
        used |= {n, c}
        chosen.append(Reaction(n, graph.of_element(n, "H")[0], c, oxygen_of[c]))
    return chosen


def _within(atoms: Atoms, first: NDArray[np.int64], second: NDArray[np.int64], reach: float) -> NDArray[np.int64]:
    """Pairs (m, 2) of rows closer than a distance, the closest first."""
    box = atoms.box
    trees = [periodic_tree(atoms.position[rows], box) for rows in (first, second)]
    found = [(a, b) for a, row in enumerate(trees[0].query_ball_tree(trees[1], reach)) for b in row]
    pairs = np.array([(first[a], second[b]) for a, b in found], dtype=np.int64).reshape(-1, 2)
    apart = nearest_image(atoms.position[pairs[:, 0]] - atoms.position[pairs[:, 1]], box)
    return pairs[np.argsort(np.linalg.norm(apart, axis=1), kind="stable")]


def _pulled_shut(atoms: Atoms, reactions: list[Reaction], seed: int, work_dir: Path) -> Atoms | None:
    """Relax long new bonds; None if one stays open or passes through a ring."""
    run = ResinRun(work_dir, atoms, HOT, seed, CONTACT_STYLES)
    try:
        for factor in _STIFFENING:
            run.soften(_NEW_BOND, factor)
            run.damp(_PULL_STEPS, HOT)
        shut = run.atoms()
        ends = np.array([(reaction.nitrogen, reaction.carbon) for reaction in reactions])
        length = np.linalg.norm(nearest_image(shut.position[ends[:, 0]] - shut.position[ends[:, 1]], shut.box), axis=1)
        if length.max() > _BOND_LENGTH + _LONGEST or speared_rings(shut):
            return None
        run.hold(round(_MOVING_TIME / STEP), HOT, HOT)
        return run.atoms()
    finally:
        run.close()


def _moved_on(atoms: Atoms, seed: int, work_dir: Path) -> Atoms:
    """The atoms after some time at constant volume."""
    run = ResinRun(work_dir, atoms, HOT, seed, CONTACT_STYLES)
    try:
        run.hold(round(_MOVING_TIME / STEP), HOT, HOT)
        return run.atoms()
    finally:
        run.close()
