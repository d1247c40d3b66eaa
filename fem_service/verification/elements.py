"""Bricks and cohesive elements against closed forms."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from fem_service.cohesive_law import CohesiveLaw
from fem_service.cohesive_layer import CohesiveLayers
from fem_service.equilibrium import Grips
from fem_service.hexahedron import Hexahedra
from fem_service.laminate_mesh import LaminateMesh, stack
from fem_service.plane_mesh import rectangle
from fem_service.point_material import ElasticMaterial
from fem_service.quasi_static import QuasiStatic
from fem_service.verification.beams import transversely_isotropic
from protocol.verification import Case, Check

#: Table 6.6 with K = 2.71e8 MPa/mm, and the same with a layer soft enough to see its rising part.
_TABLE: Final = CohesiveLaw(2.71e17, 60e6, 90e6, 200.0, 1000.0, 1.0)
_SOFT: Final = CohesiveLaw(1e14, 60e6, 90e6, 200.0, 1000.0, 1.6)
_ORTHOTROPIC: Final = transversely_isotropic(166.8e9, 15.0e9, 0.34, 0.29, 3.86e9, 5.8e9)


def isotropic(young: float, poisson: float) -> NDArray[np.float64]:
    """Stiffness, shape (6, 6), Pa."""
    return transversely_isotropic(young, young, poisson, poisson, *[0.5 * young / (1.0 + poisson)] * 2)


def distorted(seed: int) -> tuple[LaminateMesh, NDArray[np.bool_]]:
    """Bricks, 3 x 3 x 3, with their inner nodes moved at random; which nodes are inner."""
    mesh = stack(rectangle(3.0, 2.0, 3, 3), np.zeros(3), 0.5)
    inner = np.all((mesh.nodes > 1e-9) & (mesh.nodes < mesh.nodes.max(axis=0) - 1e-9), axis=1)
    moved = mesh.nodes.copy()
    moved[inner] += np.random.default_rng(seed).uniform(-0.12, 0.12, (int(inner.sum()), 3))
    return LaminateMesh(moved, mesh.bricks, mesh.ply, mesh.layers, mesh.interface, mesh.angles), inner


def _patch(folder: Path) -> list[Check]:
    """Any uniform strain on the border makes the same strain inside, whatever the shape of the bricks."""
    checks = []
    random = np.random.default_rng(2)
    for mean in (False, True):
        worst = 0.0
        mesh, inner = distorted(5)
        border = np.flatnonzero(np.repeat(~inner, 3))
        for _ in range(6):
            gradient = random.normal(size=(3, 3)) * 1e-3
            exact = mesh.nodes @ gradient.T
            grips = Grips(border, exact.reshape(-1)[border])
            problem = QuasiStatic(mesh, ElasticMaterial(_ORTHOTROPIC), grips, mean_dilatation=mean, tolerance=1e-12)
            found = problem.bricks.strains(problem.advance(problem.rest(), 1.0).displacement)
            sym = gradient + gradient.T
            wanted = np.array([*np.diag(gradient), sym[1, 2], sym[0, 2], sym[0, 1]])
            worst = max(worst, float(np.abs(found - wanted).max() / np.abs(wanted).max()))
        label = "mean dilatation" if mean else "full integration"
        checks.append(Check(f"patch of distorted bricks, {label}: error of strain", worst, 0.0, 1e-8, "uniform strain"))
    return checks


def _single(folder: Path) -> list[Check]:
    """One brick under each of the six unit strains has the energy of the strain, and no stiffness when it is turned."""
    checks = []
    mesh = stack(rectangle(2e-3, 1e-3, 1, 1), np.zeros(1), 0.5e-3)
    for mean in (False, True):
        bricks = Hexahedra(mesh.nodes, mesh.bricks, mean_dilatation=mean)
        matrix = bricks.stiffnesses(_ORTHOTROPIC[None], np.zeros((1, 8), np.int64))[0]
        label = "mean dilatation" if mean else "full integration"
        for number, (i, j) in enumerate(((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))):
            gradient = np.zeros((3, 3))
            gradient[i, j] = 1e-3
            moved = (mesh.nodes[mesh.bricks[0]] @ gradient.T).reshape(-1)
            energy = 0.5 * moved @ matrix @ moved
            wanted = 0.5e-6 * _ORTHOTROPIC[number, number] * 1e-9
            source = "half C strain^2 times the volume"
            checks.append(Check(f"one brick, strain {number + 1}, {label}: energy", energy, wanted, 1e-8, source, "J"))
        turn = np.array([[0, -0.2, 0.1], [0.2, 0, -0.3], [-0.1, 0.3, 0]])
        turned = (mesh.nodes[mesh.bricks[0]] @ turn.T).reshape(-1)
        force = np.abs(matrix @ turned).max() / (np.abs(matrix).max() * np.abs(turned).max())
        checks.append(Check(f"one brick turned, {label}: force", float(force), 0.0, 1e-8, "rigid motion"))
    return checks


def tip_force(columns: int, rows: int, *, mean: bool) -> float:
    """Force at the tip of a cantilever, 10 x 1 x 1, E = 1, nu = 0, that bends it by 1 there, in elements."""
    mesh = stack(rectangle(10.0, 1.0, columns, 1), np.zeros(1), 1.0, per_ply=rows)
    tip, root = np.flatnonzero(mesh.nodes[:, 0] == 10.0), np.flatnonzero(mesh.nodes[:, 0] == 0.0)
    freedoms = np.concatenate([3 * root, 3 * root + 1, 3 * root + 2, 3 * tip + 2])
    per_load = np.concatenate([np.zeros(3 * len(root)), np.ones(len(tip))])
    order = np.argsort(freedoms)
    material = ElasticMaterial(isotropic(1.0, 0.0))
    problem = QuasiStatic(mesh, material, Grips(freedoms[order], per_load[order]), mean_dilatation=mean, tolerance=1e-7)
    return problem.advance(problem.rest(), 1.0).force


def _cantilever(folder: Path) -> list[Check]:
    """Timoshenko's beam: w = P L^3 / (3 E I) + 6 P L / (5 G A)."""
    exact = 1.0 / (1000.0 / (3.0 / 12.0) + 6.0 * 10.0 / (5.0 * 0.5))
    counts = ((10, 1), (20, 2), (40, 4), (80, 8))
    errors = {mean: [tip_force(*n, mean=mean) / exact - 1.0 for n in counts] for mean in (False, True)}
    lines = ["columns rows error_full_integration error_mean_dilatation"]
    lines += [f"{n[0]} {n[1]} {errors[False][k]:.5e} {errors[True][k]:.5e}" for k, n in enumerate(counts)]
    (folder / "cantilever.txt").write_text("\n".join(lines) + "\n")
    figure = Figure(figsize=(5, 4), layout="constrained")
    axes = figure.subplots()
    for mean, label in ((False, "full integration"), (True, "mean dilatation")):
        axes.loglog([n[1] for n in counts], errors[mean], "o-", label=label)
    axes.loglog([1, 8], [errors[False][0], errors[False][0] / 64], "k--", label="second order")
    axes.set(xlabel="bricks through the depth", ylabel="stiffer than Timoshenko's beam by")
    axes.legend()
    figure.savefig(folder / "cantilever.png", dpi=120)
    checks = []
    for mean, label in ((False, "full integration"), (True, "mean dilatation")):
        error = errors[mean]
        order = float(np.log2((error[1] - error[2]) / (error[2] - error[3])))
        limit = error[3] + (error[3] - error[2]) / 3.0
        source = "Timoshenko's beam with shear factor 5/6"
        checks += [
            Check(f"cantilever, 80 x 8 bricks, {label}: force at the tip", 1.0 + error[3], 1.0, 0.01, source),
            Check(f"cantilever, limit of the meshes, {label}: force at the tip", 1.0 + limit, 1.0, 2e-3, source),
            Check(f"cantilever, {label}: order of convergence", order, 2.0, 0.1, "linear shape functions"),
        ]
    return checks


