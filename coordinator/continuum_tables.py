"""Tables of a scene file that say what the continuum is: material, grid, edges, loads, cracks. SI once read."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field

from coordinator.layup import read_layup
from coordinator.table import Count, Name, Number, Table
from coordinator.units import (
    Acceleration,
    Angle,
    Length,
    PositiveDensity,
    PositiveEnergyPerArea,
    PositiveLength,
    PositivePressure,
    PositiveTime,
    Pressure,
    Rate,
    StressIntensity,
    Time,
    Velocity,
    ZeroPressure,
)

#: Fields of [continuum.material] that a law needs, and those that it may have.
LAWS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "isotropic": (("young", "poisson"), ()),
    "orthotropic": (
        ("young_1", "young_2", "young_3", "poisson_12", "poisson_13", "poisson_23", "shear_12"), ("angle",),
    ),
    "neo_hookean": (("young", "poisson"), ()),
    "j2_plasticity": (("young", "poisson", "yield_stress"), ("hardening", "saturation", "saturation_rate")),
    "laminate": (("layup", "ply_thickness"), ()),
}  # fmt: skip
#: Fields of [[continuum.edges]] that a kind needs.
EDGE_KINDS: dict[str, tuple[str, ...]] = {
    "displacement": ("component", "times", "displacements"),
    "velocity": ("component", "times", "velocities"),
    "symmetry": (),
    "traction": ("component", "times", "tractions"),
    "pressure": ("times", "pressures"),
    "absorbing": (),
    "k_field": ("field", "times", "factors"),
}
Poisson = Annotated[float, Field(strict=True, gt=-1, lt=0.5)]


class Material(Table):
    """A material law and its constants; which of them it needs is in `LAWS`."""

    law: Literal["isotropic", "orthotropic", "neo_hookean", "j2_plasticity", "laminate"] = "isotropic"
    density: PositiveDensity = Field(description="kg/m3")
    thickness: PositiveLength | None = Field(default=None, description="m; of a laminate that of all its plies")
    young: PositivePressure | None = Field(default=None, description="Young's modulus, Pa")
    poisson: Poisson | None = Field(default=None, description="Poisson's ratio")
    young_1: PositivePressure | None = Field(default=None, description="Young's modulus along axis 1, Pa")
    young_2: PositivePressure | None = Field(default=None, description="Young's modulus along axis 2, Pa")
    young_3: PositivePressure | None = Field(default=None, description="Young's modulus along z, Pa")
    poisson_12: Number | None = Field(default=None, description="contraction along 2 over extension along 1")
    poisson_13: Number | None = Field(default=None, description="contraction along z over extension along 1")
    poisson_23: Number | None = Field(default=None, description="contraction along z over extension along 2")
    shear_12: PositivePressure | None = Field(default=None, description="shear modulus in the plane, Pa")
    angle: Angle | None = Field(default=None, description="from x to axis 1, rad")
    yield_stress: PositivePressure | None = Field(default=None, description="Pa")
    hardening: ZeroPressure | None = Field(default=None, description="linear hardening, Pa")
    saturation: ZeroPressure | None = Field(default=None, description="hardening that saturates, Pa")
    saturation_rate: Annotated[Number, Field(ge=0)] | None = Field(
        default=None, description="rate of saturation with plastic strain"
    )

    layup: Name | None = Field(default=None, description="plies from the lowest up, such as [45/0/-45/90]2s")
    ply_thickness: PositiveLength | None = Field(default=None, description="of each ply, m")

    @property
    def whole_thickness(self) -> float:
        """Thickness of the body, m."""
        if self.law == "laminate":
            assert self.layup is not None and self.ply_thickness is not None  # held by the cross-field checks
            return len(read_layup(self.layup).angles) * self.ply_thickness
        assert self.thickness is not None  # likewise
        return self.thickness

    def constants(self) -> dict[str, Any]:
        """Return the constants of the law that are given, SI, by name; a laminate has its constants elsewhere."""
        needed, possible = LAWS[self.law]
        given = {name: getattr(self, name) for name in (*needed, *possible) if getattr(self, name) is not None}
        return {"law": self.law, "density": self.density, **given}


class KField(Table):
    """Displacements around a crack tip in an infinite elastic body."""

    tip: tuple[Length, Length] = Field(description="place of the tip, m")
    k_1: StressIntensity = Field(description="stress intensity, opening, Pa m^0.5")
    k_2: StressIntensity = Field(default=0.0, description="stress intensity, sliding, Pa m^0.5")
    angle: Angle = Field(default=0.0, description="from x to the direction in which the crack would grow, rad")


class Edge(Table):
    """What is prescribed on one edge of the body; values over time are linear between the rows of a table."""

    kind: Literal["displacement", "velocity", "symmetry", "traction", "pressure", "absorbing", "k_field"] = (
        "displacement"
    )
    edge: Literal["left", "right", "bottom", "top"]
    component: Literal["x", "y"] | None = None
    times: list[Time] | None = Field(default=None, min_length=1, description="s, ascending; constant after the last")
    displacements: list[Length] | None = Field(default=None, min_length=2, description="m")
    velocities: list[Velocity] | None = Field(default=None, min_length=1, description="m/s")
    tractions: list[Pressure] | None = Field(
        default=None, min_length=1, description="force per reference area along `component`, Pa"
    )
    pressures: list[Pressure] | None = Field(default=None, min_length=1, description="positive pushes inwards, Pa")
    field: KField | None = Field(default=None, description="displacements at a factor of 1")
    factors: list[Number] | None = Field(default=None, min_length=1, description="of the field, one for each of times")

    @property
    def axis(self) -> int:
        """Component as an index, 0 is x, 1 is y; the normal one where the kind has none."""
        return self.normal_axis if self.component is None else "xy".index(self.component)

    @property
    def normal_axis(self) -> int:
        """Axis of the edge's normal."""
        return 0 if self.edge in ("left", "right") else 1

    @property
    def moves(self) -> bool:
        """Whether the edge's motion is prescribed."""
        return self.kind in ("displacement", "velocity", "symmetry", "k_field")

    @property
    def first_velocity(self) -> float:
        """Velocity of the edge at the start, m/s."""
        if self.kind == "velocity":
            assert self.velocities is not None  # held by the cross-field checks
            return self.velocities[0]
        if self.kind == "displacement":
            assert self.times is not None and self.displacements is not None
            return (self.displacements[1] - self.displacements[0]) / (self.times[1] - self.times[0])
        return 0.0

    @property
    def last_way(self) -> float:
        """What moves or loads the edge at last, along its component; 0 where nothing does."""
        if self.kind == "pressure":
            assert self.pressures is not None
            return -self.pressures[-1] if self.edge in ("right", "top") else self.pressures[-1]
        values = self.displacements or self.velocities or self.tractions or [0.0]
        return values[-1]

    def given(self) -> dict[str, Any]:
        """Return what the kind needs, SI, by name; the component as an index."""
        values = {name: getattr(self, name) for name in EDGE_KINDS[self.kind]}
        if "component" in values:
            values["component"] = self.axis
        if self.field is not None:
            values["field"] = self.field.model_dump()
        return {"kind": self.kind, "edge": self.edge, **values}


