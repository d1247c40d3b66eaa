"""Messages of the role `continuum`: advance a continuum under interface reaction forces."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from protocol.arrays import ArraySpec, FloatArray, IntArray
from protocol.messages import (
    Count,
    Finite,
    Integer,
    Message,
    Natural,
    NonNegative,
    Part,
    Point2,
    Positive,
    check_ascending,
    check_indices,
    wrong,
)


class IsotropicMaterial(Part):
    """Linear elastic, isotropic."""

    young: Positive = Field(description="[Pa] Young's modulus")
    poisson: float = Field(gt=-1, lt=0.5, description="[1] Poisson's ratio")
    density: Positive = Field(description="[kg/m3] mass per volume")


class Rectangle(Part):
    """An axis-parallel rectangle, m."""

    lower: Point2 = Field(description="[m] x, y of the lower left corner")
    upper: Point2 = Field(description="[m] x, y of the upper right corner, each above `lower`")

    @model_validator(mode="after")
    def _has_an_inside(self) -> Self:
        if not (self.lower[0] < self.upper[0] and self.lower[1] < self.upper[1]):
            raise wrong("upper", f"{list(self.upper)} is not above lower {list(self.lower)} in x and y")
        return self


class Overlap(Part):
    """Where continuum and atoms overlap: a ring between two rectangles.

    No continuum is modelled inside `inner`. In the ring, stiffness and mass of the continuum are both
    scaled by `weight`, which leaves its wave speed as it is.
    """

    inner: Rectangle = Field(description="atoms only: no material points inside")
    outer: Rectangle = Field(description="holds `inner`; outside it is continuum only")
    weight: float = Field(gt=0, le=1, description="[1] factor on stiffness and mass of the continuum in the ring")

    @model_validator(mode="after")
    def _outer_holds_inner(self) -> Self:
        for axis in (0, 1):
            if self.inner.lower[axis] < self.outer.lower[axis] or self.inner.upper[axis] > self.outer.upper[axis]:
                raise wrong("inner", f"reaches beyond outer along {'xy'[axis]}")
        return self


class EdgeCondition(Part):
    """Prescribed displacement of one edge of the body, piecewise linear in time."""

    edge: Literal["left", "right", "bottom", "top"] = Field(description="edge of `body`")
    component: Literal[0, 1] = Field(description="0 is x, 1 is y")
    times: list[Finite] = Field(
        min_length=2, description="[s] ascending; the displacement is constant before the first and after the last"
    )
    displacements: list[Finite] = Field(min_length=2, description="[m] one for each of `times`")

    @model_validator(mode="after")
    def _is_a_table(self) -> Self:
        if len(self.times) != len(self.displacements):
            raise wrong("displacements", f"has {len(self.displacements)} entries, times has {len(self.times)}")
        check_ascending("times", self.times)
        return self


class CrackLine(Part):
    """A traction-free crack along a polyline."""

    points: list[Point2] = Field(min_length=2, description="[m] x, y of each corner of the line")


class ContinuumConfigure(Message):
    """The whole continuum problem."""

    assumption: Literal["plane_stress", "plane_strain"] = Field(description="how the third direction behaves")
    thickness: Positive = Field(description="[m] extent of the body along z")
    body: Rectangle = Field(description="reference shape of the body")
    cell_size: Positive = Field(description="[m] edge of a background cell")
    points_per_cell: Count = Field(description="material points per cell and direction")
    material: IsotropicMaterial = Field(description="one material for the whole body")
    overlap: Overlap | None = Field(default=None, description="absent: continuum everywhere in `body`")
    cracks: list[CrackLine] = Field(default_factory=list, description="absent or empty: no crack")
    edges: list[EdgeCondition] = Field(default_factory=list, description="an edge without a condition is free")
    initial_velocity_gradient: Annotated[tuple[Finite, Finite, Finite, Finite], Field(strict=False)] | None = Field(
        default=None, description="[1/s] xx, xy, yx, yy: the initial velocity is this gradient times position"
    )
    damping_rate: NonNegative = Field(
        default=0.0, description="[1/s] mass-proportional damping: a free velocity decays as exp(-rate t)"
    )
    time_step: Positive = Field(description="[s] step of `advance`")


class ContinuumConfigured(Message):
    """What was built."""

    courant_number: float = Field(description="[1] time step times wave speed over cell size (Eq 31)")
    stable_time_step: float = Field(description="[s] largest stable step")
    cells: Integer = Field(description="cells that hold material")
    position: Annotated[FloatArray, ArraySpec("<f8", ("points", 3), "m")] = Field(
        description="reference positions of the material points; rows of all point fields are in this order"
    )
    weight: Annotated[FloatArray, ArraySpec("<f8", ("points",))] = Field(
        description="`overlap.weight` for points in the ring, 1 elsewhere, the mean over its domain for a point across"
    )


class ContinuumRegister(Message):
    """Anchor points, which the continuum carries, and interface volume cells (IVC)."""

    anchor_position: Annotated[FloatArray, ArraySpec("<f8", ("anchors", 3), "m")] = Field(
        description="reference positions, inside the body"
    )
    anchor_ivc: Annotated[IntArray, ArraySpec("<i8", ("anchors",))] = Field(
        description="row of the IVC that the anchor belongs to, 0 to ivcs - 1"
    )
    ivc_lower: Annotated[FloatArray, ArraySpec("<f8", ("ivcs", 3), "m")] = Field(
        description="lower corners of the IVC boxes in the reference shape"
    )
    ivc_upper: Annotated[FloatArray, ArraySpec("<f8", ("ivcs", 3), "m")] = Field(
        description="upper corners, above the lower ones in x and y"
    )

    @model_validator(mode="after")
    def _indices_and_boxes(self) -> Self:
        check_indices("anchor_ivc", self.anchor_ivc, len(self.ivc_lower))
        for ivc, (lower, upper) in enumerate(zip(self.ivc_lower, self.ivc_upper, strict=True)):
            if not (lower[0] < upper[0] and lower[1] < upper[1]):
                raise wrong("ivc_upper", f"row {ivc} {upper.tolist()} is not above ivc_lower {lower.tolist()}")
        return self


class ContinuumRegistered(Message):
    """Material points found in each IVC; an IVC with anchors but no point is an error."""

    points_in_ivc: Annotated[IntArray, ArraySpec("<i8", ("ivcs",))] = Field(
        description="number of material points in each IVC"
    )


class ContinuumAdvance(Message):
    """Advance under constant reaction forces.

    `ivc_force` is spread equally over the material points of each IVC (Eq 87). `anchor_force` is spread
    with the shape functions that interpolate the anchors' motion. At most one of the two is given.
    """

    steps: Count = Field(description="steps of `time_step`")
    ivc_force: Annotated[FloatArray, ArraySpec("<f8", ("ivcs", 3), "N")] | None = Field(
        default=None, description="force on the continuum in each IVC"
    )
    anchor_force: Annotated[FloatArray, ArraySpec("<f8", ("anchors", 3), "N")] | None = Field(
        default=None, description="force on the continuum at each anchor"
    )

    @model_validator(mode="after")
    def _one_way_to_spread(self) -> Self:
        if self.ivc_force is not None and self.anchor_force is not None:
            raise wrong("anchor_force", "is given beside ivc_force; give one of the two")
        return self


class ContinuumAdvanced(Message):
    """State after the steps. Energies in J for the whole thickness."""

    step: Natural = Field(description="steps since `configure`")
    anchor_displacement: Annotated[FloatArray, ArraySpec("<f8", ("anchors", 3), "m")] = Field(
        description="since `register`"
    )
    anchor_velocity: Annotated[FloatArray, ArraySpec("<f8", ("anchors", 3), "m/s")] = Field(
        description="displacement of the last step over the time step"
    )
    edge_force: Annotated[FloatArray, ArraySpec("<f8", ("edges",), "N")] = Field(
        description="force on the body by each edge condition, in its component"
    )
    edge_displacement: Annotated[FloatArray, ArraySpec("<f8", ("edges",), "m")] = Field(
        description="prescribed displacement now"
    )
    kinetic_energy: float = Field(description="[J] of the material points")
    strain_energy: float = Field(description="[J] of the material points")
    edge_work: float = Field(description="[J] work done by the edges since the start")
    interface_work: float = Field(description="[J] work done by the reaction forces since the start")
    damping_loss: float = Field(description="[J] energy taken by damping since the start")
    points_lost: Natural = Field(description="points that left the grid since the start")
