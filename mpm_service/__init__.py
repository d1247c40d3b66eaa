"""Material point solver for concurrent multiscale mechanics.

>>> from mpm_service import Grid, IsotropicElastic, MaterialPointSolver, fill_rectangle
>>> steel = IsotropicElastic(young=210e9, poisson=0.3, density=7850.0, assumption="plane_stress")
>>> body = fill_rectangle((0.0, 0.0), (1.0, 0.1), cell_size=0.01)
>>> grid = Grid((-0.05, -0.05), 0.01, (110, 20))
>>> solver = MaterialPointSolver(grid, body, steel, thickness=0.01, time_step=5e-7)
>>> solver.advance(10)
>>> solver.points.velocity.shape
(4000, 2)
"""

from .conditions import EdgeCondition, FieldCondition, NodeCondition, symmetry
from .crack_line import Crack
from .cracks import CrackSet, Tip
from .damping import Damping, Relaxation, relax
from .errors import SolverError
from .grid import Grid
from .hierarchy import HierarchicalGrid
from .hierarchy_filling import fill_hierarchy
from .holes import Hole, cut_holes
from .k_field import CrackTipField
from .loads import AbsorbingEdge, BodyForce, Traction
from .material import Material, MaterialError
from .material_points import Body, fill_rectangle, fill_region
from .materials import IsotropicElastic, J2Plasticity, Laminate, NeoHookean, OrthotropicElastic
from .overlap import Overlap, OverlapError, cut_overlaps
from .scheme import Scheme
from .set_up import largest_time_step
from .shape_functions import shape_functions
from .solver import Energies, MaterialPointSolver
from .time_functions import Constant, Ramp, Sine, Step, Table

__all__ = [
    "AbsorbingEdge",
    "Body",
    "BodyForce",
    "Constant",
    "Crack",
    "CrackSet",
    "CrackTipField",
    "Damping",
    "EdgeCondition",
    "Energies",
    "FieldCondition",
    "Grid",
    "HierarchicalGrid",
    "Hole",
    "IsotropicElastic",
    "J2Plasticity",
    "Laminate",
    "Material",
    "MaterialError",
    "MaterialPointSolver",
    "NeoHookean",
    "NodeCondition",
    "OrthotropicElastic",
    "Overlap",
    "OverlapError",
    "Ramp",
    "Relaxation",
    "Scheme",
    "Sine",
    "SolverError",
    "Step",
    "Table",
    "Tip",
    "Traction",
    "cut_holes",
    "cut_overlaps",
    "fill_hierarchy",
    "fill_rectangle",
    "fill_region",
    "largest_time_step",
    "relax",
    "shape_functions",
    "symmetry",
]
