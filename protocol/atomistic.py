"""Messages of the role `atomistic`: integrate atoms while anchors move, answer averaged reactions."""

from __future__ import annotations

from typing import Annotated, Self

import numpy as np
from pydantic import Field, model_validator

from protocol.arrays import ArraySpec, FloatArray, IntArray
from protocol.messages import (
    Count,
    Finite,
    Message,
    Natural,
    NonNegative,
    Part,
    Positive,
    check_indices,
    wrong,
)


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
    thickness: float = Field(description="[m] thickness to which Pa and kg/m3 refer")


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


class AtomisticConfigure(Message):
    """The whole atomistic problem."""

    force_field: str = Field(description="a name of `capabilities.force_fields`")
    sample: Sample = Field(description="what to build")
    temperature: NonNegative = Field(description="[K] of the run")
    time_step: Positive = Field(description="[s] step of the integration")
    seed: Natural = Field(description="of all random numbers of the run")


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

    @model_validator(mode="after")
    def _indices_and_stiffness(self) -> Self:
        check_indices("anchor_ivc", self.anchor_ivc, None)
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
    temperature: float = Field(description="[K] mean over the reference windows, all atoms")


class AtomisticAdvance(Message):
    """Set the anchors, hold them, integrate `steps` (M) steps."""

    steps: Count = Field(description="M, the window of the average")
    anchor_position: Annotated[FloatArray, ArraySpec("<f8", ("anchors", 3), "m")] = Field(
        description="where the anchors are held, rows as in `register`"
    )
    anchor_velocity: Annotated[FloatArray, ArraySpec("<f8", ("anchors", 3), "m/s")] = Field(
        description="velocity that the damper works against; it does not move the anchors"
    )


class AtomisticAdvanced(Message):
    """Averages over the window (Eq 87) and the state at its end. Forces act on the continuum."""

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
    broken_bonds: Natural = Field(description="bonds of the unloaded sample that are broken now")
    crack_tip: Finite | None = Field(
        default=None, description="[m] x of the tip by connectivity; absent without a crack"
    )
    longest_bond: float = Field(description="[m] length of the longest bond that holds")
    warnings: list[str] = Field(description="what a user should know, one sentence each")
