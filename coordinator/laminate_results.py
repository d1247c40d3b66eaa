"""The results file of a laminate run, `results.h5`.

===================  =====================================================================
``/VTKHDF``          bricks with their fields at some increments, VTKHDF (SI); tensors as xx, yy, zz, xy, yz, xz
``/series``          one array a quantity, one entry an increment, SI, with attribute `unit`
``/watched``         strain, stress and stress of each subcell in the bricks that are watched; absent: none are
``/new_failures``    subcells that failed in each increment, by ply and material
``/events``          failure sequence, one JSON object an event
``/scene``           text, overrides, resolved values as JSON (SI), as attributes
``/versions``        version of every package that matters, as attributes
===================  =====================================================================

Everything is held in memory and written beside the file, which is then replaced in one move: whoever opens it finds the
whole state of some increment, also after a kill.
"""

from __future__ import annotations

import json
import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from coordinator.watched_places import WatchedPlaces
from protocol.arrays import FloatArray, IntArray

#: Quantities of an increment, with their unit and meaning.
SERIES: dict[str, tuple[str, str]] = {
    "load": ("1", "part of the whole load"),
    "strain": ("1", "elongation over length"),
    "force": ("N", "with which the laminate is pulled"),
    "stress": ("Pa", "force over the cross section without the hole"),
    "iterations": ("1", "solutions of the increment"),
    "halved": ("1", "tries that found no equilibrium"),
    "residual": ("1", "force out of balance over the largest force"),
    "work": ("J", "of the ends so far"),
    "viscous_energy": ("J", "that the viscosity of cohesive layers has taken so far"),
    "queried": ("1", "points of which the microstructure was asked"),
    "spared": ("1", "points that could not fail and were answered elastically"),
    "seconds_assembly": ("s", "spent on element matrices"),
    "seconds_solution": ("s", "spent on factorisation and solution"),
    "seconds_micromechanics": ("s", "spent on queries, the wire included"),
    "seconds_wire": ("s", "of that not computed by the service"),
    "seconds_other": ("s", "spent otherwise"),
}
_VTK_HEXAHEDRON = 12
#: Places of VTK's components xx, yy, zz, xy, yz, xz in ours, and the way back.
_TO_VTK, _FROM_VTK = [0, 1, 2, 5, 3, 4], [0, 1, 2, 4, 5, 3]


@dataclass(frozen=True, eq=False)
class Frame:
    """Fields of the plate after an increment.

    Attributes
    ----------
    step : int
    strain : float
    displacement : float64 array, shape (nodes, 3)
        m.
    stress : float64 array, shape (bricks, 6)
        11, 22, 33, 23, 13, 12 in the axes of the plate, Pa.
    failed : float64 array, shape (bricks, materials)
        Share of each material's subcells that has failed.
    """

    step: int
    strain: float
    displacement: FloatArray
    stress: FloatArray
    failed: FloatArray

    def von_mises(self) -> FloatArray:
        """Equivalent stress, shape (bricks,), Pa."""
        s11, s22, s33, s23, s13, s12 = self.stress.T
        normal = (s11 - s22) ** 2 + (s22 - s33) ** 2 + (s33 - s11) ** 2
        found: FloatArray = np.sqrt(0.5 * normal + 3.0 * (s23**2 + s13**2 + s12**2))
        return found


