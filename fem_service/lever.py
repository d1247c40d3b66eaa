"""A testing machine that pulls at several nodes at once through a lever, in place of nodes that are held.

The lever moves by q = sum of a_i u_i over the degrees of freedom it grips, and a spring of the machine joins it to
where the load is: F = k (load - q). Each degree of freedom then feels a_i F, so the forces keep their ratios whatever
the specimen does: the lever of mixed-mode bending, or an end face under uniform traction.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class Lever:
    """A lever and the spring of its machine.

    Attributes
    ----------
    nodes : ndarray of int64, shape (nodes,)
        That it grips.
    weights : ndarray of float, shape (nodes, 3)
        a: its own movement per displacement of a node, and the force on a node per force on the lever.
    stiffness : float
        k, N/m. The specimen moves it by load - F / k.

    Raises
    ------
    ValueError
        If a shape does not fit or the stiffness is not positive.
    """

    nodes: NDArray[np.int64]
    weights: NDArray[np.float64]
    stiffness: float

    def __post_init__(self) -> None:
        if self.weights.shape != (len(self.nodes), 3):
            raise ValueError(f"weights has shape {self.weights.shape}; it must have ({len(self.nodes)}, 3)")
        if not (np.isfinite(self.stiffness) and self.stiffness > 0.0):
            raise ValueError(f"stiffness is {self.stiffness}; it must be finite and greater than 0")

    def moved(self, displacement: NDArray[np.float64]) -> float:
        """q, m, at nodal displacements, shape (nodes of the mesh, 3), m."""
        return float(np.sum(self.weights * displacement[self.nodes]))

    def force(self, displacement: NDArray[np.float64], load: float) -> float:
        """F, N."""
        return self.stiffness * (load - self.moved(displacement))

    def elements(self) -> NDArray[np.int64]:
        """Its nodes as the one element of a group, shape (1, nodes)."""
        return self.nodes[None]

    def forces(self, displacement: NDArray[np.float64], load: float) -> NDArray[np.float64]:
        """Forces with which it holds its nodes, shape (1, 3 nodes), N."""
        return -self.force(displacement, load) * self.weights.reshape(1, -1)

    def push(self, size: int) -> NDArray[np.float64]:
        """Change of the forces on nodes per load, shape (size,), N/m."""
        whole = np.zeros((size // 3, 3))
        whole[self.nodes] = self.stiffness * self.weights
        return whole.reshape(-1)

    def stiffnesses(self) -> NDArray[np.float64]:
        """Shape (1, 3 nodes, 3 nodes), N/m."""
        weights = self.weights.reshape(-1)
        return self.stiffness * np.outer(weights, weights)[None]
