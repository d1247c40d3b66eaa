"""J of atoms against closed forms: K fields, rigid motion, uniform strain, residual stress."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from md_service import units
from md_service.atoms import Atoms, Box, CrackCut
from md_service.graphene import graphene
from md_service.j_integral import Contour, Domain, eshelby
from md_service.j_meter import AtomFields, JMeter
from md_service.k_field import KField
from md_service.verification.k_field_j import held_sheet
from md_service.weighted_fit import Slit

SPACING = 1.42e-10
AREA = 0.75 * np.sqrt(3.0) * SPACING**2
MEAN_DISTANCE = float(np.sqrt(AREA))
YOUNG, POISSON = 1e12, 0.2
TIP = Slit(0.0, 0.0)
SIZES = (10e-10, 15e-10, 20e-10, 30e-10)
#: A load so small that strains, near 1e-6, leave finite deformation out.
SMALL = 1e3


def lattice(spacing: float = SPACING, half: float = 42e-10) -> NDArray[np.float64]:
    """Whole honeycomb, shape (n, 2), with the line y = 0 in the middle between two zigzag chains."""
    atoms = graphene(2.4 * half, 2.4 * half, spacing=spacing).position[:, :2]
    rows = np.unique(np.round(atoms[:, 1], 16))
    gaps = np.diff(rows)
    wide = np.flatnonzero(gaps > 0.75 * spacing)
    between = wide[np.argmin(np.abs(rows[wide]))]
    atoms = atoms - [0.0, 0.5 * (rows[between] + rows[between + 1])]
    return np.ascontiguousarray(atoms[(np.abs(atoms) < half).all(axis=1)])


def values_of(field: KField, place: NDArray[np.float64]) -> tuple[NDArray[np.float64], ...]:
    """Displacement, energy density and virial over volume of a K field at atoms."""
    virial = np.zeros((len(place), 6))
    virial[:, [0, 1, 3]] = field.stress(place)
    return field.displacement(place), field.energy_density(place), virial


ATOMS = lattice()
CONTOUR = Contour(ATOMS, TIP, 20e-10, MEAN_DISTANCE)
DOMAIN = Domain(ATOMS, TIP, 10e-10, 30e-10, MEAN_DISTANCE, AREA)
MODES = [(SMALL, 0.0), (0.0, SMALL), (SMALL, -0.7 * SMALL)]


@pytest.mark.parametrize("half_size", SIZES)
@pytest.mark.parametrize(("k1", "k2"), MODES)
@pytest.mark.parametrize("plane", ["stress", "strain"])
def test_contour_in_a_k_field_is_k_squared_over_e(k1: float, k2: float, plane: str, half_size: float) -> None:
    field = KField(k1, YOUNG, POISSON, k2, plane)  # type: ignore[arg-type]
    expected = (k1**2 + k2**2) * (1.0 if plane == "stress" else 1.0 - POISSON**2) / YOUNG
    j = Contour(ATOMS, TIP, half_size, MEAN_DISTANCE).j(*values_of(field, ATOMS))
    assert j == pytest.approx(expected, rel=2.5e-3)


@pytest.mark.parametrize(("inner", "outer"), [(8e-10, 16e-10), (10e-10, 25e-10), (20e-10, 35e-10)])
@pytest.mark.parametrize(("k1", "k2"), MODES)
def test_domain_in_a_k_field_is_k_squared_over_e(k1: float, k2: float, inner: float, outer: float) -> None:
    field = KField(k1, YOUNG, POISSON, k2)
    j = Domain(ATOMS, TIP, inner, outer, MEAN_DISTANCE, AREA).j(*values_of(field, ATOMS))
    assert j == pytest.approx(field.energy_release_rate, rel=1e-2)


def test_error_falls_with_the_spacing_of_atoms() -> None:
    field = KField(SMALL, YOUNG, POISSON)
    errors = []
    for spacing in (2.84e-10, 1.42e-10, 0.71e-10, 0.355e-10):
        place = lattice(spacing, 25e-10)
        distance = float(np.sqrt(0.75 * np.sqrt(3.0)) * spacing)
        j = Contour(place, TIP, 15e-10, distance).j(*values_of(field, place))
        errors.append(abs(j / field.energy_release_rate - 1.0))
    # Second order or better over three halvings.
    assert errors[3] < errors[0] / 64.0
    assert errors[0] > errors[1] > errors[2] > errors[3]


def test_random_places_of_atoms_give_the_same_j() -> None:
    place = np.random.default_rng(7).uniform(-30e-10, 30e-10, (9000, 2))
    field = KField(SMALL, YOUNG, POISSON, 0.5 * SMALL)
    distance = float(np.sqrt(60e-10**2 / 9000))
    assert Contour(place, TIP, 15e-10, distance).j(*values_of(field, place)) == pytest.approx(
        field.energy_release_rate, rel=1e-2
    )


def test_finite_rotation_of_the_whole_leaves_j() -> None:
    field = KField(SMALL, YOUNG, POISSON)
    u, energy, virial = values_of(field, ATOMS)
    angle = np.radians(20.0)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    turned_u = (ATOMS + u) @ turn.T - ATOMS
    stress = virial[:, [[0, 3], [3, 1]]]
    turned = turn @ stress @ turn.T
    turned_virial = np.zeros_like(virial)
    turned_virial[:, [0, 1, 3]] = turned[:, [0, 1, 0], [0, 1, 1]]
    # What is left is the error of the fitted stress: a rotation turns stress that is out of balance into J.
    load = SMALL / np.sqrt(2.0 * np.pi * 20e-10) * 40e-10
    for measure, allowed in ((CONTOUR, 5e-6), (DOMAIN, 2e-4)):
        assert abs(measure.j(turned_u, energy, turned_virial) - measure.j(u, energy, virial)) < allowed * load


def test_uniform_strain_without_a_crack_has_no_j() -> None:
    strain = np.array([[2e-2, 5e-3], [-3e-3, -1e-2]])
    u = ATOMS @ strain.T
    virial = np.tile([2e10, -1e9, 0.0, 3e9, 0.0, 0.0], (len(ATOMS), 1))
    energy = np.full(len(ATOMS), 3e8)
    # The slit's gap is zero, so the contour is closed. The domain's is a sum over atoms in place of an integral.
    scale = 3e8 * 40e-10
    for measure, allowed in ((CONTOUR, 1e-8), (DOMAIN, 5e-4)):
        assert abs(measure.j(u, energy, virial)) < allowed * scale


def test_large_strain_uses_the_first_piola_kirchhoff_stress() -> None:
    stretch, stress, energy = 1.2, 3e10, 5e9
    gradient = np.zeros((1, 2, 2))
    gradient[0, 0, 0] = stretch - 1.0
    virial = np.array([[stretch * stress, 0.0, 0.0, 0.0, 0.0, 0.0]])  # Kirchhoff: det(F) sigma
    flux = eshelby(gradient, np.array([energy]), virial)
    # A bar under uniaxial stress: P = sigma with the area across unchanged, so M_11 = W - (stretch - 1) sigma.
    assert flux[0, 0] == pytest.approx(energy - (stretch - 1.0) * stress, rel=1e-14)
    assert flux[0, 1] == 0.0


def test_out_of_plane_displacement_takes_its_share() -> None:
    """Mode III: u_z = 2 K/mu sqrt(r / 2 pi) sin(theta / 2), J = K^2 / (2 mu) (Eq 75)."""
    x, y = ATOMS.T
    r, theta = np.hypot(x, y), np.arctan2(y, x)
    shear = YOUNG / (2.0 * (1.0 + POISSON))
    u = np.zeros((len(ATOMS), 3))
    u[:, 2] = 2.0 * SMALL / shear * np.sqrt(r / (2.0 * np.pi)) * np.sin(0.5 * theta)
    virial = np.zeros((len(ATOMS), 6))
    virial[:, 4] = -SMALL / np.sqrt(2.0 * np.pi * r) * np.sin(0.5 * theta)
    virial[:, 5] = SMALL / np.sqrt(2.0 * np.pi * r) * np.cos(0.5 * theta)
    energy = SMALL**2 / (2.0 * np.pi * r) / (2.0 * shear)
    expected = SMALL**2 * (1.0 + POISSON) / YOUNG
    assert Contour(ATOMS, TIP, 15e-10, MEAN_DISTANCE).j(u, energy, virial) == pytest.approx(expected, rel=2.5e-3)
    domain = Domain(ATOMS, TIP, 10e-10, 25e-10, MEAN_DISTANCE, AREA)
    assert domain.j(u, energy, virial) == pytest.approx(expected, rel=1e-2)


def test_residual_stress_of_the_reference_is_taken_off() -> None:
    """Energy counted from a stressed reference holds tau_0 : H, linear in the load."""
    field = KField(SMALL, YOUNG, POISSON)
    u, energy, virial = values_of(field, ATOMS)
    initial = np.tile([0.0, 1e9, 0.0, 0.0, 0.0, 0.0], (len(ATOMS), 1))
    contour = Contour(ATOMS, TIP, 15e-10, MEAN_DISTANCE)
    strain_yy = (virial[:, 1] - POISSON * virial[:, 0]) / YOUNG
    stored = energy + 1e9 * strain_yy
    assert contour.j(u, stored, virial, initial) == pytest.approx(field.energy_release_rate, rel=0.05)
    assert abs(contour.j(u, stored, virial) / field.energy_release_rate - 1.0) > 10.0


def test_bulk_energy_as_reference_counts_the_faces() -> None:
    """The trap: without a reference of each atom J is off by the energy of the crack's faces."""
    sample = cracked()
    face_energy = 6.0  # J/m^2 of each face; a zigzag edge has one outermost atom on sqrt(3) bond lengths
    behind = sample.position[:, 0] < 0.0
    gap = np.abs(sample.position[:, 1])
    outermost = behind & (gap < 1.5 * SPACING)
    thickness = float(sample.thickness or 0.0)
    energy = np.where(outermost, face_energy * np.sqrt(3.0) * SPACING * thickness, 0.0)
    at_rest = AtomFields(sample.position, energy, np.zeros((len(sample), 6)))
    bulk = AtomFields(sample.position, np.zeros(len(sample)), np.zeros((len(sample), 6)))
    meter = JMeter(sample, (0.0, 0.0), [20e-10])
    meter.set_reference(at_rest)
    assert meter.measure(at_rest).contour[0] == 0.0
    assert meter.measure(at_rest).domain[0] == 0.0
    meter.set_reference(bulk)
    assert meter.measure(at_rest).domain[0] == pytest.approx(-2.0 * face_energy, rel=0.02)
    # The contour's fits smear energy that sits in one row of atoms.
    assert meter.measure(at_rest).contour[0] < -face_energy


