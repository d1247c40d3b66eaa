"""Material points as VTKHDF 2.0: poly data of vertices that change with time.

Arrays of all frames follow each other; `Steps` holds where a frame begins in each. What does not change
(topology, weight) is written once and every frame points to it; where points were added since the last frame,
topology and weight are written again. Values are single precision, in units that fit the size of the body (Angstrom
and ps for atoms, mm and us for a specimen; the attribute `unit` names them) and stresses in GPa, since ParaView knows
no units and tolerances of its geometry suit numbers near one; this module takes and gives SI.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from protocol.arrays import FloatArray, IntArray

GIGAPASCAL = 1e9
GROUP = "VTKHDF"
#: Units of length, and of the time that goes with each, in SI.
LENGTHS = {"Angstrom": 1e-10, "um": 1e-6, "mm": 1e-3, "m": 1.0}
TIMES = {"ps": 1e-12, "ns": 1e-9, "us": 1e-6, "s": 1.0}
_TIME_OF = dict(zip(LENGTHS, TIMES, strict=True))
#: Bodies are at least this many units of length wide in their file, but for the smallest unit.
_FEWEST = 5.0
#: Fields that change with time: components.
FIELDS = {"Displacement": 3, "Velocity": 3, "Stress": 3, "VonMises": 1}
#: Begins the names of fields of what has failed.
FAILED = "Failed "
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
        Share of stiffness and mass. Rows that an earlier frame had too are the same points, of the same weight.
    failed : dict of str to float64 array, shape (points,)
        Of a laminate: share of a material's subcells that has failed, by the words for plies and material. All frames
        of a file have the same names.
    """

    step: int
    time: float
    position: FloatArray
    displacement: FloatArray
    velocity: FloatArray
    stress: FloatArray
    weight: FloatArray
    failed: dict[str, FloatArray] = field(default_factory=dict)


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
        If a frame has fewer points than the one before.
    """
    if not frames:
        return
    if GROUP not in file:
        _create(file, frames[0])
    group = file[GROUP]
    units = _Units(str(group["Points"].attrs["unit"]))
    steps = group["Steps"]
    first = int(steps.attrs["NSteps"])
    for array in (*(steps[name] for name in _STEP_TABLES), *steps["PointDataOffsets"].values()):
        array.resize(first + len(frames), axis=0)
    for row, frame in enumerate(frames, first):
        count, held = len(frame.position), int(group["NumberOfPoints"][-1]) if len(group["NumberOfPoints"]) else -1
        if count < held:
            raise ValueError(f"step {frame.step} has {count} points, the frame before has {held}")
        if count > held:
            _append_part(group, frame)
        _point_to_part(group, row)
        begin = len(group["Points"])
        steps["Values"][row], steps["Step"][row] = frame.time / units.time, frame.step
        steps["PointOffsets"][row] = begin
        changing = _changing(group)
        for name, array in (("Points", group["Points"]), *((name, group["PointData"][name]) for name in changing)):
            array.resize(begin + count, axis=0)
            array[begin:] = _values(name, frame, units)
            if name in changing:
                steps["PointDataOffsets"][name][row] = begin
    steps.attrs["NSteps"] = first + len(frames)


def truncate(file: h5py.File, step: int) -> None:
    """Drop the frames after `step`."""
    if GROUP not in file:
        return
    group = file[GROUP]
    steps = group["Steps"]
    keep = int(np.searchsorted(steps["Step"][:], step, side="right"))
    if keep == 0:  # VTK refuses a temporal file without a step
        del file[GROUP]
        return
    if keep == int(steps.attrs["NSteps"]):
        return
    part = int(steps["PartOffsets"][keep - 1])
    end = int(steps["PointOffsets"][keep - 1] + group["NumberOfPoints"][part])
    weights = int(steps["PointDataOffsets/Weight"][keep - 1] + group["NumberOfPoints"][part])
    for array in (*(steps[name] for name in _STEP_TABLES), *steps["PointDataOffsets"].values()):
        array.resize(keep, axis=0)
    for array in (group["Points"], *(group["PointData"][name] for name in _changing(group))):
        array.resize(end, axis=0)
    group["PointData/Weight"].resize(weights, axis=0)
    group["NumberOfPoints"].resize(part + 1, axis=0)
    for kind in _CELL_KINDS:
        cells = group[kind]["NumberOfCells"][: part + 1].sum()
        group[kind]["NumberOfCells"].resize(part + 1, axis=0)
        group[kind]["NumberOfConnectivityIds"].resize(part + 1, axis=0)
        group[kind]["Offsets"].resize(cells + part + 1, axis=0)
        group[kind]["Connectivity"].resize(cells, axis=0)
    steps.attrs["NSteps"] = keep


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
        self._units = _Units(str(self._group["Points"].attrs["unit"]))
        self.step: IntArray = self._group["Steps/Step"][:]
        self.time: FloatArray = self._group["Steps/Values"][:] * self._units.time

    def __len__(self) -> int:
        return len(self.step)

    def frame(self, index: int) -> PointsFrame:
        """Return one frame."""
        if not 0 <= index < len(self):
            raise IndexError(f"frame {index} of {len(self)}")
        steps, data = self._group["Steps"], self._group["PointData"]
        count = int(self._group["NumberOfPoints"][int(steps["PartOffsets"][index])])
        begin = int(steps["PointOffsets"][index])
        weights = int(steps["PointDataOffsets/Weight"][index])
        part = slice(begin, begin + count)
        fields = {
            name.lower(): data[name][part].astype(np.float64) * self._units.of(name)
            for name in FIELDS
            if name != "VonMises"
        }
        return PointsFrame(
            step=int(self.step[index]), time=float(self.time[index]),
            position=self._group["Points"][part].astype(np.float64) * self._units.length,
            weight=data["Weight"][weights : weights + count].astype(np.float64), **fields,
            failed={name.removeprefix(FAILED): data[name][part].astype(np.float64) for name in _changing(self._group)
                    if name.startswith(FAILED)},
        )  # fmt: skip


def _changing(group: h5py.Group) -> list[str]:
    """Names of the fields of a file that change with time."""
    return [name for name in group["PointData"] if name != "Weight"]


class _Units:
    """Units of a file: SI size of each, by the name of the one of length."""

    def __init__(self, name: str) -> None:
        self.name, self.time_name = name, _TIME_OF[name]
        self.length, self.time = LENGTHS[name], TIMES[self.time_name]

    def of(self, field: str) -> float:
        """Return the SI size of the unit of a field."""
        return {"Displacement": self.length, "Velocity": self.length / self.time}.get(field, GIGAPASCAL)

    def name_of(self, field: str) -> str:
        """Return the name of the unit of a field."""
        return {"Displacement": self.name, "Velocity": f"{self.name}/{self.time_name}"}.get(field, "GPa")


def _units_for(position: FloatArray) -> _Units:
    extent = float(np.ptp(position, axis=0).max()) if len(position) else 0.0
    fitting = [name for name, size in LENGTHS.items() if extent >= _FEWEST * size]
    return _Units(fitting[-1] if fitting else "Angstrom")


def _values(name: str, frame: PointsFrame, units: _Units) -> NDArray[np.float32]:
    if name == "Points":
        return (frame.position / units.length).astype(np.float32)
    if name.startswith(FAILED):
        return frame.failed[name.removeprefix(FAILED)].astype(np.float32)
    value = von_mises(frame.stress) if name == "VonMises" else getattr(frame, name.lower())
    return (value / units.of(name)).astype(np.float32)


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
    units = _units_for(frame.position)
    group = file.create_group(GROUP)
    group.attrs["Version"] = np.array([2, 0], dtype=np.int64)
    group.attrs.create("Type", b"PolyData", dtype=h5py.string_dtype("ascii", len("PolyData")))

    def grows(
        parent: h5py.Group, name: str, tail: tuple[int, ...] = (), kind: type = np.int64, chunk: int = 256
    ) -> Any:
        return parent.create_dataset(
            name, shape=(0, *tail), maxshape=(None, *tail), dtype=kind, chunks=(max(chunk, 1), *tail)
        )

    count = len(frame.position)
    grows(group, "NumberOfPoints")
    for kind in _CELL_KINDS:
        part = group.create_group(kind)
        for name in ("NumberOfCells", "NumberOfConnectivityIds"):
            grows(part, name)
        for name in ("Offsets", "Connectivity"):
            grows(part, name, chunk=count if kind == "Vertices" else 1)
    grows(group, "Points", (3,), np.float32, count).attrs["unit"] = units.name
    data = group.create_group("PointData")
    for name, components in FIELDS.items():
        tail = () if components == 1 else (components,)
        grows(data, name, tail, np.float32, count).attrs["unit"] = units.name_of(name)
    for name in frame.failed:
        grows(data, FAILED + name, (), np.float32, count)
    grows(data, "Weight", (), np.float32, count)

    steps = group.create_group("Steps")
    steps.attrs["NSteps"] = np.int64(0)
    for name in _STEP_TABLES:
        tail = (4,) if name in ("CellOffsets", "ConnectivityIdOffsets") else ()
        grows(steps, name, tail, np.float64 if name == "Values" else np.int64)
    steps["Values"].attrs["unit"] = units.time_name
    offsets = steps.create_group("PointDataOffsets")
    for name in data:
        grows(offsets, name)


def _append_part(group: h5py.Group, frame: PointsFrame) -> None:
    """Write topology and weight of a frame with another number of points than the one before."""
    count = len(frame.position)
    _extend(group["NumberOfPoints"], [count])
    for kind in _CELL_KINDS:
        cells = count if kind == "Vertices" else 0
        _extend(group[kind]["NumberOfCells"], [cells])
        _extend(group[kind]["NumberOfConnectivityIds"], [cells])
        _extend(group[kind]["Offsets"], np.arange(cells + 1))
        _extend(group[kind]["Connectivity"], np.arange(cells))
    _extend(group["PointData/Weight"], frame.weight)


def _extend(array: Any, values: Any) -> None:
    begin = len(array)
    array.resize(begin + len(values), axis=0)
    array[begin:] = values


def _point_to_part(group: h5py.Group, row: int) -> None:
    """Let a step point to the topology and weight that were written last."""
    steps, part = group["Steps"], len(group["NumberOfPoints"]) - 1
    earlier = int(group["NumberOfPoints"][:part].sum())
    steps["PartOffsets"][row], steps["NumberOfParts"][row] = part, 1
    # One vertex a point: as many cells and connectivity ids as points. The reader adds the one entry that each
    # earlier part has more in `Offsets` itself.
    steps["CellOffsets"][row] = [earlier, 0, 0, 0]
    steps["ConnectivityIdOffsets"][row] = [earlier, 0, 0, 0]
    steps["PointDataOffsets/Weight"][row] = len(group["PointData/Weight"]) - int(group["NumberOfPoints"][part])
