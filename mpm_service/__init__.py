"""Two-dimensional material point solver for concurrent multiscale mechanics."""

from .boundary import EdgeCondition
from .crack import Crack
from .errors import SolverError
from .grid import Grid
from .material_points import Body, Overlap, fill_rectangle
from .materials import IsotropicElastic
from .shape_functions import gimp_shape_functions
from .solver import Energies, MaterialPointSolver

__all__ = [
    "Body",
    "Crack",
    "EdgeCondition",
    "Energies",
    "Grid",
    "IsotropicElastic",
    "MaterialPointSolver",
    "Overlap",
    "SolverError",
    "fill_rectangle",
    "gimp_shape_functions",
]
