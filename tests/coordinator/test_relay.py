"""The crack relay: each arrow of its picture, and what it asks of the services."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from coordinator.crack_passage import CrackPassage
from coordinator.interface import build_interface
from coordinator.region import Region
from coordinator.relay import Borders, Cut, Leg, Relay, Sight
from coordinator.ring import rectangle_ring
from coordinator.scene import SceneError, read_scene
from protocol import atomistic as a
from protocol import continuum as c

A = 1e-10
BORDERS = Borders(-50 * A, -35 * A, 35 * A, 50 * A)
CELL = 5 * A


def relay(leg: Leg, critical: float | None = None) -> Relay:
    return Relay(BORDERS, CELL, leg, critical)


def test_in_the_continuum_the_stress_of_the_last_growth_is_saved() -> None:
    one = relay(Leg.CONTINUUM)
    for stress in (3e9, 5e9):
        assert one.decide(Sight(grew=True, stress=stress)) is None
    assert one.decide(Sight(stress=9e9)) is None  # measured, but it did not grow
    assert one.leg is Leg.CONTINUUM and one.critical_stress == 5e9 and one.leg.propagate


def test_a_crack_that_reaches_the_ring_becomes_a_cut_through_its_near_half() -> None:
    one = relay(Leg.CONTINUUM)
    cut = one.decide(Sight(grew=True, reached=True, stress=7e9))
    assert one.leg is Leg.ATOMS and not one.leg.propagate and one.critical_stress == 7e9
    assert cut is not None and cut.atoms is not None
    assert cut.continuum_to == BORDERS.near_inner and cut.atoms[1] == BORDERS.near_inner
    assert cut.atoms[0] < BORDERS.near_outer  # beyond the last atom: the edge is cut through


def test_among_the_atoms_nothing_is_asked_until_the_tip_is_at_the_far_side() -> None:
    one = relay(Leg.ATOMS, 7e9)
    assert one.decide(Sight(atom_tip=0.0, stress=99e9, grew=True, reached=True)) is None
    assert one.leg is Leg.ATOMS and one.critical_stress == 7e9
    cut = one.decide(Sight(atom_tip=BORDERS.far_inner - 0.5 * CELL))
    assert one.leg is Leg.WAITING
    assert cut is not None and cut.atoms is not None and cut.continuum_to == BORDERS.far_outer
    assert cut.atoms[0] == BORDERS.far_inner - 0.5 * CELL and cut.atoms[1] > BORDERS.far_outer


def test_at_the_far_side_the_continuum_cracks_anew_at_the_saved_stress() -> None:
    one = relay(Leg.WAITING, 7e9)
    assert one.decide(Sight(stress=None)) is None
    assert one.decide(Sight(stress=6.9e9, reached=True)) is None
    assert one.leg is Leg.WAITING
    assert one.decide(Sight(stress=7e9)) == Cut(BORDERS.far_outer + 0.5 * CELL)
    assert one.leg is Leg.BEYOND and one.leg.propagate


def test_without_a_saved_stress_it_waits_for_ever() -> None:
    one = relay(Leg.WAITING)
    assert one.decide(Sight(stress=1e15)) is None and one.leg is Leg.WAITING


def test_beyond_the_atoms_it_is_the_continuums_alone() -> None:
    one = relay(Leg.BEYOND, 7e9)
    assert one.decide(Sight(grew=True, reached=True, stress=9e9, atom_tip=1.0)) is None
    assert one.leg is Leg.BEYOND and one.critical_stress == 7e9


@pytest.mark.parametrize("leg", list(Leg))
@pytest.mark.parametrize("stress", [None, 3e9])
def test_its_state_is_restored(leg: Leg, stress: float | None) -> None:
    other = relay(Leg.CONTINUUM)
    other.restore(relay(leg, stress).state())
    assert (other.leg, other.critical_stress) == (leg, stress)


# --- with services -----------------------------------------------------------------------------------------------

SCENE = """
title = "relay"
[run]
steps = 1
[continuum]
assumption = "plane_stress"
lower = ["-200 angstrom", "-100 angstrom"]
upper = ["200 angstrom", "100 angstrom"]
cell_size = "5 angstrom"
[atomistic]
force_field = "airebo-sharp"
width = "100 angstrom"
height = "100 angstrom"
temperature = "300 K"
time_step = "0.5 fs"
[handshake]
width = "15 angstrom"
steps_per_exchange = 10
ivc_size = "7.5 angstrom"
[[regions]]
name = "right"
centre = ["60 angstrom", "0 angstrom"]
[[regions]]
name = "left"
centre = ["-60 angstrom", "0 angstrom"]
mirrored = true
[crack]
start_x = "-5 angstrom"
tip_x = "5 angstrom"
y = "0 angstrom"
[crack.growth]
critical_energy_release_rate = "10 J/m^2"
interval = 5
"""


class Service:
    """Answers nothing, and keeps what it was asked."""

    def __init__(self) -> None:
        self.asked: list[tuple[str, Any]] = []

    def call(self, operation: str, request: Any, reply: Any, step: int = 0) -> None:
        self.asked.append((operation, request))


def passages() -> tuple[list[CrackPassage], list[Any], Any]:
    """Both tips of a crack between two samples, with their services and the continuum's."""
    scene = read_scene(SCENE, "relay")
    continuum: Any = Service()
    regions = []
    for place in scene.places:
        client: Any = Service()
        region = Region(scene, place, client)
        x = np.arange(-50, 51, 2.5) * A
        region.own_reference = np.column_stack([g.ravel() for g in np.meshgrid(x, x)] + [np.zeros(x.size**2)])
        half = np.array([50 * A, 50 * A])
        ring = rectangle_ring(((-35 * A, -35 * A), (35 * A, 35 * A)), -half, half, ["left", "right", "bottom", "top"])
        region.interface = build_interface(region.own_reference, ring, 7.5 * A, 0.0)
        regions.append(region)
    return CrackPassage.of_scene(scene, regions, continuum), [region.client for region in regions], continuum


