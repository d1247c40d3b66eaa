"""Atoms as H5MD 1.1 (P. de Buyl, P. H. Colberg, F. Höfling, Comput. Phys. Commun. 185, 1546, 2014).

Lengths are in nm and times in ps inside the file: both are units of the format's own units module and
of MDAnalysis, which knows neither m nor the module's name for an Angstrom. This module takes and gives SI.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import h5py
import numpy as np

from coordinator.atom_measurements import MeasuredFields
from coordinator.elements import ELEMENTS
from protocol.arrays import FloatArray, IntArray

NANOMETRE = 1e-9
PICOSECOND = 1e-12
GROUP = "particles/atoms"
_FRAMES_PER_TIME_CHUNK = 256
#: Fields of each atom: unit in the file and its SI size.
FIELDS = {
    "displacement": ("nm", NANOMETRE),
    "velocity": ("nm ps-1", NANOMETRE / PICOSECOND),
    "stress": ("Pa", 1.0),
    "energy": ("J", 1.0),
}
#: Fields on a grid, likewise.
GRID_FIELDS = {
    **{name: FIELDS[name] for name in ("displacement", "velocity", "stress")},
    "density": ("kg m-3", 1.0),
    "temperature": ("K", 1.0),
}
GRID = "observables/grid"


@dataclass(frozen=True)
class AtomsFrame:
    """Atoms at one step.

    Attributes
    ----------
    step : int
    time : float
        s.
    position : float64 array, shape (atoms, 3)
        m.
    """

    step: int
    time: float
    position: FloatArray


def create(file: h5py.File, author: str, creator: str, version: str) -> None:
    """Write the root of the format: version, author, creator, units module."""
    root = file.create_group("h5md")
    root.attrs["version"] = np.array([1, 1], dtype=np.int32)
    root.create_group("author").attrs["name"] = np.bytes_(author.encode())
    by = root.create_group("creator")
    by.attrs["name"], by.attrs["version"] = np.bytes_(creator.encode()), np.bytes_(version.encode())
    units = root.create_group("modules/units")
    units.attrs["version"] = np.array([1, 0], dtype=np.int32)
    units.attrs["system"] = "SI"


def create_atoms(
    file: h5py.File, atom_id: IntArray, species: IntArray, mass: FloatArray, reference: FloatArray
) -> None:
    """Write what does not change with time, and room for the rest.

    Parameters
    ----------
    file : h5py.File
    atom_id : int64 array, shape (atoms,)
    species : int64 array, shape (atoms,)
        Atomic number, 0 for one that is not known.
    mass : float64 array, shape (atoms,)
        kg.
    reference : float64 array, shape (atoms, 3)
        Positions without load, from which displacements count, m.
    """
    count = len(atom_id)
    group = file.create_group(GROUP)
    box = group.create_group("box")
    box.attrs["dimension"] = 3
    box.attrs.create("boundary", np.array([b"none"] * 3, dtype="S4"))
    group.create_dataset("id", data=np.asarray(atom_id, dtype=np.int32))
    present = {
        ELEMENTS[int(number)][0] if int(number) in ELEMENTS else "X": int(number) for number in np.unique(species)
    }
    group.create_dataset("species", data=np.asarray(species), dtype=h5py.enum_dtype(present, np.int32))
    masses = group.create_dataset("mass", data=np.asarray(mass) / 1.66053906892e-27)
    masses.attrs["unit"] = "u"
    rest = group.create_dataset("reference_position", data=np.asarray(reference) / NANOMETRE)
    rest.attrs["unit"] = "nm"
    position = group.create_group("position")
    position.create_dataset("step", shape=(0,), maxshape=(None,), dtype=np.int64, chunks=(_FRAMES_PER_TIME_CHUNK,))
    time = position.create_dataset(
        "time", shape=(0,), maxshape=(None,), dtype=np.float64, chunks=(_FRAMES_PER_TIME_CHUNK,)
    )
    time.attrs["unit"] = "ps"
    value = position.create_dataset(
        "value", shape=(0, count, 3), maxshape=(None, count, 3), dtype=np.float64, chunks=(1, count, 3)
    )
    value.attrs["unit"] = "nm"
    edges = box.create_group("edges")
    # The box belongs to the positions: same step and time, as hard links (H5MD 1.1, "box").
    edges["step"], edges["time"] = position["step"], position["time"]
    sides = edges.create_dataset("value", shape=(0, 3), maxshape=(None, 3), dtype=np.float64)
    sides.attrs["unit"] = "nm"


def append(file: h5py.File, frames: Sequence[AtomsFrame]) -> None:
    """Append frames. The box is the extent of the atoms: nothing is periodic."""
    if not frames:
        return
    group = file[GROUP]
    position, edges = group["position"], group["box/edges"]
    start = len(position["step"])
    for name in ("step", "time", "value"):
        position[name].resize(start + len(frames), axis=0)
    edges["value"].resize(start + len(frames), axis=0)
    for row, frame in enumerate(frames, start):
        position["step"][row] = frame.step
        position["time"][row] = frame.time / PICOSECOND
        position["value"][row] = frame.position / NANOMETRE
        extent = np.ptp(frame.position, axis=0) / NANOMETRE
        # A flat sheet has no height, but a cell without volume is an error to every reader.
        edges["value"][row] = np.maximum(extent, 0.1)


def append_fields(file: h5py.File, step: int, time: float, measured: MeasuredFields) -> None:
    """Append measured fields: elements of the particles with times of their own, and observables on a grid."""
    for name, value in measured.atoms.items():
        unit, size = FIELDS[name]
        _append_element(file.require_group(f"{GROUP}/{name}"), step, time, value / size, unit)
    if measured.grid is None:
        return
    grid = file.require_group(GRID)
    if "origin" not in grid.attrs:
        grid.attrs["origin"] = np.array(measured.grid.origin) / NANOMETRE
        grid.attrs["spacing"] = measured.grid.spacing / NANOMETRE
        grid.attrs["unit"] = "nm"
        grid.attrs["description"] = "first point of the grid and distance of points; arrays are (frame, x, y, z, ...)"
    for name, value in measured.on_grid.items():
        unit, size = GRID_FIELDS[name]
        _append_element(grid.require_group(name), step, time, value / size, unit)


def _append_element(group: h5py.Group, step: int, time: float, value: FloatArray, unit: str) -> None:
    if "value" not in group:
        group.create_dataset("step", shape=(0,), maxshape=(None,), dtype=np.int64, chunks=(_FRAMES_PER_TIME_CHUNK,))
        group.create_dataset("time", shape=(0,), maxshape=(None,), dtype=np.float64, chunks=(_FRAMES_PER_TIME_CHUNK,))
        group["time"].attrs["unit"] = "ps"
        group.create_dataset(
            "value", shape=(0, *value.shape), maxshape=(None, *value.shape), dtype=np.float64, chunks=(1, *value.shape)
        )
        group["value"].attrs["unit"] = unit
    row = len(group["step"])
    for name, entry in (("step", step), ("time", time / PICOSECOND), ("value", value)):
        group[name].resize(row + 1, axis=0)
        group[name][row] = entry


def _elements(file: h5py.File) -> list[h5py.Group]:
    """Return the groups of measured fields that are there."""
    names = [*(f"{GROUP}/{name}" for name in FIELDS), *(f"{GRID}/{name}" for name in GRID_FIELDS)]
    return [file[name] for name in names if name in file]


def truncate(file: h5py.File, step: int) -> None:
    """Drop the frames after `step`."""
    for element in _elements(file):
        keep = int(np.searchsorted(element["step"][:], step, side="right"))
        for name in ("step", "time", "value"):
            element[name].resize(keep, axis=0)
    if GROUP not in file:
        return
    group = file[GROUP]
    keep = int(np.searchsorted(group["position/step"][:], step, side="right"))
    for name in ("position/step", "position/time", "position/value", "box/edges/value"):
        group[name].resize(keep, axis=0)


class AtomsReader:
    """Atoms of a results file, in SI.

    Attributes
    ----------
    step : int64 array, shape (frames,)
    time : float64 array, shape (frames,)
        s.
    atom_id : int64 array, shape (atoms,)
    species : int64 array, shape (atoms,)
        Atomic numbers; 0 where no element is known.
    reference : float64 array, shape (atoms, 3)
        Positions without load, m.
    """

    def __init__(self, file: h5py.File) -> None:
        group = file[GROUP]
        self._group = group
        self._value: Any = group["position/value"]
        self.step: IntArray = group["position/step"][:]
        self.time: FloatArray = group["position/time"][:] * PICOSECOND
        self.atom_id: IntArray = group["id"][:].astype(np.int64)
        self.species: IntArray = group["species"][:].astype(np.int64)
        self.reference: FloatArray = group["reference_position"][:] * NANOMETRE

    def __len__(self) -> int:
        return len(self.step)

    def field(self, name: str) -> tuple[IntArray, FloatArray]:
        """Return steps and values of a measured field of each atom, SI.

        Raises
        ------
        KeyError
            If it was not measured.
        """
        return _read_element(self._group[name], FIELDS[name][1])

    def position(self, frame: int) -> FloatArray:
        """Return the positions of a frame, shape (atoms, 3), m."""
        found: FloatArray = self._value[frame] * NANOMETRE
        return found


class GridReader:
    """Fields of the atoms on a grid, in SI.

    Attributes
    ----------
    origin : float64 array, shape (3,)
        The first point, m.
    spacing : float
        m.
    names : list of str
    """

    def __init__(self, file: h5py.File) -> None:
        self._group = file[GRID]
        self.origin: FloatArray = np.array(self._group.attrs["origin"]) * NANOMETRE
        self.spacing = float(self._group.attrs["spacing"]) * NANOMETRE
        self.names = list(self._group)

    def field(self, name: str) -> tuple[IntArray, FloatArray]:
        """Return steps, shape (frames,), and values, shape (frames, x, y, z, ...), of a field."""
        return _read_element(self._group[name], GRID_FIELDS[name][1])


def _read_element(group: h5py.Group, size: float) -> tuple[IntArray, FloatArray]:
    return group["step"][:], group["value"][:] * size