def cracked(size: float = 84e-10) -> Atoms:
    return graphene(size, size, spacing=SPACING, crack=CrackCut(0.0))


def loaded(sample: Atoms, field: KField) -> AtomFields:
    """Fields of a sample in a K field, whose faces are those of the slit."""
    u, energy, virial = values_of(field, sample.position)
    return AtomFields(sample.position + u, energy * sample.atom_volume, virial * sample.atom_volume)


def at_rest(sample: Atoms) -> AtomFields:
    return AtomFields(sample.position, np.zeros(len(sample)), np.zeros((len(sample), 6)))


def test_meter_measures_every_contour_and_domain() -> None:
    sample = cracked()
    field = KField(SMALL, YOUNG, POISSON)
    meter = JMeter(sample, (0.0, 0.0), SIZES)
    meter.set_reference(at_rest(sample))
    values = meter.measure(loaded(sample, field))
    np.testing.assert_allclose(values.contour, field.energy_release_rate, rtol=5e-3)
    np.testing.assert_allclose(values.domain, field.energy_release_rate, rtol=1e-2)
    assert values.contour_error is None


def test_meter_takes_a_solid_as_well() -> None:
    """A glass, 6000 atoms in 60 x 60 x 20 angstrom, in plane strain."""
    low, high = np.array([-30e-10, -30e-10, 0.0]), np.array([30e-10, 30e-10, 20e-10])
    place = np.random.default_rng(17).uniform(low, high, (6000, 3))
    glass = replace(
        cracked(),
        position=place,
        kind=np.zeros(6000, dtype=np.int64),
        box=Box(low, high, (False, False, True)),
        thickness=None,
        site_volume=None,
    )
    field = KField(10.0, 3e9, 0.35, plane="strain")
    meter = JMeter(glass, (0.0, 0.0), [15e-10, 20e-10])
    meter.set_reference(at_rest(glass))
    values = meter.measure(loaded(glass, field))
    np.testing.assert_allclose(values.contour, field.energy_release_rate, rtol=0.01)
    # A sum over atoms at random places in place of an integral: 1/sqrt(3000) of it is noise.
    np.testing.assert_allclose(values.domain, field.energy_release_rate, rtol=0.05)


