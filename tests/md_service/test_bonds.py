import numpy as np
import pytest

from md_service.bonds import Bonds
from md_service.force_fields import force_field
from md_service.graphene import CrackCut, sheet

FIELD = force_field("airebo")
CRACK = CrackCut(0.0)


@pytest.fixture
def cracked():
    return sheet(40e-10, 40e-10, FIELD.lattice_constant, CRACK).position


def opened(position, tip_x):
    """Sheet with its upper half lifted by 1 A left of a new tip: the vertical bonds below the chain at y = 0 break."""
    new = position.copy()
    new[(position[:, 1] > -0.5 * FIELD.lattice_constant) & (position[:, 0] < tip_x), 1] += 1e-10
    return new


def test_undeformed_sheet_has_no_broken_bond_and_its_tip_at_the_slit(cracked):
    report = Bonds(cracked, FIELD, CRACK).report(cracked)
    assert (report.broken, report.tip_x, report.sticking, report.warning) == (0, 0.0, 0, "")
    assert report.longest_length == pytest.approx(FIELD.lattice_constant)


def test_tip_moves_with_the_bonds_that_break_ahead_of_the_slit(cracked):
    bonds = Bonds(cracked, FIELD, CRACK)
    new_tip = 9e-10
    report = bonds.report(opened(cracked, new_tip))
    cell = np.sqrt(3) * FIELD.lattice_constant
    assert report.broken >= round(new_tip / cell)
    assert new_tip - cell < report.tip_x < new_tip + cell


def test_a_hole_away_from_the_crack_is_counted_but_moves_no_tip(cracked):
    lifted = cracked.copy()
    atom = np.argmin(np.linalg.norm(cracked - [8e-10, 12e-10, 0.0], axis=1))
    lifted[atom, 2] += 3e-10
    report = Bonds(cracked, FIELD, CRACK).report(lifted)
    assert report.broken == 3
    assert report.tip_x == 0.0


def test_without_a_slit_there_is_no_tip():
    position = sheet(30e-10, 30e-10, FIELD.lattice_constant).position
    assert np.isnan(Bonds(position, FIELD, None).report(position).tip_x)


def test_bonds_that_stick_at_the_switching_start_are_reported_with_the_trap(cracked):
    stretched = cracked.copy()
    atom = np.argmin(np.linalg.norm(cracked - [1.2e-10, 0.0, 0.0], axis=1))
    partner = Bonds(cracked, FIELD, CRACK)
    pair = next(pair for pair in partner.pairs if atom in pair)
    other = pair[0] if pair[1] == atom else pair[1]
    direction = cracked[atom] - cracked[other]
    stretched[atom] = cracked[other] + direction * (1.005 * FIELD.switching_start / np.linalg.norm(direction))
    report = partner.report(stretched)
    assert report.sticking >= 1
    assert "1.70 A" in report.warning
    assert report.longest_length == pytest.approx(1.005 * FIELD.switching_start, rel=0.02)
