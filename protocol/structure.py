"""Messages of the role `structure`: a laminate under growing displacement that asks its microstructure at every point.

The laminate lies in the plane of x and y, its plies are counted from the lowest z up. It is pulled along x by its two
ends. The cell of the microstructure is defined as in `register` of the role `micromechanics`, with axis 1 along the
fibre of each ply; the structure service registers it there and asks in the axes of the plies.
"""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal, Self

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
    Positive,
    check_indices,
    since,
    wrong,
)
from protocol.micromechanics import RegisterCell
from protocol.version import Version

Fraction = Annotated[float, Field(gt=0, le=1, allow_inf_nan=False)]


class PlateMesh(Part):
    """How the plane of the laminate is divided into elements."""

    added_in: ClassVar[Version] = Version(1, 4)

    around: Count | None = Field(
        default=None, description="elements round a quarter of the hole, or half of a notch, even"
    )
    radial: Count | None = Field(default=None, description="elements from the hole or notch to the square round it")
    growth: Positive = Field(
        default=1.0, description="[1] size of the outermost element of a ray over that of the one at the hole"
    )
    beyond: Natural = Field(
        default=0, description="columns of elements between the square and each end; with a hole or notches"
    )
    columns: Count | None = Field(default=None, description="elements along x; without hole and notches")
    rows: Count | None = Field(default=None, description="elements along y; without hole and notches")
    bricks_per_ply: Count = Field(default=1, description="elements through a ply")
    mean_dilatation: bool = Field(
        default=False,
        description="whether the volumetric strain of a brick is its mean (selectively reduced integration)",
    )


class CohesiveConstants(Part):
    """Bilinear cohesive law between plies of different angle (Eqs 91 to 93)."""

    added_in: ClassVar[Version] = Version(1, 4)

    stiffness: Positive = Field(description="[Pa/m] K")
    normal_strength: Positive = Field(description="[Pa] Y_t")
    shear_strength: Positive = Field(description="[Pa] S")
    opening_toughness: Positive = Field(description="[J/m^2] G_Ic")
    sliding_toughness: Positive = Field(description="[J/m^2] G_IIc")
    mix_exponent: Positive = Field(default=1.0, description="[1] alpha of Benzeggagh and Kenane")


class Increments(Part):
    """How the load grows."""

    added_in: ClassVar[Version] = Version(1, 4)

    first: Fraction = Field(default=0.02, description="[1] first increment, as a part of the whole load")
    least: Fraction = Field(default=1e-5, description="[1] increment below which the run is given up")
    most: Fraction = Field(default=0.05, description="[1] largest increment")
    iterations: Count = Field(default=100, description="solutions after which an increment is halved")
    tolerance: Positive = Field(
        default=1e-6, description="[1] largest force out of balance at a free node over the largest of all"
    )
    viscosity: NonNegative = Field(
        default=0.0,
        description="[1] part of the whole load over which the damage of cohesive layers follows: in an increment d of"
        " the load it goes d / (d + viscosity) of the way",
        json_schema_extra=since(1, 5),
    )
    dissipation: Positive | None = Field(
        default=None,
        description="[J] of the whole laminate: an increment of the load that takes more than this, or that is not"
        " found, is made again so that it takes this, and so are those after it while the load rises by less than"
        " `most` in each; the load may fall. Refused with `viscosity`, and where something fails without"
        " `fracture_energy`, yields or is not at its stress-free temperature. absent: increments are by the load",
        json_schema_extra=since(1, 5),
    )

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        if not self.least <= self.first <= self.most:
            raise wrong("first", f"is {self.first:g}; it must lie between least and most")
        return self

    @model_validator(mode="after")
    def _one_control(self) -> Self:
        if self.dissipation is not None and self.viscosity:
            raise wrong("dissipation", "is given beside a viscosity; give one of the two")
        return self


class StructureConfigure(RegisterCell):
    """The laminate, its cell, its mesh and its load."""

    length: Positive = Field(description="[m] along x")
    width: Positive = Field(description="[m] along y")
    hole_diameter: Positive | None = Field(default=None, description="[m] in the middle; absent: no hole")
    notch_diameter: Positive | None = Field(
        default=None,
        description="[m] of two half-round notches in the middle of both sides, meshed as a hole is; not with"
        " `hole_diameter`; absent: none",
        json_schema_extra=since(1, 5),
    )
    angles: list[Finite] = Field(min_length=1, description="[rad] of each ply from x towards y, from the lowest up")
    ply_thickness: Positive = Field(description="[m] of each ply")
    quarter: bool = Field(
        default=False, description="model the quarter with x and y above 0, between two planes of symmetry"
    )
    lower_half: bool = Field(
        default=False,
        description="`angles` are those of the lower half of a symmetric laminate, held at its middle plane",
    )
    mesh: PlateMesh = Field(description="elements")
    cohesive: CohesiveConstants | None = Field(default=None, description="absent: plies are tied")
    temperature: NonNegative = Field(description="[K] of the whole run")
    final_strain: Positive = Field(description="[1] elongation over length at the end of the run")
    increments: Increments = Field(default_factory=Increments, description="how the load grows")
    damage: Literal["elimination", "none"] = Field(
        default="elimination", description="`none`: subcells do not fail, whatever their allowables"
    )
    micromechanics: str = Field(description="endpoint of a service of the role `micromechanics`")
    plane_nodes: Annotated[FloatArray, ArraySpec("<f8", ("plane_nodes", 2), "m")] | None = Field(
        default=None,
        description="nodes of a mesh of the plane that is given, not made; x and y from the middle of the laminate;"
        " with `plane_elements`. The outline, holes and all, is that of the mesh: of `mesh` only `bricks_per_ply` and"
        " `mean_dilatation` are used, `hole_diameter` and"
        " `notch_diameter` are not",
        json_schema_extra=since(1, 5),
    )
    plane_elements: Annotated[IntArray, ArraySpec("<i8", ("plane_elements", 4))] | None = Field(
        default=None,
        description="nodes of each quadrilateral, counterclockwise; together from end to end and from side to side of"
        " the part that is modelled",
        json_schema_extra=since(1, 5),
    )

    @model_validator(mode="after")
    def _hole_or_notches(self) -> Self:
        if self.notch_diameter is not None and self.hole_diameter is not None:
            raise wrong("notch_diameter", "is given beside hole_diameter; give one of the two")
        return self

    @model_validator(mode="after")
    def _plane_is_whole(self) -> Self:
        nodes, elements = self.plane_nodes, self.plane_elements
        if (nodes is None) != (elements is None):
            missing, given = ("plane_nodes", "plane_elements") if nodes is None else ("plane_elements", "plane_nodes")
            raise wrong(missing, f"is missing beside {given}; give both or none")
        if nodes is not None and elements is not None:
            if not len(elements):
                raise wrong("plane_elements", "is empty; a mesh has at least one element")
            check_indices("plane_elements", elements.reshape(-1), len(nodes))
        return self


