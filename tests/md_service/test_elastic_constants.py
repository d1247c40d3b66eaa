import pytest

from md_service.elastic_constants import measure_graphene
from md_service.engine import LammpsEngine
from md_service.force_fields import FORCE_FIELDS
from md_service.graphene import sheet

# Tension tests at 0 K with other scripts on the same potentials: E in GPa, Poisson's ratio.
STATIC = {
    "tersoff": (1054.0, 0.064),
    "airebo": (827.0, 0.357),
    "airebo-sharp": (827.0, 0.357),
    "rebo": (728.0, 0.388),
    "lcbop": (933.0, 0.221),
}


@pytest.mark.parametrize("name", sorted(STATIC))
def test_static_constants_of_each_profile(name, tmp_path):
    young, poisson = STATIC[name]
    measured = measure_graphene(name, 0.0, tmp_path)
    assert measured.young == pytest.approx(young * 1e9, rel=0.01)
    assert measured.poisson == pytest.approx(poisson, rel=0.01)
    assert measured.lattice_constant == pytest.approx(FORCE_FIELDS[name].lattice_constant, rel=1e-6)
    assert measured.thickness == 3.35e-10
    # Two atoms of 12.011 u in a cell of 3 sqrt(3) / 2 a^2.
    cell = 1.5 * 3**0.5 * measured.lattice_constant**2 * 3.35e-10
    assert measured.density == pytest.approx(2 * 12.011 * 1.66053907e-27 / cell, rel=1e-8)


def test_sheet_of_the_static_lattice_constant_is_free_of_stress(tmp_path):
    """The engine's virial per atom, another code path, vanishes inside a sheet of the profile's constant."""
    position = sheet(40e-10, 40e-10, FORCE_FIELDS["tersoff"].lattice_constant).position
    engine = LammpsEngine(tmp_path, "tersoff", position, temperature=0.0, seed=0)
    stress = engine.fields(["stress"])["stress"]
    stretched = LammpsEngine(tmp_path / "b", "tersoff", position * [1.001, 1.0, 1.0], temperature=0.0, seed=0)
    centre = (abs(position[:, :2]) < 10e-10).all(axis=1)
    assert abs(stress[centre]).max() < 1e6
    # Plane stress at zero lateral strain: sigma = E / (1 - nu^2) eps, with relaxation of the two sublattices left out.
    assert stretched.fields(["stress"])["stress"][centre, 0].mean() == pytest.approx(1.06e9, rel=0.1)
    engine.close()
    stretched.close()


def test_thermal_constants_go_over_into_the_static_ones_at_low_temperature(tmp_path):
    seen = []
    static = measure_graphene("tersoff", 0.0, tmp_path)
    cold = measure_graphene("tersoff", 0.5, tmp_path, seed=4, progress=lambda done, total: seen.append((done, total)))
    # The strains differ (0.4 % against 0.2 %), hence the few tenths of a percent besides the statistical error.
    assert cold.young == pytest.approx(static.young, rel=0.01)
    assert cold.poisson == pytest.approx(static.poisson, abs=0.005)
    assert cold.lattice_constant == pytest.approx(static.lattice_constant, rel=2e-5)
    assert 0.0 < cold.young_error < 0.01 * cold.young
    assert seen[-1][0] == seen[-1][1]
    assert [done for done, _ in seen] == sorted(done for done, _ in seen)


def test_bad_input_names_its_field(tmp_path):
    with pytest.raises(ValueError, match="temperature is -1"):
        measure_graphene("tersoff", -1.0, tmp_path)
    with pytest.raises(ValueError, match="thickness is 0"):
        measure_graphene("tersoff", 0.0, tmp_path, thickness=0.0)
