"""Stiffness tensors against lattice sums, published values, and each other."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from md_service.atom_system import AtomSystem
from md_service.atoms import Atoms, Box
from md_service.crystals import fcc, hexagonal
from md_service.elastic_constants import isotropic_properties, measure_graphene, measure_isotropic
from md_service.elastic_tensor import VOIGT, jackknife
from md_service.force_fields import FORCE_FIELDS
from md_service.graphene import graphene
from md_service.statistics import estimate
from md_service.stiffness import Sampling, static_stiffness, thermal_stiffness
from md_service.strained_sample import deformed, vector_fix
from md_service.thermal_properties import thermal_expansion

# Tension tests at 0 K with other scripts on the same potentials: E in GPa, Poisson's ratio.
STATIC = {
    "tersoff": (1054.0, 0.064),
    "airebo": (827.0, 0.357),
    "airebo-sharp": (827.0, 0.357),
    "rebo": (728.0, 0.388),
    "lcbop": (933.0, 0.221),
}
EPSILON, SIGMA, CUTOFF = 0.0103236 * 1.602176634e-19, 3.405e-10, 12e-10  # argon of the profile lennard-jones


@pytest.mark.parametrize("name", sorted(STATIC))
def test_static_constants_of_each_graphene_profile(name, tmp_path):
    young, poisson = STATIC[name]
    measured = measure_graphene(name, 0.0, tmp_path)
    assert measured.young == pytest.approx(young * 1e9, rel=0.01)
    assert measured.poisson == pytest.approx(poisson, rel=0.01)
    assert measured.lattice_constant == pytest.approx(FORCE_FIELDS[name].lattice_constant, rel=1e-6)
    assert measured.thickness == pytest.approx(3.35e-10, rel=1e-12)
    # Two atoms of 12.011 u in a cell of 3 sqrt(3) / 2 a^2.
    cell = 1.5 * 3**0.5 * measured.lattice_constant**2 * 3.35e-10
    assert measured.density == pytest.approx(2 * 12.011 * 1.66053907e-27 / cell, rel=1e-8)


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


def lattice_vectors(atoms: Atoms) -> np.ndarray:
    """Vectors from one atom of a Bravais crystal to all others within the cut-off and a little more."""
    edges = atoms.box.edges
    reach = np.where(atoms.box.periodic, 4, 0)
    shifts = np.stack(np.meshgrid(*(np.arange(-n, n + 1) for n in reach), indexing="ij"), -1).reshape(-1, 3)
    vectors = (shifts[:, None, :] @ edges + atoms.position - atoms.position[0]).reshape(-1, 3)
    distance = np.linalg.norm(vectors, axis=1)
    return vectors[(distance > 1e-12) & (distance < CUTOFF)]


def lattice_sums(atoms: Atoms) -> tuple[np.ndarray, np.ndarray]:
    """Stress and, at zero stress, stiffness of a Bravais crystal of Lennard-Jones atoms (Born and Huang):
    sigma_ij = sum phi' x_i x_j / r / 2V, C_ijkl = sum (phi'' - phi'/r) x_i x_j x_k x_l / r^2 / 2V per atom."""
    vectors = lattice_vectors(atoms)
    r = np.linalg.norm(vectors, axis=1)
    first = 4 * EPSILON * (-12 * SIGMA**12 / r**13 + 6 * SIGMA**6 / r**7)
    second = 4 * EPSILON * (156 * SIGMA**12 / r**14 - 42 * SIGMA**6 / r**8)
    volume = atoms.volume / len(atoms)
    product = np.array([vectors[:, i] * vectors[:, j] for i, j in VOIGT])
    stress = (product * first / r).sum(axis=1) / (2 * volume)
    stiffness = np.einsum("ap,bp,p->ab", product, product, (second - first / r) / r**2) / (2 * volume)
    return stress, stiffness


def test_lennard_jones_fcc_has_the_stiffness_of_its_lattice_sums(tmp_path):
    measured = static_stiffness(fcc("Ar", 3.74e-10, (3, 3, 3)), "lennard-jones", tmp_path)  # 0.5 % too wide
    stress, stiffness = lattice_sums(measured.atoms)
    scale = stiffness[0, 0]
    assert abs(stress).max() < 1e-7 * scale
    np.testing.assert_allclose(measured.tensor, stiffness, atol=2e-4 * scale, rtol=0)
    # Cauchy's relation of central forces.
    assert measured.tensor[0, 1] == pytest.approx(measured.tensor[3, 3], rel=2e-3)
    assert measured.error.max() == 0.0


def test_lennard_jones_layer_has_the_stiffness_of_its_lattice_sums(tmp_path):
    layer = hexagonal(3.80e-10, 26e-10, 26e-10, periodic=True)
    measured = static_stiffness(layer, "lennard-jones", tmp_path)
    assert measured.components == (0, 1, 5)
    stress, stiffness = lattice_sums(measured.atoms)
    plane = stiffness[np.ix_([0, 1, 5], [0, 1, 5])]
    assert abs(stress[[0, 1, 5]]).max() < 1e-7 * plane[0, 0]
    np.testing.assert_allclose(measured.tensor, plane, atol=3e-4 * plane[0, 0], rtol=0)
    # A hexagonal net of central forces is isotropic with nu = 1/3.
    assert measured.isotropic()[0].poisson == pytest.approx(1 / 3, abs=1e-3)


def test_a_bigger_cell_and_a_sheared_cell_give_the_same_tensor(tmp_path):
    """The measured strain of a triclinic box is the physical one, whatever the shape of the cell."""
    straight = fcc("Ar", 3.7195132e-10, (2, 2, 2))
    lx, ly, lz = straight.box.high - straight.box.low
    box = Box(straight.box.low, straight.box.high, (True,) * 3, np.array([lx, 0.0, -ly]))
    assert box.volume == pytest.approx(lx * ly * lz)  # the same lattice in other edges
    one = static_stiffness(straight, "lennard-jones", tmp_path, relax_box=False)
    other = static_stiffness(straight.at(straight.position, box), "lennard-jones", tmp_path, relax_box=False)
    np.testing.assert_allclose(other.tensor, one.tensor, atol=1e-5 * one.tensor[0, 0], rtol=0)


def test_graphene_tensor_is_isotropic_after_inner_relaxation_and_agrees_with_the_tension_test(tmp_path):
    profile = FORCE_FIELDS["tersoff"]
    sheet = graphene(14e-10, 14e-10, spacing=profile.lattice_constant, periodic=True)
    tensor = static_stiffness(sheet, profile, tmp_path, strain=2e-4).tensor
    assert tensor[0, 0] == pytest.approx(tensor[1, 1], rel=1e-4)
    assert tensor[2, 2] == pytest.approx(0.5 * (tensor[0, 0] - tensor[0, 1]), rel=1e-4)
    tension = measure_graphene(profile, 0.0, tmp_path)
    young = tensor[0, 0] - tensor[0, 1] ** 2 / tensor[0, 0]
    assert young == pytest.approx(tension.young, rel=0.01)  # the tension test strains by 0.2 %


def test_copper_at_a_temperature_is_cubic_softer_and_expands_as_at_constant_pressure(tmp_path):
    profile = FORCE_FIELDS["eam-copper"]
    crystal = fcc("Cu", profile.spacing("copper", 0.0), (3, 3, 3))
    settings = Sampling(strain=4e-3, settling=0.25e-12, sampling=0.35e-12, replicas=3, damping_time=0.05e-12)
    warm = thermal_stiffness(crystal, profile, 300.0, tmp_path, sampling=settings)
    static = static_stiffness(crystal, profile, tmp_path).tensor
    direct, shear = np.diag(warm.tensor)[:3], np.diag(warm.tensor)[3:]
    error = np.diag(warm.error)
    # Cubic within four standard errors, which three replicas know poorly; at least 0.3 % is allowed.
    assert abs(direct - direct.mean()).max() < max(4 * error[:3].max(), 0.003 * direct.mean())
    assert abs(shear - shear.mean()).max() < max(4 * error[3:].max(), 0.003 * shear.mean())
    # Copper softens by 2 to 8 % up to room temperature (Overton and Gaffney, Phys. Rev. 98, 969, 1955).
    assert 0.92 < direct.mean() / static[0, 0] < 0.98
    assert 0.92 < shear.mean() / static[3, 3] < 0.98

    expansion = thermal_expansion(warm, profile, tmp_path)
    system = AtomSystem(tmp_path / "npt", profile, crystal, profile.time_step)
    stretch, spread = [], []
    for temperature in expansion.temperatures:
        system.build(crystal.position)
        system.session.commands(
            [
                f"velocity all create {2 * temperature} 7",
                "variable size equal vol",
                f"fix npt all npt temp {temperature} {temperature} 0.1 iso 0 0 0.5",
                "run 2000 post no",
                "fix size all vector 2 v_size",
                "run 9000 post no",
            ]
        )
        volume = vector_fix(system, "size", 1)
        stretch.append(volume.mean() / 3)
        spread.append(estimate(volume, 1.0).standard_error[0] / 3)
    system.session.close()
    middle = 3 * np.mean(stretch)
    span = expansion.temperatures[1] - expansion.temperatures[0]
    alpha, alpha_error = (stretch[1] - stretch[0]) / middle / span, np.hypot(*spread) / middle / span
    assert alpha_error < 0.12 * alpha
    assert abs(expansion.mean - alpha) < 4 * np.hypot(alpha_error, expansion.mean_error)


def test_a_sample_far_from_rest_is_brought_to_zero_stress(tmp_path):
    """Without a known spacing the box is corrected after the first replica."""
    profile = FORCE_FIELDS["lennard-jones"]
    crystal = fcc("Ar", 3.76e-10, (3, 3, 3))  # 0.9 % too wide
    wide = replace(crystal, spacing=None)
    settings = Sampling(strain=4e-3, settling=1e-12, sampling=2e-12, replicas=2, damping_time=0.3e-12)
    measured = thermal_stiffness(wide, profile, 5.0, tmp_path, sampling=settings, isotropic=True)
    edge = np.diag(measured.at_rest.box.edges) / 3 / 2**0.5
    assert edge == pytest.approx(np.full(3, profile.spacing("argon", 5.0)), rel=1e-3)
    # The box was corrected by 0.9 %, and little is left to go.
    assert abs(measured.rest_strain[:3]).max() < 2e-3


def test_isotropic_properties_of_a_cubic_crystal(tmp_path):
    """Hill's average of copper, with the closed forms for cubic crystals."""
    crystal = fcc("Cu", FORCE_FIELDS["eam-copper"].spacing("copper", 0.0), (2, 2, 2))
    measured = measure_isotropic(crystal, "eam-copper", 0.0, tmp_path)
    tensor = static_stiffness(crystal, "eam-copper", tmp_path).tensor
    c11, c12, c44 = tensor[0, 0], tensor[0, 1], tensor[3, 3]
    bulk = (c11 + 2 * c12) / 3
    shear = 0.5 * ((c11 - c12 + 3 * c44) / 5 + 5 * (c11 - c12) * c44 / (4 * c44 + 3 * (c11 - c12)))
    assert measured.young == pytest.approx(9 * bulk * shear / (3 * bulk + shear), rel=1e-6)
    assert measured.poisson == pytest.approx((3 * bulk - 2 * shear) / (6 * bulk + 2 * shear), rel=1e-6)
    assert measured.lattice_constant == pytest.approx(2.556138e-10, rel=1e-5)
    assert measured.density == pytest.approx(4 * 63.546 * 1.66053907e-27 / (2**0.5 * 2.556138e-10) ** 3, rel=1e-4)
    assert np.isnan(measured.thickness)


