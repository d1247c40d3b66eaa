"""Messages of the role `atomistic`: integrate atoms while anchors move, answer averaged reactions."""

from __future__ import annotations

from typing import Annotated, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from protocol.arrays import ArrayMap, ArrayMapSpec, ArraySpec, FloatArray, IntArray
from protocol.atomistic_parts import (
    PASSIVE,
    SPRING,
    SURFACE,
    CrackCut,
    Drift,
    Ensemble,
    ForceFieldCommands,
    Sample,
    SampleFile,
)
from protocol.messages import (
    Count,
    Finite,
    Message,
    Natural,
    NonNegative,
    Point2,
    Point3,
    Positive,
    check_indices,
    since,
    wrong,
)

__all__ = [
    "PASSIVE",
    "SPRING",
    "SURFACE",
    "AtomisticAdvance",
    "AtomisticAdvanced",
    "AtomisticConfigure",
    "AtomisticConfigured",
    "AtomisticRegister",
    "AtomisticRegistered",
    "CollectRequest",
    "Collecting",
    "CrackCut",
    "CutRequest",
    "DisplaceRequest",
    "Displaced",
    "Drift",
    "Ensemble",
    "EquilibrateRequest",
    "Equilibrated",
    "ForceFieldCommands",
    "GridFields",
    "GridFieldsRequest",
    "JIntegral",
    "JIntegralRequest",
    "Properties",
    "PropertiesRequest",
    "Sample",
    "SampleFile",
    "Severed",
]

ByteArray = NDArray[np.uint8]


class PropertiesRequest(Message):
    """Measure the constants that the continuum needs, for one material as its force field has it."""

    force_field: str = Field(description="a name of `capabilities.force_fields`")
    material: str = Field(description="a name of `capabilities.materials`")
    temperature: NonNegative = Field(description="[K] 0 is a static measurement")
    seed: Natural = Field(description="of the random numbers; equal seeds give equal answers")


class Properties(Message):
    """Isotropic constants at zero stress, each with its standard error (0 for a static measurement)."""

    lattice_constant: float = Field(description="[m] nearest-neighbour distance")
    lattice_constant_error: float = Field(description="[m] standard error")
    young: float = Field(description="[Pa] Young's modulus")
    young_error: float = Field(description="[Pa] standard error")
    poisson: float = Field(description="[1] Poisson's ratio")
    poisson_error: float = Field(description="[1] standard error")
    density: float = Field(description="[kg/m3] mass per volume")
    thickness: float = Field(description="[m] thickness of one layer, to which Pa and kg/m3 refer")


class AtomisticConfigure(Message):
    """The whole atomistic problem."""

    force_field: str = Field(description="a name of `capabilities.force_fields`; with `commands` any name")
    sample: Sample | None = Field(default=None, description="what to build; absent only with `sample_file`")
    temperature: NonNegative = Field(description="[K] of the run")
    time_step: Positive = Field(description="[s] step of the integration")
    seed: Natural = Field(description="of all random numbers of the run")
    sample_file: SampleFile | None = Field(
        default=None, description="the sample is the one in `sample_data`", json_schema_extra=since(1, 2)
    )
    sample_data: Annotated[ByteArray, ArraySpec("|u1", ("bytes",))] | None = Field(
        default=None,
        description="a LAMMPS data file, plain or packed by gzip, of a `sample_file` without name",
        json_schema_extra=since(1, 2),
    )
    commands: ForceFieldCommands | None = Field(
        default=None, description="the force field, where it is none of the service's", json_schema_extra=since(1, 2)
    )
    keep: list[Point2] = Field(
        default_factory=list,
        description="[m] corners of a simple polygon; atoms outside it are left out; absent: all stay",
        json_schema_extra=since(1, 3),
    )

    @model_validator(mode="after")
    def _one_sample(self) -> Self:
        if (self.sample is None) == (self.sample_file is None):
            problem = "is missing" if self.sample is None else "is given beside sample_file"
            raise wrong("sample", f"{problem}; give sample, or sample_file with sample_data")
        held = self.sample_file is not None and self.sample_file.name is not None
        if (self.sample_data is not None) != (self.sample_file is not None and not held):
            problem = "is missing" if self.sample_data is None else "is given beside sample, or a name of sample_file"
            raise wrong("sample_data", f"{problem}; it is the file of a sample_file without name")
        return self


