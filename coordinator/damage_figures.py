"""Pictures of the bonds of a network around a crack's tip: which hold, and which are broken."""

from __future__ import annotations

from typing import Final

import numpy as np
from matplotlib.collections import LineCollection
from scipy.spatial import cKDTree

from coordinator.display_units import ANGSTROM
from coordinator.figures import BLUE, INK, PALE, RED, Picture, map_axes, picture
from coordinator.results import Results
from coordinator.scene import Scene
from protocol.arrays import FloatArray, IntArray

#: Covalent radii by atomic number, m (Cordero et al., Dalton Trans. 2008, 2832; sp3 carbon).
COVALENT_RADIUS: Final = {
    1: 0.31e-10, 5: 0.84e-10, 6: 0.76e-10, 7: 0.71e-10, 8: 0.66e-10, 9: 0.57e-10, 14: 1.11e-10, 15: 1.07e-10,
    16: 1.05e-10, 17: 1.02e-10,
}  # fmt: skip
#: Atoms nearer than this many sums of their radii in the sample are bonded.
REACH: Final = 1.2
#: A bond is broken at this many times its length in the sample, as the atomistic service counts them.
BROKEN: Final = 1.4


def network_bonds(place: FloatArray, number: IntArray) -> tuple[IntArray, FloatArray]:
    """Return rows of bonded atoms, shape (bonds, 2), and lengths, m, by covalent radii; none for unknown elements.

    Parameters
    ----------
    place : float64 array, shape (atoms, 3)
        m.
    number : int64 array, shape (atoms,)
        Atomic numbers.
    """
    radius = np.array([COVALENT_RADIUS.get(int(z), 0.0) for z in number])
    pairs = cKDTree(place).query_pairs(2.0 * REACH * float(radius.max()), output_type="ndarray").astype(np.int64)
    length = np.linalg.norm(place[pairs[:, 0]] - place[pairs[:, 1]], axis=1)
    bonded = (length < REACH * radius[pairs].sum(axis=1)) & (radius[pairs] > 0.0).all(axis=1)
    return pairs[bonded], length[bonded]


def damage_pictures(results: Results, scene: Scene, most: int = 4) -> list[Picture]:
    """Draw the network around the crack's tip at several times; those that broke are orange, from atom to atom.

    Bonds through faces where the sample repeats are left out.
    """
    atoms = results.atoms
    if scene.crack is None or atoms is None or not len(atoms):
        return []
    pairs, length = network_bonds(atoms.reference, atoms.species)
    if not len(pairs):
        return []
    heavy = atoms.species > 1
    half = 0.5 * np.ptp(atoms.reference[:, :2], axis=0).max() / ANGSTROM
    x, y = ((float(middle / ANGSTROM - half), float(middle / ANGSTROM + half))
            for middle in (scene.crack.tip_x, scene.crack.y))  # fmt: skip
    found = []
    for frame in sorted({round(k) for k in np.linspace(0, len(atoms) - 1, most)}):
        place = atoms.position(frame)
        broken = np.linalg.norm(place[pairs[:, 0]] - place[pairs[:, 1]], axis=1) > BROKEN * length
        flat = place[:, :2] / ANGSTROM
        lines = np.stack([flat[pairs[:, 0]], flat[pairs[:, 1]]], axis=1)
        figure, axes, _, scale = map_axes(x, y, bar=False)
        axes.add_collection(LineCollection(list(lines[~broken]), colors=PALE, linewidths=0.3 * scale, zorder=1))
        for part, colour, size in ((~heavy, BLUE, 0.25), (heavy, INK, 0.45)):
            axes.scatter(flat[part, 0], flat[part, 1], s=(size * scale) ** 2, color=colour, linewidths=0, zorder=2)
        axes.add_collection(LineCollection(list(lines[broken]), colors=RED, linewidths=0.35 * scale, zorder=3))
        time = atoms.time[frame] / 1e-12
        caption = (
            f"Step {atoms.step[frame]}. Orange: {np.count_nonzero(broken)} of {len(pairs)} bonds of the sample are"
            f" longer than {BROKEN} times what they were. All of the depth is seen at once; hydrogen is drawn small."
        )
        found.append(picture(figure, f"Bonds around the crack tip, {time:.3g} ps", caption, raster=True))
    return found
