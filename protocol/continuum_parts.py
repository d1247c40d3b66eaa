"""Parts of the messages of the role `continuum`: shape, materials, edges, cracks, what a reply tells of tips."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, Tag, model_validator

from protocol.kinds import mark, told_apart_by
from protocol.laminate_material import LaminateMaterial
from protocol.messages import (
    Count,
    Finite,
    Natural,
    NonNegative,
    Part,
    Point2,
    Positive,
    check_ascending,
    since,
    wrong,
)
from protocol.version import Version

_V1_1, _V1_3, _V1_5 = Version(1, 1), Version(1, 3), Version(1, 5)
Poisson = Annotated[float, Field(gt=-1, lt=0.5, allow_inf_nan=False)]
Edge = Literal["left", "right", "bottom", "top"]


# --- shape ---------------------------------------------------------------------------------------------------------


class Rectangle(Part):
    """An axis-parallel rectangle, m."""

    lower: Point2 = Field(description="[m] x, y of the lower left corner")
    upper: Point2 = Field(description="[m] x, y of the upper right corner, each above `lower`")

    @model_validator(mode="after")
    def _has_an_inside(self) -> Self:
        if not (self.lower[0] < self.upper[0] and self.lower[1] < self.upper[1]):
            raise wrong("upper", f"{list(self.upper)} is not above lower {list(self.lower)} in x and y")
        return self


class Hole(Part):
    """A round hole in the body; it may reach beyond it.

    A material point whose square domain is cut has the share of mass and stiffness that lies outside the hole.
    """

    added_in = _V1_5

    centre: Point2 = Field(description="[m] x, y")
    radius: Positive = Field(description="[m] of the circle")


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


class OverlapRegion(Part):
    """Where continuum and atoms overlap: a ring between two simple polygons, of any shape.

    No continuum is modelled inside `inner`. In the ring, stiffness and mass of the continuum are both scaled by
    a weight: `constant` is `weight` everywhere; the others go from `weight` at `inner` to 1 at `outer`, with
    s = d_inner / (d_inner + d_outer) from the distances to the two polygons: weight + (1 - weight) p(s),
    p = s (`linear`), 3 s^2 - 2 s^3 (`cubic`) or s^exponent (`power`). A material point takes the mean over its domain.
    With `stiffness` the weight is that of the mass alone.
    """

    added_in = _V1_3

    inner: list[Point2] = Field(min_length=3, description="[m] corners in order; atoms only inside")
    outer: list[Point2] = Field(min_length=3, description="[m] corners in order; holds `inner`; continuum only outside")
    weight: float = Field(gt=0, le=1, description="[1] factor on stiffness and mass of the continuum at `inner`")
    profile: Literal["constant", "linear", "cubic", "power"] = Field(
        default="constant", description="how the factor goes from `inner` to `outer`"
    )
    exponent: Annotated[Finite, Field(ge=1)] = Field(default=1.0, description="[1] of the profile `power`")
    stiffness: Annotated[Finite, Field(gt=0, le=1)] | None = Field(
        default=None, description="[1] factor on the stiffness in all of the ring; absent: as the weight"
    )


# --- numerical scheme ----------------------------------------------------------------------------------------------


class Scheme(Part):
    """Variant of the material point method. Another discretisation ignores it."""

    added_in = _V1_1

    interpolation: Literal["linear", "ugimp", "cpgimp", "bspline"] = Field(
        default="ugimp", description="grid functions that the points see: linear, GIMP, convected GIMP, B-spline"
    )
    integration: Literal["usf", "usl", "musl", "usavg"] = Field(
        default="musl", description="stress updated first, last, last with momenta mapped again, or both"
    )
    transfer: Literal["flip", "pic", "xpic", "fmpm"] = Field(
        default="fmpm", description="how nodal velocities reach the points"
    )
    order: Annotated[Count, Field(le=20)] = Field(default=2, description="order of `xpic` and `fmpm`")
    period: Count = Field(default=1, description="`transfer` is used every so many steps, `flip` between")


# --- materials -----------------------------------------------------------------------------------------------------


class IsotropicMaterial(Part):
    """Linear elastic, isotropic, small strain."""

    law: Literal["isotropic"] = Field(
        default="isotropic", description="the law; absent, it is `isotropic`", json_schema_extra=since(1, 1)
    )
    young: Positive = Field(description="[Pa] Young's modulus")
    poisson: Poisson = Field(description="[1] Poisson's ratio")
    density: Positive = Field(description="[kg/m3] mass per volume")


class OrthotropicMaterial(Part):
    """Linear elastic, orthotropic, small strain; axes 1 and 2 lie in the plane, 3 is z."""

    added_in = _V1_1

    law: Literal["orthotropic"] = Field(default="orthotropic", description="the law")
    young_1: Positive = Field(description="[Pa] Young's modulus along axis 1")
    young_2: Positive = Field(description="[Pa] Young's modulus along axis 2")
    young_3: Positive = Field(description="[Pa] Young's modulus along axis 3")
    poisson_12: Finite = Field(description="[1] contraction along 2 over extension along 1")
    poisson_13: Finite = Field(description="[1] contraction along 3 over extension along 1")
    poisson_23: Finite = Field(description="[1] contraction along 3 over extension along 2")
    shear_12: Positive = Field(description="[Pa] shear modulus in the plane")
    angle: Finite = Field(default=0.0, description="[rad] from x to axis 1, counterclockwise")
    density: Positive = Field(description="[kg/m3] mass per volume")


class NeoHookeanMaterial(Part):
    """Hyperelastic, compressible, isotropic: right at large rotation and strain."""

    added_in = _V1_1

    law: Literal["neo_hookean"] = Field(default="neo_hookean", description="the law")
    young: Positive = Field(description="[Pa] Young's modulus at small strain")
    poisson: Poisson = Field(description="[1] Poisson's ratio at small strain")
    density: Positive = Field(description="[kg/m3] mass per volume")


class J2PlasticityMaterial(Part):
    """Elastic-plastic by von Mises with isotropic hardening, at finite strain.

    Yield stress at the equivalent plastic strain e: yield_stress + hardening e + saturation (1 - exp(-rate e)).
    """

    added_in = _V1_1

    law: Literal["j2_plasticity"] = Field(default="j2_plasticity", description="the law")
    young: Positive = Field(description="[Pa] Young's modulus")
    poisson: Poisson = Field(description="[1] Poisson's ratio")
    density: Positive = Field(description="[kg/m3] mass per volume")
    yield_stress: Positive = Field(description="[Pa] at first yield")
    hardening: NonNegative = Field(default=0.0, description="[Pa] linear part")
    saturation: NonNegative = Field(default=0.0, description="[Pa] part that saturates")
    saturation_rate: NonNegative = Field(default=0.0, description="[1] rate of saturation with plastic strain")


Material = Annotated[
    Annotated[IsotropicMaterial, Tag(mark("isotropic"))]
    | Annotated[OrthotropicMaterial, Tag(mark("orthotropic"))]
    | Annotated[NeoHookeanMaterial, Tag(mark("neo_hookean"))]
    | Annotated[J2PlasticityMaterial, Tag(mark("j2_plasticity"))]
    | Annotated[LaminateMaterial, Tag(mark("laminate"))],
    told_apart_by("law", "isotropic", "orthotropic", "neo_hookean", "j2_plasticity", "laminate"),
]


# --- edges and loads -----------------------------------------------------------------------------------------------


class _Table(Part):
    """A part with a table over time, linear in between and constant outside."""

    def _check_table(self, values: str) -> None:
        times, given = self.times, getattr(self, values)  # type: ignore[attr-defined]
        if len(times) != len(given):
            raise wrong(values, f"has {len(given)} entries, times has {len(times)}")
        check_ascending("times", times)


class EdgeCondition(_Table):
    """Prescribed displacement of one edge of the body, piecewise linear in time."""

    kind: Literal["displacement"] = Field(
        default="displacement",
        description="what is prescribed; absent, it is `displacement`",
        json_schema_extra=since(1, 1),
    )
    edge: Edge = Field(description="edge of `body`")
    component: Literal[0, 1] = Field(description="0 is x, 1 is y")
    times: list[Finite] = Field(
        min_length=2, description="[s] ascending; the displacement is constant before the first and after the last"
    )
    displacements: list[Finite] = Field(min_length=2, description="[m] one for each of `times`")

    @model_validator(mode="after")
    def _is_a_table(self) -> Self:
        self._check_table("displacements")
        return self


class EdgeVelocity(_Table):
    """Prescribed velocity of one edge of the body."""

    added_in = _V1_1

    kind: Literal["velocity"] = Field(default="velocity", description="what is prescribed")
    edge: Edge = Field(description="edge of `body`")
    component: Literal[0, 1] = Field(description="0 is x, 1 is y")
    times: list[Finite] = Field(min_length=1, description="[s] ascending; constant before the first, after the last")
    velocities: list[Finite] = Field(min_length=1, description="[m/s] one for each of `times`")

    @model_validator(mode="after")
    def _is_a_table(self) -> Self:
        self._check_table("velocities")
        return self


class EdgeSymmetry(Part):
    """The edge is a line of symmetry: its normal displacement is zero."""

    added_in = _V1_1

    kind: Literal["symmetry"] = Field(default="symmetry", description="what is prescribed")
    edge: Edge = Field(description="edge of `body`")


class EdgeTraction(_Table):
    """Force per reference area of one edge, in a fixed direction."""

    added_in = _V1_1

    kind: Literal["traction"] = Field(default="traction", description="what is prescribed")
    edge: Edge = Field(description="edge of `body`")
    component: Literal[0, 1] = Field(description="0 is x, 1 is y")
    times: list[Finite] = Field(min_length=1, description="[s] ascending; constant before the first, after the last")
    tractions: list[Finite] = Field(min_length=1, description="[Pa] one for each of `times`")

    @model_validator(mode="after")
    def _is_a_table(self) -> Self:
        self._check_table("tractions")
        return self


class EdgePressure(_Table):
    """Pressure on one edge, along its present normal and over its present area; positive pushes inwards."""

    added_in = _V1_1

    kind: Literal["pressure"] = Field(default="pressure", description="what is prescribed")
    edge: Edge = Field(description="edge of `body`")
    times: list[Finite] = Field(min_length=1, description="[s] ascending; constant before the first, after the last")
    pressures: list[Finite] = Field(min_length=1, description="[Pa] one for each of `times`")

    @model_validator(mode="after")
    def _is_a_table(self) -> Self:
        self._check_table("pressures")
        return self


class KField(Part):
    """Displacements around a crack tip in an infinite elastic body (the singular term of Williams).

    Plane stress or plane strain as the problem has it, for an isotropic material.
    """

    added_in = _V1_3

    tip: Point2 = Field(description="[m] x, y of the tip in the undeformed body")
    k_1: Finite = Field(description="[Pa m^0.5] stress intensity, opening")
    k_2: Finite = Field(default=0.0, description="[Pa m^0.5] the same, sliding")
    angle: Finite = Field(default=0.0, description="[rad] from x to the direction in which the crack would grow")


class EdgeKField(_Table):
    """Both displacements of one edge follow a crack-tip field times a factor over time."""

    added_in = _V1_3

    kind: Literal["k_field"] = Field(default="k_field", description="what is prescribed")
    edge: Edge = Field(description="edge of `body`")
    field: KField = Field(description="at a factor of 1")
    times: list[Finite] = Field(min_length=1, description="[s] ascending; constant before the first, after the last")
    factors: list[Finite] = Field(min_length=1, description="[1] one for each of `times`")

    @model_validator(mode="after")
    def _is_a_table(self) -> Self:
        self._check_table("factors")
        return self


class EdgeAbsorbing(Part):
    """The edge lets waves leave: dashpots of the material's impedance, normal and tangential."""

    added_in = _V1_1

    kind: Literal["absorbing"] = Field(default="absorbing", description="what is prescribed")
    edge: Edge = Field(description="edge of `body`")


