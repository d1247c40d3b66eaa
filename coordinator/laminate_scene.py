"""Scenes of laminates: a plate of plies that is pulled, with a cell of the microstructure at every point."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, PrivateAttr

from coordinator.given_plane import GivenPlane, read_given_plane
from coordinator.layup import Layup, read_layup
from coordinator.micromechanics_table import Micromechanics
from coordinator.scene_checks import Problem
from coordinator.scene_file import SceneError, file_text, problem_line, read_table
from coordinator.table import Count, Name, Number, SceneTable, Table
from coordinator.units import (
    LENGTHS,
    Length,
    PositiveEnergyPerArea,
    PositiveLength,
    PositivePressure,
    Quantity,
    Temperature,
    readable,
)

Share = Annotated[Number, Field(gt=0, le=1)]
PositiveEnergy = Annotated[float, Quantity("energy", "positive")]
PositivePressurePerLength = Annotated[float, Quantity("pressure per length", "positive")]


class Laminate(Table):
    """The plate."""

    layup: Name = Field(description="plies from the lowest up, such as [45/0/-45/90]2s")
    ply_thickness: PositiveLength = Field(description="of each ply, m")
    length: PositiveLength = Field(description="along x, in which it is pulled, m")
    width: PositiveLength = Field(description="along y, m")
    hole_diameter: PositiveLength | None = Field(default=None, description="of a round hole in the middle, m")
    notch_diameter: PositiveLength | None = Field(
        default=None, description="of half-round notches in the middle of both sides, m"
    )
    temperature: Temperature = Field(default=300.0, description="of the whole run, K")
    symmetry: bool = Field(
        default=True, description="model only the part that the planes of symmetry of plate and layup leave"
    )


class Mesh(Table):
    """How the plate is divided: by the other keys, or as a file says."""

    file: Name | None = Field(
        default=None, description="file of another program with quadrilaterals of the plate, relative to the scene"
    )
    file_unit: Literal["m", "cm", "mm", "um", "inch"] = Field(default="mm", description="of lengths in the file")
    around: Count | None = Field(
        default=None, description="elements round a quarter of the hole, or half of a notch, even"
    )
    radial: Count | None = Field(default=None, description="elements from the hole or notch to the square round it")
    growth: Annotated[Number, Field(gt=0)] = Field(default=1.0, description="of elements from the hole outwards")
    beyond: Annotated[int, Field(strict=True, ge=0)] = Field(
        default=0, description="columns of elements between the square and each end"
    )
    columns: Count | None = Field(default=None, description="elements along x, without hole and notches")
    rows: Count | None = Field(default=None, description="elements along y, without hole and notches")
    bricks_per_ply: Count = Field(default=1, description="elements through a ply")
    integration: Literal["full", "selective"] = Field(
        default="full", description="selective: the volumetric strain of an element is its mean"
    )


class Cohesive(Table):
    """Layers between plies of different angle (Table 6.6)."""

    stiffness: PositivePressurePerLength = Field(description="K, Pa/m")
    normal_strength: PositivePressure = Field(description="Y_t, Pa")
    shear_strength: PositivePressure = Field(description="S, Pa")
    opening_toughness: PositiveEnergyPerArea = Field(description="G_Ic, J/m^2")
    sliding_toughness: PositiveEnergyPerArea = Field(description="G_IIc, J/m^2")
    mix_exponent: Annotated[Number, Field(gt=0)] = Field(default=1.0, description="alpha of Benzeggagh and Kenane")


class Load(Table):
    """How far and in which increments the plate is pulled."""

    final_strain: Annotated[Number, Field(gt=0)] = Field(description="elongation over length at the end")
    first: Share = Field(default=0.02, description="first increment, a part of the whole load")
    least: Share = Field(default=1e-5, description="increment below which the run is given up")
    most: Share = Field(default=0.05, description="largest increment")
    tolerance: Annotated[Number, Field(gt=0, lt=1)] = Field(
        default=1e-6, description="largest force out of balance over the largest force"
    )
    iterations: Count = Field(default=100, description="solutions after which an increment is halved")
    viscosity: Annotated[Number, Field(ge=0)] = Field(
        default=0.0, description="part of the whole load over which the damage of cohesive layers follows"
    )
    dissipation: PositiveEnergy | None = Field(
        default=None, description="energy that an increment takes where the laminate softens, J; absent: none is set"
    )
    stop_below: Annotated[Number, Field(ge=0, lt=1)] = Field(
        default=0.0, description="the run ends when the force has fallen below this part of its peak"
    )


class Structure(Table):
    """Who solves for the plate."""

    backend: Name = Field(default="fem_service", description="of the role structure")


class Place(Table):
    """A place of the plate where the microstructure is watched: the brick there, or the nearest one."""

    x: Length = Field(description="along the pull, from the middle of the plate, m")
    y: Length = Field(description="across the pull, from the middle of the plate, m")
    ply: Count = Field(description="counted from the lowest, which is 1")


class Output(Table):
    """What is written."""

    fields_every: Count = Field(default=5, description="increments between fields of the whole plate")
    watched: list[Place] = Field(
        default_factory=list, description="places where the stress of each subcell is written after every increment"
    )


class LaminateScene(SceneTable):
    """A scene with a table ``[laminate]``."""

    title: str = Field(default="", description="a line for people")
    laminate: Laminate = Field(description="the plate")
    mesh: Mesh = Field(description="elements")
    load: Load = Field(description="the pull")
    micromechanics: Micromechanics = Field(description="the cell at every point")
    cohesive: Cohesive | None = Field(default=None, description="absent: plies are tied")
    structure: Structure = Field(default_factory=Structure, description="the solver")
    output: Output = Field(default_factory=Output, description="what is written")
    _plane: GivenPlane | None = PrivateAttr(default=None)

    @property
    def plane(self) -> GivenPlane | None:
        """The mesh of the plane, where a file gives it."""
        return self._plane

    @property
    def cell_file(self) -> Path:
        """The cell file."""
        return self.folder / self.micromechanics.cell

    @property
    def layup(self) -> Layup:
        """The plies."""
        return read_layup(self.laminate.layup)

    @property
    def quarter(self) -> bool:
        """Whether the planes x = 0 and y = 0 are planes of symmetry that are used."""
        return self.can_be_quartered and (self._plane is None or self._plane.quarter)

    @property
    def can_be_quartered(self) -> bool:
        """Whether the planes x = 0 and y = 0 are planes of symmetry that may be used."""
        return self.laminate.symmetry and all(angle % 90.0 == 0.0 for angle in self.layup.angles)

    @property
    def lower_half(self) -> bool:
        """Whether the middle plane is a plane of symmetry that is used."""
        angles = self.layup.angles
        return self.laminate.symmetry and self.layup.is_symmetric and len(angles) % 2 == 0

    @property
    def modelled_angles(self) -> tuple[float, ...]:
        """Angles of the plies that are modelled, degrees."""
        return self.layup.half() if self.lower_half else self.layup.angles

    def modelled_place(self, place: Place) -> tuple[float, float, int]:
        """Where a place lies in the part that is modelled: x and y in m, and the ply from 0."""
        x, y = (abs(place.x), abs(place.y)) if self.quarter else (place.x, place.y)
        ply = place.ply - 1
        if self.lower_half:
            ply = min(ply, len(self.layup.angles) - 1 - ply)
        return x, y, ply


def load_laminate(path: str | Path, overrides: Sequence[str] = ()) -> LaminateScene:
    """Read the file of a laminate scene; arguments and errors are those of `coordinator.scene.load_scene`."""
    file = Path(path)
    text = file_text(file)
    scene = read_table(LaminateScene, _checks, text, overrides, str(file))
    scene.of_file(file.stem, text, overrides, file.resolve().parent)
    if not scene.cell_file.is_file():
        values = {"micromechanics": {"cell": scene.micromechanics.cell}}
        where = ("micromechanics", "cell")
        raise SceneError([problem_line(str(file), where, values, f"there is no such file in {scene.folder}")])
    if scene.mesh.file is not None:
        try:
            scene._plane = _given_plane(scene, scene.folder / scene.mesh.file)
        except ValueError as error:
            values = {"mesh": {"file": scene.mesh.file}}
            raise SceneError([problem_line(str(file), ("mesh", "file"), values, str(error))]) from None
    return scene


def _given_plane(scene: LaminateScene, file: Path) -> GivenPlane:
    plate = scene.laminate
    found = read_given_plane(file, scene.mesh.file_unit, scene.structure.backend, plate.length, plate.width)
    if found.quarter and not scene.can_be_quartered:
        raise ValueError(
            "is a quarter of the plate: that needs laminate.symmetry and plies along x or y; a mesh of the whole plate "
            "does not"
        )
    return found


def _checks(scene: Any, tables: set[str]) -> list[Problem]:
    """Checks between fields; `scene` may be a draft of which some fields are None."""
    problems: list[Problem] = []
    laminate, mesh, load = scene.laminate, scene.mesh, scene.load
    if laminate is not None and laminate.layup is not None:
        try:
            read_layup(laminate.layup)
        except ValueError as error:
            problems.append((("laminate", "layup"), str(error)))
    if laminate is not None and mesh is not None and "laminate" in tables:
        problems += _mesh_checks(laminate, mesh, tables)
    if laminate is not None and scene.output is not None:
        problems += _place_checks(laminate, scene.output)
    if load is not None and load.dissipation is not None and load.viscosity:
        problems.append((("load", "dissipation"), "cannot stand beside load.viscosity"))
    sizes = () if load is None else (load.least, load.first, load.most)
    if sizes and None not in sizes and sorted(sizes) != list(sizes):
        problems.append((("load", "first"), "must lie between load.least and load.most"))
    return problems


def _mesh_checks(laminate: Any, mesh: Any, tables: set[str]) -> list[Problem]:
    problems: list[Problem] = []
    if "mesh.file" in tables:
        given = "must be left out: mesh.file gives the mesh"
        keys = ("around", "radial", "growth", "beyond", "columns", "rows")
        problems += [(("mesh", name), given) for name in keys if f"mesh.{name}" in tables]
        problems += [(("laminate", name), f"{given}, holes included") for name in ("hole_diameter", "notch_diameter")
                     if f"laminate.{name}" in tables]  # fmt: skip
        return problems
    if "mesh.file_unit" in tables:
        problems.append((("mesh", "file_unit"), "needs mesh.file"))
    rounds = [name for name in ("hole_diameter", "notch_diameter") if f"laminate.{name}" in tables]
    if len(rounds) == 2:
        return [(("laminate", "notch_diameter"), "cannot stand beside laminate.hole_diameter")]
    needed, other = ("around", "radial"), ("columns", "rows")
    kind = "with notches" if "notch_diameter" in rounds else "with a hole"
    if not rounds:
        needed, other, kind = other, needed, "without a hole"
    problems += [(("mesh", name), f"is missing; a plate {kind} needs it") for name in needed
                 if f"mesh.{name}" not in tables]  # fmt: skip
    problems += [(("mesh", name), f"a plate {kind} has none") for name in other if f"mesh.{name}" in tables]
    if mesh.around is not None and mesh.around % 2:
        problems.append((("mesh", "around"), "must be even"))
    diameter = getattr(laminate, rounds[0]) if rounds else None
    if diameter is None or laminate.length is None or laminate.width is None:
        return problems
    longer = laminate.length > laminate.width * (1.0 + 1e-9)
    if not diameter < laminate.width:
        problems.append((("laminate", rounds[0]), "must be less than the width"))
    if laminate.length < laminate.width * (1.0 - 1e-9):
        problems.append((("laminate", "length"), f"must be at least the width of a plate {kind}"))
    elif mesh.beyond is not None and longer != (mesh.beyond > 0):
        wanted = "at least 1, since the plate is longer than wide" if longer else "0, since the plate is square"
        problems.append((("mesh", "beyond"), f"must be {wanted}"))
    return problems


def _place_checks(laminate: Any, output: Any) -> list[Problem]:
    problems: list[Problem] = []
    plies = None
    if laminate.layup is not None:
        with contextlib.suppress(ValueError):  # which is told of already
            plies = len(read_layup(laminate.layup).angles)
    for number, place in enumerate(output.watched or ()):
        for name, extent in (("x", laminate.length), ("y", laminate.width)):
            value = getattr(place, name)
            if value is not None and extent is not None and abs(value) > 0.5 * extent * (1.0 + 1e-9):
                side = readable(0.5 * extent, LENGTHS)
                problems.append((("output", "watched", number, name), f"must lie between -{side} and {side}"))
        if plies is not None and place.ply is not None and place.ply > plies:
            problems.append((("output", "watched", number, "ply"), f"must be 1 to {plies}"))
    return problems


def radians(angles: Sequence[float]) -> list[float]:
    """Angles in rad."""
    return [math.radians(angle) for angle in angles]
