"""The results file of a run, `results.h5`, and how it survives a killed run.

Everything is buffered until `flush`, which writes a copy of the file beside it and puts that in its
place in one move. Whoever opens the file, at any time, finds the whole state of some flush.

==================  =====================================================================
``/h5md``           root of H5MD 1.1
``/particles``      atoms, H5MD (nm, ps)
``/observables``    fields of the atoms on a grid, H5MD; only where the scene asks for them, and then
                    also as images in files of the folder `fields` beside this one
``/VTKHDF``         material points, VTKHDF (Angstrom, ps, GPa)
``/time_series``    one array a quantity, SI, with attributes `unit` and `description`
``/interface``      cells, anchors, overlap, and force and standard error of each cell, SI
``/events``         what the continuum told of, one JSON object an event, SI
``/scene``          text, overrides, resolved values as JSON (SI)
``/versions``       version of every package that matters, as attributes
``/seeds``          seeds, as attributes
==================  =====================================================================
"""

from __future__ import annotations

import json
import math
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any, Self

import h5py
import numpy as np
from numpy.typing import ArrayLike

from coordinator import h5md, vtkhdf
from coordinator.atom_measurements import MeasuredFields
from coordinator.grid_vtkhdf import write_grid
from coordinator.series import series_of
from protocol.arrays import FloatArray, IntArray

_CHUNK = 1024
#: Folder beside the file, for images of fields on a grid, which VTKHDF has one a file.
GRID_FOLDER = "fields"
_STATIC_INTERFACE = ("ivc_lower", "ivc_upper", "anchor_position", "anchor_ivc", "inner", "outer")


class ResultsError(ValueError):
    """A results file that cannot be written or read as asked."""