def test_meter_finds_the_gap_of_the_slit() -> None:
    # One chain of 1.5 bonds is missing.
    meter = JMeter(cracked(), (0.0, 0.0), [15e-10])
    assert meter.slit.half_gap == pytest.approx(0.75 * SPACING, rel=0.15)
    assert meter.at_tip(8e-10).slit.half_gap == meter.slit.half_gap


def test_meter_follows_the_tip_with_its_reference() -> None:
    sample = cracked()
    meter = JMeter(sample, (0.0, 0.0), [15e-10])
    meter.set_reference(at_rest(sample))
    field = KField(SMALL, YOUNG, POISSON)
    fields = loaded(sample, field)
    moved = meter.at_tip(4e-10)
    # Still around the singularity: the same J; the fits ahead of the old tip are one-sided without need.
    assert moved.measure(fields).contour[0] == pytest.approx(field.energy_release_rate, rel=0.02)
    # Not around it any more: nothing.
    ahead = meter.at_tip(22e-10)
    assert abs(ahead.measure(fields).domain[0]) < 0.02 * field.energy_release_rate


def test_atoms_of_new_faces_can_be_left_out() -> None:
    sample = cracked()
    meter = JMeter(sample, (0.0, 0.0), [15e-10])
    meter.set_reference(at_rest(sample))
    fields = loaded(sample, KField(SMALL, YOUNG, POISSON))
    before = meter.measure(fields)
    odd = np.flatnonzero((sample.position[:, 0] < -5e-10) & (np.abs(sample.position[:, 1]) < 1.5 * SPACING))
    fields.energy[odd] += 1e-19
    disturbed = meter.measure(fields)
    assert abs(disturbed.contour[0] - before.contour[0]) > 1e3 * before.contour[0]
    repaired = meter.at_tip(0.0, without=odd).measure(fields)
    assert repaired.contour[0] == pytest.approx(before.contour[0], rel=0.02)
    assert repaired.domain[0] == pytest.approx(before.domain[0], rel=0.02)


