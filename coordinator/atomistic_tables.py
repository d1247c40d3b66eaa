"""Tables of a scene file that say what the atoms are and what is measured on them. SI once read."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from coordinator.table import Count, Name, Table
from coordinator.units import PositiveLength, PositiveTime, Pressure, Temperature, Time

#: Files of samples end like this; another name is that of a sample that the service holds.
FILE_ENDINGS = (".data", ".data.gz", ".lmp", ".lmp.gz")


class Commands(Table):
    """A force field of the user's own, as LAMMPS commands."""

    unit_style: Literal["metal", "real"] = Field(description="units of the numbers in the lines")
    atom_style: Literal["atomic", "charge", "full"] = "atomic"
    lines: list[Name] = Field(min_length=1, description="commands that set styles and coefficients")


class Ensemble(Table):
    """Bath of all atoms while they are equilibrated."""

    thermostat: Literal["langevin", "nose-hoover", "berendsen", "andersen"]
    damping_time: PositiveTime = Field(default=1e-13, description="s")
    pressure: Pressure | None = Field(default=None, description="that the box follows along z, Pa; absent: it stays")
    pressure_time: PositiveTime = Field(default=1e-12, description="s")
    keep: bool = Field(default=False, strict=True, description="whether it stays on in the coupled run")


class JIntegral(Table):
    """J at the crack tip, from the atoms."""

    interval: Count = Field(description="coupling steps between two values, each of the mean over them")
    half_sizes: list[PositiveLength] = Field(min_length=1, description="from the tip to the sides of each contour, m")
    tip: Literal["tracked", "start"] = Field(
        default="tracked", description="contours follow the tip that the bonds show, or stay where it was at the start"
    )


class Fields(Table):
    """Fields of the atoms, averaged over time, and over space on a grid."""

    interval: Count = Field(description="coupling steps between two frames, each of the mean over them")
    atoms: list[Literal["displacement", "velocity", "stress", "energy"]] = Field(default=[], description="of each atom")
    spacing: PositiveLength | None = Field(default=None, description="of the grid, m; absent: no grid")
    radius: PositiveLength | None = Field(default=None, description="of the average around a point, m")


class Atomistic(Table):
    """The atomistic sample, centred on the origin."""

    backend: Name = "md_service"
    ranks: Count = Field(default=1, description="MPI processes")
    force_field: Name
    commands: Commands | None = Field(default=None, description="absent: force_field is a name that the backend knows")
    material: Name = "graphene"
    sample: Name | None = Field(
        default=None, description="file of a sample, or name of one that the service holds; absent: it is built"
    )
    width: PositiveLength = Field(description="extent along x, m")
    height: PositiveLength = Field(description="extent along y, m")
    layers: Count = Field(default=1, description="layers of a sheet, or cells along z of a crystal")
    orientation: Literal["zigzag", "armchair"] | None = Field(
        default=None, description="direction of graphene along x; absent: zigzag"
    )
    periodic_z: bool | None = Field(
        default=None, strict=True, description="whether the box of `sample` repeats along z; absent: as the file says"
    )
    temperature: Temperature = Field(description="K")
    time_step: PositiveTime = Field(description="s")
    equilibration: Time = Field(default=1e-12, description="time before the reference is measured, s")
    settle: bool = Field(
        default=False, strict=True, description="whether the equilibration may end before, once nothing drifts"
    )
    ensemble: Ensemble | None = Field(default=None, description="absent: the service's own choice")
    hold: Time = Field(
        default=0.0, description="time with the load of the preload held, anchors at rest, before the first step, s"
    )
    reference: PositiveTime = Field(default=1e-12, description="averaging time of the reference force, s")
    j: JIntegral | None = Field(default=None, description="absent: J is not measured")
    fields: Fields | None = Field(default=None, description="absent: positions only")

    @property
    def from_file(self) -> bool:
        """Whether the sample is in a file of the user's."""
        return self.sample is not None and self.sample.endswith(FILE_ENDINGS)

    @property
    def collects(self) -> bool:
        """Whether means over windows are collected."""
        return self.j is not None or self.fields is not None