def test_strain_moves_atoms_with_their_box():
    atoms = fcc("Ar", 3.72e-10, (2, 2, 2))
    strain = np.array([0.01, -0.02, 0.03, 0.004, 0.005, 0.006])
    strained = deformed(atoms, (0, 1, 2, 3, 4, 5), strain)
    inside = (strained.position - strained.box.low) @ np.linalg.inv(strained.box.edges)
    before = (atoms.position - atoms.box.low) @ np.linalg.inv(atoms.box.edges)
    np.testing.assert_allclose(inside, before, atol=1e-12)
    gradient = (np.linalg.inv(atoms.box.edges) @ strained.box.edges).T
    small = 0.5 * (gradient + gradient.T) - np.eye(3)
    expected = [small[i, j] * (1 if i == j else 2) for i, j in VOIGT]
    np.testing.assert_allclose(expected, strain, atol=1e-15)


def test_jackknife_of_a_mean_is_the_standard_error():
    replicas = np.random.default_rng(5).normal(2.0, 0.3, (7, 3))
    value, error = jackknife(replicas, np.asarray)
    np.testing.assert_allclose(value, replicas.mean(axis=0))
    np.testing.assert_allclose(error, replicas.std(axis=0, ddof=1) / 7**0.5, rtol=1e-12)


