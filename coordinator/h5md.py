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

from protocol.arrays import FloatArray, IntArray

NANOMETRE = 1e-9
PICOSECOND = 1e-12
GROUP = "particles/atoms"
_FRAMES_PER_TIME_CHUNK = 256
#: Elements of the polymers and composites that are modelled, by atomic number.
_SYMBOLS = {1: "H", 6: "C", 7: "N", 8: "O", 9: "F", 14: "Si", 15: "P", 16: "S", 17: "Cl"}


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
        Atomic number.
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
    present = {_SYMBOLS.get(int(number), f"Z{number}"): int(number) for number in np.unique(species)}
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


def truncate(file: h5py.File, step: int) -> None:
    """Drop the frames after `step`."""
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
    reference : float64 array, shape (atoms, 3)
        Positions without load, m.
    """

    def __init__(self, file: h5py.File) -> None:
        group = file[GROUP]
        self._value: Any = group["position/value"]
        self.step: IntArray = group["position/step"][:]
        self.time: FloatArray = group["position/time"][:] * PICOSECOND
        self.atom_id: IntArray = group["id"][:].astype(np.int64)
        self.reference: FloatArray = group["reference_position"][:] * NANOMETRE

    def __len__(self) -> int:
        return len(self.step)

    def position(self, frame: int) -> FloatArray:
        """Return the positions of a frame, shape (atoms, 3), m."""
        found: FloatArray = self._value[frame] * NANOMETRE
        return found
