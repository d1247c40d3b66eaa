"""What a scene asks to have measured on its atoms during the run: J at the crack tip, fields."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from coordinator.atomistic_request import crack_cut, grid_request
from coordinator.atomistic_tables import Fields, JIntegral
from coordinator.region import Region
from coordinator.scene import Scene
from coordinator.series import series_name
from protocol import atomistic as a
from protocol.arrays import FloatArray
from protocol.errors import ProtocolError
from protocol.messages import FieldsReply, FieldsRequest


@dataclass(frozen=True)
class Grid:
    """A regular grid.

    Attributes
    ----------
    origin : tuple of float
        The first point, m.
    spacing : float
        From point to point, m.
    counts : tuple of int
        Points along x, y, z.
    """

    origin: tuple[float, float, float]
    spacing: float
    counts: tuple[int, int, int]


@dataclass(frozen=True)
class MeasuredFields:
    """Fields of the atoms, means since the last ones.

    Attributes
    ----------
    atoms : dict of str to float64 array, shape (atoms, ...)
        Of each atom by name, SI.
    grid : Grid or None
        None where there is none.
    on_grid : dict of str to float64 array, shape (x, y, z, ...)
        Averages around the points of the grid, SI.
    """

    atoms: dict[str, FloatArray]
    grid: Grid | None
    on_grid: dict[str, FloatArray]


class AtomMeasurements:
    """Takes what a scene asks for from the atomistic service.

    Parameters
    ----------
    scene : Scene
    region : Region
        Configured.
    alone : bool
        Whether it is the only region of the scene; else the names of its series end with its own.

    Attributes
    ----------
    notes : list of str
        What a user should know.
    """

    def __init__(self, scene: Scene, region: Region, alone: bool = True) -> None:
        self.notes: list[str] = []
        self._scene = scene
        self._region = region
        self._alone = alone
        self._client = region.client
        position = region.own_reference
        self._grid = grid_request(scene, position.min(axis=0), position.max(axis=0))

    def take(self, step: int, values: dict[str, float], cracked: bool = True) -> MeasuredFields | None:
        """Measure what is due at a step: J goes into `values` where a tip is among the atoms; fields are returned."""
        table = self._scene.atomistic
        assert table is not None
        fields, j = table.fields, table.j
        measured = None
        # Fields come first, since the answer of J begins a new average.
        if fields is not None and step % fields.interval == 0:
            measured = self._fields(fields, step)
        if j is not None and cracked and step % j.interval == 0:
            found = self._j(j, step)
            values.update({series_name(name, self._region.name, self._alone): value for name, value in found.items()})
        elif measured is not None:
            self._client.call("collect_fields", a.CollectRequest(active=True), a.Collecting, step=step)
        return measured

    def _j(self, table: JIntegral, step: int) -> dict[str, float]:
        cut = crack_cut(self._scene, self._region.frame) if table.tip == "start" else None
        tip = None if cut is None else (cut.tip_x, cut.y)
        request = a.JIntegralRequest(half_sizes=table.half_sizes, tip=tip)
        try:
            found = self._client.call("j_integral", request, a.JIntegral, step=step)
        except ProtocolError as error:
            if error.code != "bad_field" or step == table.interval:
                raise
            # The tip has come so far that a contour leaves the atoms; that is no reason to end the run.
            if not self.notes:
                self.notes.append(f"J could not be measured at step {step}: {error.report.sentence}")
            return {}
        values: dict[str, float] = {"j_tip": self._region.frame.x_to_scene(found.tip[0])}
        for contour in range(len(table.half_sizes)):
            values[f"j_contour_{contour}"] = float(found.contour[contour])
            values[f"j_contour_error_{contour}"] = float(found.standard_error[contour])
            values[f"j_domain_{contour}"] = float(found.domain[contour])
            values[f"j_domain_error_{contour}"] = float(found.domain_error[contour])
        return values

    def _fields(self, table: Fields, step: int) -> MeasuredFields:
        atoms: dict[str, np.ndarray] = {}
        if table.atoms:
            request = FieldsRequest(names=list(table.atoms))
            atoms = self._client.call("fields", request, FieldsReply, step=step).fields
        if self._grid is None:
            return MeasuredFields(atoms, None, {})
        reply = self._client.call("grid_fields", self._grid, a.GridFields, step=step)
        origin = self._region.frame.to_scene(np.array([self._grid.origin]))[0]
        return MeasuredFields(atoms, Grid(tuple(origin), self._grid.spacing, self._grid.counts), reply.fields)