AnyEdge = Annotated[
    Annotated[EdgeCondition, Tag(mark("displacement"))]
    | Annotated[EdgeVelocity, Tag(mark("velocity"))]
    | Annotated[EdgeSymmetry, Tag(mark("symmetry"))]
    | Annotated[EdgeTraction, Tag(mark("traction"))]
    | Annotated[EdgePressure, Tag(mark("pressure"))]
    | Annotated[EdgeAbsorbing, Tag(mark("absorbing"))]
    | Annotated[EdgeKField, Tag(mark("k_field"))],
    told_apart_by("kind", "displacement", "velocity", "symmetry", "traction", "pressure", "absorbing", "k_field"),
]


class BodyForce(_Table):
    """Acceleration of all material, such as gravity."""

    added_in = _V1_1

    acceleration: Point2 = Field(description="[m/s2] x, y at a factor of 1")
    times: list[Finite] = Field(default=[0.0], min_length=1, description="[s] ascending; constant outside")
    factors: list[Finite] = Field(default=[1.0], min_length=1, description="[1] one for each of `times`")

    @model_validator(mode="after")
    def _is_a_table(self) -> Self:
        self._check_table("factors")
        return self


class Preload(Part):
    """Equilibrium before the first step, with loads and edges held at their values of time zero.

    `relaxation` is kinetic: all velocities are set to zero at each peak of kinetic energy. `static` solves for the
    grid's displacements by Newton's method. Both end when the residual, the norm of the out-of-balance nodal forces
    over that of the forces that act, is at most `tolerance`. With overlaps it is the whole body that is brought to
    equilibrium, without holes and with full weight, as if there were no atoms; the points then start from its state.
    """

    added_in = _V1_1

    tolerance: Annotated[Positive, Field(lt=1)] = Field(description="[1] residual to reach")
    max_steps: Count = Field(description="steps (`static`: iterations) after which it ends without having reached it")
    method: Literal["relaxation", "static"] = Field(
        default="relaxation", description="how", json_schema_extra=since(1, 3)
    )


