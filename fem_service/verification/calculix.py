"""CalculiX on the same mesh with the same constants: displacement and reaction of every node."""

from __future__ import annotations

import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fem_service.equilibrium import Grips
from fem_service.laminate_deck import laminate_deck
from fem_service.laminate_mesh import LaminateMesh, stack
from fem_service.plane_mesh import open_hole
from fem_service.point_material import ElasticMaterial, PointMaterial
from fem_service.quasi_static import QuasiStatic
from fem_service.tension import tension_grips
from protocol.verification import CannotRun, Case, Check

#: Displacements, m, and reactions, N, of all nodes, each of shape (nodes, 3).
Nodal = tuple[NDArray[np.float64], NDArray[np.float64]]

_SECONDS = 300.0
_EXTENT, _HOLE, _PLY, _STRAIN = 8e-3, 3.175e-3, 0.25e-3, 1e-3
#: A carbon/epoxy ply: E1, E2, E3, G23, G13, G12, Pa, and nu12, nu13, nu23.
_MODULI = np.array([160e9, 9e9, 8e9, 3e9, 4.5e9, 5e9])
_RATIOS = (0.3, 0.28, 0.45)


def run_calculix(deck: str, folder: Path) -> Nodal:
    """What CalculiX finds for a deck of `fem_service.laminate_deck`, with the seven digits that it prints.

    Raises
    ------
    CannotRun
        If it is not installed.
    RuntimeError
        If it does not finish.
    """
    if shutil.which("ccx") is None:
        raise CannotRun("CalculiX (ccx) is not installed; on Debian: apt install calculix-ccx")
    (folder / "laminate.inp").write_text(deck)
    done = subprocess.run(["ccx", "-i", "laminate"], cwd=folder, capture_output=True, text=True, timeout=_SECONDS)
    if "Job finished" not in done.stdout:
        raise RuntimeError(f"CalculiX did not finish:\n{done.stdout[-2000:]}{done.stderr[-1000:]}")
    tables: list[list[list[float]]] = []
    for line in (folder / "laminate.dat").read_text().splitlines():
        words = line.split()
        if words and words[0] in ("displacements", "forces"):
            tables.append([])
        elif len(words) == 4 and words[0].isdecimal():
            tables[-1].append([float(word) for word in words[1:]])
    displacement, reaction = (np.array(table) for table in tables)
    return 1e-3 * displacement, reaction


def solved(mesh: LaminateMesh, grips: Grips, material: PointMaterial, *, mean_dilatation: bool = False) -> Nodal:
    """What our elements find."""
    solver = QuasiStatic(mesh, material, grips, mean_dilatation=mean_dilatation, tolerance=1e-12)
    found = solver.advance(solver.rest(), 1.0)
    reaction = np.zeros(mesh.nodes.size)
    freedoms = 3 * mesh.bricks[:, :, None] + np.arange(3)
    np.add.at(reaction, freedoms.reshape(len(mesh.bricks), -1), solver.bricks.forces(found.stress))
    return found.displacement, reaction.reshape(-1, 3)


def largest_differences(one: Nodal, other: Nodal) -> tuple[float, float]:
    """Largest difference at any node over the largest value, of displacements and of reactions."""
    first, second = (float(np.abs(a - b).max() / np.abs(b).max()) for a, b in zip(one, other, strict=True))
    return first, second


def _stiffness() -> NDArray[np.float64]:
    compliance = np.diag(1.0 / _MODULI)
    for (i, j), ratio in zip(((0, 1), (0, 2), (1, 2)), _RATIOS, strict=True):
        compliance[i, j] = compliance[j, i] = -ratio / _MODULI[i]
    return np.asarray(np.linalg.inv(compliance), dtype=np.float64)


def _run(folder: Path) -> list[Check]:
    stiffness = _stiffness()
    plane = open_hole(_EXTENT, _EXTENT, _HOLE, around=12, radial=10, growth=4.0)
    checks = []
    for layup, angles, lower_half in (
        ("[45/0/-45/90]s", (45.0, 0.0, -45.0, 90.0), True),
        ("[0/45/90], which bends and twists", (0.0, 45.0, 90.0), False),
    ):
        mesh = stack(plane, np.radians(angles), _PLY)
        grips = tension_grips(mesh, lower_half=lower_half)
        grips = replace(grips, per_load=grips.per_load * _STRAIN * _EXTENT)
        theirs = run_calculix(laminate_deck(mesh, grips, stiffness), folder)
        found = largest_differences(theirs, solved(mesh, grips, ElasticMaterial(stiffness)))
        other = largest_differences(theirs, solved(mesh, grips, ElasticMaterial(stiffness), mean_dilatation=True))
        for name, difference, told in zip(("displacement", "reaction"), found, other, strict=True):
            source = (
                f"CalculiX, C3D8, {len(mesh.bricks)} bricks (mean dilatation, another element, differs by {told:.2g})"
            )
            checks.append(Check(f"{layup}: largest difference of {name}", difference, 0.0, 1e-6, source))
    return checks


CASES: list[Case] = [
    Case("structure", "calculix", "open-hole laminates, elastic, against CalculiX on the same mesh", _run),
]
