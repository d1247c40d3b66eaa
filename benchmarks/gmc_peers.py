"""Other software's answer for a fibre composite, where it is installed: `pip install scalebridge[peers]`."""

from __future__ import annotations

import importlib.util
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_matrix
from scipy.sparse.linalg import splu

from gmc_service.engineering_constants import EngineeringConstants

#: Component of strain that the derivative of u[i] along (x2, x3)[k] adds to; order 11, 22, 33, 23, 13, 12.
_STRAIN: Final = ((5, 4), (1, 3), (3, 2))


def installed(module: str) -> bool:
    """Whether a module can be imported."""
    return importlib.util.find_spec(module) is not None


def homocompy_stiffness(
    model: str, fraction: float, fibre: EngineeringConstants, matrix: EngineeringConstants
) -> NDArray[np.float64]:
    """Stiffness by a closed form of HomoComPy.

    Parameters
    ----------
    model : str
        ``mori_tanaka`` or ``chamis_model``.
    fraction : float
        Of the fibre.
    fibre, matrix : EngineeringConstants
        Transversely isotropic and isotropic.

    Returns
    -------
    ndarray, shape (6, 6)
    """
    import homocompy

    along, across, nu12, nu23, shear, transverse = getattr(homocompy, model)(
        fraction, fibre.E11, fibre.E22, fibre.nu12, fibre.G12, fibre.G23, matrix.E11, matrix.nu12
    )
    return EngineeringConstants(along, across, across, nu12, nu12, nu23, shear, shear, transverse).stiffness()


def scikit_fem_stiffness(
    lines: tuple[NDArray[np.float64], NDArray[np.float64]], stiffness: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Effective stiffness of a periodic cell by scikit-fem with nine-node quadrilaterals.

    Parameters
    ----------
    lines : pair of ndarray
        Places of the lines between elements along axes 2 and 3, m.
    stiffness : ndarray, shape (rows, columns, 6, 6)
        Of each element between the lines, Pa.

    Returns
    -------
    ndarray, shape (6, 6)
    """
    import skfem

    mesh = skfem.MeshQuad.init_tensor(*lines)
    centres = mesh.p[:, mesh.t].mean(axis=1)
    row, column = (np.searchsorted(lines[axis], centres[axis]) - 1 for axis in range(2))
    own = np.moveaxis(stiffness[row, column], 0, -1)[..., None]  # (6, 6, elements, 1)
    basis = skfem.Basis(mesh, skfem.ElementVector(skfem.ElementQuad2(), 3))
    terms = [(i, k) for i in range(3) for k in range(2)]

    @skfem.BilinearForm
    def form(u: Any, v: Any, w: Any) -> Any:
        return sum(own[_STRAIN[i][k], _STRAIN[j][m]] * v.grad[i, k] * u.grad[j, m] for i, k in terms for j, m in terms)

    def source(load: int) -> Any:
        return skfem.LinearForm(lambda v, w: -sum(own[_STRAIN[i][k], load] * v.grad[i, k] for i, k in terms))

    size = np.array([line[-1] - line[0] for line in lines])
    share = np.round((basis.doflocs.T - mesh.p.min(axis=1)) / size * 2**30).astype(np.int64) % 2**30
    component = np.zeros(basis.N, dtype=np.int64)
    for table in (basis.nodal_dofs, basis.facet_dofs, basis.interior_dofs):
        component[table] = np.arange(len(table))[:, None] % 3
    _, number = np.unique(np.column_stack([share // 4, component]), axis=0, return_inverse=True)
    number = number.reshape(-1)
    joined = csc_matrix((np.ones(basis.N), (np.arange(basis.N), number)))
    forces = joined.T @ np.column_stack([source(load).assemble(basis) for load in range(6)])
    matrix = csc_matrix(joined.T @ form.assemble(basis) @ joined)
    free = np.setdiff1d(np.arange(matrix.shape[0]), number[basis.nodal_dofs[:, 0]])
    answer = np.zeros_like(forces)
    answer[free] = splu(matrix[free][:, free]).solve(forces[free])
    areas = np.outer(np.diff(lines[0]), np.diff(lines[1])) / size.prod()
    return np.asarray(np.einsum("rc,rckl->kl", areas, stiffness) - forces.T @ answer / size.prod())