# --- cracks --------------------------------------------------------------------------------------------------------


class CrackGrowth(Part):
    """A crack grows where its energy release rate is at least the critical one."""

    added_in = _V1_1

    critical_energy_release_rate: Positive = Field(description="[J/m2] of new crack")
    rule: Literal["straight", "max_hoop"] = Field(
        default="max_hoop", description="direction: straight on, or normal to the largest hoop stress"
    )
    interval: Count = Field(description="steps between two looks at the tips")


class CrackLine(Part):
    """A crack along a polyline; an end inside the body is a tip."""

    points: list[Point2] = Field(min_length=2, description="[m] x, y of each corner of the line")
    contact: Literal["frictionless", "stick", "coulomb"] = Field(
        default="frictionless", description="how closed faces touch", json_schema_extra=since(1, 1)
    )
    friction: NonNegative = Field(
        default=0.0, description="[1] coefficient of `coulomb`, 0 with the others", json_schema_extra=since(1, 1)
    )
    growth: CrackGrowth | None = Field(
        default=None, description="absent: the crack does not grow", json_schema_extra=since(1, 1)
    )
    measure_every: Natural = Field(
        default=0,
        description="steps between measurements of J, K and G at its tips; 0: only as `growth` needs them",
        json_schema_extra=since(1, 1),
    )

    @model_validator(mode="after")
    def _friction_fits_contact(self) -> Self:
        if self.friction > 0 and self.contact != "coulomb":
            raise wrong("friction", f"is {self.friction:g}, must be 0 with contact {self.contact!r}")
        return self


