"""Material points as VTKHDF 2.0: poly data of vertices that change with time.

Arrays of all frames follow each other; `Steps` holds where a frame begins in each. What does not change
(topology, weight) is written once and every frame points to it. Values are single precision, lengths in
Angstrom, times in ps, stresses in GPa, since ParaView knows no units and tolerances of its geometry suit
numbers near one; this module takes and gives SI.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from protocol.arrays import FloatArray, IntArray

ANGSTROM = 1e-10
PICOSECOND = 1e-12
GIGAPASCAL = 1e9
GROUP = "VTKHDF"
#: Fields that change with time: components, size of the file's unit in SI, name of that unit.
FIELDS: dict[str, tuple[int, float, str]] = {
    "Displacement": (3, ANGSTROM, "Angstrom"),
    "Velocity": (3, ANGSTROM / PICOSECOND, "Angstrom/ps"),
    "Stress": (3, GIGAPASCAL, "GPa"),
    "VonMises": (1, GIGAPASCAL, "GPa"),
}
_CELL_KINDS = ("Vertices", "Lines", "Polygons", "Strips")


@dataclass(frozen=True)
class PointsFrame:
    """Material points at one step.

    Attributes
    ----------
    step : int
    time : float
        s.
    position, displacement, velocity : float64 array, shape (points, 3)
        m, m, m/s.
    stress : float64 array, shape (points, 3)
        xx, yy, xy, Pa.
    weight : float64 array, shape (points,)
        Share of stiffness and mass; the same in every frame.
    """

    step: int
    time: float
    position: FloatArray
    displacement: FloatArray
    velocity: FloatArray
    stress: FloatArray
    weight: FloatArray


def von_mises(stress: FloatArray) -> FloatArray:
    """Return the equivalent stress of plane stress, shape (points,), from xx, yy, xy, shape (points, 3)."""
    xx, yy, xy = stress.T
    equivalent: FloatArray = np.sqrt(xx * xx - xx * yy + yy * yy + 3.0 * xy * xy)
    return equivalent


def append(file: h5py.File, frames: Sequence[PointsFrame]) -> None:
    """Append frames; the first one creates the group.

    Raises
    ------
    ValueError
        If a frame has another number of points than the first one.
    """
    if not frames:
        return
    if GROUP not in file:
        _create(file, frames[0])
    group = file[GROUP]
    count = int(group["NumberOfPoints"][0])
    first = int(group["Steps"].attrs["NSteps"])
    total = first + len(frames)
    _steps(group["Steps"], total)
    for name, array in (("Points", group["Points"]), *((name, group["PointData"][name]) for name in FIELDS)):
        array.resize(total * count, axis=0)
        for row, frame in enumerate(frames, first):
            if len(frame.position) != count:
                raise ValueError(f"step {frame.step} has {len(frame.position)} points, the file has {count}")
            array[row * count : (row + 1) * count] = _values(name, frame)
    for row, frame in enumerate(frames, first):
        steps = group["Steps"]
        steps["Values"][row] = frame.time / PICOSECOND
        steps["Step"][row] = frame.step
        steps["PointOffsets"][row] = row * count
        for name in FIELDS:
            steps["PointDataOffsets"][name][row] = row * count
    group["Steps"].attrs["NSteps"] = total


def truncate(file: h5py.File, step: int) -> None:
    """Drop the frames after `step`."""
    if GROUP not in file:
        return
    group = file[GROUP]
    count = int(group["NumberOfPoints"][0])
    keep = int(np.searchsorted(group["Steps/Step"][:], step, side="right"))
    if keep == 0:  # VTK refuses a temporal file without a step
        del file[GROUP]
        return
    _steps(group["Steps"], keep)
    for array in (group["Points"], *(group["PointData"][name] for name in FIELDS)):
        array.resize(keep * count, axis=0)
    group["Steps"].attrs["NSteps"] = keep


class PointsReader:
    """Material points of a results file, in SI.

    Attributes
    ----------
    step : int64 array, shape (frames,)
    time : float64 array, shape (frames,)
        s.
    """

    def __init__(self, file: h5py.File) -> None:
        self._group: Any = file[GROUP]
        self._count = int(self._group["NumberOfPoints"][0])
        self.step: IntArray = self._group["Steps/Step"][:]
        self.time: FloatArray = self._group["Steps/Values"][:] * PICOSECOND

    def __len__(self) -> int:
        return len(self.step)

    def frame(self, index: int) -> PointsFrame:
        """Return one frame."""
        if not 0 <= index < len(self):
            raise IndexError(f"frame {index} of {len(self)}")
        part = slice(index * self._count, (index + 1) * self._count)
        data = self._group["PointData"]
        fields = {
            name.lower(): data[name][part].astype(np.float64) * scale
            for name, (_, scale, _) in FIELDS.items()
            if name != "VonMises"
        }
        return PointsFrame(
            step=int(self.step[index]), time=float(self.time[index]),
            position=self._group["Points"][part].astype(np.float64) * ANGSTROM,
            weight=data["Weight"][:].astype(np.float64), **fields,
        )  # fmt: skip


def _values(name: str, frame: PointsFrame) -> NDArray[np.float32]:
    if name == "Points":
        return (frame.position / ANGSTROM).astype(np.float32)
    _, scale, _ = FIELDS[name]
    value = von_mises(frame.stress) if name == "VonMises" else getattr(frame, name.lower())
    return (value / scale).astype(np.float32)


def _steps(steps: h5py.Group, total: int) -> None:
    """Give the tables of `Steps` room for `total` frames; new rows point to the shared parts, at 0."""
    for array in (*(steps[n] for n in _STEP_TABLES), *steps["PointDataOffsets"].values()):
        array.resize(total, axis=0)
    steps["NumberOfParts"][:] = 1


_STEP_TABLES = (
    "Values",
    "Step",
    "PartOffsets",
    "NumberOfParts",
    "PointOffsets",
    "CellOffsets",
    "ConnectivityIdOffsets",
)


def _create(file: h5py.File, frame: PointsFrame) -> None:
    count = len(frame.position)
    group = file.create_group(GROUP)
    group.attrs["Version"] = np.array([2, 0], dtype=np.int64)
    group.attrs.create("Type", b"PolyData", dtype=h5py.string_dtype("ascii", len("PolyData")))
    group.create_dataset("NumberOfPoints", data=np.array([count], dtype=np.int64))
    for kind in _CELL_KINDS:
        cells = count if kind == "Vertices" else 0
        part = group.create_group(kind)
        part.create_dataset("NumberOfCells", data=np.array([cells], dtype=np.int64))
        part.create_dataset("NumberOfConnectivityIds", data=np.array([cells], dtype=np.int64))
        part.create_dataset("Offsets", data=np.arange(cells + 1, dtype=np.int64))
        part.create_dataset("Connectivity", data=np.arange(cells, dtype=np.int64))

    def grows(parent: h5py.Group, name: str, components: int, unit: str) -> None:
        tail = () if components == 1 else (components,)
        array = parent.create_dataset(
            name, shape=(0, *tail), maxshape=(None, *tail), dtype=np.float32, chunks=(max(count, 1), *tail)
        )
        array.attrs["unit"] = unit

    grows(group, "Points", 3, "Angstrom")
    data = group.create_group("PointData")
    for name, (components, _, unit) in FIELDS.items():
        grows(data, name, components, unit)
    data.create_dataset("Weight", data=frame.weight.astype(np.float32))

    steps = group.create_group("Steps")
    steps.attrs["NSteps"] = np.int64(0)
    for name in _STEP_TABLES:
        tail = (4,) if name in ("CellOffsets", "ConnectivityIdOffsets") else ()
        number: type = np.float64 if name == "Values" else np.int64
        steps.create_dataset(name, shape=(0, *tail), maxshape=(None, *tail), dtype=number, chunks=(256, *tail))
    steps["Values"].attrs["unit"] = "ps"
    offsets = steps.create_group("PointDataOffsets")
    for name in (*FIELDS, "Weight"):
        offsets.create_dataset(name, shape=(0,), maxshape=(None,), dtype=np.int64, chunks=(256,))
