"""Carries out the crack relay in a scene: looks at the tips, cuts atoms, extends the continuum's crack."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np

from coordinator.region import Region
from coordinator.relay import Borders, Cut, Leg, Relay, Sight
from coordinator.scene import Scene
from coordinator.series import series_name
from coordinator.units import LENGTHS, readable
from protocol import atomistic as a
from protocol import continuum as c
from protocol.arrays import FloatArray
from protocol.client import Client

#: Row of [crack] among the continuum's cracks.
CRACK = 0
#: Kinds of the continuum's events that the relay heeds.
GROWTH, REACHED = "growth", "reached_overlap"

#: Part of the widest gap between rows above which another one counts as wide.
_WIDE = 0.9


class CrackPassage:
    """One tip of a scene's crack on its way through one region.

    Parameters
    ----------
    scene : Scene
        With a crack that may grow in the continuum.
    region : Region
        Joined.
    continuum : Client
    alone : bool
        Whether it is the only region of the scene; else the names of its series end with its own.
    """

    def __init__(self, scene: Scene, region: Region, continuum: Client, alone: bool = True) -> None:
        crack = scene.crack
        assert crack is not None
        self._region = region
        self._continuum = continuum
        self._alone = alone
        self._y = crack.y
        self._own_y = crack.y - region.frame.centre[1]
        self._cut_y = _between_rows(region.own_reference[:, 1], self._own_y)
        self._end: Literal[0, 1] = 0 if region.frame.mirrored else 1
        tip = crack.start_x if region.frame.mirrored else crack.tip_x
        assert tip is not None
        borders = _borders(region, self._own_y)
        in_continuum = region.frame.x_to_sample(tip) < borders.near_outer
        leg = Leg.CONTINUUM if in_continuum else Leg.ATOMS
        self._relay = Relay(borders, scene.finest_cell, leg, crack.critical_stress)

    @classmethod
    def of_scene(cls, scene: Scene, regions: Sequence[Region], continuum: Client) -> list[CrackPassage]:
        """Return one for each region where the scene has a crack that may grow in the continuum."""
        if scene.crack is None or scene.crack.growth is None:
            return []
        return [cls(scene, region, continuum, alone=len(regions) == 1) for region in regions]

    @property
    def leg(self) -> Leg:
        """Who carries the tip."""
        return self._relay.leg

    def follow(
        self, continuum: c.ContinuumAdvanced, atoms: a.AtomisticAdvanced, step: int, values: dict[str, float]
    ) -> list[c.ContinuumEvent]:
        """Take in a coupling step; cut and extend where the tip changes hands.

        Parameters
        ----------
        continuum, atoms : reply of each service
        step : int
            Of the coupling.
        values : dict of str to float
            Takes the leg.

        Returns
        -------
        list of ContinuumEvent
            What happened, in words.
        """
        told = {event.kind: event.tip for event in continuum.events if event.tip is not None and self._mine(event.tip)}
        now = next((tip for tip in continuum.tips if self._mine(tip)), None)
        measured = told.get(REACHED) or told.get(GROWTH) or now
        before = self._relay.leg
        cut = self._relay.decide(
            Sight(
                grew=GROWTH in told,
                reached=REACHED in told,
                stress=None if measured is None else measured.hoop_stress,
                atom_tip=atoms.crack_tip,
            )
        )
        name = series_name("crack_leg", self._region.name, self._alone)
        values[name] = float(self._relay.leg.value)
        if cut is not None:
            self._carry_out(cut, step)
        if self._relay.leg is before:
            return []
        return [c.ContinuumEvent(kind="relay", step=continuum.step, sentence=self._sentence(atoms))]

    def state(self) -> np.ndarray:
        """Return what `restore` needs."""
        return self._relay.state()

    def restore(self, state: np.ndarray) -> None:
        """Set what `state` gave; the cuts are in the services' own states."""
        self._relay.restore(state)

    # --- inside ------------------------------------------------------------------------------------------

    def _mine(self, tip: c.CrackTip) -> bool:
        return (tip.crack, tip.end) == (CRACK, self._end)

    def _carry_out(self, cut: Cut, step: int) -> None:
        if cut.atoms is not None:
            severed = a.CutRequest(from_x=cut.atoms[0], to_x=cut.atoms[1], y=self._cut_y)
            self._region.client.call("cut", severed, a.Severed, step=step)
        tip = (self._region.frame.x_to_scene(cut.continuum_to), self._y)
        extension = c.CrackExtension(crack=CRACK, end=self._end, points=[tip])
        self._continuum.call("extend_crack", extension, c.CrackExtended, step=step)

    def _sentence(self, atoms: a.AtomisticAdvanced) -> str:
        leg, critical = self._relay.leg, self._relay.critical_stress
        stress = "" if critical is None else f" at a stress ahead of {critical / 1e9:.3g} GPa"
        if leg is Leg.ATOMS:
            where = f"the handshake of {self._region.name} and went on as a cut among its atoms"
            return f"The crack of the continuum reached {where}{stress}."
        if leg is Leg.WAITING:
            place = "" if atoms.crack_tip is None else f", at {readable(atoms.crack_tip, LENGTHS, 4)} in its frame"
            return f"The crack among the atoms of {self._region.name} reached the far side{place}."
        return f"The crack goes on in the continuum behind {self._region.name}{stress}."


def _borders(region: Region, y: float) -> Borders:
    """Return where the line of the crack crosses the ring."""
    crossings: FloatArray = np.sort(
        np.concatenate([_crossings(ring, y) for ring in (region.interface.ring.outer, region.interface.ring.inner)])
    )
    if len(crossings) != 4:
        raise ValueError(f"crack.y: its line crosses the ring of {region.name} {len(crossings)} times, must 4 times")
    return Borders(*crossings.tolist())


def _crossings(corners: FloatArray, y: float) -> FloatArray:
    """Return the x at which a polygon's border crosses a height."""
    first, second = corners, np.roll(corners, -1, axis=0)
    cross = (first[:, 1] > y) != (second[:, 1] > y)
    one, other = first[cross], second[cross]
    return np.asarray(one[:, 0] + (y - one[:, 1]) * (other[:, 0] - one[:, 0]) / (other[:, 1] - one[:, 1]))


def _between_rows(heights: FloatArray, y: float) -> float:
    """Return the height nearest to `y` that lies in the middle of a widest gap between rows of atoms, m.

    A cut there crosses the fewest bonds: in graphene the upright ones, one a cell. A glass has no rows, and is cut
    where the crack lies.
    """
    rows = np.unique(np.round(heights, 12))
    gaps = np.diff(rows)
    wide = gaps > _WIDE * gaps.max(initial=0.0)
    middle = 0.5 * (rows[:-1] + rows[1:])[wide]
    near = middle[np.argmin(np.abs(middle - y))] if len(middle) else y
    return float(near) if abs(near - y) < 2.0 * gaps.max(initial=0.0) else y