@dataclass(eq=False)
class LaminateResults:
    """All that a run of a laminate has found.

    Attributes
    ----------
    scene : dict
        ``name``, ``title``, ``text``, ``overrides``, ``resolved``, ``command``.
    materials : list of str
        Of the cell.
    angles : float64 array, shape (plies,)
        Of the modelled plies, degrees.
    nodes : float64 array, shape (nodes, 3)
        m.
    bricks : int64 array, shape (bricks, 8)
    ply : int64 array, shape (bricks,)
    section : float
        m^2.
    series : dict of str to list of float
        See `SERIES`.
    new_failures : list of int64 array, shape (plies, materials)
    layer_damage : list of float64 array, shape (interfaces,)
    frames : list of Frame
    watched : WatchedPlaces or None
    events : list of dict
    versions : dict of str to str
    """

    scene: dict[str, Any]
    materials: list[str]
    angles: FloatArray
    nodes: FloatArray
    bricks: IntArray
    ply: IntArray
    section: float
    series: dict[str, list[float]] = field(default_factory=lambda: {name: [] for name in SERIES})
    new_failures: list[IntArray] = field(default_factory=list)
    layer_damage: list[FloatArray] = field(default_factory=list)
    frames: list[Frame] = field(default_factory=list)
    watched: WatchedPlaces | None = None
    events: list[dict[str, Any]] = field(default_factory=list)
    versions: dict[str, str] = field(default_factory=dict)

    @property
    def increments(self) -> int:
        """Increments made."""
        return len(self.series["load"])

    def cut(self, increments: int) -> None:
        """Drop what lies after so many increments."""
        for values in self.series.values():
            del values[increments:]
        del self.new_failures[increments:], self.layer_damage[increments:]
        if self.watched is not None:
            self.watched.cut(increments)
        self.frames = [frame for frame in self.frames if frame.step <= increments]
        self.events = [event for event in self.events if event["step"] <= increments]

    def write(self, path: Path) -> None:
        """Write the file in one move."""
        new = path.with_name(path.name + ".new")
        with h5py.File(new, "w") as file:
            series = file.create_group("series")
            for name, values in self.series.items():
                series[name] = np.array(values, dtype=np.float64)
                series[name].attrs["unit"], series[name].attrs["description"] = SERIES[name]
            plies = len(self.angles)
            file["new_failures"] = np.array(self.new_failures, dtype=np.int64).reshape(-1, plies, len(self.materials))
            file["layer_damage"] = np.stack(self.layer_damage) if self.layer_damage else np.zeros((0, 0))
            if self.watched is not None:
                self.watched.write(file.create_group("watched"))
            file["events"] = [json.dumps(event) for event in self.events] or np.zeros(0, dtype="S1")
            scene = file.create_group("scene")
            for name, value in self.scene.items():
                scene.attrs[name] = value if isinstance(value, str) else json.dumps(value)
            scene.attrs["materials"] = json.dumps(self.materials)
            scene.attrs["section"] = self.section
            scene["angles"] = self.angles
            file.create_group("versions").attrs.update(self.versions)
            self._write_bricks(file.create_group("VTKHDF"))
        with new.open("rb") as written:
            os.fsync(written.fileno())
        os.replace(new, path)

    @classmethod
    def read(cls, path: Path) -> LaminateResults:
        """Read a file that `write` made.

        Raises
        ------
        ValueError
            If it is none.
        """
        try:
            with h5py.File(path) as file:
                scene, bricks = file["scene"], file["VTKHDF"]
                plain = {name: str(scene.attrs[name]) for name in ("name", "title", "text", "command")}
                found = cls(
                    scene={**plain, **{name: json.loads(scene.attrs[name]) for name in ("overrides", "resolved")}},
                    materials=json.loads(scene.attrs["materials"]),
                    angles=scene["angles"][:],
                    nodes=bricks["Points"][:],
                    bricks=bricks["Connectivity"][:].reshape(-1, 8),
                    ply=bricks["CellData/Ply"][:],
                    section=float(scene.attrs["section"]),
                    series={name: file["series"][name][:].tolist() for name in SERIES},
                    new_failures=list(file["new_failures"][:]),
                    layer_damage=list(file["layer_damage"][:]),
                    watched=WatchedPlaces.read(file["watched"]) if "watched" in file else None,
                    events=[json.loads(event) for event in file["events"][:]],
                    versions={name: str(value) for name, value in file["versions"].attrs.items()},
                )
                found.frames = found._read_frames(bricks)
        except (OSError, KeyError) as error:
            raise ValueError(f"{path} holds no results of a laminate: {error}") from None
        return found

    def _write_bricks(self, group: h5py.Group) -> None:
        group.attrs["Version"] = np.array([2, 0], dtype=np.int64)
        kind = b"UnstructuredGrid"
        group.attrs.create("Type", kind, dtype=h5py.string_dtype("ascii", len(kind)))
        count, nodes, frames = len(self.bricks), len(self.nodes), self.frames
        group["NumberOfPoints"] = np.array([nodes], dtype=np.int64)
        group["NumberOfCells"] = np.array([count], dtype=np.int64)
        group["NumberOfConnectivityIds"] = np.array([8 * count], dtype=np.int64)
        group["Points"] = self.nodes
        group["Types"] = np.full(count, _VTK_HEXAHEDRON, dtype=np.uint8)
        group["Connectivity"] = self.bricks.reshape(-1)
        group["Offsets"] = 8 * np.arange(count + 1, dtype=np.int64)
        points, cells = group.create_group("PointData"), group.create_group("CellData")
        cells["Ply"] = self.ply
        if not frames:
            return
        steps = group.create_group("Steps")
        steps.attrs["NSteps"] = len(frames)
        # One mesh for all: every step reads the same part from its start.
        steps["Values"] = np.array([frame.strain for frame in frames])
        steps["Increment"] = np.array([frame.step for frame in frames], dtype=np.int64)
        still = np.zeros(len(frames), dtype=np.int64)
        for name in ("PartOffsets", "PointOffsets"):
            steps[name] = still
        steps["NumberOfParts"] = still + 1
        for name in ("CellOffsets", "ConnectivityIdOffsets"):
            steps[name] = still[:, None]
        rows = np.arange(len(frames), dtype=np.int64)
        point_offsets, cell_offsets = steps.create_group("PointDataOffsets"), steps.create_group("CellDataOffsets")
        cell_offsets["Ply"] = still
        points["Displacement"] = np.concatenate([frame.displacement for frame in frames])
        point_offsets["Displacement"] = rows * nodes
        cells["Stress"] = np.concatenate([frame.stress[:, _TO_VTK] for frame in frames])
        cells["VonMises"] = np.concatenate([frame.von_mises() for frame in frames])
        cell_offsets["Stress"] = cell_offsets["VonMises"] = rows * count
        for place in range(len(self.materials)):
            name = self._failed_name(place)
            cells[name] = np.concatenate([frame.failed[:, place] for frame in frames])
            cell_offsets[name] = rows * count

    def _failed_name(self, place: int) -> str:
        """Name of a field; a slash in the name of a material would be a group of the file."""
        return "Failed_" + self.materials[place].replace("/", "_")

    def _read_frames(self, group: h5py.Group) -> list[Frame]:
        if "Steps" not in group:
            return []
        strains, steps = group["Steps/Values"][:], group["Steps/Increment"][:]
        count = len(strains)
        displacement = group["PointData/Displacement"][:].reshape(count, -1, 3)
        stress = np.ascontiguousarray(group["CellData/Stress"][:].reshape(count, -1, 6)[:, :, _FROM_VTK])
        parts = [group[f"CellData/{self._failed_name(place)}"][:] for place in range(len(self.materials))]
        failed = np.stack([part.reshape(count, -1) for part in parts], axis=-1)
        return [
            Frame(int(step), float(strain), displacement[k], stress[k], failed[k])
            for k, (step, strain) in enumerate(zip(steps, strains, strict=True))
        ]