class Scheme(Table):
    """Variant of the material point method."""

    interpolation: Literal["linear", "ugimp", "cpgimp", "bspline"] = "ugimp"
    integration: Literal["usf", "usl", "musl", "usavg"] = "musl"
    transfer: Literal["flip", "pic", "xpic", "fmpm"] = "fmpm"
    order: Annotated[Count, Field(le=20)] = Field(default=2, description="order of xpic and fmpm")
    period: Count = Field(default=1, description="steps between two filtered transfers, flip in the others")


class Hole(Table):
    """A round hole in the body, which it may reach beyond."""

    centre: tuple[Length, Length] = Field(description="x and y, m")
    diameter: PositiveLength = Field(description="m")


class Refinement(Table):
    """A rectangle in which cells are half as large as around it."""

    lower: tuple[Length, Length] = Field(description="lower left corner, m")
    upper: tuple[Length, Length] = Field(description="upper right corner, m")


class BodyForce(Table):
    """Acceleration of all material."""

    acceleration: tuple[Acceleration, Acceleration] = Field(description="x and y, m/s2")
    times: list[Time] = Field(default=[0.0], min_length=1, description="s, ascending; constant after the last")
    factors: list[Number] = Field(default=[1.0], min_length=1, description="one for each of times")


class Preload(Table):
    """Equilibrium of the whole body under the loads of time zero, before the first step."""

    method: Literal["relaxation", "static"] = Field(
        default="relaxation", description="kinetic relaxation, or Newton's method"
    )

    tolerance: Annotated[float, Field(strict=True, gt=0, lt=1)] = Field(description="residual to reach, relative")
    max_steps: Count = Field(description="steps after which the run goes on without having reached it")


