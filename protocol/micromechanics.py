"""Messages of the role `micromechanics`: stress, tangent and failure of a periodic cell at many points at once.

The role is stateless: what a point has gone through travels with the query and comes back with the answer. A service
keeps nothing but the definitions of cells, each under an id that follows from its content.

Components of stress and strain are 11, 22, 33, 23, 13, 12, strains of shear in engineering measure; axis 1 runs along
the fibres. Subcell (beta, gamma) lies in row beta along axis 2 and column gamma along axis 3; in flat arrays its index
is beta * columns + gamma.
"""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal, Self

import numpy as np
from numpy.typing import NDArray
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
    check_ascending,
    check_indices,
    since,
    wrong,
)
from protocol.stiffness import stiffness_problem
from protocol.version import Version

ByteArray = NDArray[np.uint8]

CellId = Annotated[str, Field(min_length=1, max_length=128)]
Three = Annotated[tuple[Positive | None, Positive | None, Positive | None], Field(strict=False)]
Matrix36 = Annotated[list[Finite], Field(min_length=36, max_length=36)]
Vector6 = Annotated[list[Finite], Field(min_length=6, max_length=6)]


class MaterialFailure(Part):
    """One failure criterion with its allowables. A component without an allowable is not checked."""

    added_in: ClassVar[Version] = Version(1, 4)

    criterion: Literal["maximum_stress", "maximum_strain", "tsai_hill", "hashin"] = Field(
        description="`maximum_strain` takes strains, the others stresses"
    )
    tension: Three = Field(default=(None, None, None), description="[Pa or 1] along 1, 2, 3; nil: not checked")
    compression: Three = Field(
        default=(None, None, None), description="[Pa or 1] along 1, 2, 3, as positive numbers; nil: not checked"
    )
    shear: Three = Field(default=(None, None, None), description="[Pa or 1] of 23, 13, 12; nil: not checked")


class MaterialPlasticity(Part):
    """J2 plasticity with linear isotropic hardening."""

    added_in: ClassVar[Version] = Version(1, 4)

    yield_stress: Positive = Field(description="[Pa] in uniaxial tension")
    hardening: NonNegative = Field(default=0.0, description="[Pa] of the yield stress per equivalent plastic strain")


class CellMaterial(Part):
    """A constituent. Between temperatures the constants are linear; with one entry they hold at any temperature."""

    added_in: ClassVar[Version] = Version(1, 4)

    name: str = Field(description="for people; it plays no part in the id of the cell")
    temperatures: list[NonNegative] = Field(min_length=1, description="[K] ascending")
    stiffness: list[Matrix36] = Field(
        description="[Pa] for each temperature the 6 x 6 matrix row by row; symmetric and positive definite"
    )
    expansion: list[Vector6] = Field(
        description="[1/K] for each temperature the thermal strain per kelvin, secant from `stress_free_temperature`"
    )
    failures: list[MaterialFailure] = Field(
        default_factory=list, description="all are checked; the first that is reached fails the subcell"
    )
    fracture_energy: Positive | None = Field(
        default=None, description="[J/m^2] per area of crack, for softening; absent: a subcell fails at once"
    )
    reduces_strength: bool = Field(
        default=False,
        description="with `fracture_energy`, in an element so long that it would store more than its crack can take: "
        "the strength is lowered to sqrt(2 E G_c / length) (Bazant and Oh 1983); otherwise the element is refused",
        json_schema_extra=since(1, 5),
    )
    plasticity: MaterialPlasticity | None = Field(default=None, description="absent: elastic until it fails")

    @model_validator(mode="after")
    def _tables_fit(self) -> Self:
        check_ascending("temperatures", self.temperatures)
        for name, rows in (("stiffness", self.stiffness), ("expansion", self.expansion)):
            if len(rows) != len(self.temperatures):
                raise wrong(name, f"has {len(rows)} entries, temperatures has {len(self.temperatures)}")
        for entry in self.stiffness:
            problem = stiffness_problem(np.reshape(entry, (6, 6)))
            if problem is not None:
                raise wrong("stiffness", problem)
        return self


class RegisterCell(Message):
    """Define a repeating unit cell. Equal definitions have equal ids, however often and by whom they are sent."""

    heights: Annotated[FloatArray, ArraySpec("<f8", ("rows",), "m")] = Field(
        description="extent of each row along axis 2, above 0"
    )
    widths: Annotated[FloatArray, ArraySpec("<f8", ("columns",), "m")] = Field(
        description="extent of each column along axis 3, above 0"
    )
    phase: Annotated[IntArray, ArraySpec("<i8", ("rows", "columns"))] = Field(
        description="material of each subcell, a row of `materials`"
    )
    materials: list[CellMaterial] = Field(min_length=1, description="constituents")
    stress_free_temperature: NonNegative = Field(
        default=300.0, description="[K] at which the unloaded cell has no stress"
    )
    knock_down: Annotated[Positive, Field(le=1)] = Field(
        default=1e-4, description="[1] factor on the stiffness of a failed subcell"
    )
    after_failure: Literal["gmc", "floor", "high_fidelity"] = Field(
        default="gmc", description="what answers for a cell with failed subcells, where methods differ"
    )

    @model_validator(mode="after")
    def _sizes_and_phases(self) -> Self:
        for name in ("heights", "widths"):
            values = getattr(self, name)
            if not len(values):
                raise wrong(name, "is empty; a cell has at least one row and one column")
            if not (values > 0.0).all():
                raise wrong(name, f"holds {values.min():g} m; every size must be greater than 0")
        check_indices("phase", self.phase.reshape(-1), len(self.materials))
        return self


