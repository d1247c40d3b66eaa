"""Parts of the messages of the role `atomistic`: samples, force fields of a user's own, ensembles, drifts."""

from __future__ import annotations

from typing import ClassVar, Literal

from pydantic import Field

from protocol.messages import Count, Finite, Part, Positive, since
from protocol.version import Version

#: Kinds of anchors, by their number on the wire.
SPRING, PASSIVE, SURFACE = 0, 1, 2

Thermostat = Literal["langevin", "nose-hoover", "berendsen", "andersen"]


class CrackCut(Part):
    """A crack from the left edge of the sample to `tip_x` at height `y`, made by removing atoms."""

    tip_x: Finite = Field(description="[m] x of the tip")
    y: Finite = Field(description="[m] height of the crack line")


class Sample(Part):
    """A flat sample centred on the origin; the service makes it from the nearest whole cells."""

    material: str = Field(description="a name of `capabilities.materials`")
    width: Positive = Field(description="[m] extent along x")
    height: Positive = Field(description="[m] extent along y")
    lattice_constant: Positive | None = Field(default=None, description="[m] absent: that of the force field at 0 K")
    crack: CrackCut | None = Field(default=None, description="absent: no crack")
    layers: Count = Field(
        default=1,
        description="layers of a sheet, or cells along z of a crystal, which repeats there",
        json_schema_extra=since(1, 2),
    )
    orientation: Literal["zigzag", "armchair"] | None = Field(
        default=None, description="direction of graphene along x; absent: zigzag", json_schema_extra=since(1, 2)
    )


class SampleFile(Part):
    """A sample in a LAMMPS data file, and what the file does not tell of it."""

    added_in: ClassVar[Version] = Version(1, 2)

    name: str | None = Field(
        default=None,
        description="a name of `capabilities.samples`, which the service holds; absent: the file is `sample_data`",
    )
    periodic_z: bool | None = Field(
        default=None,
        description="whether the box repeats along z; absent: as the file says, if it does; along x and y it is free",
    )
    crack: CrackCut | None = Field(
        default=None, description="the slit that is in the file, from which growth counts; absent: as the file says"
    )


class ForceFieldCommands(Part):
    """A force field of the user's own, as commands of LAMMPS that set styles and coefficients."""

    added_in: ClassVar[Version] = Version(1, 2)

    unit_style: Literal["metal", "real"] = Field(description="units of the numbers in the commands")
    atom_style: Literal["atomic", "charge", "full"] = Field(description="what an atom carries")
    commands: list[str] = Field(
        min_length=1,
        description="`pair_*`, `bond_*`, `angle_*`, `dihedral_*`, `improper_*`, `kspace_*`, `special_bonds`, `mass`,"
        " `set`; files are looked up among the potentials of the service",
    )


class Ensemble(Part):
    """Coupling of all atoms to a bath, at the temperature of the run, beside that of the anchored atoms."""

    added_in: ClassVar[Version] = Version(1, 2)

    thermostat: Thermostat = Field(description="a name of `capabilities.ensembles`")
    damping_time: Positive = Field(default=1e-13, description="[s] relaxation time of the thermostat")
    pressure: Finite | None = Field(
        default=None, description="[Pa] that the periodic directions of the box follow; absent: the box stays"
    )
    pressure_time: Positive = Field(default=1e-12, description="[s] relaxation time of the barostat")


class Drift(Part):
    """How far a quantity still moved over the last part of an equilibration, against what noise alone does."""

    added_in: ClassVar[Version] = Version(1, 2)

    quantity: str = Field(description="such as `energy`")
    drift: float = Field(description="[SI] change over that part, by a straight line")
    standard_error: float = Field(description="[SI] of the drift")
