"""Strain of atoms and continuum after a patch run, over windows two cells of the grid wide.

Finer than two cells the grid has no strain, so that is where atoms and continuum are compared. The strain of atoms
is fitted to their displacements since the same run without load (edges of a sample relax, a hot sheet shrinks); that
of the continuum follows from its stress, since displacements of material points keep ripples of waves that passed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from coordinator.checkpoint import read_checkpoint
from coordinator.local_strain import local_strain, mean_gradient
from coordinator.results import Results
from protocol.arrays import FloatArray

#: Bins whose threes make a window, in cells of the grid.
BIN = 2.0 / 3.0


@dataclass(frozen=True)
class PatchState:
    """Where a run ended.

    Attributes
    ----------
    reference : float64 array, shape (atoms, 2)
        Places as built, m.
    displacement : float64 array, shape (blocks, atoms, 2)
        Means over successive blocks of time, m.
    point, strain : float64 array, shape (points, 2) and (points, 3)
        Material points as built, m, and their strain xx, yy, xy.
    inner, outer : float64 array, shape (2, 2)
        Lower and upper corner of the borders of the ring, m.
    body : float64 array, shape (2, 2)
        Lower and upper corner of the continuum, m.
    cell : float
        Of the grid, m.
    """

    reference: FloatArray
    displacement: FloatArray
    point: FloatArray
    strain: FloatArray
    inner: FloatArray
    outer: FloatArray
    body: FloatArray
    cell: float


@dataclass(frozen=True)
class StrainErrors:
    """Differences from the applied strain over that strain; columns xx, yy, xy.

    Attributes
    ----------
    mean, mean_error, mean_scatter : float64 array, shape (3,)
        Of the one gradient fitted to all atoms inside the handshake; its standard error; that of the strain of the
        loaded run alone. Both runs share their random numbers, so much of their noise is the same, block by block.
    place, atoms, atoms_error : float64 array, shape (n, 2), (n, 3) and (n, 3)
        Windows of atoms, m, the strain fitted in each, and its standard error.
    inside : bool array, shape (n,)
        Whose middle lies inside the handshake.
    point, continuum : float64 array, shape (m, 2) and (m, 3)
        Windows of material points outside the ring, m, and their mean strain. Points less than a cell from the edges
        of the body are left out: under shear the body parts from the lines of the grid there, with or without atoms.
    beyond : bool array, shape (m,)
        Which of them take only points more than a cell from the ring. The others belong to the handshake: their
        nodes carry forces of atoms.
    """

    mean: FloatArray
    mean_error: FloatArray
    mean_scatter: FloatArray
    place: FloatArray
    atoms: FloatArray
    atoms_error: FloatArray
    inside: np.ndarray
    point: FloatArray
    continuum: FloatArray
    beyond: np.ndarray

    @property
    def worst_inside(self) -> float:
        """Largest error of any window of atoms inside the handshake."""
        return float(np.max(np.abs(self.atoms[self.inside])))

    @property
    def worst_outside(self) -> float:
        """Largest error of any window of the continuum beyond the handshake."""
        return float(np.max(np.abs(self.continuum[self.beyond])))

    @property
    def worst_handshake(self) -> float:
        """Largest error of any window in the handshake, of atoms and continuum."""
        near = np.concatenate([self.atoms[~self.inside], self.continuum[~self.beyond]])
        return float(np.max(np.abs(near)))


def read_state(results: Results, folder: Path, blocks: int = 1, settled: float = 0.0) -> PatchState:
    """Read how a run ended.

    Parameters
    ----------
    results : Results
    folder : Path
        Of the run, with its checkpoint.
    blocks : int
        Blocks of time over which displacements are averaged; 1 takes the last displacements alone.
    settled : float
        Share of the run that is left out before the first block.

    Raises
    ------
    RuntimeError
        Where the run wrote no atoms or no points.
    """
    if results.atoms is None or results.points is None:
        raise RuntimeError("the run wrote no atoms or no points")
    reference = results.atoms.reference[:, :2]
    if blocks == 1:
        moved = (results.atoms.position(len(results.atoms) - 1) - results.atoms.reference)[None, :, :2]
    else:
        _, values = results.atoms.field("displacement")
        kept = values[int(settled * len(values)) :, :, :2]
        moved = np.stack([part.mean(axis=0) for part in np.array_split(kept, blocks)])
    continuum = results.scene["resolved"]["continuum"]
    last = len(results.points) - 1
    first = last if blocks == 1 else int(np.ceil(settled * last))
    frames = [results.points.frame(k) for k in range(first, last + 1)]
    return PatchState(
        np.asarray(reference, dtype=np.float64),
        np.asarray(moved, dtype=np.float64),
        np.asarray(frames[-1].position[:, :2] - frames[-1].displacement[:, :2]),
        np.mean([_elastic_strain(frame.stress, folder) for frame in frames], axis=0),
        np.array(results.interface["inner"]),
        np.array(results.interface["outer"]),
        np.array([continuum["lower"], continuum["upper"]], dtype=np.float64),
        float(continuum["cell_size"]),
    )


def as_built(state: PatchState) -> PatchState:
    """Return the state without displacements and strain."""
    return replace(state, displacement=np.zeros_like(state.displacement), strain=np.zeros_like(state.strain))


def _elastic_strain(stress: FloatArray, folder: Path) -> FloatArray:
    """Strains xx, yy, xy in plane stress, by the constants that the run measured."""
    header, _ = read_checkpoint(folder)
    young, poisson = header["properties"]["young"], header["properties"]["poisson"]
    xx, yy, xy = stress[:, 0], stress[:, 1], stress[:, 2]
    return np.column_stack([xx - poisson * yy, yy - poisson * xx, (1.0 + poisson) * xy]) / young


def strain_errors(loaded: PatchState, unloaded: PatchState, gradient: FloatArray) -> StrainErrors:
    """Compare the strain between two runs with that applied.

    Parameters
    ----------
    loaded, unloaded : PatchState
        Of the same scene with as many blocks.
    gradient : float64 array, shape (2, 2)
        du_i / dX_j of the edges.
    """
    applied = symmetric(gradient[None])[0]
    scale = float(np.max(np.abs(applied)))
    size = BIN * loaded.cell
    place = loaded.reference
    low, high = loaded.inner
    within = np.all((place > low) & (place < high), axis=1)

    def fits(state: PatchState) -> tuple[FloatArray, FloatArray]:
        mean = symmetric(np.array([mean_gradient(place[within], u[within]) for u in state.displacement]))
        return mean, np.stack([symmetric(local_strain(place, u, size).gradient) for u in state.displacement])

    (mean, windows), (mean_0, windows_0) = fits(loaded), fits(unloaded)
    centre = local_strain(place, loaded.displacement[0], size).centre
    outer_low, outer_high = loaded.outer
    rim = loaded.body + loaded.cell * np.array([[1.0], [-1.0]])
    outside = np.any((loaded.point < outer_low) | (loaded.point > outer_high), axis=1)
    outside &= np.all((loaded.point > rim[0]) & (loaded.point < rim[1]), axis=1)
    clear = np.any((loaded.point < outer_low - loaded.cell) | (loaded.point > outer_high + loaded.cell), axis=1)
    strained = (loaded.strain - unloaded.strain - applied) / scale
    parts = [window_means(loaded.point[rows], strained[rows], size) for rows in (outside & clear, outside & ~clear)]
    return StrainErrors(
        ((mean - mean_0).mean(axis=0) - applied) / scale,
        standard_error(mean - mean_0) / scale,
        standard_error(mean) / scale,
        centre,
        ((windows - windows_0).mean(axis=0) - applied) / scale,
        standard_error(windows - windows_0) / scale,
        np.all((centre > low) & (centre < high), axis=1),
        np.concatenate([middle for middle, _ in parts]),
        np.concatenate([value for _, value in parts]),
        np.repeat([True, False], [len(middle) for middle, _ in parts]),
    )


def symmetric(gradient: FloatArray) -> FloatArray:
    """Strains xx, yy, xy of gradients, shape (n, 2, 2)."""
    shear = 0.5 * (gradient[:, 0, 1] + gradient[:, 1, 0])
    return np.column_stack([gradient[:, 0, 0], gradient[:, 1, 1], shear])


def standard_error(blocks: FloatArray) -> FloatArray:
    """Standard error of the mean over blocks, shape (blocks, ...); zero for one block."""
    count = len(blocks)
    if count == 1:
        return np.zeros(blocks.shape[1:])
    return np.asarray(blocks.std(axis=0, ddof=1) / np.sqrt(count))


def window_means(place: FloatArray, value: FloatArray, size: float) -> tuple[FloatArray, FloatArray]:
    """Average values over the bins of a square grid, each with the eight around it.

    Parameters
    ----------
    place : float64 array, shape (n, 2)
        m.
    value : float64 array, shape (n, k)
    size : float
        Edge of a bin, m.

    Returns
    -------
    centre : float64 array, shape (bins, 2)
        Of the bins that hold a place, m.
    mean : float64 array, shape (bins, k)
    """
    origin = place.min(axis=0) - 1e-3 * size
    cell = np.floor((place - origin) / size).astype(np.int64) + 1
    shape = tuple(cell.max(axis=0) + 2)
    table = np.zeros((*shape, value.shape[1] + 1))
    np.add.at(table, (cell[:, 0], cell[:, 1]), np.column_stack([np.ones(len(place)), value]))
    bins = np.argwhere(table[..., 0] > 0)
    total = sum(table[bins[:, 0] + i, bins[:, 1] + j] for i in (-1, 0, 1) for j in (-1, 0, 1))
    return origin + (bins - 0.5) * size, np.asarray(total)[:, 1:] / np.asarray(total)[:, :1]