class CellRegistered(Message):
    """The cell is known."""

    cell: CellId = Field(description="id of the cell: the same for every equal definition")
    subcells: Count = Field(description="rows times columns")
    failed_bytes: Count = Field(description="[byte] of the bit field `failed` of a point")
    history_values: Natural = Field(description="numbers of `history` of a point; 0 where nothing but failure is kept")
    material_fraction: Annotated[FloatArray, ArraySpec("<f8", ("materials",))] = Field(
        description="share of each material in the area of the cell"
    )


class LocaliseRequest(Message):
    """Ask for the fields inside the cell at each point, in the given state: nothing fails or flows on the way."""

    cell: CellId = Field(description="id from `register`")
    temperature: NonNegative = Field(description="[K] of all points")
    strain: Annotated[FloatArray, ArraySpec("<f8", ("points", 6))] = Field(description="macroscopic strain")
    failed: Annotated[ByteArray, ArraySpec("|u1", ("points", "failed_bytes"))] | None = Field(
        default=None,
        description="bit n % 8 (1 is the lowest) of byte n / 8 is 1 where subcell n has failed; absent: none has",
    )
    history: Annotated[FloatArray, ArraySpec("<f8", ("points", "history_values"))] | None = Field(
        default=None, description="from the answer to the query before; absent: zeros, the virgin state"
    )


class EvaluateRequest(LocaliseRequest):
    """Ask for the stress at each point. Subcells that reach their limits fail within the query, in a cascade."""

    element_length: Annotated[FloatArray, ArraySpec("<f8", ("points",), "m")] | None = Field(
        default=None,
        description="macroscopic length over which a crack is spread, above 0; needed with `fracture_energy`",
    )
    want_tangent: bool = Field(default=True, description="whether tangents are answered")

    @model_validator(mode="after")
    def _lengths_are_positive(self) -> Self:
        lengths = self.element_length
        if lengths is not None and len(lengths) and not lengths.min() > 0.0:
            raise wrong("element_length", f"holds {lengths.min():g} m; every length must be greater than 0")
        return self


class Evaluated(Message):
    """Stress and new state; rows are in the order of the query."""

    stress: Annotated[FloatArray, ArraySpec("<f8", ("points", 6), "Pa")] = Field(description="macroscopic stress")
    failed: Annotated[ByteArray, ArraySpec("|u1", ("points", "failed_bytes"))] = Field(
        description="bits of the subcells that have failed now"
    )
    history: Annotated[FloatArray, ArraySpec("<f8", ("points", "history_values"))] = Field(
        description="to be sent with the next query of these points"
    )
    tangent_index: Annotated[IntArray, ArraySpec("<i8", ("points",))] | None = Field(
        default=None, description="row of `tangents` of each point; absent where no tangent was wanted"
    )
    tangents: Annotated[FloatArray, ArraySpec("<f8", ("tangents", 6, 6), "Pa")] | None = Field(
        default=None, description="each one once, in the order in which the points first use them"
    )
    new_failures: Natural = Field(description="subcells of all points that failed in this query")


class Localised(Message):
    """Mean stress and strain of every subcell at each point."""

    stress: Annotated[FloatArray, ArraySpec("<f8", ("points", "subcells", 6), "Pa")] = Field(
        description="of each subcell"
    )
    strain: Annotated[FloatArray, ArraySpec("<f8", ("points", "subcells", 6))] = Field(description="of each subcell")


class CellPropertiesRequest(Message):
    """Ask for the effective constants of a cell, intact or with failed subcells."""

    cell: CellId = Field(description="id from `register`")
    temperature: NonNegative = Field(description="[K] of the cell")
    failed: Annotated[ByteArray, ArraySpec("|u1", ("failed_bytes",))] | None = Field(
        default=None, description="bits as in a query; absent: none has failed"
    )


class CellProperties(Message):
    """Effective constants: stress = stiffness (strain - expansion (temperature - stress_free_temperature))."""

    stiffness: Annotated[FloatArray, ArraySpec("<f8", (6, 6), "Pa")] = Field(description="B*")
    expansion: Annotated[FloatArray, ArraySpec("<f8", (6,), "1/K")] = Field(description="thermal strain per kelvin")
    material_fraction: Annotated[FloatArray, ArraySpec("<f8", ("materials",))] = Field(
        description="share of each material in the area of the cell"
    )
    safe_energy: NonNegative = Field(
        default=0.0,
        description="[J/m^3] no intact point fails or yields where strain times stiffness times strain is below twice"
        " this; 0: not known, 1e300: nothing ever does",
    )