class CrackGrowth(Table):
    """When and how a crack grows."""

    critical_energy_release_rate: PositiveEnergyPerArea = Field(description="J/m2")
    rule: Literal["straight", "max_hoop"] = "max_hoop"
    interval: Count = Field(description="steps between two looks at the tips")


class CrackLine(Table):
    """A crack of the continuum along a polyline; an end inside the body is a tip."""

    points: list[tuple[Length, Length]] = Field(min_length=2, description="corners of the line, m")
    contact: Literal["frictionless", "stick", "coulomb"] = "frictionless"
    friction: Annotated[Number, Field(ge=0)] = Field(default=0.0, description="coefficient of coulomb")
    measure_every: Annotated[int, Field(strict=True, ge=0)] = Field(
        default=0, description="steps between measurements of J, K and G; 0: only where it may grow"
    )
    growth: CrackGrowth | None = Field(default=None, description="absent: it does not grow")


class Continuum(Table):
    """The continuum, its grid and its edges."""

    backend: Name = "mpm_service"
    assumption: Literal["plane_stress", "plane_strain"]
    lower: tuple[Length, Length] = Field(description="lower left corner of the body, m")
    upper: tuple[Length, Length] = Field(description="upper right corner of the body, m")
    cell_size: PositiveLength = Field(description="edge of a background cell, m")
    points_per_cell: Count = Field(default=2, description="material points per cell and direction")
    damping_rate: Rate = Field(default=0.0, description="mass-proportional damping on the grid, 1/s")
    point_damping_rate: Rate = Field(default=0.0, description="mass-proportional damping of the points, 1/s")
    force_scaling: Annotated[Number, Field(ge=0, lt=1)] = Field(
        default=0.0, description="c: forces are multiplied by 1 - c, which slows the dynamics and damps nothing"
    )
    initial_velocity: Literal["rest", "follow_edges"] = "rest"
    on_lost_points: Literal["continue", "stop"] = "continue"
    time_step: PositiveTime | None = Field(
        default=None, description="s; only without [atomistic], else steps_per_exchange times its time step"
    )
    material: Material | None = Field(default=None, description="absent: measured by the atomistic service")
    measured_law: Literal["isotropic", "neo_hookean"] = Field(
        default="isotropic", description="law that the measured constants go into"
    )
    scheme: Scheme = Field(default_factory=Scheme, description="absent: the defaults of each key")
    holes: list[Hole] = Field(default=[], description="where the body has no material")
    edges: list[Edge] = Field(default=[], description="what is prescribed on edges")
    body_force: BodyForce | None = Field(default=None, description="absent: none")
    preload: Preload | None = Field(default=None, description="absent: the run starts unrelaxed")
    initial_field: KField | None = Field(default=None, description="absent: the body starts undeformed")
    refinement: list[Refinement] = Field(default=[], description="finer levels, each inside the one before")
    cracks: list[CrackLine] = Field(default=[], description="cracks of the continuum beside [crack]")

    @property
    def pull_axis(self) -> int | None:
        """Axis along which two edges that move pull the body apart, y first; None where no two do."""
        moved = {(edge.edge, edge.axis) for edge in self.edges if edge.moves and edge.kind != "k_field"}
        pairs = {1: {("top", 1), ("bottom", 1)}, 0: {("right", 0), ("left", 0)}}
        return next((axis for axis, pair in pairs.items() if pair <= moved), None)

    def initial_velocity_gradient(self) -> tuple[float, float, float, float] | None:
        """Velocity gradient (xx, xy, yx, yy), 1/s, that starts the body with its edges; None from rest."""
        if self.initial_velocity == "rest":
            return None
        gradient = [0.0] * 4
        for edge in self.edges:
            place = (self.lower, self.upper)[edge.edge in ("right", "top")][edge.normal_axis]
            if edge.moves and place != 0.0:
                gradient[2 * edge.axis + edge.normal_axis] = edge.first_velocity / place
        return gradient[0], gradient[1], gradient[2], gradient[3]
