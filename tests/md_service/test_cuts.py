"""Severed atoms: forces against separated halves and pair sums, bonds and the crack's tip, states."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from md_service import service as services
from md_service.atoms import Atoms, CrackCut, Topology
from md_service.bonds import Bonds, bonded_pairs
from md_service.crystals import fcc, hexagonal
from md_service.cuts import Cut, crack_with, joined, severed, sides
from md_service.engine import Engine
from md_service.engines import LAMMPS
from md_service.errors import EngineError
from md_service.force_fields import custom_force_field, force_field
from md_service.graphene import graphene
from md_service.lammps_dynamics import LammpsDynamics
from md_service.lattice_dynamics import LATTICE, SPRINGS
from md_service.lennard_jones import lennard_jones_parameters
from md_service.service import AtomisticService
from protocol import atomistic as a
from protocol.errors import ProtocolError
from protocol.messages import Empty, RestoreRequest

A = 1e-10
FAR = 1e-6  # m, beyond all atoms
MPIEXEC = Path(sys.prefix) / "bin" / "mpiexec"


def rattled(atoms: Atoms) -> NDArray[np.float64]:
    """Places that no symmetry holds together."""
    noise = np.random.default_rng(0).normal(0.0, 0.03 * A, atoms.position.shape)
    noise[:, 2] *= np.ptp(atoms.position[:, 2]) > 0.0
    return np.asarray(atoms.position + noise)


class Forces:
    """Energy and forces by LAMMPS at given places."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def __call__(
        self, name: str, atoms: Atoms, position: NDArray[np.float64], cuts: tuple[Cut, ...] = ()
    ) -> tuple[float, NDArray[np.float64]]:
        dynamics = LAMMPS.make(self._folder, name, atoms, temperature=0.0, seed=1, time_step=1e-16)
        assert isinstance(dynamics, LammpsDynamics)
        dynamics.sever(cuts)
        dynamics.displace(position - atoms.position)
        dynamics._run(0)
        system = dynamics._system
        found = system.potential_energy(), system.gather(system.local("f")) * system.units.force
        dynamics.close()
        return found


@pytest.fixture
def forces(tmp_path: Path) -> Iterator[Forces]:
    yield Forces(tmp_path)


def sheet_of(name: str) -> tuple[Atoms, float]:
    """A sheet and a height between two of its rows."""
    profile = force_field(name)
    if name == "lennard-jones":
        return hexagonal(profile.spacing("hexagonal", 0.0), 40 * A, 40 * A), 1e-12
    if name == "eam-copper":
        return fcc("Cu", profile.spacing("copper", 0.0), (4, 4, 3), (False, False, True)), 1e-12
    return graphene(20 * A, 20 * A, spacing=profile.lattice_constant), 1e-12


SEVERABLE = ["tersoff", "airebo", "airebo-sharp", "rebo", "rebo-sharp", "lcbop", "lennard-jones", "eam-copper",
             "reaxff-cho"]  # fmt: skip


@pytest.mark.parametrize("name", SEVERABLE)
def test_sheet_cut_through_is_two_sheets(name: str, forces: Forces) -> None:
    atoms, y = sheet_of(name)
    position = rattled(atoms)
    upper = atoms.position[:, 1] > y
    energy, force = forces(name, atoms, position, (Cut(-FAR, FAR, y),))
    whole, _ = forces(name, atoms, position)
    alone, by_half = 0.0, np.zeros_like(force)
    for half in (upper, ~upper):
        part = replace(atoms, position=atoms.position[half], kind=atoms.kind[half])
        of_half, by_half[half] = forces(name, part, position[half])
        alone += of_half
    assert energy - whole > 0.0
    # Charges of ReaxFF are found by iteration.
    exact = 1e-9 if name.startswith("reaxff") else 1e-11
    assert abs(energy - alone) < exact * (energy - whole)
    np.testing.assert_allclose(force, by_half, rtol=0.0, atol=exact * np.abs(by_half).max())


def test_part_of_a_cut_takes_the_pairs_across_it(forces: Forces) -> None:
    """Lennard-Jones by LAMMPS against the sum over the pairs that are not severed."""
    atoms, y = sheet_of("lennard-jones")
    position = rattled(atoms)
    cut = Cut(-FAR, 5 * A, y)
    upper, lower = sides(cut, atoms, bonded_pairs(atoms)[0])
    epsilon, sigma, cutoff = lennard_jones_parameters()
    way = position[:, None] - position[None]
    square = np.sum(way**2, axis=2)
    np.fill_diagonal(square, np.inf)
    acts = (square < cutoff**2) & ~(upper[:, None] & lower) & ~(lower[:, None] & upper)
    six = np.where(acts, sigma**6 / square**3, 0.0)
    energy, force = forces("lennard-jones", atoms, position, (cut,))
    assert energy == pytest.approx(2.0 * epsilon * np.sum(six**2 - six), rel=1e-6)
    pull = 24.0 * epsilon * np.einsum("ij,ija->ia", (2.0 * six**2 - six) / square, way)
    np.testing.assert_allclose(force, pull, rtol=0.0, atol=1e-6 * np.abs(pull).max())
    assert energy > forces("lennard-jones", atoms, position)[0]