def replies(crack_end: int | None, atom_tip: float) -> tuple[Any, Any]:
    """A step in which one end reached its ring, or none did."""
    events = []
    if crack_end is not None:
        tip = c.CrackTip(crack=0, end=crack_end, position=(0.0, 0.0), length=10 * A, hoop_stress=8e9)
        events.append(c.ContinuumEvent(kind="reached_overlap", step=3, sentence="there", tip=tip))
    continuum = c.ContinuumAdvanced.model_construct(step=3, tips=[], events=events)
    return continuum, a.AtomisticAdvanced.model_construct(crack_tip=atom_tip)


def test_each_sample_takes_the_tip_that_comes_to_it() -> None:
    (right, left), (right_atoms, left_atoms), continuum = passages()
    assert right.leg is left.leg is Leg.CONTINUUM
    values: dict[str, float] = {}
    step = replies(0, -50 * A)  # the left end
    assert right.follow(*step, 1, values) == [] and right_atoms.asked == []
    told = left.follow(*step, 1, values)
    assert left.leg is Leg.ATOMS and len(told) == 1 and "left" in told[0].sentence and "8 GPa" in told[0].sentence
    ((operation, cut),) = left_atoms.asked
    assert operation == "cut" and cut.to_x == pytest.approx(-35 * A) and cut.from_x < -50 * A
    # The rows of this sheet are 2.5 A apart, one of them on the crack's line: the cut runs between two.
    assert abs(cut.y) == pytest.approx(1.25 * A)
    ((operation, extension),) = continuum.asked
    assert operation == "extend_crack" and (extension.crack, extension.end) == (0, 0)
    # Mirrored: the near inner border of the left sample lies on its right.
    assert extension.points[0] == pytest.approx((-60 * A + 35 * A, 0.0))
    assert values == {"crack_leg@right": 0.0, "crack_leg@left": 1.0}


def test_a_passage_is_restored_with_its_leg() -> None:
    (right, _), _, _ = passages()
    right.follow(*replies(1, -50 * A), 1, {})
    (other, _), _, _ = passages()
    other.restore(right.state())
    assert other.leg is Leg.ATOMS


def test_a_crack_that_begins_among_the_atoms_needs_the_stress_of_the_scene() -> None:
    text = SCENE.replace('start_x = "-5 angstrom"', "").replace('tip_x = "5 angstrom"', 'tip_x = "60 angstrom"')
    text = text[: text.index('[[regions]]\nname = "left"')] + text[text.index("[crack]") :]
    with pytest.raises(SceneError, match=r"crack\.critical_stress: is missing"):
        read_scene(text, "relay")
    scene = read_scene(text.replace('y = "0 angstrom"', 'y = "0 angstrom"\ncritical_stress = "5 GPa"'), "relay")
    assert scene.crack is not None and scene.crack.critical_stress == pytest.approx(5e9)
