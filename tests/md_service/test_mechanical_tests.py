"""Tension tests against the stiffness of the same crystal, and until failure."""

import numpy as np
import pytest

from md_service.crystals import fcc
from md_service.elastic_tensor import engineering_constants
from md_service.force_fields import FORCE_FIELDS
from md_service.graphene import graphene
from md_service.mechanical_tests import uniaxial_tension
from md_service.stiffness import static_stiffness

ARGON = FORCE_FIELDS["lennard-jones"]


def test_tension_of_a_cold_crystal_has_the_modulus_of_its_stiffness(tmp_path):
    crystal = fcc("Ar", ARGON.spacing("argon", 0.0), (3, 3, 3))
    static = engineering_constants(static_stiffness(crystal, ARGON, tmp_path).tensor)
    # A wave crosses the 1.6 nm in about 1 ps; 1 % takes 5 ps.
    pulled = uniaxial_tension(
        crystal, ARGON, 0.5, 2e9, "y", 0.01, 3, tmp_path, fit_strain=0.01, replicas=2, time_step=10e-15
    )
    assert pulled.modulus == pytest.approx(static["E1"], rel=0.01)
    assert pulled.poisson == pytest.approx(static["nu12"], abs=0.01)
    assert not pulled.passed_strength
    assert pulled.strength == pulled.stress.max()
    assert pulled.strain[-1] == pytest.approx(0.01, rel=0.02)
    assert pulled.stress[-1] == pytest.approx(pulled.modulus * pulled.strain[-1], rel=0.1)


def test_a_crystal_that_is_pulled_far_fails(tmp_path):
    crystal = fcc("Ar", ARGON.spacing("argon", 10.0), (3, 3, 3))
    seen = []
    pulled = uniaxial_tension(
        crystal, ARGON, 10.0, 5e10, "x", 0.6, 1, tmp_path, fit_strain=0.01, replicas=2, time_step=10e-15,
        progress=lambda done, total: seen.append((done, total)),
    )  # fmt: skip
    assert pulled.passed_strength
    assert 0.03 < pulled.strength_strain < 0.4
    # The ideal strength of a crystal is of the order of a tenth of its modulus (Frenkel, Orowan).
    assert 0.02 < pulled.strength / 3e9 < 0.3
    assert pulled.stress[-1] < pulled.strength - 2 * pulled.strength_error
    assert all(done <= total for done, total in seen)


def test_a_sheet_is_pulled_in_its_plane_with_the_stress_of_its_thickness(tmp_path):
    sheet = graphene(15e-10, 15e-10, spacing=FORCE_FIELDS["tersoff"].lattice_constant, periodic=True)
    pulled = uniaxial_tension(sheet, "tersoff", 1.0, 2e10, "x", 0.01, 1, tmp_path, fit_strain=0.005, replicas=2)
    assert pulled.modulus == pytest.approx(1054e9, rel=0.02)
    assert pulled.poisson == pytest.approx(0.064, abs=0.01)
    assert np.isfinite(pulled.standard_error).all()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"temperature": 0.0}, "temperature is 0"),
        ({"rate": -1.0}, "rate is -1"),
        ({"strain": float("nan")}, "strain is nan"),
        ({"fit_strain": 0.5}, "fit_strain is 0.5"),
        ({"axis": "w"}, "axis is 'w'; it must be x, y or z"),
        ({"axis": "z"}, "axis is 'z', along which the sample is not periodic"),
        ({"replicas": 1}, "replicas is 1"),
    ],
)
def test_bad_input_names_its_field(tmp_path, change, message):
    options = {"temperature": 300.0, "rate": 1e10, "axis": "x", "strain": 0.1, "seed": 1, "work_dir": tmp_path}
    crystal = fcc("Ar", 3.72e-10, (3, 3, 3), (True, True, False))
    with pytest.raises(ValueError, match=message):
        uniaxial_tension(crystal, ARGON, **(options | change))