class ResultsWriter:
    """Write `results.h5`, so that a killed run leaves a readable, self-consistent file.

    Parameters
    ----------
    path : str or Path
        The file; one that exists is replaced at the first flush.
    header : dict
        ``scene``: dict of `name`, `title`, `text`, `overrides` (list of str), `resolved` (dict);
        ``versions``: dict of str to str; ``seeds``: dict of str to int; ``command``: str.

    Raises
    ------
    ResultsError
        If the header lacks one of these.
    """

    def __init__(self, path: str | Path, header: dict[str, Any]) -> None:
        missing = [key for key in ("scene", "versions", "seeds", "command") if key not in header]
        missing += [
            f"scene.{k}"
            for k in ("name", "title", "text", "overrides", "resolved")
            if k not in header.get("scene", {k: 0})
        ]
        if missing:
            raise ResultsError(f"header lacks {', '.join(missing)}")
        self._start(Path(path), exists=False, last_step=-1)
        self._static.append(lambda file: _write_header(file, header))

    def _start(self, path: Path, exists: bool, last_step: int) -> None:
        self.path = path
        self._exists = exists
        self._status = "running"
        self._last_row = self._last_ivc = self._last_atoms = self._last_points = last_step
        self._static: list[Callable[[h5py.File], None]] = []
        self._rows: list[tuple[int, dict[str, float]]] = []
        self._ivc_rows: list[tuple[int, FloatArray, FloatArray]] = []
        self._atoms: list[h5md.AtomsFrame] = []
        self._points: list[vtkhdf.PointsFrame] = []
        self._measured: list[tuple[int, float, MeasuredFields]] = []
        self._events: list[tuple[int, str]] = []

    @classmethod
    def resume(cls, path: str | Path, step: int) -> Self:
        """Go on with a file; whatever lies after `step` is dropped.

        Raises
        ------
        ResultsError
            If there is no such file.
        """
        writer = cls.__new__(cls)
        writer._start(Path(path), exists=True, last_step=step)
        if not writer.path.exists():
            raise ResultsError(f"{writer.path}: there are no results to go on with")
        writer._static.append(lambda file: _truncate(file, step))
        writer.flush()
        return writer

    def atoms(self, atom_id: IntArray, species: IntArray, mass: FloatArray, reference: FloatArray) -> None:
        """Say which atoms there are, before the first frame; see `h5md.create_atoms`."""
        ids, kinds, masses, rest = atom_id.copy(), species.copy(), mass.copy(), reference.copy()
        self._static.append(lambda file: h5md.create_atoms(file, ids, kinds, masses, rest))

    def interface(
        self,
        ivc_lower: ArrayLike,
        ivc_upper: ArrayLike,
        anchor_position: ArrayLike,
        anchor_ivc: ArrayLike,
        inner: ArrayLike,
        outer: ArrayLike,
        rings: dict[str, dict[str, FloatArray]] | None = None,
    ) -> None:
        """Say where the interface is, before its first row.

        Parameters
        ----------
        ivc_lower, ivc_upper : array_like, shape (ivcs, 3)
            Corners of the interface volume cells, m.
        anchor_position : array_like, shape (anchors, 3)
            Reference positions of the anchors, m.
        anchor_ivc : array_like of int, shape (anchors,)
            Cell of each anchor.
        inner, outer : array_like, shape (2, 2)
            Lower and upper corner of boxes around the borders of the first region's overlap, m.
        rings : dict, optional
            Corners of the borders `inner` and `outer` of each region's overlap by its name, shape (corners, 2), m.
        """
        given = (ivc_lower, ivc_upper, anchor_position, anchor_ivc, inner, outer)
        values = {name: np.array(value) for name, value in zip(_STATIC_INTERFACE, given, strict=True)}
        self._static.append(lambda file: _create_interface(file, values, rings or {}))

    def crack(self, critical: float, own: float) -> None:
        """Keep the critical crack length of Eq 1 and the length of the scene's crack, m."""
        self._static.append(lambda file: file.attrs.update({"critical_crack_length": critical, "crack_length": own}))

    def row(self, step: int, values: dict[str, float]) -> None:
        """Add one row of the time series.

        Parameters
        ----------
        step : int
            Coupling step, greater than the last one.
        values : dict of str to float
            SI; must hold `time`. A name that was not there before is NaN in earlier rows.

        Raises
        ------
        ResultsError
            If the step is not greater than the last one or `time` is missing.
        """
        self._last_row = _ascending("row", step, self._last_row)
        if "time" not in values:
            raise ResultsError(f"row of step {step} has no time")
        self._rows.append((step, dict(values)))

    def ivc_row(self, step: int, force: ArrayLike, error: ArrayLike) -> None:
        """Add force and standard error of every interface volume cell, shape (ivcs, 3), N."""
        self._last_ivc = _ascending("ivc_row", step, self._last_ivc)
        self._ivc_rows.append((step, np.array(force, dtype=np.float64), np.array(error, dtype=np.float64)))

    def atoms_frame(self, step: int, time: float, position: ArrayLike) -> None:
        """Add the positions of all atoms, shape (atoms, 3), m, in the order of `atoms`."""
        self._last_atoms = _ascending("atoms_frame", step, self._last_atoms)
        self._atoms.append(h5md.AtomsFrame(step, time, np.array(position, dtype=np.float64)))

    def points_frame(
        self,
        step: int,
        time: float,
        position: ArrayLike,
        displacement: ArrayLike,
        velocity: ArrayLike,
        stress: ArrayLike,
        weight: ArrayLike,
        failed: dict[str, FloatArray] | None = None,
    ) -> None:
        """Add the material points; shapes and units as in `vtkhdf.PointsFrame`."""
        self._last_points = _ascending("points_frame", step, self._last_points)
        arrays = [np.array(a, dtype=np.float64) for a in (position, displacement, velocity, stress, weight)]
        position, displacement, velocity, stress, weight = arrays
        self._points.append(
            vtkhdf.PointsFrame(step, time, position, displacement, velocity, stress, weight, failed or {})
        )

    def measured(self, step: int, time: float, fields: MeasuredFields) -> None:
        """Add fields that were measured on the atoms."""
        self._measured.append((step, time, fields))

    def event(self, step: int, event: dict[str, Any]) -> None:
        """Add something that happened, plain values in SI; `step` is the coupling step that told of it."""
        self._events.append((step, json.dumps(event, allow_nan=False)))

    def flush(self) -> None:
        """Commit all that was added since the last flush, or nothing."""
        temporary = self.path.with_name(self.path.name + ".tmp")
        if self._exists:
            shutil.copyfile(self.path, temporary)
        with h5py.File(temporary, "a" if self._exists else "w") as file:
            for write in self._static:
                write(file)
            _append_rows(file, self._rows)
            _append_ivc_rows(file, self._ivc_rows)
            h5md.append(file, self._atoms)
            vtkhdf.append(file, self._points)
            for step, time, fields in self._measured:
                h5md.append_fields(file, step, time, fields)
            _append_events(file, self._events)
            file.attrs["status"] = self._status
        with temporary.open("rb+") as handle:
            os.fsync(handle.fileno())
        os.replace(temporary, self.path)
        _sync_folder(self.path.parent)
        for step, _, fields in self._measured:
            if fields.grid is not None:
                write_grid(self.path.parent / GRID_FOLDER / f"grid_{step:08d}.vtkhdf", fields.grid, fields.on_grid)
        # Only now: an interrupt before the move leaves the old file and the whole buffer.
        self._exists = True
        buffers: tuple[list[Any], ...] = (
            self._static, self._rows, self._ivc_rows, self._atoms, self._points, self._measured,
            self._events,
        )  # fmt: skip
        for buffer in buffers:
            buffer.clear()

    def close(self, status: str) -> None:
        """Commit the rest with the final status of the run, for example `finished` or `failed`."""
        self._status = status
        self.flush()