def test_bonds_of_a_crystal_that_are_severed_are_those_that_cross_the_line() -> None:
    for atoms in (graphene(30 * A, 30 * A, spacing=1.4 * A), graphene(30 * A, 30 * A, spacing=1.4 * A,
                  orientation="armchair"), hexagonal(3.5 * A, 40 * A, 40 * A)):  # fmt: skip
        pairs, _ = bonded_pairs(atoms)
        first, second = atoms.position[pairs[:, 0]], atoms.position[pairs[:, 1]]
        for y in (0.13 * A, 1.1 * A, -2.3 * A):
            if np.abs(atoms.position[:, 1] - y).min() < 0.05 * A:
                continue
            for start, end in ((-FAR, -3.3 * A), (-7.7 * A, 4.4 * A), (0.3 * A, FAR)):
                crosses = (first[:, 1] - y) * (second[:, 1] - y) < 0.0
                x = first[:, 0] + (second[:, 0] - first[:, 0]) * (y - first[:, 1]) / np.where(
                    crosses, second[:, 1] - first[:, 1], 1.0
                )
                wanted = crosses & (x > start) & (x < end)
                assert wanted.any()
                np.testing.assert_array_equal(severed(Cut(start, end, y), atoms, pairs), wanted)


def test_cuts_that_touch_are_one() -> None:
    atoms = graphene(30 * A, 30 * A, spacing=1.4 * A)
    y = 1.05 * A
    cuts = joined((), Cut(-FAR, -2 * A, y), atoms)
    cuts = joined(cuts, Cut(8 * A, 10 * A, y), atoms)
    cuts = joined(cuts, Cut(0.0, 2 * A, 5.0 * A), atoms)
    assert len(cuts) == 3
    cuts = joined(cuts, Cut(-2 * A, 3 * A, y), atoms)
    assert cuts == (Cut(8 * A, 10 * A, y), Cut(0.0, 2 * A, 5.0 * A), Cut(-FAR, 3 * A, y))
    cuts = joined(cuts, Cut(3 * A, 9 * A, y), atoms)
    assert set(cuts) == {Cut(0.0, 2 * A, 5.0 * A), Cut(-FAR, 10 * A, y)}


def test_crack_goes_on_from_the_end_of_a_cut() -> None:
    whole = graphene(40 * A, 40 * A, spacing=1.4 * A)
    slit = graphene(40 * A, 40 * A, spacing=1.4 * A, crack=CrackCut(-5 * A))
    y = 0.75 * 1.4 * A  # bonds that stand upright, beside the row that the slit took
    assert crack_with(None, (), whole) is None
    assert crack_with(None, (Cut(-FAR, 2 * A, y),), whole) == CrackCut(2 * A, y)
    assert crack_with(None, (Cut(-4 * A, 2 * A, y),), whole) == CrackCut(2 * A, y, -4 * A)
    assert crack_with(slit.crack, (Cut(-5 * A, 3 * A, y),), slit) == CrackCut(3 * A)
    # Neither ahead of the tip nor in other rows is it this crack.
    assert crack_with(slit.crack, (Cut(1 * A, 3 * A, y),), slit) == slit.crack
    assert crack_with(slit.crack, (Cut(-5 * A, 3 * A, y + 6 * A),), slit) == slit.crack
    bonds = Bonds(slit, force_field("airebo-sharp"))
    bonds.sever((Cut(-5 * A, 3 * A, y),))
    report = bonds.report(slit.position)
    upright = np.sqrt(3.0) * 1.4 * A
    assert report.broken == pytest.approx(8 * A / upright, abs=1.0) and report.tip_x == 3 * A
    # The next upright bond, pulled apart, brings the tip further.
    ahead = np.flatnonzero(severed(Cut(3 * A, 3 * A + upright, y), slit, bonds.pairs))
    assert len(ahead) == 1
    opened = slit.position.copy()
    opened[bonds.pairs[ahead[0], 1], 1] += 1.0 * A
    assert bonds.report(opened).tip_x == pytest.approx(slit.position[bonds.pairs[ahead[0], 0], 0])
    assert bonds.report(opened).tip_x > 3 * A


