"""Case `md/k-field-j`: J of a cracked graphene sheet whose frame is held in the field of a stress intensity factor."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from md_service.anchors import PASSIVE, checked_anchors
from md_service.atoms import Atoms, CrackCut
from md_service.elastic_constants import measure_graphene
from md_service.force_fields import force_field as profile_of
from md_service.graphene import graphene
from md_service.j_meter import AtomFields, JMeter, JValues
from md_service.k_field import KField
from md_service.lammps_dynamics import LammpsDynamics
from protocol.verification import Case, Check

FORCE_FIELDS = ("tersoff", "airebo")
SIZE = 103e-10  # m, edge of the sheet
FRAME = 7e-10  # m, width of the held frame; beyond the reach of the forces
RATE = 1.5  # J/m^2; strains stay small outside of the tip, so K^2/E' of linear elasticity is the reference
HALF_SIZES = (10e-10, 15e-10, 20e-10, 25e-10, 30e-10)  # m
AT = 1  # the contour of 15 angstrom
_TIP_ROUNDS = 2
_ITERATIONS = 20000


@dataclass(frozen=True)
class HeldSheet:
    """A cracked sheet, relaxed in a frame that follows a K field.

    Attributes
    ----------
    field : KField
        As applied.
    tip_x : float
        Where the K field has its tip, m.
    values : JValues
        J of the atoms by half size.
    inner_rate : float
        K^2/E' of the K field that fits the relaxed atoms inside of the frame, J/m^2.
    """

    field: KField
    tip_x: float
    values: JValues
    inner_rate: float


def held_sheet(
    folder: Path, force_field: str, size: float = SIZE, half_sizes: tuple[float, ...] = HALF_SIZES
) -> HeldSheet:
    """Hold a frame at the displacements of a K field, relax the atoms inside, and measure J.

    The continuum's tip need not be where the slit was cut. It is put where the relaxed atoms have it: a tip that is
    off by delta shows as a displacement of order r^(-1/2) in them.
    """
    profile = profile_of(force_field)
    constants = measure_graphene(profile, 0.0, folder)
    field = KField.of_energy_release_rate(RATE, constants.young, constants.poisson)
    atoms = graphene(size, size, spacing=constants.lattice_constant, crack=CrackCut(0.0))
    depth = np.minimum(atoms.position - atoms.position.min(axis=0), atoms.position.max(axis=0) - atoms.position)
    frame = np.flatnonzero(depth[:, :2].min(axis=1) < FRAME)

    rest = _relaxed(folder / "rest", force_field, atoms, frame, atoms.position)
    tip_x = 0.0
    for _ in range(_TIP_ROUNDS):
        displacement = field.displacement(atoms.position - [tip_x, 0.0, 0.0])
        loaded = _relaxed(folder / "loaded", force_field, atoms, frame, rest.position + displacement)
        factor, shift = _fitted_tip(field, atoms, loaded.position - rest.position, tip_x, depth)
        applied_tip, tip_x = tip_x, tip_x + shift
    meter = JMeter(atoms, (0.0, 0.0), half_sizes)
    meter.set_reference(rest)
    return HeldSheet(field, applied_tip, meter.measure(loaded), factor**2 * field.energy_release_rate)


def _relaxed(
    folder: Path, force_field: str, atoms: Atoms, frame: NDArray[np.int64], start: NDArray[np.float64]
) -> AtomFields:
    """Minimise from a start with the frame held there."""
    held = np.full(len(frame), PASSIVE)
    nothing = np.zeros(len(frame))
    dynamics = LammpsDynamics(folder, profile_of(force_field), atoms.at(start), temperature=0.0, seed=1)
    try:
        cells = np.zeros(len(frame), dtype=np.int64)
        dynamics.adopt(checked_anchors(frame, start[frame], nothing, cells, None, atoms.atom_mass, held))
        dynamics.minimise(_ITERATIONS)
        virial, energy = dynamics.virial_and_energy()
        return AtomFields(dynamics.position(), energy, virial)
    finally:
        dynamics.close()


def _fitted_tip(
    field: KField, atoms: Atoms, displacement: NDArray[np.float64], tip_x: float, depth: NDArray[np.float64]
) -> tuple[float, float]:
    """Factor on the K field and shift of its tip, m, that fit the displacements between tip and frame."""
    place = atoms.position[:, :2] - [tip_x, 0.0]
    between = (np.hypot(*place.T) > 10e-10) & (depth[:, :2].min(axis=1) > 2.0 * FRAME)
    place, wanted = place[between], displacement[between, :2]
    step = 1e-13
    moved = np.array([step, 0.0])
    ahead = (field.displacement(place - moved) - field.displacement(place + moved)) / (2.0 * step)
    uniform = np.column_stack([place[:, 0], -field.poisson * place[:, 1]])
    shift = np.broadcast_to([1.0, 0.0], place.shape)
    columns = [field.displacement(place), ahead, uniform, shift]
    scale = [float(np.abs(column).max()) for column in columns]
    basis = np.column_stack([(column / size).ravel() for column, size in zip(columns, scale, strict=True)])
    found = np.linalg.lstsq(basis, wanted.ravel(), rcond=None)[0] / scale
    return float(found[0]), float(found[1] / found[0])


def k_field_j(folder: Path) -> list[Check]:
    """J by contour and domain against K^2/E', and its spread over contours."""
    checks = []
    for name in FORCE_FIELDS:
        sheet = held_sheet(folder / name, name)
        reference = sheet.field.energy_release_rate
        source = f"K^2/E' of the applied field, {name}, E' measured at 0 K"
        size = f"{HALF_SIZES[AT] * 1e10:.0f} A"
        contour, domain = sheet.values.contour, sheet.values.domain
        checks += [
            Check(f"J, contour at {size}, {name}", float(contour[AT]), reference, 0.03, source, unit="J/m^2"),
            Check(f"J, domain within {size}, {name}", float(domain[AT]), reference, 0.03, source, unit="J/m^2"),
            Check(
                f"spread of J over contours of {HALF_SIZES[0] * 1e10:.0f} to {HALF_SIZES[-1] * 1e10:.0f} A, {name}",
                float(np.ptp(contour) / contour.mean()),
                0.03,
                0.0,
                "J does not depend on the contour; limit set for the product",
                at_most=True,
            ),
            Check(
                f"K^2/E' of the relaxed displacements, {name}",
                sheet.inner_rate,
                reference,
                0.01,
                source,
                unit="J/m^2",
            ),
        ]
    return checks


CASES = [Case("md", "k-field-j", "J of atoms in a K field by contour and domain against K^2/E'", k_field_j)]