def test_standard_error_is_the_scatter_over_replicas() -> None:
    sample = cracked(60e-10)
    field = KField(1e6, YOUNG, POISSON)  # J = 1 J/m^2
    meter = JMeter(sample, (0.0, 0.0), [15e-10])
    meter.set_reference(at_rest(sample))
    clean = loaded(sample, field)
    rng = np.random.default_rng(11)

    def noisy() -> AtomFields:
        return AtomFields(
            clean.position + rng.normal(0.0, 2e-12, clean.position.shape),
            clean.energy + rng.normal(0.0, 1e-20, clean.energy.shape),
            clean.virial + rng.normal(0.0, 3e-19, clean.virial.shape),
        )

    replicas = [meter.measure_blocks([noisy() for _ in range(16)]) for _ in range(24)]
    contours = np.array([values.contour[0] for values in replicas])
    domains = np.array([values.domain[0] for values in replicas])
    contour_error, domain_error = (
        np.sqrt(np.mean([np.square(getattr(values, name)) for values in replicas]))
        for name in ("contour_error", "domain_error")
    )
    # 24 replicas give their scatter within 15 % (one standard deviation).
    assert contour_error == pytest.approx(contours.std(ddof=1), rel=0.4)
    assert domain_error == pytest.approx(domains.std(ddof=1), rel=0.4)
    assert abs(contours.mean() - meter.measure(clean).contour[0]) < 4.0 * contours.std(ddof=1) / np.sqrt(24)


def test_thermal_stress_of_the_reference_cancels_its_virial() -> None:
    """A sample at rest at 300 K has the virial k T on the diagonal, which is no stress."""
    sample = cracked()
    field = KField(1e6, YOUNG, POISSON)
    fields = loaded(sample, field)
    warm = np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0]) * units.BOLTZMANN * 300.0
    cold = JMeter(sample, (0.0, 0.0), [15e-10])
    cold.set_reference(at_rest(sample))
    meter = JMeter(sample, (0.0, 0.0), [15e-10], temperature=300.0)
    meter.set_reference(replace(at_rest(sample), virial=np.tile(warm, (len(sample), 1))))
    shifted = replace(fields, virial=fields.virial + warm)
    assert meter.measure(shifted).contour[0] == pytest.approx(cold.measure(fields).contour[0], rel=1e-9)


def test_atoms_in_a_k_field_have_its_j(tmp_path: Path) -> None:
    """Tersoff graphene relaxed in a small held frame; the case md/k-field-j has the full size."""
    sheet = held_sheet(tmp_path, "tersoff", 60e-10, (10e-10, 15e-10))
    expected = sheet.field.energy_release_rate
    np.testing.assert_allclose(sheet.values.contour, expected, rtol=0.03)
    np.testing.assert_allclose(sheet.values.domain, expected, rtol=0.03)
    assert sheet.inner_rate == pytest.approx(expected, rel=0.03)