def test_cut_from_a_grown_tip_brings_the_tip_to_its_end() -> None:
    """Bonds broken by the load reach from the slit to where the cut begins."""
    slit = graphene(40 * A, 40 * A, spacing=1.4 * A, crack=CrackCut(-5 * A))
    bonds, y = Bonds(slit, force_field("airebo-sharp")), 0.75 * 1.4 * A
    grown = np.flatnonzero(severed(Cut(-5 * A, 3 * A, y), slit, bonds.pairs))
    opened = slit.position.copy()
    opened[:, 1] += np.where((slit.position[:, 1] > y) & (slit.position[:, 0] < 3 * A), 1.0 * A, 0.0)
    tip = bonds.report(opened).tip_x
    assert bonds.broken(bonds.lengths(opened))[grown].all() and 1 * A < tip < 4 * A
    bonds.sever((Cut(tip, tip + 5 * A, y),))
    assert bonds.report(opened).tip_x == tip + 5 * A


def anchored(service: AtomisticService, crack: a.CrackCut | None = None, **changes: object) -> a.AtomisticRegister:
    values = {
        "force_field": "harmonic", "temperature": 0.0, "time_step": 1e-15, "seed": 3,
        "sample": a.Sample(material="hexagonal", width=80 * A, height=80 * A, crack=crack),
    }  # fmt: skip
    built = service.configure(a.AtomisticConfigure.model_validate({**values, **changes}))
    half = np.abs(built.position[:, :2]).max(axis=0)
    rows = np.flatnonzero((np.abs(built.position[:, :2]) > 0.75 * half).any(axis=1))
    register = a.AtomisticRegister(
        atom_id=built.atom_id[rows], anchor_position=built.position[rows], damping_time=5e-14,
        anchor_ivc=np.zeros(len(rows), dtype=np.int64), stiffness=np.full(len(rows), 100.0),
    )  # fmt: skip
    service.register(register)
    service.collect_fields(a.CollectRequest(active=True))
    service.equilibrate(a.EquilibrateRequest(steps=40, windows=8, window_steps=5))
    return register


def advance(service: AtomisticService, register: a.AtomisticRegister, strain: float) -> a.AtomisticAdvanced:
    place = register.anchor_position * [1.0, 1.0 + strain, 1.0]
    return service.advance(
        a.AtomisticAdvance(steps=20, anchor_position=place, anchor_velocity=np.zeros_like(place))
    )  # fmt: skip


def test_springs_across_the_cut_are_gone_and_their_energy_with_them(tmp_path: Path) -> None:
    service = services.make_lattice(tmp_path)
    register = anchored(service)
    for _ in range(100):
        loaded = advance(service, register, 0.02)
    assert loaded.crack_tip is None and loaded.broken_bonds == 0
    before = service._configured().dynamics.virial_and_energy()[1].sum()  # type: ignore[union-attr]
    done = service.cut(a.CutRequest(from_x=-FAR, to_x=0.1 * A, y=0.3 * A))
    # Two springs each 3.45 A; those at rest have no energy, the strained ones give theirs up.
    x = service._configured().atoms.position[:, 0]
    assert done.bonds == pytest.approx(2 * (0.1 * A - x.min()) / (3.45 * A), abs=1.0)
    assert -before < done.energy < 0.0 and done.step == loaded.step
    after = advance(service, register, 0.02)
    assert after.broken_bonds == done.bonds and after.crack_tip == pytest.approx(0.1 * A)
    gained = after.kinetic_energy + after.potential_energy - loaded.kinetic_energy - loaded.potential_energy
    # What the cut took away is no work of anyone.
    work = after.anchor_work - loaded.anchor_work
    assert gained - done.energy == pytest.approx(work, rel=2e-3)
    for _ in range(100):
        opened = advance(service, register, 0.02)
    assert opened.potential_energy < loaded.potential_energy
    reply = service.j_integral(a.JIntegralRequest(half_sizes=[20 * A]))
    assert reply.tip == (pytest.approx(0.1 * A), 0.3 * A)
    assert reply.contour[0] > 0.0
    longer = service.cut(a.CutRequest(from_x=0.1 * A, to_x=12 * A, y=0.3 * A))
    assert service._configured().cuts == (Cut(-FAR, 12 * A, 0.3 * A),)
    last = advance(service, register, 0.02)
    assert last.broken_bonds == done.bonds + longer.bonds and last.crack_tip == pytest.approx(12 * A)