class Results:
    """Read a results file, in SI. Use as a context manager.

    Parameters
    ----------
    path : str or Path

    Attributes
    ----------
    status : str
    scene : dict
        `name`, `title`, `text`, `overrides`, `resolved`.
    versions : dict of str to str
    seeds : dict of str to int
    command : str
    step : int64 array, shape (rows,)
    series : dict of str to float64 array, shape (rows,)
        By name, `time` among them.
    units : dict of str to str
        Unit of each series.
    rings : dict
        Corners of the borders `inner` and `outer` of each region's overlap by its name, shape (corners, 2), m.
    interface : dict of str to array
        As given to `ResultsWriter.interface`, and `step`, `force`, `error`; empty without interface.
    atoms : AtomsReader or None
    grid : GridReader or None
        Fields of the atoms on a grid.
    points : PointsReader or None
    events : list of dict
        What the continuum told of, in order; plain values in SI.

    Raises
    ------
    ResultsError
        If the file is not there or no results file.
    """

    def __init__(self, path: str | Path) -> None:
        try:
            self._file = h5py.File(path, "r")
        except OSError as error:
            raise ResultsError(f"{path}: cannot be read as results: {error}") from None
        file = self._file
        if "scene" not in file or "time_series" not in file:
            file.close()
            raise ResultsError(f"{path}: is HDF5, but no results of scalebridge")
        self.status = str(file.attrs["status"])
        self.command = str(file.attrs["command"])
        scene = file["scene"]
        self.scene: dict[str, Any] = {
            "name": str(scene.attrs["name"]),
            "title": str(scene.attrs["title"]),
            "text": scene["text"].asstr()[()],
            "overrides": json.loads(scene["overrides"].asstr()[()]),
            "resolved": json.loads(scene["resolved"].asstr()[()]),
        }
        self.versions = {key: str(value) for key, value in file["versions"].attrs.items()}
        self.seeds = {key: int(value) for key, value in file["seeds"].attrs.items()}
        table = file["time_series"]
        self.step: IntArray = table["step"][:]
        self.series: dict[str, FloatArray] = {name: table[name][:] for name in table if name != "step"}
        self.units = {name: str(table[name].attrs["unit"]) for name in self.series}
        interface = file.get("interface", {})
        self.interface: dict[str, Any] = {name: array[:] for name, array in interface.items() if name != "rings"}
        #: Measures that are known from the start, m.
        self.measures: dict[str, float] = {
            name: float(file.attrs[name]) for name in ("critical_crack_length", "crack_length") if name in file.attrs
        }
        self.rings: dict[str, dict[str, FloatArray]] = {
            region: {name: array[:] for name, array in borders.items()}
            for region, borders in interface.get("rings", {}).items()
        }
        if not self.rings and "inner" in self.interface:  # written by an earlier version: boxes
            self.rings = {"atomistic": {name: _box_corners(self.interface[name]) for name in ("inner", "outer")}}
        self.atoms = h5md.AtomsReader(file) if h5md.GROUP in file else None
        self.grid = h5md.GridReader(file) if h5md.GRID in file else None
        self.points = vtkhdf.PointsReader(file) if vtkhdf.GROUP in file else None
        told = file["events/json"].asstr()[:] if "events" in file else []
        self.events: list[dict[str, Any]] = [json.loads(text) for text in told]

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self._file.close()


def _ascending(what: str, step: int, last: int) -> int:
    if step <= last:
        raise ResultsError(f"{what}: step {step} must be greater than the last one, {last}")
    return step