def _opened(law: CohesiveLaw, mix: float, sizes: NDArray[np.float64]) -> NDArray[np.float64]:
    """Traction along an opening of constant mix."""
    face = np.array([[0.0, 0.0, 0.0], [2e-3, 0.0, 0.0], [2e-3, 1e-3, 0.0], [0.0, 1e-3, 0.0]])
    layer = CohesiveLayers(np.concatenate([face, face]), np.arange(8)[None], law)
    direction = np.array([np.sqrt(0.7 * mix), np.sqrt(0.3 * mix), np.sqrt(1.0 - mix)])
    damage, tractions = np.zeros((1, 4, 2)), []
    for size in sizes:
        found = layer.respond(np.tile(size * direction, (1, 4, 1)), damage)
        damage = found.damage
        force = layer.forces(found.traction)[0, 12:].reshape(4, 3).sum(axis=0)
        tractions.append(force @ direction / layer.areas.sum())
    return np.array(tractions)


def _cohesive(folder: Path) -> list[Check]:
    opened = _TABLE.final_opening(0.0) * 1e3
    checks = [Check("final opening in mode I", opened, 6.66666667e-3, 1e-6, "Table 6.6, Eq 91", "mm")]
    figure = Figure(figsize=(9, 4), layout="constrained")
    axes = figure.subplots(1, 2)
    for axis, (name, law) in zip(axes, (("Table 6.6", _TABLE), ("soft", _SOFT)), strict=True):
        for mix, label in ((0.0, "mode I"), (0.25, "25 % mode II"), (0.5, "50 % mode II"), (1.0, "mode II")):
            onset = 1.0 / (law.stiffness * np.sqrt((1 - mix) / law.normal_strength**2 + mix / law.shear_strength**2))
            final = law.final_opening(mix)
            sizes = np.concatenate([np.linspace(0, onset, 20), np.linspace(onset, final, 200)[1:], [1.05 * final]])
            traction = _opened(law, mix, sizes)
            wanted = law.opening_toughness + (law.sliding_toughness - law.opening_toughness) * mix**law.mix_exponent
            area = float(np.trapezoid(traction, sizes))
            checks.append(Check(f"{name}, {label}: area under the curve", area, wanted, 1e-6, "Eq 93", "J/m^2"))
            parts = np.array([1.0 - mix, mix]) * traction.max() ** 2
            criterion = parts[0] / law.normal_strength**2 + parts[1] / law.shear_strength**2
            checks.append(Check(f"{name}, {label}: criterion at the peak", float(criterion), 1.0, 1e-6, "Eq 92"))
            axis.plot(sizes * 1e6, traction / 1e6, label=label)
        axis.set(xlabel="opening, um", ylabel="traction, MPa", title=f"{name}: K = {law.stiffness:g} Pa/m")
    axes[0].legend()
    figure.savefig(folder / "cohesive.png", dpi=120)
    return checks


def _elements(folder: Path) -> list[Check]:
    return [*_patch(folder), *_single(folder), *_cantilever(folder), *_cohesive(folder)]


CASES: list[Case] = [
    Case("structure", "elements", "patch tests, single bricks, a cantilever, the cohesive law in all modes", _elements)
]
