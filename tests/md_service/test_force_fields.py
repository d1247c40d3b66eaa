import dataclasses
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from md_service import units
from md_service.atom_system import AtomSystem
from md_service.atoms import Atoms, Box
from md_service.chemical_elements import ATOMIC_WEIGHT
from md_service.crystals import fcc, hexagonal
from md_service.errors import EngineError
from md_service.force_fields import FORCE_FIELDS, ForceField, custom_force_field, force_field
from md_service.graphene import graphene
from md_service.lammps_library import potentials_folder

LATTICES = [(name, material) for name, profile in FORCE_FIELDS.items() for material in profile.lattice]
SWITCHED = [name for name, profile in FORCE_FIELDS.items() if profile.switching_start is not None]
ELEMENT = {"copper": "Cu", "aluminium": "Al", "argon": "Ar"}


def sample(material: str, spacing: float) -> Atoms:
    if material == "graphene":
        return graphene(20e-10, 20e-10, spacing=spacing, periodic=True)
    if material == "hexagonal":
        return hexagonal(spacing, 30e-10, 30e-10, periodic=True)
    return fcc(ELEMENT[material], spacing, (3, 3, 3))


def energy(folder: Path, field: ForceField, atoms: Atoms) -> float:
    system = AtomSystem(folder, field, atoms, field.time_step)
    system.build(atoms.position)
    system.run(0, True, 0)
    value = system.potential_energy()
    system.session.close()
    return value


def molecule(elements: tuple[str, ...], kind: list[int], position: list[list[float]]) -> Atoms:
    x = np.array(position) * 1e-10
    mass = np.array([ATOMIC_WEIGHT[element] * units.MASS for element in elements])
    return Atoms(x, np.array(kind), elements, elements, mass, Box(x.min(axis=0), x.max(axis=0)))


# --- profiles ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("name", "material"), LATTICES)
def test_lattice_at_0_K_is_without_pressure(name: str, material: str, tmp_path: Path) -> None:
    field = force_field(name)
    spacing = field.spacing(material, 0.0)
    axes = ("pxx", "pyy", "pzz") if material in ELEMENT else ("pxx", "pyy")

    def pressure(length: float) -> float:
        atoms = sample(material, length)
        system = AtomSystem(tmp_path, field, atoms, field.time_step)
        system.build(atoms.position)
        system.session.commands(["thermo_style custom step pxx pyy pzz", "run 0 post no"])
        value = sum(system.session.lmp.get_thermo(axis) for axis in axes)
        system.session.close()
        return value

    tolerance = 1e-16  # m
    assert pressure(spacing - tolerance) > 0.0 > pressure(spacing + tolerance)


@pytest.mark.parametrize(("name", "material"), [pair for pair in LATTICES if not pair[0].startswith("reaxff")])
def test_lattice_is_known_with_an_error_above_0_K_and_lies_between_the_table_in_between(
    name: str, material: str
) -> None:
    field = force_field(name)
    kelvin = sorted(field.lattice[material])
    assert kelvin[0] == 0.0 < kelvin[1]
    assert field.lattice_error[material][kelvin[1]] > 0.0
    cold, warm = (field.spacing(material, value) for value in kelvin)
    assert field.spacing(material, 0.5 * kelvin[1]) == pytest.approx(0.5 * (cold + warm), rel=1e-12)
    assert field.spacing(material, 2.0 * kelvin[1]) == pytest.approx(2.0 * warm - cold, rel=1e-12)
    with pytest.raises(ValueError, match="known up to"):
        field.spacing(material, 2.1 * kelvin[1])
    with pytest.raises(ValueError, match="known up to"):
        field.spacing(material, -1.0)


@pytest.mark.parametrize("name", ["reaxff", "reaxff-cho"])
def test_lattice_that_is_known_at_0_K_only_is_refused_above(name: str) -> None:
    assert force_field(name).spacing("graphene", 0.0) == force_field(name).lattice_constant
    with pytest.raises(ValueError, match="known up to 0 K"):
        force_field(name).spacing("graphene", 300.0)


def truncated_sum(points: np.ndarray, sigma: float, cutoff: float) -> float:
    """Nearest-neighbour distance at which a lattice of unit spacing has the least Lennard-Jones energy."""
    distance = np.linalg.norm(points, axis=1)
    distance = distance[distance > 0.0]
    a = 1.11 * sigma
    for _ in range(50):
        inside = distance[distance * a < cutoff]
        # d/da of sum (sigma/(a r))^12 - (sigma/(a r))^6 = 0
        a = sigma * (2.0 * np.sum(inside**-12.0) / np.sum(inside**-6.0)) ** (1.0 / 6.0)
    return float(a)


