"""Stiffness and bending of laminates against classical lamination theory, which is written out here by itself."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from fem_service.equilibrium import Grips
from fem_service.laminate_mesh import LaminateMesh, stack
from fem_service.lever import Lever
from fem_service.plane_mesh import rectangle
from fem_service.point_material import ElasticMaterial
from fem_service.quasi_static import QuasiStatic
from fem_service.verification.beams import transversely_isotropic
from protocol.verification import Case, Check

#: IM7/EPON 862 at a fibre fraction of 0.6: E1, E2, nu12, nu23, G12, G23.
_PLY: Final = (166785.894e6, 15003.7323e6, 0.340531864, 0.286246729, 3858.68478e6, 2681.12315e6)
_THICK: Final = 0.25e-3  # m
_LAYUPS: Final = {
    "[0]": (0.0,),
    "[30]": (30.0,),
    "[0/90]s": (0.0, 90.0, 90.0, 0.0),
    "[45/0/-45/90]2s": (45.0, 0.0, -45.0, 90.0) * 2 + (90.0, -45.0, 0.0, 45.0) * 2,
    "[0/90]": (0.0, 90.0),
}
_SOURCE: Final = "classical lamination theory"


def lamination(angles: tuple[float, ...], thickness: float) -> tuple[NDArray[np.float64], ...]:
    """A, B and D of plies, degrees, from the lowest up, about z = 0 at the middle; order xx, yy, xy (Jones 1999).

    Reduced stiffness in the ply, then the textbook's fourth powers of sine and cosine: nothing of the finite elements.
    """
    along, across, poisson, _, shear, _ = _PLY
    part = 1.0 - poisson**2 * across / along
    q11, q22, q12, q66 = along / part, across / part, poisson * across / part, shear
    a, b, d = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((3, 3))
    for number, angle in enumerate(angles):
        m, n = np.cos(np.radians(angle)), np.sin(np.radians(angle))
        q = np.zeros((3, 3))
        q[0, 0] = q11 * m**4 + 2 * (q12 + 2 * q66) * m**2 * n**2 + q22 * n**4
        q[1, 1] = q11 * n**4 + 2 * (q12 + 2 * q66) * m**2 * n**2 + q22 * m**4
        q[0, 1] = q[1, 0] = (q11 + q22 - 4 * q66) * m**2 * n**2 + q12 * (m**4 + n**4)
        q[2, 2] = (q11 + q22 - 2 * q12 - 2 * q66) * m**2 * n**2 + q66 * (m**4 + n**4)
        q[0, 2] = q[2, 0] = (q11 - q12 - 2 * q66) * m**3 * n + (q12 - q22 + 2 * q66) * m * n**3
        q[1, 2] = q[2, 1] = (q11 - q12 - 2 * q66) * m * n**3 + (q12 - q22 + 2 * q66) * m**3 * n
        low = (number - 0.5 * len(angles)) * thickness
        high = low + thickness
        a += q * (high - low)
        b += q * (high**2 - low**2) / 2
        d += q * (high**3 - low**3) / 3
    return a, b, d


def _resultants(angles: tuple[float, ...]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """N and M, shape (3, 3), of unit membrane strains xx, yy, xy (columns), with the sides held to them and z free."""
    mesh = stack(rectangle(2e-3, 2e-3, 3, 3), np.radians(angles), _THICK)
    x, y, z = mesh.nodes.T
    side = np.flatnonzero((x < 1e-9) | (x > 2e-3 - 1e-9) | (y < 1e-9) | (y > 2e-3 - 1e-9))
    floor = np.flatnonzero(z == 0.0)  # stays flat, and feels no force
    freedoms = np.concatenate([3 * side, 3 * side + 1, 3 * floor + 2])
    order = np.argsort(freedoms)
    force, moment = np.zeros((3, 3)), np.zeros((3, 3))
    for column, gradient in enumerate(([[1, 0], [0, 0]], [[0, 0], [0, 1]], [[0, 0.5], [0.5, 0]])):
        moved = mesh.nodes[side][:, :2] @ np.array(gradient, dtype=np.float64).T
        values = np.concatenate([moved[:, 0], moved[:, 1], np.zeros(len(floor))])
        grips = Grips(freedoms[order], values[order])
        problem = QuasiStatic(mesh, ElasticMaterial(transversely_isotropic(*_PLY)), grips, tolerance=1e-9)
        found = problem.advance(problem.rest(), 1e-3)
        plane = found.stress[:, :, [0, 1, 5]] * problem.bricks.volumes[:, :, None] / (4e-6 * 1e-3)
        arm = problem.bricks.positions(mesh.nodes)[:, :, 2] - 0.5 * len(angles) * _THICK
        force[:, column] = plane.sum(axis=(0, 1))
        moment[:, column] = (plane * arm[:, :, None]).sum(axis=(0, 1))
    return force, moment


def bent(size: float, per_ply: int) -> tuple[NDArray[np.float64], LaminateMesh, NDArray[np.float64]]:
    """Strains and curvatures x, y of [0/90] under a tension of 1 N/m along x, ends free to turn; mesh, displacement.

    A quarter of a strip of 24 mm by 12 mm; even traction on its end comes from a lever.
    """
    plane = rectangle(12e-3, 6e-3, round(12e-3 / size), 10)
    mesh = stack(plane, np.radians([0.0, 90.0]), _THICK, per_ply=per_ply)
    x, y, _ = mesh.nodes.T
    hold = {3 * int(n): 0.0 for n in np.flatnonzero(x == 0.0)} | {3 * int(n) + 1: 0.0 for n in np.flatnonzero(y == 0.0)}
    hold[2] = 0.0
    freedoms = np.array(sorted(hold), dtype=np.int64)
    end = np.flatnonzero(x > 12e-3 - 1e-9)
    share = np.zeros((len(mesh.nodes), 3))  # of even traction: by the area of end that a node has
    rows = np.searchsorted(end, mesh.bricks[np.isin(mesh.bricks, end).any(axis=1)][:, [1, 2, 5, 6]])
    np.add.at(share[:, 0], end[rows], 0.25)
    weights = share[end] / share[:, 0].sum()
    stiff = 2e9
    problem = QuasiStatic(
        mesh,
        ElasticMaterial(transversely_isotropic(*_PLY)),
        Grips(freedoms, np.zeros(len(freedoms))),
        lever=Lever(end, weights, stiff),
        tolerance=1e-6,
    )
    found = problem.advance(problem.rest(), 1e-6)
    per_tension = found.displacement * 6e-3 / found.force
    # w = -kx x^2 / 2 - ky y^2 / 2 near the middle; u and v at the lowest face give strains there.
    near = np.flatnonzero((x <= 6e-3) & (y <= 3e-3) & (mesh.nodes[:, 2] == 0.0))
    terms = np.column_stack([np.ones(len(near)), x[near] ** 2, y[near] ** 2])
    _, kx, ky = np.linalg.lstsq(terms, per_tension[near, 2], rcond=None)[0]
    slope_x = per_tension[near, 0] @ x[near] / (x[near] @ x[near])
    slope_y = per_tension[near, 1] @ y[near] / (y[near] @ y[near])
    kx, ky = -2.0 * kx, -2.0 * ky
    return np.array([slope_x + kx * _THICK, slope_y + ky * _THICK, kx, ky]), mesh, per_tension


def _laminate(folder: Path) -> list[Check]:
    checks = []
    for text, angles in _LAYUPS.items():
        a, b, _ = lamination(angles, _THICK)
        force, moment = _resultants(angles)
        error = float(np.abs(force - a).max() / np.abs(a).max())
        checks.append(Check(f"{text}: A, worst entry over the largest", error, 0.0, 0.005, _SOURCE))
        young = 1.0 / (np.linalg.inv(force)[0, 0] * len(angles) * _THICK)
        wanted = 1.0 / (np.linalg.inv(a)[0, 0] * len(angles) * _THICK)
        checks.append(Check(f"{text}: membrane Ex", float(young), float(wanted), 0.005, _SOURCE, "Pa"))
        scale = np.abs(a).max() * _THICK
        error = float(np.abs(moment - b).max() / scale)
        checks.append(Check(f"{text}: B, worst entry over A times the thickness of a ply", error, 0.0, 0.005, _SOURCE))
    checks += _bending(folder)
    return checks


def _bending(folder: Path) -> list[Check]:
    a, b, d = lamination((0.0, 90.0), _THICK)
    flexibility = np.linalg.inv(np.block([[a, b], [b, d]]))[:, 0]
    wanted = flexibility[[0, 1, 3, 4]]
    names = ("strain x", "strain y", "curvature x", "curvature y")
    scale = np.abs(wanted)[[0, 1, 2, 2]]  # [0/90] does not bend across the load: that is judged by the other curvature
    lines = ["size_mm per_ply " + " ".join(f"error_{name.replace(' ', '_')}" for name in names)]
    coarser = found = np.zeros(4)
    for size, per_ply in ((0.6e-3, 1), (0.3e-3, 2), (0.15e-3, 4)):
        coarser = found
        found, mesh, moved = bent(size, per_ply)
        lines.append(f"{size * 1e3:g} {per_ply} " + " ".join(f"{v:+.5f}" for v in (found - wanted) / scale))
    (folder / "bending.txt").write_text("\n".join(lines) + "\n")
    figure = Figure(figsize=(6, 4), layout="constrained")
    axes = figure.subplots()
    for axis, name, k in ((0, "along x at y = 0", 2), (1, "along y at x = 0", 3)):
        line = np.flatnonzero((mesh.nodes[:, 1 - axis] == 0.0) & (mesh.nodes[:, 2] == 0.0))
        place = mesh.nodes[line, axis]
        axes.plot(place * 1e3, moved[line, 2] * 1e9, "o", ms=3, label=f"finite elements {name}")
        axes.plot(place * 1e3, -0.5 * wanted[k] * place**2 * 1e9, "k-", lw=1)
    axes.set(xlabel="mm from the middle", ylabel="deflection, nm, at 1 N/m", title="[0/90] in tension; lines: CLT")
    axes.legend()
    figure.savefig(folder / "bending.png", dpi=120)
    limit = found + (found - coarser) / 3.0  # bricks are of second order
    checks = []
    for k, name in enumerate(names):
        for label, value in (("bricks of 0.15 mm", found), ("limit of the meshes", limit)):
            quantity = f"[0/90] in tension, {name}, {label}: error"
            allowed = 0.005 if value is limit else 0.01
            checks.append(Check(quantity, float((value[k] - wanted[k]) / scale[k]), 0.0, allowed, _SOURCE))
    return checks


CASES: list[Case] = [
    Case("structure", "laminate", "stiffness and bending against classical lamination theory", _laminate)
]