class AtomisticConfigured(Message):
    """What was built. Ids are stable names of atoms; rows of all atom arrays are in this order."""

    atom_id: Annotated[IntArray, ArraySpec("<i8", ("atoms",))] = Field(description="unique")
    position: Annotated[FloatArray, ArraySpec("<f8", ("atoms", 3), "m")] = Field(description="of the sample as built")
    atom_mass: Annotated[FloatArray, ArraySpec("<f8", ("atoms",), "kg")] = Field(description="mass of each atom")
    warnings: list[str] = Field(description="what a user should know, one sentence each")


class AtomisticRegister(Message):
    """Tie atoms to anchor points by springs (Eqs 85-86) and a damper relative to the anchor's velocity.

    The damper of an atom of mass m is m / `damping_time`; above 0 K it is the friction of a Langevin
    thermostat, so the anchored atoms are kept at the temperature of the run.
    """

    atom_id: Annotated[IntArray, ArraySpec("<i8", ("anchors",))] = Field(
        description="atom of each anchor; an atom has at most one"
    )
    anchor_position: Annotated[FloatArray, ArraySpec("<f8", ("anchors", 3), "m")] = Field(
        description="where the anchors are at rest"
    )
    anchor_ivc: Annotated[IntArray, ArraySpec("<i8", ("anchors",))] = Field(
        description="row of the IVC that the anchor belongs to, 0 to ivcs - 1"
    )
    stiffness: Annotated[FloatArray, ArraySpec("<f8", ("anchors",), "N/m")] = Field(
        description="of each spring, not negative"
    )
    damping_time: Positive | None = Field(default=None, description="[s] absent: no damper, no thermostat")
    anchor_kind: Annotated[IntArray, ArraySpec("<i8", ("anchors",))] | None = Field(
        default=None, description="0 spring, 1 passive, 2 surface; absent: all springs", json_schema_extra=since(1, 2)
    )
    damping_share: Annotated[FloatArray, ArraySpec("<f8", ("anchors",))] | None = Field(
        default=None,
        description="factor on the damper of each anchor, above 0 and at most 1; absent: 1",
        json_schema_extra=since(1, 3),
    )
    motion: Literal["held", "linear"] = Field(
        default="held",
        description="of the anchors during `advance`: they stand still, or go on with their velocity",
        json_schema_extra=since(1, 2),
    )

    @model_validator(mode="after")
    def _indices_and_stiffness(self) -> Self:
        check_indices("anchor_ivc", self.anchor_ivc, None)
        if self.anchor_kind is not None:
            check_indices("anchor_kind", self.anchor_kind, SURFACE + 1)
        share = self.damping_share
        if share is not None and not ((share > 0) & (share <= 1)).all():
            raise wrong("damping_share", f"holds {share.min():g} to {share.max():g}; allowed is above 0 to 1")
        if (self.stiffness < 0).any():
            raise wrong("stiffness", f"holds {self.stiffness.min():g}; a stiffness is not negative")
        if len(np.unique(self.atom_id)) != len(self.atom_id):
            raise wrong("atom_id", "names an atom twice; an atom has at most one anchor")
        return self


class AtomisticRegistered(Message):
    """The anchors are set."""

    ivcs: Natural = Field(description="number of IVCs: largest `anchor_ivc` plus one, 0 without anchors")


class EquilibrateRequest(Message):
    """Bring the atoms to temperature with anchors at rest, then measure the reference force f(t0) of Eq 87."""

    steps: Natural = Field(description="steps before the measurement")
    windows: Count = Field(
        description="windows of the reference average; a service takes 8 or more, and may refuse fewer"
    )
    window_steps: Count = Field(description="M: steps of a window, as in `advance`")
    ensemble: Ensemble | None = Field(
        default=None,
        description="bath of all atoms during `steps`; absent: the service's own choice",
        json_schema_extra=since(1, 2),
    )
    keep_ensemble: bool = Field(
        default=False,
        description="the bath stays on, also during `advance`; needs `ensemble`",
        json_schema_extra=since(1, 2),
    )
    settle: bool = Field(
        default=False,
        description="`steps` is the most: the equilibration ends once energy and stress drift less than their error",
        json_schema_extra=since(1, 2),
    )

    @model_validator(mode="after")
    def _something_to_keep(self) -> Self:
        if self.keep_ensemble and self.ensemble is None:
            raise wrong("keep_ensemble", "is set, but there is no ensemble to keep")
        return self