class StructureConfigured(Message):
    """The laminate is meshed and at rest."""

    nodes: Annotated[FloatArray, ArraySpec("<f8", ("nodes", 3), "m")] = Field(description="positions")
    bricks: Annotated[IntArray, ArraySpec("<i8", ("bricks", 8))] = Field(
        description="nodes of each, round the lower face and then round the upper one"
    )
    ply: Annotated[IntArray, ArraySpec("<i8", ("bricks",))] = Field(description="ply of each brick, the lowest is 0")
    layers: Annotated[IntArray, ArraySpec("<i8", ("layers", 8))] = Field(
        description="nodes of each cohesive element, round the lower face and then round the upper one"
    )
    interface: Annotated[IntArray, ArraySpec("<i8", ("layers",))] = Field(
        description="interface of each, that above ply 0 is 0"
    )
    points: Natural = Field(description="integration points of the bricks")
    unknowns: Natural = Field(description="degrees of freedom that are solved for")
    cell: str = Field(description="id of the cell")
    section: Positive = Field(description="[m^2] whole cross section of the laminate away from the hole")


class StructureAdvance(Message):
    """Make one increment, as large as it can be made."""

    largest: Fraction = Field(default=1.0, description="[1] not larger than this part of the whole load")
    watched: list[Natural] = Field(
        default_factory=list,
        description="bricks of which strain, stress and the stress of subcells are answered",
        json_schema_extra=since(1, 5),
    )


class StructureAdvanced(Message):
    """The laminate in equilibrium after an increment."""

    step: Integer = Field(description="increments so far")
    load: Finite = Field(description="[1] part of the whole load that acts now; 1 at the end of the run")
    strain: Finite = Field(description="[1] elongation over length")
    force: Finite = Field(description="[N] with which the whole laminate is pulled")
    iterations: Natural = Field(description="solutions of this increment, those of halved tries included")
    halved: Natural = Field(description="tries of this increment that found no equilibrium")
    residual: Finite = Field(description="[1] largest force out of balance at a free node over the largest of all")
    factorisations: Natural = Field(description="so far")
    queried: Natural = Field(
        description="points of which the microstructure was asked in this increment, all iterations"
    )
    spared: Natural = Field(description="points that could not fail and were answered by the elastic stiffness")
    new_failures: Annotated[IntArray, ArraySpec("<i8", ("plies", "materials"))] = Field(
        description="subcells that failed in this increment, by ply and by material of the cell"
    )
    layer_damage: Annotated[FloatArray, ArraySpec("<f8", ("interfaces",))] = Field(
        description="[1] share of the area of each interface that has no traction left"
    )
    seconds: dict[str, NonNegative] = Field(
        description="[s] of this increment: assembly, factorisation, solution, micromechanics, of which wire"
    )
    work: Finite = Field(
        default=0.0,
        description="[J] of the ends of the whole laminate so far, trapezoidal over the increments",
        json_schema_extra=since(1, 5),
    )
    viscous_energy: Finite = Field(
        default=0.0,
        description="[J] that the viscosity of the cohesive layers of the whole laminate has taken so far",
        json_schema_extra=since(1, 5),
    )
    watched_strain: Annotated[FloatArray, ArraySpec("<f8", ("watched", 6))] | None = Field(
        default=None,
        description="of each watched brick in the axes of its ply, mean of its points; absent where none is watched",
        json_schema_extra=since(1, 5),
    )
    watched_stress: Annotated[FloatArray, ArraySpec("<f8", ("watched", 6), "Pa")] | None = Field(
        default=None, description="likewise", json_schema_extra=since(1, 5)
    )
    watched_subcells: Annotated[FloatArray, ArraySpec("<f8", ("watched", "subcells", 6), "Pa")] | None = Field(
        default=None,
        description="stress of each subcell of the cell, mean of the brick's points, each in its own state: its mean by"
        " area over the subcells is `watched_stress`",
        json_schema_extra=since(1, 5),
    )
