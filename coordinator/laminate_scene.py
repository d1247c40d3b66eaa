"""Scenes of laminates: a plate of plies that is pulled, with a cell of the microstructure at every point."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from coordinator.layup import Layup, read_layup
from coordinator.scene_checks import Problem
from coordinator.scene_file import SceneError, file_text, problem_line, read_table
from coordinator.table import Count, Name, Number, SceneTable, Table
from coordinator.units import PositiveEnergyPerArea, PositiveLength, PositivePressure, Quantity, Temperature

Share = Annotated[Number, Field(gt=0, le=1)]
PositivePressurePerLength = Annotated[float, Quantity("pressure per length", "positive")]


class Laminate(Table):
    """The plate."""

    layup: Name = Field(description="plies from the lowest up, such as [45/0/-45/90]2s")
    ply_thickness: PositiveLength = Field(description="of each ply, m")
    length: PositiveLength = Field(description="along x, in which it is pulled, m")
    width: PositiveLength = Field(description="along y, m")
    hole_diameter: PositiveLength | None = Field(default=None, description="of a round hole in the middle, m")
    temperature: Temperature = Field(default=300.0, description="of the whole run, K")
    symmetry: bool = Field(
        default=True, description="model only the part that the planes of symmetry of plate and layup leave"
    )


class Mesh(Table):
    """How the plate is divided."""

    around: Count | None = Field(default=None, description="elements round a quarter of the hole, even")
    radial: Count | None = Field(default=None, description="elements from the hole to the square round it")
    growth: Annotated[Number, Field(gt=0)] = Field(default=1.0, description="of elements from the hole outwards")
    beyond: Annotated[int, Field(strict=True, ge=0)] = Field(
        default=0, description="columns of elements between the square and each end"
    )
    columns: Count | None = Field(default=None, description="elements along x, without a hole")
    rows: Count | None = Field(default=None, description="elements along y, without a hole")
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
    stop_below: Annotated[Number, Field(ge=0, lt=1)] = Field(
        default=0.0, description="the run ends when the force has fallen below this part of its peak"
    )


class Micromechanics(Table):
    """The cell at every point, and who answers for it."""

    cell: Name = Field(description="cell file, relative to the scene")
    backend: Name = Field(default="gmc_service", description="of the role micromechanics")
    workers: Count = Field(default=1, description="processes that share its work")
    failure: bool = Field(default=True, description="whether subcells fail")


class Structure(Table):
    """Who solves for the plate."""

    backend: Name = Field(default="fem_service", description="of the role structure")


class Output(Table):
    """What is written."""

    fields_every: Count = Field(default=5, description="increments between fields of the whole plate")


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
    return scene


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
        hole = laminate.hole_diameter
        needed, other = (("around", "radial"), ("columns", "rows"))
        if "laminate.hole_diameter" not in tables:
            needed, other = other, needed
        kind = "with a hole" if "laminate.hole_diameter" in tables else "without a hole"
        problems += [(("mesh", name), f"is missing; a plate {kind} needs it") for name in needed
                     if f"mesh.{name}" not in tables]  # fmt: skip
        problems += [(("mesh", name), f"a plate {kind} has none") for name in other if f"mesh.{name}" in tables]
        if mesh.around is not None and mesh.around % 2:
            problems.append((("mesh", "around"), "must be even"))
        if laminate.length is not None and laminate.width is not None:
            longer = laminate.length > laminate.width * (1.0 + 1e-9)
            if hole is not None and not hole < laminate.width:
                problems.append((("laminate", "hole_diameter"), "must be less than the width"))
            if hole is not None and laminate.length < laminate.width * (1.0 - 1e-9):
                problems.append((("laminate", "length"), "must be at least the width, where there is a hole"))
            elif hole is not None and mesh.beyond is not None and longer != (mesh.beyond > 0):
                wanted = "at least 1, since the plate is longer than wide" if longer else "0, since the plate is square"
                problems.append((("mesh", "beyond"), f"must be {wanted}"))
    sizes = () if load is None else (load.least, load.first, load.most)
    if sizes and None not in sizes and sorted(sizes) != list(sizes):
        problems.append((("load", "first"), "must lie between load.least and load.most"))
    return problems


def radians(angles: Sequence[float]) -> list[float]:
    """Angles in rad."""
    return [math.radians(angle) for angle in angles]