class Equilibrated(Message):
    """Reference forces on the continuum, and how much one window's mean scatters."""

    reference_ivc_force: Annotated[FloatArray, ArraySpec("<f8", ("ivcs", 3), "N")] = Field(
        description="mean over all windows; `advance` subtracts it"
    )
    reference_ivc_error: Annotated[FloatArray, ArraySpec("<f8", ("ivcs", 3), "N")] = Field(
        description="standard error of the reference"
    )
    window_ivc_deviation: Annotated[FloatArray, ArraySpec("<f8", ("ivcs", 3), "N")] = Field(
        description="standard deviation of one window's mean"
    )
    reference_anchor_force: Annotated[FloatArray, ArraySpec("<f8", ("anchors", 3), "N")] | None = Field(
        default=None,
        description="mean force on the continuum at each anchor; `advance` subtracts it; absent: not known",
        json_schema_extra=since(1, 3),
    )
    temperature: float = Field(description="[K] mean over the reference windows, all atoms")
    steps_done: Natural | None = Field(
        default=None, description="steps before the measurement; absent: as asked", json_schema_extra=since(1, 2)
    )
    settled: bool | None = Field(
        default=None,
        description="whether all drifts are within their errors; absent without `settle`",
        json_schema_extra=since(1, 2),
    )
    drifts: list[Drift] = Field(
        default_factory=list,
        description="drifts over the last part, with `settle`",
        json_schema_extra=since(1, 2),
    )


class AtomisticAdvance(Message):
    """Set the anchors, hold them (or let them move), integrate `steps` (M) steps."""

    steps: Count = Field(description="M, the window of the average")
    anchor_position: Annotated[FloatArray, ArraySpec("<f8", ("anchors", 3), "m")] = Field(
        description="where the anchors are held, rows as in `register`"
    )
    anchor_velocity: Annotated[FloatArray, ArraySpec("<f8", ("anchors", 3), "m/s")] = Field(
        description="velocity that the damper works against; it moves the anchors only where `motion` is linear"
    )
    until_error: Positive | None = Field(
        default=None,
        description="[N] further windows are run until no `ivc_standard_error` is above it; absent: one window",
        json_schema_extra=since(1, 2),
    )
    most_windows: Count = Field(
        default=1, description="windows at most, with `until_error`", json_schema_extra=since(1, 2)
    )


class AtomisticAdvanced(Message):
    """Averages over the window (Eq 87) and the state at its end. Forces act on the continuum.

    A mean counts the moments at the window's start (with the anchors in their new places) and at its end by half, as a
    Verlet integrator's kicks do: it is the impulse on the atoms over the window's length. A mean over steps 1 to M is
    half a step late, and feeds energy into the exchange.
    """

    step: Natural = Field(description="step counter of the solver")
    anchor_force: Annotated[FloatArray, ArraySpec("<f8", ("anchors", 3), "N")] = Field(
        description="mean of spring and damper minus the reference"
    )
    ivc_force: Annotated[FloatArray, ArraySpec("<f8", ("ivcs", 3), "N")] = Field(
        description="sum of the anchor forces of each IVC"
    )
    ivc_standard_error: Annotated[FloatArray, ArraySpec("<f8", ("ivcs", 3), "N")] = Field(
        description="standard error of `ivc_force`"
    )
    temperature: float = Field(description="[K] all atoms")
    handshake_temperature: float = Field(description="[K] anchored atoms")
    potential_energy: float = Field(description="[J] without the springs")
    kinetic_energy: float = Field(description="[J] of all atoms")
    spring_energy: float = Field(description="[J] in the springs of the anchors")
    anchor_work: float = Field(
        description="[J] work that springs, dampers and thermostat did on the atoms since configure"
    )
    thermostat_work: float | None = Field(
        default=None,
        description="[J] the part of `anchor_work` that is none of the springs'; absent: not known",
        json_schema_extra=since(1, 2),
    )
    windows: Count = Field(default=1, description="windows that the averages are over", json_schema_extra=since(1, 2))
    correlation_time: NonNegative | None = Field(
        default=None,
        description="[s] of the forces, the longest of all IVCs; absent: not known",
        json_schema_extra=since(1, 2),
    )
    momentum: Point3 | None = Field(
        default=None, description="[kg m/s] of all atoms; absent: not known", json_schema_extra=since(1, 3)
    )
    broken_bonds: Natural = Field(description="bonds of the unloaded sample that are broken now")
    crack_tip: Finite | None = Field(
        default=None, description="[m] x of the tip by connectivity; absent without a crack"
    )
    longest_bond: float = Field(description="[m] length of the longest bond that holds")
    longest_bond_atoms: Annotated[tuple[Natural, Natural], Field(strict=False)] | None = Field(
        default=None, description="ids of its atoms; absent: not known", json_schema_extra=since(1, 2)
    )
    warnings: list[str] = Field(description="what a user should know, one sentence each")