def test_means_begin_anew_with_a_cut(tmp_path: Path) -> None:
    """J of means over windows before and after a cut would be that of no body."""
    service = services.make_lattice(tmp_path)
    register = anchored(service)
    for _ in range(5):
        advance(service, register, 0.02)
    service.cut(a.CutRequest(from_x=-FAR, to_x=0.1 * A, y=0.3 * A))
    with pytest.raises(ProtocolError, match="no window was collected"):
        service.j_integral(a.JIntegralRequest(half_sizes=[20 * A]))
    for _ in range(2):
        advance(service, register, 0.02)
    reply = service.j_integral(a.JIntegralRequest(half_sizes=[20 * A]))
    assert reply.samples < 5  # of the windows after it alone


@pytest.mark.parametrize("engine", ["lattice", "lammps"])
def test_checkpoint_carries_the_cuts(engine: str, tmp_path: Path) -> None:
    make = {"lattice": services.make_lattice, "lammps": services.make_service}[engine]
    sample = a.Sample(material="graphene", width=30 * A, height=30 * A, crack=a.CrackCut(tip_x=-8 * A, y=0.0))
    changes = {} if engine == "lattice" else {"force_field": "airebo-sharp", "sample": sample, "time_step": 0.5e-15}
    runs = []
    for name in ("one", "other"):
        (tmp_path / name).mkdir()
        service = make(tmp_path / name)
        runs.append((service, anchored(service, **changes)))
    (one, register), (other, _) = runs
    y = 1.0 * A
    done = one.cut(a.CutRequest(from_x=-FAR, to_x=0.5 * A, y=y))
    advance(one, register, 0.01)
    saved = one.checkpoint(Empty())
    other.restore(RestoreRequest(step=saved.step, state=saved.state))
    for strain in (0.02, 0.03):
        went, came = advance(one, register, strain), advance(other, register, strain)
        assert np.array_equal(went.anchor_force, came.anchor_force)
        assert went.broken_bonds == came.broken_bonds >= done.bonds > 0
        assert went.crack_tip == came.crack_tip == pytest.approx(0.5 * A)
    # Back to the time before the cut there is none.
    fresh = make(tmp_path / "one")
    anchored(fresh, **changes)
    whole = fresh.checkpoint(Empty())
    other.restore(RestoreRequest(step=whole.step, state=whole.state))
    assert advance(other, register, 0.01).broken_bonds == 0


def test_a_cut_force_field_does_not_warn_of_bonds_that_were_severed(tmp_path: Path) -> None:
    service = services.make_service(tmp_path)
    sample = a.Sample(material="graphene", width=30 * A, height=30 * A)
    register = anchored(service, force_field="airebo-sharp", sample=sample, time_step=0.5e-15)
    service.cut(a.CutRequest(from_x=-FAR, to_x=0.0, y=0.0))
    assert advance(service, register, 0.01).warnings == []


def test_what_cannot_be_severed_says_so(tmp_path: Path) -> None:
    lattice = services.make_lattice(tmp_path)
    anchored(lattice)
    for field, values in (
        ("to_x", {"from_x": 1 * A, "to_x": 1 * A, "y": 0.0}),
        ("y", {"from_x": -FAR, "to_x": 1 * A, "y": 50 * A}),
    ):
        with pytest.raises(ProtocolError) as caught:
            lattice.cut(a.CutRequest(**values))
        assert (caught.value.report.code, caught.value.report.field) == ("bad_field", field)
    request = a.CutRequest(from_x=-FAR, to_x=0.0, y=0.0)
    argon = {"force_field": "lennard-jones", "time_step": 5e-15}
    for make, changes in ((services.make_openmm, argon), (services.make_ase, argon)):
        service = make(tmp_path)
        assert "cut" not in service.capabilities()["operations"]  # type: ignore[operator]
        service.configure(
            a.AtomisticConfigure(
                sample=a.Sample(material="hexagonal", width=30 * A, height=30 * A), temperature=0.0, seed=1, **changes
            )
        )
        with pytest.raises(ProtocolError) as caught:
            service.cut(request)
        assert caught.value.report.code == "unsupported"


def test_lists_of_bonds_are_not_severed() -> None:
    sheet = hexagonal(3.8 * A, 40 * A, 40 * A)
    none = np.zeros((0, 4), dtype=np.int64)
    lists = Topology(np.array([[0, 0, 1]]), none, none, none, ("CT-CT",), (), (), ())
    assert "lists of bonds" in force_field("opls-aa").severing_trap(replace(sheet, topology=lists))
    # A force field that sees atoms alone does not look at them.
    assert force_field("reaxff").severing_trap(replace(sheet, topology=lists)) == ""


