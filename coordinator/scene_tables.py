"""Tables of a scene file as models. All values are SI floats once read."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from coordinator.atomistic_tables import Atomistic
from coordinator.continuum_tables import Continuum, CrackGrowth
from coordinator.grid_lines import snapped_overlap
from coordinator.micromechanics_table import Micromechanics
from coordinator.table import Corners, Count, Name, SceneTable, Table
from coordinator.units import (
    Length,
    PositiveEnergyPerArea,
    PositiveForce,
    PositiveLength,
    PositivePressure,
    PositiveStiffness,
    PositiveTime,
)

Side = Literal["left", "right", "bottom", "top"]
Seed = Annotated[int, Field(strict=True, ge=0, lt=2**31)]


class Run(Table):
    """How long the run is and how often it writes."""

    steps: Count = Field(description="most coupling steps")
    output_every: Count = Field(default=50, description="steps between frames of atoms and points")
    checkpoint_every: Count = Field(default=100, description="steps between checkpoints")
    seed: Seed = 1
    stop_after_crack_growth: PositiveLength | None = Field(
        default=None, description="the run ends when a crack tip has moved so far, m"
    )


#: What `handshake.preset` sets where the scene does not: the dissertation's plain scheme.
PRESETS: dict[str, dict[str, Any]] = {"seed": {"weight": 1.0, "spread": "ivc", "profile": "constant"}}


class Handshake(Table):
    """Overlap of continuum and atoms, and the exchange between them."""

    preset: Literal["seed"] | None = Field(
        default=None, description="the dissertation's plain scheme: full weight, stiff springs, spread over cells"
    )
    width: PositiveLength = Field(description="width of the ring, m")
    shape: Literal["rectangle", "circle", "polygon"] = Field(default="rectangle", description="of the ring's borders")
    corners: list[tuple[Length, Length]] | None = Field(
        default=None, min_length=3, description="of the outer border of a polygon, from the middle of the sample, m"
    )
    sides: list[Side] = Field(
        default=["left", "right", "bottom", "top"],
        min_length=1,
        description="where a rectangle has a ring; elsewhere the sample ends where the body does",
    )
    steps_per_exchange: Count | None = Field(
        default=None, description="M: atomistic steps in one exchange; absent: chosen by force_error"
    )
    force_error: PositiveForce | None = Field(
        default=None, description="M is the smallest whose mean force on a cell has at most this standard error, N"
    )
    most_steps_per_exchange: Count = Field(default=200, description="largest M that force_error may choose")
    continuum_steps: Count | None = Field(
        default=None, description="sub-steps of the continuum in one exchange; absent: as few as are stable"
    )
    scheme: Literal["serial", "parallel"] = Field(
        default="serial", description="one service after the other, or both at once with predicted anchors"
    )
    ivc_size: PositiveLength = Field(description="edge of an interface volume cell, m")
    damping_time: PositiveTime | None = Field(default=None, description="s; absent: no damper, no thermostat")
    weight: Annotated[float, Field(strict=True, gt=0, le=1)] | None = Field(
        default=None, description="share of the continuum's stiffness and mass; absent: by theory"
    )
    profile: Literal["constant", "linear", "cubic", "power"] | None = Field(
        default=None,
        description="of the weight, from `weight` at the inner border to 1 at the outer; absent: the steepest power"
        " that is stable, or constant where weight or stiffness are given",
    )
    stiffness: PositiveStiffness | None = Field(default=None, description="anchor spring, N/m; absent: by theory")
    stiffness_weight: Annotated[float, Field(strict=True, gt=0, le=1)] | None = Field(
        default=None, description="share of the continuum's stiffness alone; absent: by theory, or as its mass"
    )
    alpha: Annotated[float, Field(strict=True, ge=0, lt=1)] = Field(
        default=0.0, description="the springs carry 1 - alpha of their energy (Eq 84)"
    )
    spread: Literal["ivc", "anchor"] = Field(
        default="anchor", description="reactions go back along the shape functions, or evenly to the points of an IVC"
    )
    motion: Literal["held", "linear"] = Field(
        default="held", description="anchors stand still during an exchange, or go on with their velocity"
    )
    anchor_spacing: PositiveLength | None = Field(
        default=None,
        description="least distance between two anchors, on atoms other than hydrogen, m; absent: all atoms",
    )
    passive_width: PositiveLength | None = Field(
        default=None, description="atoms so near to the sample's edge have no spring and follow the continuum, m"
    )
    surface_width: PositiveLength | None = Field(
        default=None, description="on atoms so near to the sample's edge a constant force replaces the spring, m"
    )
    until_error: PositiveForce | None = Field(
        default=None, description="an exchange is repeated until no force on a cell has a larger standard error, N"
    )
    most_windows: Count = Field(default=10, description="repetitions at most")

    @model_validator(mode="before")
    @classmethod
    def _apply_preset(cls, given: Any) -> Any:
        if isinstance(given, dict) and given.get("preset") in PRESETS:
            return {**PRESETS[given["preset"]], **given}
        return given


class Place(Table):
    """A place for a sample of atoms, as [atomistic] and [handshake] say, with a service of its own."""

    name: Annotated[str, Field(strict=True, pattern=r"^[a-z][a-z0-9_]{0,19}$")]
    centre: tuple[Length, Length] = Field(default=(0.0, 0.0), description="where the middle of the sample lies, m")
    mirrored: bool = Field(default=False, strict=True, description="whether x of the sample points to -x")


class Crack(Table):
    """A straight crack along x, from the left edge of the body or from a second tip inside."""

    tip_x: Length = Field(description="right tip, m")
    y: Length = Field(description="m")
    start_x: Length | None = Field(default=None, description="left tip, m; absent: the left edge is cut through")
    growth: CrackGrowth | None = Field(
        default=None, description="how it grows in the continuum; absent: it grows among the atoms only"
    )
    critical_stress: PositivePressure | None = Field(
        default=None, description="stress at which the continuum cracks anew behind the atoms, where none was saved, Pa"
    )
    toughness: PositiveEnergyPerArea | None = Field(
        default=None, description="critical energy release rate, for the critical crack length of Eq 1, J/m2"
    )
    strength: PositivePressure | None = Field(
        default=None, description="theoretical strength, for Eq 1, Pa; absent: a tenth of Young's modulus"
    )


class Scene(SceneTable):
    """A whole scene in SI, with the text it was read from."""

    title: Name
    run: Run
    continuum: Continuum
    atomistic: Atomistic | None = None
    handshake: Handshake | None = None
    regions: list[Place] = Field(default=[], description="where there are atoms; absent: around the origin")
    crack: Crack | None = None
    micromechanics: Micromechanics | None = Field(default=None, description="the cell of a laminate's plies")

    @property
    def places(self) -> list[Place]:
        """Regions of atoms; a scene that names none has one around the origin."""
        if self.atomistic is None:
            return []
        return self.regions or [Place(name="atomistic")]

    @property
    def finest_cell(self) -> float:
        """Edge of a cell of the finest level, m."""
        return self.continuum.cell_size / 2 ** len(self.continuum.refinement)

    def with_steps_per_exchange(self, steps: int) -> Scene:
        """Return the scene with M chosen."""
        assert self.handshake is not None
        return self.model_copy(update={"handshake": self.handshake.model_copy(update={"steps_per_exchange": steps})})

    @property
    def time_step(self) -> float:
        """Coupling step, s; with M still to be chosen, the longest that it may become."""
        if self.atomistic is not None and self.handshake is not None:
            steps = self.handshake.steps_per_exchange or self.handshake.most_steps_per_exchange
            return steps * self.atomistic.time_step
        assert self.continuum.time_step is not None  # held by the cross-field checks
        return self.continuum.time_step

    def overlap(self, width: float | None = None, height: float | None = None) -> tuple[Corners, Corners] | None:
        """Return the inner and the outer rectangle of the handshake of a sample around the origin, on grid lines.

        Parameters
        ----------
        width, height : float, optional
            True extent of the sheet, m; the requested extent where absent.
        """
        if self.atomistic is None or self.handshake is None:
            return None
        return snapped_overlap(
            self.continuum.lower, self.finest_cell, width or self.atomistic.width,
            height or self.atomistic.height, self.handshake.width,
        )  # fmt: skip