# --- parts of replies ----------------------------------------------------------------------------------------------


class GridLevel(Part):
    """One level of the grid."""

    added_in = _V1_1

    cell_size: float = Field(description="[m] edge of a cell")
    cells: Natural = Field(description="cells of this level that hold material")
    points: Natural = Field(description="material points of this level's size")


class Relaxation(Part):
    """How the preload ended."""

    added_in = _V1_1

    residual: float = Field(description="[1] out-of-balance force over the forces that act, at its end")
    steps: Natural = Field(description="steps that it took")
    converged: bool = Field(description="whether the residual is at most `preload.tolerance`")


class CrackTip(Part):
    """One tip of a crack. What was not measured (yet) is absent."""

    added_in = _V1_1

    crack: Natural = Field(description="row of the crack in `cracks` of `configure`")
    end: Natural = Field(description="0: at the first point of the line, 1: at its last")
    position: Point2 = Field(description="[m] x, y now")
    length: float = Field(description="[m] of the whole crack along its reference line")
    measured_at: Natural | None = Field(default=None, description="step of the measurement that follows")
    j: Finite | None = Field(default=None, description="[J/m2] dynamic J-integral")
    k_1: Finite | None = Field(default=None, description="[Pa m^0.5] stress intensity, opening")
    k_2: Finite | None = Field(default=None, description="[Pa m^0.5] stress intensity, sliding")
    g_1: Finite | None = Field(default=None, description="[J/m2] energy release rate by virtual crack closure, opening")
    g_2: Finite | None = Field(default=None, description="[J/m2] the same, sliding")
    hoop_stress: Finite | None = Field(default=None, description="[Pa] opening stress just ahead of the tip")


class ContinuumEvent(Part):
    """Something that happened at one step."""

    added_in = _V1_1

    kind: str = Field(
        description="`growth`, `arrest`, `reached_overlap`, `points_lost` or `failure`; newer versions may add others"
    )
    step: Natural = Field(description="steps since `configure` when it happened")
    sentence: str = Field(description="what happened, for people")
    count: Natural | None = Field(default=None, description="`points_lost`: how many")
    tip: CrackTip | None = Field(default=None, description="`growth`, `arrest`, `reached_overlap`: the tip after it")