def test_forces_without_pairs_cannot_be_severed() -> None:
    commands = ["pair_style lj/cut/coul/long 9.0", "kspace_style pppm 1e-4", "pair_coeff * * 0.01 3.4"]
    own = custom_force_field("mine", "real", "charge", commands, 1e-15)
    assert "kspace_style" in own.severing_trap(hexagonal(3.8 * A, 40 * A, 40 * A))


def test_more_cuts_than_lammps_has_groups_for_are_refused(tmp_path: Path) -> None:
    atoms = graphene(20 * A, 60 * A, spacing=1.44 * A)
    engine = Engine(
        LAMMPS.make(tmp_path, "tersoff", atoms, temperature=0.0, seed=1, time_step=5e-16), temperature=0.0
    )  # fmt: skip
    for number in range(8):
        engine.sever(-FAR, 0.0, (-25 + 5 * number) * A)
    with pytest.raises(EngineError, match="9 cuts apart"):
        engine.sever(-FAR, 0.0, 25 * A)
    engine.close()


def test_brittle_springs_that_were_severed_never_hold_again(tmp_path: Path) -> None:
    atoms = hexagonal(SPRINGS["harmonic-brittle"].spacing, 40 * A, 40 * A)
    dynamics = LATTICE.make(tmp_path, "harmonic-brittle", atoms, temperature=0.0, seed=1, time_step=1e-15)
    count = len(dynamics._interactions.first)  # type: ignore[attr-defined]
    dynamics.sever((Cut(-FAR, FAR, 0.1 * A),))
    kept = len(dynamics._interactions.first)  # type: ignore[attr-defined]
    assert kept < count
    dynamics.sever(())
    assert len(dynamics._interactions.first) == count  # type: ignore[attr-defined]


SCRIPT = """
import sys
import numpy as np
from md_service.force_fields import force_field
from md_service.atoms import CrackCut
from md_service.graphene import graphene
from md_service.parallel import ParallelEngine, follow
from md_service.ranks import MpiRanks

ranks = MpiRanks()
if ranks.rank > 0:
    follow(ranks)
    sys.exit(0)
folder, output = sys.argv[1:]
profile = force_field("airebo")
atoms = graphene(30e-10, 30e-10, spacing=profile.lattice_constant, crack=CrackCut(-5e-10))
x = atoms.position
ids = np.flatnonzero(np.abs(x[:, :2]).max(axis=1) > 9e-10)
engine = ParallelEngine(ranks, folder, profile, atoms, temperature=0.0, seed=1, time_step=profile.time_step)
engine.register_anchors(ids, x[ids], np.full(len(ids), 30.0), np.zeros(len(ids), dtype=np.int64), 4e-14)
engine.measure_reference(8, 10)
way = np.column_stack([0 * x[:, 0], 0.02 * x[:, 1], 0 * x[:, 2]])
engine.displace(way, (x + way)[ids])
done = engine.sever(-1.0, 2e-10, 1.05e-10)
last = engine.advance(10, (x + way)[ids], 0 * x[ids])
bonds = engine.broken_bonds()
np.savez(output, energy=done.energy, bonds=done.bonds, force=last.anchor_force, potential=last.potential_energy,
         momentum=last.momentum, broken=bonds.broken, tip=bonds.tip_x)
engine.stop()
"""


@pytest.mark.timeout(120)
def test_two_ranks_displace_and_sever_as_one(tmp_path: Path) -> None:
    if not MPIEXEC.exists():
        pytest.skip("no mpiexec beside Python")
    pytest.importorskip("mpi4py")
    script = tmp_path / "script.py"
    script.write_text(SCRIPT)
    found = []
    for ranks in (1, 2):
        output = tmp_path / f"{ranks}.npz"
        words = [str(MPIEXEC), "-n", str(ranks), sys.executable, str(script), str(tmp_path), str(output)]
        subprocess.run(words, check=True, timeout=100)
        with np.load(output) as data:
            found.append({name: data[name] for name in data.files})
    one, two = found
    assert one["bonds"] == two["bonds"] == one["broken"] == two["broken"] > 2 and one["tip"] == two["tip"] == 2e-10
    assert two["energy"] == pytest.approx(float(one["energy"]), rel=1e-9)
    assert two["potential"] == pytest.approx(float(one["potential"]), rel=1e-12)
    np.testing.assert_allclose(two["force"], one["force"], rtol=0.0, atol=1e-8 * np.abs(one["force"]).max())
    np.testing.assert_allclose(two["momentum"], one["momentum"], rtol=0.0, atol=1e-8 * np.abs(one["momentum"]).max())
