"""Messages of the role `atomistic`: integrate atoms while anchors move, answer averaged reactions."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, NonNegativeInt, PositiveInt

from protocol.arrays import ArraySpec, FloatArray, IntArray
from protocol.messages import Finite, Message, NonNegative, Part, Positive


class PropertiesRequest(Message):
    """Measure the constants that the continuum needs, for one material as its force field has it."""

    force_field: str = Field(description="a name of `capabilities.force_fields`")
    material: str = Field(description="a name of `capabilities.materials`")
    temperature: NonNegative = Field(description="K; 0 is a static measurement")
    seed: NonNegativeInt


class Properties(Message):
    """Isotropic constants at zero stress, each with its standard error (0 for a static measurement)."""

    lattice_constant: float = Field(description="nearest-neighbour distance, m")
    lattice_constant_error: float
    young: float = Field(description="Young's modulus, Pa")
    young_error: float
    poisson: float
    poisson_error: float
    density: float = Field(description="kg/m3")
    thickness: float = Field(description="thickness to which Pa and kg/m3 refer, m")


class CrackCut(Part):
    """A crack from the left edge of the sample to `tip_x` at height `y`, made by removing atoms."""

    tip_x: Finite = Field(description="m")
    y: Finite = Field(description="m")


class Sample(Part):
    """A flat sample centred on the origin; the service makes it from the nearest whole cells."""

    material: str = Field(description="a name of `capabilities.materials`")
    width: Positive = Field(description="extent along x, m")
    height: Positive = Field(description="extent along y, m")
    lattice_constant: Positive | None = Field(default=None, description="m; absent: that of the force field at 0 K")
    crack: CrackCut | None = None


class AtomisticConfigure(Message):
    """The whole atomistic problem."""

    force_field: str = Field(description="a name of `capabilities.force_fields`")
    sample: Sample
    temperature: NonNegative = Field(description="K")
    time_step: Positive = Field(description="s")
    seed: NonNegativeInt


class AtomisticConfigured(Message):
    """What was built. Ids are stable names of atoms; rows of all atom arrays are in this order."""

    atom_id: Annotated[IntArray, ArraySpec("<i8", ("atoms",))]
    position: Annotated[FloatArray, ArraySpec("<f8", ("atoms", 3), "m")]
    atom_mass: Annotated[FloatArray, ArraySpec("<f8", ("atoms",), "kg")]
    warnings: list[str]


class AtomisticRegister(Message):
    """Tie atoms to anchor points by springs (Eqs 85-86) and a damper relative to the anchor's velocity.

    The damper of an atom of mass m is m / `damping_time`; above 0 K it is the friction of a Langevin
    thermostat, so the anchored atoms are kept at the temperature of the run.
    """

    atom_id: Annotated[IntArray, ArraySpec("<i8", ("anchors",))]
    anchor_position: Annotated[FloatArray, ArraySpec("<f8", ("anchors", 3), "m")]
    anchor_ivc: Annotated[IntArray, ArraySpec("<i8", ("anchors",))]
    stiffness: Annotated[FloatArray, ArraySpec("<f8", ("anchors",), "N/m")]
    damping_time: Positive | None = Field(default=None, description="s; absent: no damper, no thermostat")


class AtomisticRegistered(Message):
    """The anchors are set."""

    ivcs: int


class EquilibrateRequest(Message):
    """Bring the atoms to temperature with anchors at rest, then measure the reference force f(t0) of Eq 87."""

    steps: NonNegativeInt = Field(description="steps before the measurement")
    windows: PositiveInt = Field(description="windows of the reference average")
    window_steps: PositiveInt = Field(description="M: steps of a window, as in `advance`")


class Equilibrated(Message):
    """Reference forces on the continuum, and how much one window's mean scatters."""

    reference_ivc_force: Annotated[FloatArray, ArraySpec("<f8", ("ivcs", 3), "N")]
    reference_ivc_error: Annotated[FloatArray, ArraySpec("<f8", ("ivcs", 3), "N")] = Field(
        description="standard error of the reference"
    )
    window_ivc_deviation: Annotated[FloatArray, ArraySpec("<f8", ("ivcs", 3), "N")] = Field(
        description="standard deviation of one window's mean"
    )
    temperature: float = Field(description="mean over the reference windows, all atoms, K")


class AtomisticAdvance(Message):
    """Set the anchors, hold them, integrate `steps` (M) steps."""

    steps: PositiveInt
    anchor_position: Annotated[FloatArray, ArraySpec("<f8", ("anchors", 3), "m")]
    anchor_velocity: Annotated[FloatArray, ArraySpec("<f8", ("anchors", 3), "m/s")]


class AtomisticAdvanced(Message):
    """Averages over the window (Eq 87) and the state at its end. Forces act on the continuum."""

    step: NonNegativeInt
    anchor_force: Annotated[FloatArray, ArraySpec("<f8", ("anchors", 3), "N")] = Field(
        description="mean of spring and damper minus the reference"
    )
    ivc_force: Annotated[FloatArray, ArraySpec("<f8", ("ivcs", 3), "N")] = Field(
        description="sum of the anchor forces of each IVC"
    )
    ivc_standard_error: Annotated[FloatArray, ArraySpec("<f8", ("ivcs", 3), "N")]
    temperature: float = Field(description="all atoms, K")
    handshake_temperature: float = Field(description="anchored atoms, K")
    potential_energy: float = Field(description="J, without the springs")
    kinetic_energy: float = Field(description="J")
    spring_energy: float = Field(description="J")
    anchor_work: float = Field(description="work done on the springs by moving anchors since the start, J")
    broken_bonds: int = Field(description="bonds of the unloaded sample that are broken now")
    crack_tip: Finite | None = Field(description="x of the tip by connectivity, m; absent without a crack")
    longest_bond: float = Field(description="m")
    warnings: list[str]
