"""Messages of the role `continuum`: advance a continuum under interface reaction forces."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from protocol.arrays import ArraySpec, FloatArray, IntArray
from protocol.continuum_parts import (
    AnyEdge,
    BodyForce,
    ContinuumEvent,
    CrackGrowth,
    CrackLine,
    CrackTip,
    EdgeAbsorbing,
    EdgeCondition,
    EdgeKField,
    EdgePressure,
    EdgeSymmetry,
    EdgeTraction,
    EdgeVelocity,
    GridLevel,
    Hole,
    IsotropicMaterial,
    J2PlasticityMaterial,
    KField,
    Material,
    NeoHookeanMaterial,
    OrthotropicMaterial,
    Overlap,
    OverlapRegion,
    Preload,
    Rectangle,
    Relaxation,
    Scheme,
)
from protocol.laminate_material import LaminateMaterial
from protocol.messages import (
    Count,
    Finite,
    Integer,
    Message,
    Natural,
    NonNegative,
    Point2,
    Positive,
    check_indices,
    since,
    wrong,
)

__all__ = [
    "AnyEdge",
    "BodyForce",
    "ContinuumAdvance",
    "ContinuumAdvanced",
    "ContinuumConfigure",
    "ContinuumConfigured",
    "ContinuumEvent",
    "ContinuumRegister",
    "ContinuumRegistered",
    "CrackExtended",
    "CrackExtension",
    "CrackGrowth",
    "CrackLine",
    "CrackTip",
    "EdgeAbsorbing",
    "EdgeCondition",
    "EdgeKField",
    "EdgePressure",
    "EdgeSymmetry",
    "EdgeTraction",
    "EdgeVelocity",
    "GridLevel",
    "Hole",
    "IsotropicMaterial",
    "J2PlasticityMaterial",
    "KField",
    "LaminateMaterial",
    "Material",
    "NeoHookeanMaterial",
    "OrthotropicMaterial",
    "Overlap",
    "OverlapRegion",
    "Preload",
    "Rectangle",
    "Relaxation",
    "Scheme",
]


class ContinuumConfigure(Message):
    """The whole continuum problem."""

    assumption: Literal["plane_stress", "plane_strain"] = Field(description="how the third direction behaves")
    thickness: Positive = Field(description="[m] extent of the body along z")
    body: Rectangle = Field(description="reference shape of the body")
    cell_size: Positive = Field(description="[m] edge of a background cell, of the coarsest level")
    points_per_cell: Count = Field(description="material points per cell and direction")
    refinement: list[Rectangle] = Field(
        default_factory=list,
        description="each halves the cells inside it and lies inside the one before",
        json_schema_extra=since(1, 1),
    )
    scheme: Scheme = Field(
        default_factory=Scheme,
        description="how the method works, where there is a choice",
        json_schema_extra=since(1, 1),
    )
    material: Material = Field(description="one material for the whole body")
    overlap: Overlap | None = Field(default=None, description="absent: continuum everywhere in `body`")
    holes: list[Hole] = Field(
        default_factory=list,
        description="where `body` has no material; they share no area",
        json_schema_extra=since(1, 5),
    )
    cracks: list[CrackLine] = Field(default_factory=list, description="absent or empty: no crack")
    edges: list[AnyEdge] = Field(default_factory=list, description="an edge without a condition is free")
    body_force: BodyForce | None = Field(default=None, description="absent: none", json_schema_extra=since(1, 1))
    initial_velocity_gradient: Annotated[tuple[Finite, Finite, Finite, Finite], Field(strict=False)] | None = Field(
        default=None, description="[1/s] xx, xy, yx, yy: the initial velocity is this gradient times position"
    )
    damping_rate: NonNegative = Field(
        default=0.0, description="[1/s] mass-proportional damping: a free velocity decays as exp(-rate t)"
    )
    point_damping_rate: NonNegative = Field(
        default=0.0,
        description="[1/s] the same, applied to the velocities of the points instead of the nodes",
        json_schema_extra=since(1, 1),
    )
    force_scaling: Annotated[NonNegative, Field(lt=1)] = Field(
        default=0.0,
        description="[1] c: nodal forces are multiplied by 1 - c (Eq 45); it slows the dynamics and damps nothing",
        json_schema_extra=since(1, 1),
    )
    preload: Preload | None = Field(
        default=None, description="absent: the run starts as it is configured", json_schema_extra=since(1, 1)
    )
    overlaps: list[OverlapRegion] = Field(
        default_factory=list,
        description="rings that do not meet each other; for one between rectangles `overlap` says the same",
        json_schema_extra=since(1, 3),
    )
    initial_field: KField | None = Field(
        default=None,
        description="the body starts with these displacements, their strain and their stress; where there is also"
        " `preload`, that starts from them",
        json_schema_extra=since(1, 3),
    )
    probe_position: Annotated[FloatArray, ArraySpec("<f8", ("probes", 3), "m")] | None = Field(
        default=None,
        description="places in the undeformed body, holes included, whose displacement at the start is wanted",
        json_schema_extra=since(1, 3),
    )
    on_lost_points: Literal["continue", "stop"] = Field(
        default="continue",
        description="`stop`: a point that leaves the grid ends the `advance` as `solver_failed`",
        json_schema_extra=since(1, 1),
    )
    time_step: Positive = Field(description="[s] step of `advance`")

    @model_validator(mode="after")
    def _one_kind_of_overlap(self) -> Self:
        if self.overlap is not None and self.overlaps:
            raise wrong("overlaps", "is given beside overlap; give one of the two")
        return self

    @model_validator(mode="after")
    def _levels_are_nested(self) -> Self:
        outer, what = self.body, "body"
        for level, inner in enumerate(self.refinement):
            if any(inner.lower[k] < outer.lower[k] or inner.upper[k] > outer.upper[k] for k in (0, 1)):
                raise wrong(f"refinement.{level}", f"reaches beyond {what}")
            outer, what = inner, f"refinement.{level}"
        return self


class ContinuumConfigured(Message):
    """What was built."""

    courant_number: float = Field(description="[1] time step times wave speed over smallest cell size (Eq 31)")
    stable_time_step: float = Field(description="[s] largest stable step")
    cells: Integer = Field(description="cells that hold material")
    levels: list[GridLevel] = Field(
        default_factory=list, description="levels of the grid, coarsest first", json_schema_extra=since(1, 1)
    )
    relaxation: Relaxation | None = Field(
        default=None, description="how `preload` ended; absent without it", json_schema_extra=since(1, 1)
    )
    position: Annotated[FloatArray, ArraySpec("<f8", ("points", 3), "m")] = Field(
        description="reference positions of the material points; rows of all point fields are in this order"
    )
    weight: Annotated[FloatArray, ArraySpec("<f8", ("points",))] = Field(
        description="`overlap.weight` for points in the ring, 1 elsewhere, the mean over its domain for a point across"
    )
    probe_displacement: Annotated[FloatArray, ArraySpec("<f8", ("probes", 3), "m")] | None = Field(
        default=None,
        description="of `probe_position` by `initial_field` and `preload`, 0 without both; absent without probes",
        json_schema_extra=since(1, 3),
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
    anchor_displacement: Annotated[FloatArray, ArraySpec("<f8", ("anchors", 3), "m")] | None = Field(
        default=None,
        description="that the anchors have already, as the body around them has; absent: none",
        json_schema_extra=since(1, 3),
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
        description="since `register`, plus what `register` gave"
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
    interface_work: float = Field(
        description="[J] work of the reaction forces since the start; each with half of the way that its anchor made in"
        " the step before it and half of that in its own step"
    )
    damping_loss: float = Field(description="[J] energy taken by damping since the start")
    load_work: float = Field(
        default=0.0,
        description="[J] work done by tractions, pressures, body force and absorbing edges since the start",
        json_schema_extra=since(1, 1),
    )
    dissipated_energy: float = Field(
        default=0.0,
        description="[J] energy taken by plastic flow, by failure of subcells and by friction of crack faces since the"
        " start",
        json_schema_extra=since(1, 1),
    )
    filter_loss: Finite | None = Field(
        default=None,
        description="[J] energy that the way from points to grid and back took since the start; negative: gave; absent:"
        " not known",
        json_schema_extra=since(1, 3),
    )
    momentum: Point2 | None = Field(
        default=None, description="[kg m/s] of the material points; absent: not known", json_schema_extra=since(1, 3)
    )
    points_lost: Natural = Field(description="points that left the grid since the start")
    queried: Natural = Field(
        default=0,
        description="with the law `laminate`: plies of points of which the microstructure was asked in these steps",
        json_schema_extra=since(1, 5),
    )
    spared: Natural = Field(
        default=0,
        description="with the law `laminate`: plies of points that could not fail and were answered by the elastic"
        " stiffness in these steps",
        json_schema_extra=since(1, 5),
    )
    tips: list[CrackTip] = Field(
        default_factory=list, description="crack tips inside the body", json_schema_extra=since(1, 1)
    )
    events: list[ContinuumEvent] = Field(
        default_factory=list, description="what happened in these steps, in order", json_schema_extra=since(1, 1)
    )


class CrackExtension(Message):
    """Let a crack go on along given corners, whatever its growth law says.

    The first corner is beyond the tip as it is now; the line from the tip to it and on through all corners is new
    crack. It may pass through the hole of an overlap, where there is no continuum.
    """

    crack: Natural = Field(description="row of the crack in `cracks` of `configure`")
    end: Literal[0, 1] = Field(description="0: at the first point of the line, 1: at its last")
    points: list[Point2] = Field(
        min_length=1, description="[m] corners in the undeformed body; the last is the new tip"
    )


class CrackExtended(Message):
    """The tips now."""

    step: Natural = Field(description="steps since `configure`")
    tips: list[CrackTip] = Field(description="crack tips inside the body")