def test_bad_input_names_its_field(tmp_path):
    crystal = fcc("Ar", 3.72e-10, (2, 2, 2))
    with pytest.raises(ValueError, match="temperature is -1"):
        measure_graphene("tersoff", -1.0, tmp_path)
    with pytest.raises(ValueError, match="thickness is 0"):
        measure_graphene("tersoff", 0.0, tmp_path, thickness=0.0)
    with pytest.raises(ValueError, match="force_field is 'nonsense'"):
        static_stiffness(crystal, "nonsense", tmp_path)
    with pytest.raises(ValueError, match="tersoff knows B, N, C; the sample has Ar"):
        static_stiffness(crystal, "tersoff", tmp_path)
    with pytest.raises(ValueError, match=r"strain is 0\.2"):
        static_stiffness(crystal, "lennard-jones", tmp_path, strain=0.2)
    with pytest.raises(ValueError, match="periodic in no direction"):
        static_stiffness(fcc("Ar", 3.72e-10, (2, 2, 2), (False,) * 3), "lennard-jones", tmp_path)
    with pytest.raises(ValueError, match="temperature is 0"):
        thermal_stiffness(crystal, "lennard-jones", 0.0, tmp_path)
    with pytest.raises(ValueError, match="replicas is 1"):
        Sampling(strain=4e-3, settling=1e-12, sampling=1e-12, replicas=1, damping_time=1e-13)
    rod = static_stiffness(fcc("Ar", 3.72e-10, (2, 2, 2), (False, False, True)), "lennard-jones", tmp_path)
    assert rod.components == (2,)
    with pytest.raises(ValueError, match="periodic along x and y"):
        isotropic_properties(rod)
    with pytest.raises(ValueError, match="that of 0 K"):
        thermal_expansion(rod, "lennard-jones", tmp_path)
