"""A cell with yielding subcells at many points: the history of a point holds the plastic strain of its subcells."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gmc_service.cell import Cell
from gmc_service.failure import checks_of
from gmc_service.gmc_reduced import homogenise
from gmc_service.plasticity import respond, strains_at_rest

#: How far an elastic stiffness may be from an isotropic one, relative: radial return holds for isotropic ones only.
_ISOTROPIC: Final = 1e-9


@dataclass(frozen=True, eq=False)
class PlasticAnswer:
    """Answer for many points.

    Attributes
    ----------
    stress : ndarray of float, shape (points, 6)
        Macroscopic, Pa.
    tangents : ndarray of float, shape (points, 6, 6)
        Consistent with the step, Pa.
    failed : ndarray of bool, shape (points, subcells)
    history : ndarray of float, shape (points, subcells, 7)
        Plastic strain (engineering shear) and equivalent plastic strain of each subcell.
    """

    stress: NDArray[np.float64]
    tangents: NDArray[np.float64]
    failed: NDArray[np.bool_]
    history: NDArray[np.float64]


class PlasticCell:
    """A cell of which at least one material yields; each query is one implicit step from the history that it brings.

    Subcells fail as in a cell that does not yield: knocked down, about the plastic strain they had.

    Parameters
    ----------
    cell : Cell
    method : str
        ``gmc``; other methods have one stress and strain for a subcell only in the mean.

    Raises
    ------
    ValueError
        If the method is another, a yielding material is not elastically isotropic or also softens, or the rule after
        failure is not that of the method.
    """

    def __init__(self, cell: Cell, method: str) -> None:
        if method != "gmc":
            raise ValueError(f"method is {method!r}; a cell with plasticity takes gmc")
        if cell.after_failure != "gmc":
            raise ValueError(f"after_failure is {cell.after_failure!r}; a cell with plasticity takes gmc")
        for material in cell.materials:
            if material.fracture_energy is not None:
                raise ValueError(
                    f"fracture_energy of {material.name} is {material.fracture_energy}; a cell has softening or "
                    "plasticity, not both"
                )
            if material.plasticity is not None:
                for stiffness in material.stiffness:
                    _check_isotropic(material.name, stiffness)
        self.cell = cell
        self._heights = cell.heights / cell.heights.sum()
        self._widths = cell.widths / cell.widths.sum()
        laws = [material.plasticity for material in cell.materials]
        phase = cell.phase.reshape(-1)
        self._yields = np.array([np.inf if law is None else law.yield_stress for law in laws])[phase]
        self._hardening = np.array([0.0 if law is None else law.hardening for law in laws])[phase]
        self._checks = checks_of(cell).arrays

    def evaluate(
        self,
        strain: NDArray[np.float64],
        temperature: float,
        failed: NDArray[np.bool_],
        history: NDArray[np.float64],
    ) -> PlasticAnswer:
        """Take points to strains; the arguments stay as they are.

        Parameters
        ----------
        strain : ndarray of float, shape (points, 6)
            Macroscopic strain at the end of the step.
        temperature : float
            K.
        failed : ndarray of bool, shape (points, subcells)
        history : ndarray of float, shape (points, subcells, 7)

        Returns
        -------
        PlasticAnswer

        Raises
        ------
        ValueError
            If a strain is not finite, or so large that the step has no answer.
        """
        strain = np.ascontiguousarray(strain, dtype=np.float64)
        if not np.isfinite(strain).all():
            point = int(np.argwhere(~np.isfinite(strain))[0, 0])
            raise ValueError(f"strain[{point}] is {strain[point].tolist()}; every component must be finite")
        failed, history = failed.copy(), np.array(history, dtype=np.float64, order="C")
        stress, tangents = np.empty_like(strain), np.empty((len(strain), 6, 6))
        unclosed = np.empty(len(strain), dtype=np.int64)
        count = respond(
            self._heights, self._widths, self._constants(temperature), self.cell.thermal_strain_at(temperature),
            self._checks, strain, failed, history, stress, tangents, unclosed,
        )  # fmt: skip
        if count:
            point = int(unclosed[0])
            raise ValueError(
                f"strain[{point}] is {strain[point].tolist()}; the plastic step to it has no answer, take it in parts"
            )
        return PlasticAnswer(stress, tangents, failed, history)

    def localise(
        self,
        strain: NDArray[np.float64],
        temperature: float,
        failed: NDArray[np.bool_],
        history: NDArray[np.float64],
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Stress and strain of every subcell with the plastic strain that the history holds; nothing yields or fails.

        Parameters and errors are those of `evaluate`.

        Returns
        -------
        stress, strain : ndarray, shape (points, subcells, 6)
        """
        return strains_at_rest(
            self._heights, self._widths, self._constants(temperature), self.cell.thermal_strain_at(temperature),
            np.ascontiguousarray(strain, dtype=np.float64), failed, np.ascontiguousarray(history, dtype=np.float64),
        )  # fmt: skip

    def mean_plastic_strain(self, temperature: float, history: NDArray[np.float64]) -> NDArray[np.float64]:
        """Plastic strain of the composite, as Eq 89 has it, where no subcell has failed.

        It is the macroscopic strain that stays when the macroscopic stress is taken away, without change of
        temperature: B*^-1 times the mean of A^T C times the plastic strain of each subcell. Where stiffnesses differ,
        that is not the mean of the plastic strains.

        Parameters
        ----------
        temperature : float
            K.
        history : ndarray of float, shape (points, subcells, 7)

        Returns
        -------
        ndarray, shape (points, 6)
        """
        stiffness = self.cell.stiffness_at(temperature)
        found = homogenise(self.cell.heights, self.cell.widths, stiffness, np.zeros((self.cell.subcells, 6)))
        pull = np.einsum("nij,pnj->pni", stiffness, history[:, :, :6])
        mean = np.einsum("n,nji,pnj->pi", self.cell.volume_fractions(), found.concentration, pull)
        return np.asarray(np.linalg.solve(found.stiffness, mean.T).T, dtype=np.float64)

    def _constants(
        self, temperature: float
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], float]:
        return self.cell.stiffness_at(temperature), self._yields, self._hardening, self.cell.knock_down


def _check_isotropic(name: str, stiffness: NDArray[np.float64]) -> None:
    lame, shear = stiffness[0, 1], stiffness[5, 5]
    wanted = np.diag([2.0, 2.0, 2.0, 1.0, 1.0, 1.0]) * shear
    wanted[:3, :3] += lame
    if np.abs(stiffness - wanted).max() > _ISOTROPIC * np.abs(stiffness).max():
        raise ValueError(f"{name} has plasticity, so its stiffness must be isotropic, and it is not")