def test_lennard_jones_lattices_are_those_of_lattice_sums() -> None:
    field = force_field("lennard-jones")
    index = np.stack(np.meshgrid(*[np.arange(-8, 9)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    cubic = index[index.sum(axis=1) % 2 == 0] / np.sqrt(2.0)
    plane = index[index[:, 2] == 0, :2] @ np.array([[1.0, 0.0], [0.5, 0.5 * np.sqrt(3.0)]])
    assert field.spacing("argon", 0.0) == pytest.approx(truncated_sum(cubic, 3.405e-10, 12e-10), abs=2e-17)
    assert field.spacing("hexagonal", 0.0) == pytest.approx(truncated_sum(plane, 3.405e-10, 12e-10), abs=2e-17)


def test_copper_and_aluminium_have_their_published_lattices() -> None:
    # Mishin et al. 2001, table II; Mendelev et al. 2008, table 1.
    assert np.sqrt(2.0) * force_field("eam-copper").spacing("copper", 0.0) == pytest.approx(3.615e-10, rel=1e-4)
    assert np.sqrt(2.0) * force_field("eam-aluminium").spacing("aluminium", 0.0) == pytest.approx(4.045e-10, rel=2e-4)


@pytest.mark.parametrize("name", SWITCHED)
def test_bonds_are_shorter_than_the_switching_window_of_their_profile(name: str) -> None:
    profile = force_field(name)
    assert profile.switching_start is not None and profile.switching_end is not None
    assert profile.lattice_constant < profile.switching_start < profile.switching_end
    assert profile.cutoff_trap
    assert profile.cure


@pytest.mark.parametrize("name", sorted(FORCE_FIELDS))
def test_profiles_state_their_source_and_a_believable_time_step(name: str) -> None:
    profile = force_field(name)
    assert profile.summary and profile.source
    assert 0.05e-15 < profile.time_step < 10e-15
    assert profile.units.name == profile.unit_style


def test_sharp_airebo_changes_two_numbers_of_a_copy_and_nothing_in_the_installed_file(tmp_path: Path) -> None:
    installed = potentials_folder() / "CH.airebo"
    before = installed.read_bytes()
    field = force_field("airebo-sharp")
    commands = field.commands(tmp_path, sample("graphene", field.lattice_constant))
    assert installed.read_bytes() == before
    (copy,) = tmp_path.iterdir()
    assert str(copy) in commands[-1]
    old, new = before.decode().splitlines(), copy.read_text().splitlines()
    changed = [(a.split(), b.split()) for a, b in zip(old, new, strict=True) if a != b]
    assert changed == [(["1.7", "rcmin_CC"], ["1.999999999999", "rcmin_CC"])]
    assert "2.0\t     rcmax_CC" in copy.read_text()


@pytest.mark.parametrize("name", ["airebo", "rebo", "reaxff", "reaxff-cho"])
def test_elements_are_mapped_by_the_names_of_the_species(name: str, tmp_path: Path) -> None:
    place = [[0.0, 0.0, 0.0], [1.09, 0.0, 0.0], [-0.36, 1.03, 0.0], [-0.36, -0.51, 0.89], [-0.36, -0.51, -0.89]]
    field = force_field(name)
    one = energy(tmp_path / "CH", field, molecule(("C", "H"), [0, 1, 1, 1, 1], place))
    other = energy(tmp_path / "HC", field, molecule(("H", "C"), [1, 0, 0, 0, 0], place))
    assert one == pytest.approx(other, rel=1e-12)
    # Atomisation energy of methane, from measured heats of formation: 1642 kJ/mol at 0 K, 17.0 eV with the zero-point
    # energy of 1.2 eV taken out; potentials come within a tenth.
    alone = energy(tmp_path / "C", field, molecule(("C", "H"), [0, 1, 1, 1, 1], np.multiply(place, 8.0).tolist()))
    assert (alone - one) / units.ENERGY == pytest.approx(18.2, rel=0.1)


def test_opls_has_the_styles_its_coefficients_are_made_for() -> None:
    from md_service.opls import STYLES

    assert force_field("opls-aa").styles == STYLES


# --- bad input -----------------------------------------------------------------------------------------------------


def test_unknown_name_lists_the_known_ones() -> None:
    with pytest.raises(ValueError, match=r"'morse'.*airebo-sharp.*tersoff"):
        force_field("morse")


def test_element_that_is_not_known_is_named(tmp_path: Path) -> None:
    atoms = molecule(("C", "H"), [0, 1], [[0, 0, 0], [1.1, 0, 0]])
    with pytest.raises(ValueError, match="tersoff knows B, N, C; the sample has H"):
        force_field("tersoff").commands(tmp_path, atoms)


def test_molecular_force_field_asks_for_bonds(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="opls-aa needs the bonds"):
        force_field("opls-aa").commands(tmp_path, molecule(("C",), [0], [[0, 0, 0]]))


def test_file_that_is_not_installed_is_named(tmp_path: Path) -> None:
    lost = dataclasses.replace(force_field("tersoff"), file_name="lost.tersoff")
    with pytest.raises(EngineError, match=r"tersoff needs lost\.tersoff"):
        lost.commands(tmp_path, molecule(("C",), [0], [[0, 0, 0]]))


def test_unknown_material_lists_the_known_ones() -> None:
    with pytest.raises(ValueError, match=r"'graphene'; it has argon, hexagonal"):
        _ = force_field("lennard-jones").lattice_constant


# --- a user's own commands -----------------------------------------------------------------------------------------


def custom(*commands: str, folder: Path | None = None) -> ForceField:
    return custom_force_field("mine", "metal", "atomic", commands, 1e-15, folder)


def test_own_commands_give_the_energy_of_the_profile_with_the_same_commands(tmp_path: Path) -> None:
    atoms = sample("graphene", 1.44e-10)
    mine = custom("pair_style tersoff", "pair_coeff * *   BNC.tersoff C")
    assert energy(tmp_path, mine, atoms) == energy(tmp_path, force_field("tersoff"), atoms)


def test_own_file_is_found_in_the_named_folder_only(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "mine"
    folder.mkdir()
    file = folder / "my.tersoff"
    file.write_text((potentials_folder() / "BNC.tersoff").read_text())
    field = custom("pair_style tersoff", "pair_coeff * * my.tersoff C", folder=folder)
    assert field.styles[1] == f'pair_coeff * * "{file}" C'
    monkeypatch.chdir(folder)
    with pytest.raises(ValueError, match=r"no file 'my\.tersoff' in"):
        custom("pair_style tersoff", "pair_coeff * * my.tersoff C")


def test_link_out_of_the_folder_is_not_followed(tmp_path: Path) -> None:
    folder = tmp_path / "mine"
    folder.mkdir()
    (tmp_path / "secret.txt").write_text("secret")
    (folder / "link.txt").symlink_to(tmp_path / "secret.txt")
    with pytest.raises(ValueError, match=r"no file 'link\.txt'"):
        custom("pair_style tersoff", "pair_coeff * * link.txt C", folder=folder)


ALLOWED = [
    "pair_style hybrid/overlay lj/cut/coul/long 10.0 reaxff NULL",
    "pair_coeff 1*2 3 lj/cut/coul/long 1.0e-6 -.5",
    "bond_coeff CA-CA 469.0 1.4",
    "special_bonds lj/coul 0.0 0.0 0.5",
    "kspace_style pppm 1e-4",
    "mass C_3 12.011",
    "set type 1*2 charge -0.18",
]


@pytest.mark.parametrize("line", ALLOWED)
def test_commands_of_a_force_field_pass(line: str) -> None:
    assert custom("pair_style zero 5.0", line).styles[1] == line


REFUSED = [
    "shell rm results",
    "include other.in",
    "variable x equal 1",
    "python f input 1",
    "fix 1 all nve",
    "run 100",
    "dump 1 all atom 1 out.txt",
    "write_data out.data",
    "read_data in.data",
    "log other.log",
    "pair_write 1 1 10 r 1 2 table.txt X",
    "bond_write 1 10 1 2 table.txt X",
    "pair_style python 5.0",
    "pair_coeff * * python.module.Class C",
    "pair_style mliap model mliappy model.pt",
    "pair_style hybrid/scaled v_scale tersoff",
    "pair_coeff * * $(shell) C",
    "pair_coeff * * ${HOME} C",
    "pair_coeff * * /etc/passwd C",
    "pair_coeff * * ../BNC.tersoff C",
    "pair_coeff * * sub/../../BNC.tersoff C",
    "pair_coeff * * ~/BNC.tersoff C",
    'pair_coeff * * "BNC.tersoff" C',
    "pair_style tersoff &",
    "pair_style tersoff # shift",
    "pair_style tersoff\nshell rm results",
    "pair_style\ttersoff",
    "pair_style tersoff; run 1",
    "set type 1 type 2",
    "set type 1 charge v_q",
    "set group all charge 1.0",
    "PAIR_STYLE tersoff",
    "",
]


@pytest.mark.parametrize("line", REFUSED)
def test_everything_else_is_refused_with_its_place(line: str) -> None:
    with pytest.raises(ValueError, match=r"commands\[1\] is "):
        custom("pair_style zero 5.0", line)


def test_styles_and_step_of_own_commands_are_checked() -> None:
    pair = ["pair_style zero 5.0", "pair_coeff * *"]
    with pytest.raises(ValueError, match="unit_style is 'lj'"):
        custom_force_field("mine", "lj", "atomic", pair, 1e-15)
    with pytest.raises(ValueError, match="atom_style is 'ellipsoid'"):
        custom_force_field("mine", "metal", "ellipsoid", pair, 1e-15)
    for step in (0.0, float("nan"), 1.0):
        with pytest.raises(ValueError, match="time_step is"):
            custom_force_field("mine", "metal", "atomic", pair, step)
    with pytest.raises(ValueError, match="neither pair_style nor bond_style"):
        custom("mass 1 12.011")


def test_profiles_are_read_without_loading_lammps() -> None:
    code = "import sys, md_service.force_fields; sys.exit('lammps' in sys.modules or 'numba' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