class CollectRequest(Message):
    """Start or stop to collect fields at the ends of windows; starting forgets what was collected."""

    active: bool = Field(description="whether to collect")


class Collecting(Message):
    """The switch is set."""

    step: Natural = Field(description="step counter of the solver")


class GridFieldsRequest(Message):
    """Ask for averages of atoms around the points of a regular grid (Hardy)."""

    names: list[str] = Field(min_length=1, description="each one of `capabilities.grid_fields`")
    origin: Point3 = Field(description="[m] the first point")
    spacing: Positive = Field(description="[m] from point to point, along each axis")
    counts: Annotated[tuple[Count, Count, Count], Field(strict=False)] = Field(
        description="points along x, y, z; one along z for a flat sample"
    )
    radius: Positive = Field(description="[m] reach of the average around a point")


class GridFields(Message):
    """One array a name, with the counts of the grid as its first three axes, then components."""

    step: Natural = Field(description="step counter of the solver")
    samples: Natural = Field(description="windows that were collected for it; 0: the values are of this moment")
    fields: Annotated[ArrayMap, ArrayMapSpec()] = Field(description="frame `fields.NAME` for each name asked for")


class JIntegralRequest(Message):
    """Ask for J at a crack tip from the atoms, by square contours and by domains inside them (Eqs 63-78)."""

    half_sizes: list[Positive] = Field(min_length=1, description="[m] from the tip to the sides of each contour")
    tip: Point2 | None = Field(default=None, description="[m] in the unloaded sample; absent: as the bonds show it")


class JIntegral(Message):
    """J of the means collected since collecting began or since the last answer."""

    step: Natural = Field(description="step counter of the solver")
    samples: Natural = Field(description="windows that were collected for it")
    tip: Point2 = Field(description="[m] that the contours are around")
    contour: Annotated[FloatArray, ArraySpec("<f8", ("contours",), "J/m^2")] = Field(
        description="J of each contour, in the order asked for"
    )
    standard_error: Annotated[FloatArray, ArraySpec("<f8", ("contours",), "J/m^2")] = Field(
        description="of `contour`, from the noise of the atoms; 0 where it is not known"
    )
    domain: Annotated[FloatArray, ArraySpec("<f8", ("contours",), "J/m^2")] = Field(
        description="J once more, as an integral over a domain inside each contour"
    )
    domain_error: Annotated[FloatArray, ArraySpec("<f8", ("contours",), "J/m^2")] = Field(
        description="of `domain`, likewise"
    )


class DisplaceRequest(Message):
    """Move all atoms and all anchors at once, as a load does that is there from the start.

    Velocities, the reference force and all counters stay; the energy that it puts into the atoms is no work of
    the anchors.
    """

    displacement: Annotated[FloatArray, ArraySpec("<f8", ("atoms", 3), "m")] = Field(
        description="added to the position of each atom, rows as in `configured`"
    )
    anchor_position: Annotated[FloatArray, ArraySpec("<f8", ("anchors", 3), "m")] = Field(
        description="where the anchors are after it, rows as in `register`"
    )


class Displaced(Message):
    """The atoms are at their new places."""

    step: Natural = Field(description="step counter of the solver")


class CutRequest(Message):
    """Sever the atoms along a line: those on one side no longer act on those on the other.

    The line lies at height `y` from `from_x` to `to_x` in the undeformed sample. It may begin where an earlier
    cut, or the crack of the sample, ended. `crack_tip` goes on from its end.
    """

    from_x: Finite = Field(description="[m] where the line begins; left of all atoms: it cuts through the edge")
    to_x: Finite = Field(description="[m] where it ends, right of `from_x`")
    y: Finite = Field(description="[m] its height, between rows of atoms")


class Severed(Message):
    """The atoms are severed."""

    step: Natural = Field(description="step counter of the solver")
    bonds: Natural = Field(description="bonds of the unloaded sample that the line crosses")
    energy: float = Field(description="[J] change of the potential energy at that moment")
