"""Messages of the role `continuum`: advance a continuum under interface reaction forces."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, NonNegativeInt, PositiveInt

from protocol.arrays import ArraySpec, FloatArray, IntArray
from protocol.messages import Finite, Message, NonNegative, Part, Point2, Positive


class IsotropicMaterial(Part):
    """Linear elastic, isotropic."""

    young: Positive = Field(description="Young's modulus, Pa")
    poisson: float = Field(gt=-1, lt=0.5, description="Poisson's ratio")
    density: Positive = Field(description="kg/m3")


class Rectangle(Part):
    """An axis-parallel rectangle, m."""

    lower: Point2
    upper: Point2


class Overlap(Part):
    """Where continuum and atoms overlap: a ring between two rectangles.

    No continuum is modelled inside `inner`. In the ring, stiffness and mass of the continuum are both
    scaled by `weight`, which leaves its wave speed as it is.
    """

    inner: Rectangle
    outer: Rectangle
    weight: float = Field(gt=0, le=1)


class EdgeCondition(Part):
    """Prescribed displacement of one edge of the body, piecewise linear in time."""

    edge: Literal["left", "right", "bottom", "top"]
    component: Literal[0, 1] = Field(description="0 is x, 1 is y")
    times: list[Finite] = Field(min_length=2, description="s, ascending; constant after the last")
    displacements: list[Finite] = Field(min_length=2, description="m")


class CrackLine(Part):
    """A traction-free crack along a polyline."""

    points: list[Point2] = Field(min_length=2, description="m")


class ContinuumConfigure(Message):
    """The whole continuum problem."""

    assumption: Literal["plane_stress", "plane_strain"]
    thickness: Positive = Field(description="m")
    body: Rectangle
    cell_size: Positive = Field(description="edge of a background cell, m")
    points_per_cell: PositiveInt = Field(description="material points per cell and direction")
    material: IsotropicMaterial
    overlap: Overlap | None = None
    cracks: list[CrackLine] = Field(default_factory=list)
    edges: list[EdgeCondition] = Field(default_factory=list)
    initial_velocity_gradient: tuple[Finite, Finite, Finite, Finite] | None = Field(
        default=None, description="xx, xy, yx, yy, 1/s: initial velocity is this gradient times position"
    )
    damping_rate: NonNegative = Field(default=0.0, description="mass-proportional damping, 1/s")
    time_step: Positive = Field(description="step of `advance`, s")


class ContinuumConfigured(Message):
    """What was built."""

    courant_number: float = Field(description="time step times wave speed over cell size (Eq 31)")
    stable_time_step: float = Field(description="largest stable step, s")
    cells: int = Field(description="cells that hold material")
    position: Annotated[FloatArray, ArraySpec("<f8", ("points", 3), "m")]
    weight: Annotated[FloatArray, ArraySpec("<f8", ("points",))]


class ContinuumRegister(Message):
    """Anchor points, which the continuum carries, and interface volume cells (IVC)."""

    anchor_position: Annotated[FloatArray, ArraySpec("<f8", ("anchors", 3), "m")]
    anchor_ivc: Annotated[IntArray, ArraySpec("<i8", ("anchors",))]
    ivc_lower: Annotated[FloatArray, ArraySpec("<f8", ("ivcs", 3), "m")]
    ivc_upper: Annotated[FloatArray, ArraySpec("<f8", ("ivcs", 3), "m")]


class ContinuumRegistered(Message):
    """Material points found in each IVC; an IVC with anchors but no point is an error."""

    points_in_ivc: Annotated[IntArray, ArraySpec("<i8", ("ivcs",))]


class ContinuumAdvance(Message):
    """Advance under constant reaction forces.

    `ivc_force` is spread equally over the material points of each IVC (Eq 87). `anchor_force` is spread
    with the shape functions that interpolate the anchors' motion. At most one of the two is given.
    """

    steps: PositiveInt
    ivc_force: Annotated[FloatArray, ArraySpec("<f8", ("ivcs", 3), "N")] | None = None
    anchor_force: Annotated[FloatArray, ArraySpec("<f8", ("anchors", 3), "N")] | None = None


class ContinuumAdvanced(Message):
    """State after the steps. Energies in J for the whole thickness."""

    step: NonNegativeInt
    anchor_displacement: Annotated[FloatArray, ArraySpec("<f8", ("anchors", 3), "m")]
    anchor_velocity: Annotated[FloatArray, ArraySpec("<f8", ("anchors", 3), "m/s")]
    edge_force: Annotated[FloatArray, ArraySpec("<f8", ("edges",), "N")] = Field(
        description="force on the body by each edge condition, in its component"
    )
    edge_displacement: Annotated[FloatArray, ArraySpec("<f8", ("edges",), "m")]
    kinetic_energy: float = Field(description="J")
    strain_energy: float = Field(description="J")
    edge_work: float = Field(description="work done by the edges since the start, J")
    interface_work: float = Field(description="work done by the reaction forces since the start, J")
    damping_loss: float = Field(description="energy taken by damping since the start, J")
    points_lost: int = Field(description="points that left the grid since the start")