def _sync_folder(folder: Path) -> None:
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _write_header(file: h5py.File, header: dict[str, Any]) -> None:
    scene = header["scene"]
    version = str(header["versions"].get("scalebridge", "unknown"))
    h5md.create(file, author="scalebridge", creator="scalebridge", version=version)
    file.attrs["command"] = header["command"]
    group = file.create_group("scene")
    group.attrs["name"], group.attrs["title"] = scene["name"], scene["title"]
    group["text"] = scene["text"]
    group["overrides"] = json.dumps(list(scene["overrides"]))
    group["resolved"] = json.dumps(scene["resolved"], allow_nan=False)
    for name, value in header["versions"].items():
        file.require_group("versions").attrs[name] = str(value)
    for name, value in header["seeds"].items():
        file.require_group("seeds").attrs[name] = int(value)
    file.require_group("versions")
    file.require_group("seeds")
    table = file.create_group("time_series")
    table.create_dataset("step", shape=(0,), maxshape=(None,), dtype=np.int64, chunks=(_CHUNK,))


def _append_rows(file: h5py.File, rows: list[tuple[int, dict[str, float]]]) -> None:
    table = file["time_series"]
    start, total = len(table["step"]), len(table["step"]) + len(rows)
    for name in dict.fromkeys(key for _, values in rows for key in values):
        if name not in table:
            array = table.create_dataset(
                name, shape=(start,), maxshape=(None,), dtype=np.float64, chunks=(_CHUNK,), fillvalue=math.nan
            )
            array.attrs["unit"], array.attrs["description"] = series_of(name).unit, series_of(name).description
    for name, array in table.items():
        array.resize(total, axis=0)
        if name == "step":
            array[start:] = [step for step, _ in rows]
        else:
            array[start:] = [values.get(name, math.nan) for _, values in rows]


def _box_corners(box: FloatArray) -> FloatArray:
    (left, bottom), (right, top) = box
    return np.array([[left, bottom], [right, bottom], [right, top], [left, top]])


def _create_interface(file: h5py.File, values: dict[str, np.ndarray], rings: dict[str, dict[str, FloatArray]]) -> None:
    group = file.create_group("interface")
    for region, borders in rings.items():
        for name, corners in borders.items():
            group[f"rings/{region}/{name}"] = corners
            group[f"rings/{region}/{name}"].attrs["unit"] = "m"
    for name, value in values.items():
        group[name] = value
        if name != "anchor_ivc":
            group[name].attrs["unit"] = "m"
    ivcs = len(values["ivc_lower"])
    group.create_dataset("step", shape=(0,), maxshape=(None,), dtype=np.int64, chunks=(_CHUNK,))
    for name in ("force", "error"):
        array = group.create_dataset(
            name, shape=(0, ivcs, 3), maxshape=(None, ivcs, 3), dtype=np.float32, chunks=(16, ivcs, 3)
        )
        array.attrs["unit"] = "N"
    group["force"].attrs["description"] = "force of the atoms on the continuum in each cell"
    group["error"].attrs["description"] = "standard error of that force"


def _append_ivc_rows(file: h5py.File, rows: list[tuple[int, FloatArray, FloatArray]]) -> None:
    if not rows:
        return
    group = file["interface"]
    start = len(group["step"])
    for name, column in (("step", 0), ("force", 1), ("error", 2)):
        group[name].resize(start + len(rows), axis=0)
        group[name][start:] = np.array([row[column] for row in rows])


def _append_events(file: h5py.File, events: list[tuple[int, str]]) -> None:
    if not events:
        return
    if "events" not in file:
        group = file.create_group("events")
        group.create_dataset("step", shape=(0,), maxshape=(None,), dtype=np.int64, chunks=(_CHUNK,))
        group.create_dataset("json", shape=(0,), maxshape=(None,), dtype=h5py.string_dtype(), chunks=(_CHUNK,))
    group = file["events"]
    start = len(group["step"])
    for name, column in (("step", 0), ("json", 1)):
        group[name].resize(start + len(events), axis=0)
        group[name][start:] = [event[column] for event in events]


def _truncate(file: h5py.File, step: int) -> None:
    for group, names in (
        (file["time_series"], None),
        (file.get("interface"), ("step", "force", "error")),
        (file.get("events"), None),
    ):
        if group is not None:
            keep = int(np.searchsorted(group["step"][:], step, side="right"))
            for name in names or tuple(group):
                group[name].resize(keep, axis=0)
    h5md.truncate(file, step)
    vtkhdf.truncate(file, step)