def test_bad_input_names_itself() -> None:
    sample = cracked(60e-10)
    with pytest.raises(ValueError, match=r"half_size is 3e-10 m.*at least"):
        JMeter(sample, (0.0, 0.0), [3e-10])
    with pytest.raises(ValueError, match=r"half_size 4e-09 m.*inside of the atoms"):
        JMeter(sample, (0.0, 0.0), [40e-10])
    with pytest.raises(ValueError, match="half_size is nan"):
        JMeter(sample, (0.0, 0.0), [np.nan])
    with pytest.raises(ValueError, match="half_sizes is empty"):
        JMeter(sample, (0.0, 0.0), [])
    with pytest.raises(ValueError, match="tip is"):
        JMeter(sample, (np.nan, 0.0), [15e-10])
    with pytest.raises(ValueError, match="no atom lies behind the tip"):
        JMeter(sample, (-40e-10, 0.0), [15e-10])
    with pytest.raises(ValueError, match="temperature is -1"):
        JMeter(sample, (0.0, 0.0), [15e-10], temperature=-1.0)
    meter = JMeter(sample, (0.0, 0.0), [15e-10])
    rest = at_rest(sample)
    with pytest.raises(ValueError, match="no reference"):
        meter.measure(rest)
    with pytest.raises(ValueError, match=r"energy has shape \(3,\)"):
        meter.set_reference(replace(rest, energy=np.zeros(3)))
    meter.set_reference(rest)
    wrong = rest.virial.copy()
    wrong[17, 2] = np.nan
    with pytest.raises(ValueError, match="virial of atom 17 is not finite"):
        meter.measure(replace(rest, virial=wrong))
    with pytest.raises(ValueError, match="3 blocks given; at least 4"):
        meter.measure_blocks([rest] * 3)
    with pytest.raises(ValueError, match="inner is 2e-09 m and outer 1e-09"):
        Domain(sample.position, TIP, 2e-9, 1e-9, MEAN_DISTANCE, AREA)


def test_k_field_is_an_elastic_field() -> None:
    """Strains of the displacements give the stress; the stress is in balance and leaves the faces free."""
    place = np.random.default_rng(13).uniform(1e-10, 30e-10, (50, 2)) * [1.0, -1.0]
    step = 1e-15
    for plane in ("stress", "strain"):
        field = KField(1e6, YOUNG, POISSON, -0.6e6, plane)
        ex, ey = np.array([step, 0.0]), np.array([0.0, step])
        by_x = (field.displacement(place + ex) - field.displacement(place - ex)) / (2.0 * step)
        by_y = (field.displacement(place + ey) - field.displacement(place - ey)) / (2.0 * step)
        strain = np.column_stack([by_x[:, 0], by_y[:, 1], 0.5 * (by_x[:, 1] + by_y[:, 0])])
        e, nu = (YOUNG, POISSON) if plane == "stress" else (YOUNG / (1.0 - POISSON**2), POISSON / (1.0 - POISSON))
        trace = strain[:, 0] + strain[:, 1]
        expected = e / (1.0 + nu) * strain
        expected[:, :2] += (e * nu / (1.0 - nu**2) * trace)[:, None]
        stress = field.stress(place)
        np.testing.assert_allclose(stress, expected, rtol=1e-5, atol=1e-5 * np.abs(stress).max())
        work = 0.5 * (stress[:, :2] * strain[:, :2]).sum(axis=1) + stress[:, 2] * strain[:, 2]
        np.testing.assert_allclose(field.energy_density(place), work, rtol=1e-5)
        faces = field.stress(np.array([[-1e-9, 1e-25], [-1e-9, -1e-25]]))
        assert np.abs(faces[:, 1:]).max() < 1e-9 * np.abs(faces).max()


def test_k_field_of_an_energy_release_rate() -> None:
    assert KField.of_energy_release_rate(9.0, 1e12, 0.3).k1 == pytest.approx(3e6, rel=1e-14)
    strain = KField.of_energy_release_rate(9.0, 1e12, 0.3, "strain")
    assert strain.k1 == pytest.approx(3e6 / np.sqrt(0.91), rel=1e-14)
    assert strain.energy_release_rate == pytest.approx(9.0, rel=1e-14)
    for bad, message in (
        ({"k1": np.nan}, "k1 is nan"),
        ({"young": 0.0}, "young is 0.0"),
        ({"poisson": 0.6, "plane": "strain"}, "poisson is 0.6"),
        ({"plane": "strees"}, "plane is 'strees'"),
    ):
        with pytest.raises(ValueError, match=message):
            KField(**{"k1": 1.0, "young": 1.0, "poisson": 0.3, **bad})  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="rate is -1"):
        KField.of_energy_release_rate(-1.0, 1e12, 0.3)
