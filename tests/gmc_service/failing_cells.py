"""Cells with allowables, and a slow, readable evaluation of one point to hold the compiled one against."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gmc_service.cell import AfterFailure, Cell
from gmc_service.gmc_dense import homogenise
from gmc_service.material import Failure, Material, constant_material, isotropic_stiffness

INF = np.inf
EPOXY_STRENGTH = 118.67e6


def fibre(expansion: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Material:
    """Fibre of the seed's Table 6.2."""
    limit = Failure("maximum_strain", tension=(0.019, INF, INF))
    return constant_material("IM7", isotropic_stiffness(276e9, 0.33), expansion, failures=(limit,))


def epoxy(expansion: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Material:
    """Neat matrix of the seed's Table 6.1."""
    s, t = EPOXY_STRENGTH, EPOXY_STRENGTH / np.sqrt(3.0)
    limit = Failure("maximum_stress", tension=(s, s, s), shear=(t, t, t))
    return constant_material("EPON 862", isotropic_stiffness(2.963e9, 0.36), expansion, failures=(limit,))


def two_by_two(after_failure: AfterFailure = "gmc", heated: bool = False) -> Cell:
    """The seed's cell: one square fibre in four subcells, fibre fraction 0.6."""
    sizes = np.array([np.sqrt(0.6), 1.0 - np.sqrt(0.6)]) * 1e-5
    expansions = ((-0.7e-6, 10e-6, 10e-6), (45e-6, 45e-6, 45e-6)) if heated else ((0.0,) * 3, (0.0,) * 3)
    materials = (fibre(expansions[0]), epoxy(expansions[1]))
    return Cell(sizes, sizes, np.array([[0, 1], [1, 1]]), materials, after_failure=after_failure)


def random_cell(seed: int, rows: int, columns: int, coupled: bool = False) -> Cell:
    """A cell of random materials that fail by all four criteria, at stresses of some ten MPa."""
    random = np.random.default_rng(seed)
    materials = []
    for number in range(5):
        root = random.normal(size=(6, 6))
        stiffness = (root @ root.T + 2.0 * np.eye(6)) * 1e9 * 10.0 ** random.uniform(0.0, 1.0)
        if not coupled:
            stiffness[:3, 3:] = stiffness[3:, :3] = 0.0
            stiffness[3:, 3:] = np.diag(np.diag(stiffness[3:, 3:]))
        x, y, s, t = random.uniform(2e7, 9e7, 4)
        failures = (
            (Failure("maximum_stress", (x, y, INF), (INF, x, x), (s, s, t)),),
            (Failure("tsai_hill", (x, y, y), (x, x, x), (s, t, t)),),
            (Failure("hashin", (x, y, y), (x, 2.0 * y, 2.0 * y), (s, t, t)),),
            (
                Failure("maximum_strain", (x / 5e9, INF, y / 5e9), (y / 5e9, x / 5e9, INF), (s / 5e9, INF, t / 5e9)),
                Failure("maximum_stress", (x, x, x)),
            ),
            (),
        )[number]
        expansion = tuple(random.uniform(0.0, 5e-5, 3))
        materials.append(constant_material(f"m{number}", stiffness, expansion, failures))
    phase = random.integers(0, 5, (rows, columns))
    phase.flat[:5] = np.arange(min(5, phase.size))
    return Cell(random.uniform(0.5, 2.0, rows), random.uniform(0.5, 2.0, columns), phase, tuple(materials))


def fails(failure: Failure, stress: NDArray[np.float64], strain: NDArray[np.float64]) -> bool:
    """Whether a subcell fails, by the criteria as they are printed."""
    load = strain if failure.criterion == "maximum_strain" else stress
    tension, compression, shear = (np.array(getattr(failure, k)) for k in ("tension", "compression", "shear"))
    chosen = np.where(load[:3] >= 0.0, tension, compression)
    ratio = np.concatenate([np.abs(load[:3]) / chosen, np.abs(load[3:]) / shear])
    if failure.criterion in ("maximum_stress", "maximum_strain"):
        return bool((ratio >= 1.0).any())
    s1, s2, s3, s23, s13, s12 = load
    if failure.criterion == "tsai_hill":
        x, y, z = 1.0 / chosen**2
        form = (ratio**2).sum() - (x + y - z) * s1 * s2 - (x + z - y) * s1 * s3 - (y + z - x) * s2 * s3
        return bool(form >= 1.0)
    along = (s12**2 + s13**2) / shear[2] ** 2
    fibre_mode = (s1 / tension[0]) ** 2 + along if s1 >= 0.0 else -s1 / compression[0]
    matrix_mode = (s23**2 - s2 * s3) / shear[0] ** 2 + along
    if s2 + s3 >= 0.0:
        matrix_mode += (s2 + s3) ** 2 / tension[1] ** 2
    else:
        matrix_mode += ((compression[1] / (2.0 * shear[0])) ** 2 - 1.0) * (s2 + s3) / compression[1]
        matrix_mode += (s2 + s3) ** 2 / (4.0 * shear[0] ** 2)
    return bool(max(fibre_mode, matrix_mode) >= 1.0)


def evaluate_slowly(
    cell: Cell, strain: NDArray[np.float64], temperature: float, failed: NDArray[np.bool_]
) -> tuple[NDArray[np.float64], NDArray[np.bool_], NDArray[np.float64]]:
    """Stress, failed subcells and stiffness of one point, with the dense method and no table."""
    failed, change = failed.copy(), temperature - cell.stress_free_temperature
    expansion = cell.expansion_at(temperature)
    while True:
        stiffness = cell.stiffness_at(temperature) * np.where(failed, cell.knock_down, 1.0)[:, None, None]
        answer = homogenise(cell.heights, cell.widths, stiffness, expansion)
        mechanical = answer.concentration @ strain + (answer.thermal - expansion) * change
        new = [
            n
            for n, phase in enumerate(cell.phase.reshape(-1))
            if not failed[n]
            and any(fails(one, stiffness[n] @ mechanical[n], mechanical[n]) for one in cell.materials[phase].failures)
        ]
        if not new:
            return answer.stiffness @ (strain - answer.expansion * change), failed, answer.stiffness
        failed[new] = True
