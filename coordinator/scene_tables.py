"""Tables of a scene file as models. All values are SI floats once read."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, PrivateAttr

from coordinator.atomistic_tables import Atomistic
from coordinator.continuum_tables import Continuum
from coordinator.table import Corners, Count, Name, Point, Table
from coordinator.units import Length, PositiveForce, PositiveLength, PositiveStiffness, PositiveTime

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


class Handshake(Table):
    """Overlap of continuum and atoms, and the exchange between them."""

    width: PositiveLength = Field(description="width of the ring, m")
    steps_per_exchange: Count = Field(description="M: atomistic steps in one continuum step")
    ivc_size: PositiveLength = Field(description="edge of an interface volume cell, m")
    damping_time: PositiveTime | None = Field(default=None, description="s; absent: no damper, no thermostat")
    weight: Annotated[float, Field(strict=True, gt=0, le=1)] | None = Field(
        default=None, description="share of the continuum's stiffness and mass; absent: by theory"
    )
    stiffness: PositiveStiffness | None = Field(default=None, description="anchor spring, N/m; absent: by theory")
    spread: Literal["ivc", "anchor"] = Field(
        default="anchor", description="reactions go back along the shape functions, or evenly to the points of an IVC"
    )
    motion: Literal["held", "linear"] = Field(
        default="held", description="anchors stand still during an exchange, or go on with their velocity"
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


class Crack(Table):
    """A straight crack from the left edge of the body."""

    tip_x: Length = Field(description="m")
    y: Length = Field(description="m")


class Scene(Table):
    """A whole scene in SI, with the text it was read from."""

    title: Name
    run: Run
    continuum: Continuum
    atomistic: Atomistic | None = None
    handshake: Handshake | None = None
    crack: Crack | None = None

    _name: str = PrivateAttr(default="")
    _folder: Path = PrivateAttr(default=Path())
    _text: str = PrivateAttr(default="")
    _overrides: tuple[str, ...] = PrivateAttr(default=())

    @property
    def name(self) -> str:
        """Name of the scene: its file name without ending."""
        return self._name

    @property
    def folder(self) -> Path:
        """Folder of the scene file, from which names of files in it count."""
        return self._folder

    @property
    def text(self) -> str:
        """Text of the scene file, without overrides."""
        return self._text

    @property
    def overrides(self) -> tuple[str, ...]:
        """Overrides as they were given, ``key.sub=value``."""
        return self._overrides

    @property
    def time_step(self) -> float:
        """Coupling step, which is the continuum's step, s."""
        if self.atomistic is not None and self.handshake is not None:
            return self.handshake.steps_per_exchange * self.atomistic.time_step
        assert self.continuum.time_step is not None  # held by the cross-field checks
        return self.continuum.time_step

    def overlap(self, width: float | None = None, height: float | None = None) -> tuple[Corners, Corners] | None:
        """Return the inner and the outer rectangle of the handshake, both on grid lines; see `snapped_overlap`.

        Parameters
        ----------
        width, height : float, optional
            True extent of the sheet, m; the requested extent where absent.
        """
        if self.atomistic is None or self.handshake is None:
            return None
        return snapped_overlap(
            self.continuum.lower, self.continuum.cell_size, width or self.atomistic.width,
            height or self.atomistic.height, self.handshake.width,
        )  # fmt: skip


def snapped_overlap(
    lower: Point, cell_size: float, width: float, height: float, handshake: float
) -> tuple[Corners, Corners]:
    """Lay the overlap ring of a centred sheet onto grid lines.

    Parameters
    ----------
    lower : tuple of float
        A corner of the grid's cells, m.
    cell_size : float
        Edge of a cell, m.
    width, height : float
        Extent of the sheet, m.
    handshake : float
        Width of the ring, a whole number of cells, m.

    Returns
    -------
    inner, outer : tuple of tuple of float
        Lower and upper corners, m. The outer rectangle has the grid lines nearest to the edges of
        the sheet, the inner one lies `handshake` inside it.
    """
    ring = round(handshake / cell_size)
    low: list[int] = []
    high: list[int] = []
    for axis, half in ((0, width / 2), (1, height / 2)):
        low.append(round((-half - lower[axis]) / cell_size))
        high.append(round((half - lower[axis]) / cell_size))

    def corner(cells: list[int], shift: int) -> Point:
        return (lower[0] + (cells[0] + shift) * cell_size, lower[1] + (cells[1] + shift) * cell_size)

    return (corner(low, ring), corner(high, -ring)), (corner(low, 0), corner(high, 0))
