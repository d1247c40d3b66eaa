import pytest

from md_service.force_fields import FORCE_FIELDS, force_field
from md_service.lammps_library import potentials_folder


def test_sharp_airebo_changes_two_numbers_of_a_copy_and_nothing_in_the_installed_file(tmp_path):
    installed = potentials_folder() / "CH.airebo"
    before = installed.read_bytes()
    commands = force_field("airebo-sharp").commands(tmp_path)
    assert installed.read_bytes() == before
    (copy,) = tmp_path.iterdir()
    assert str(copy) in commands[-1]
    old, new = before.decode().splitlines(), copy.read_text().splitlines()
    changed = [(a.split(), b.split()) for a, b in zip(old, new, strict=True) if a != b]
    assert changed == [(["1.7", "rcmin_CC"], ["1.99999999", "rcmin_CC"])]
    assert "2.0\t     rcmax_CC" in copy.read_text()


@pytest.mark.parametrize("name", sorted(FORCE_FIELDS))
def test_bonds_are_shorter_than_the_switching_window_of_their_profile(name):
    profile = FORCE_FIELDS[name]
    assert profile.lattice_constant < profile.switching_start < profile.switching_end
    assert profile.cutoff_trap


def test_unknown_name_lists_the_known_ones():
    with pytest.raises(ValueError, match=r"'morse'.*airebo-sharp.*tersoff"):
        force_field("morse")
