"""Engineering constants of a stiffness, and the stiffness of engineering constants."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class EngineeringConstants:
    """Constants along axes 1, 2, 3. ``nu12`` is minus the strain along 2 per strain along 1 under stress along 1.

    Attributes
    ----------
    E11, E22, E33 : float
        Young's moduli, Pa.
    nu12, nu13, nu23 : float
        Poisson's ratios.
    G12, G13, G23 : float
        Shear moduli, Pa.
    """

    E11: float
    E22: float
    E33: float
    nu12: float
    nu13: float
    nu23: float
    G12: float
    G13: float
    G23: float

    def stiffness(self) -> NDArray[np.float64]:
        """Stiffness of an orthotropic material with these constants, Pa, shape (6, 6).

        Raises
        ------
        ValueError
            If the compliance of the constants is singular.
        """
        compliance = np.diag([1.0 / m for m in (self.E11, self.E22, self.E33, self.G23, self.G13, self.G12)])
        compliance[0, 1] = compliance[1, 0] = -self.nu12 / self.E11
        compliance[0, 2] = compliance[2, 0] = -self.nu13 / self.E11
        compliance[1, 2] = compliance[2, 1] = -self.nu23 / self.E22
        try:
            inverse = np.linalg.inv(compliance)
        except np.linalg.LinAlgError:
            raise ValueError(
                "the compliance of these constants is singular: some strain would cost no energy"
            ) from None
        return np.asarray(0.5 * (inverse + inverse.T), dtype=np.float64)


def engineering_constants(stiffness: NDArray[np.float64]) -> EngineeringConstants:
    """Engineering constants of a stiffness.

    Parameters
    ----------
    stiffness : ndarray of float, shape (6, 6)
        Pa; order 11, 22, 33, 23, 13, 12 with engineering shear strains. Of a stiffness that couples stretch and shear
        these are still the constants of the six uniaxial tests; `coupling` tells how much they leave out.

    Returns
    -------
    EngineeringConstants

    Raises
    ------
    ValueError
        If the stiffness is singular.
    """
    flexible = _compliance(stiffness)
    moduli = 1.0 / np.diag(flexible)
    return EngineeringConstants(
        E11=float(moduli[0]),
        E22=float(moduli[1]),
        E33=float(moduli[2]),
        nu12=float(-flexible[1, 0] * moduli[0]),
        nu13=float(-flexible[2, 0] * moduli[0]),
        nu23=float(-flexible[2, 1] * moduli[1]),
        G12=float(moduli[5]),
        G13=float(moduli[4]),
        G23=float(moduli[3]),
    )


def coupling(stiffness: NDArray[np.float64]) -> float:
    """Largest correlation between a shear and any other component of strain; 0 for an orthotropic stiffness.

    Parameters
    ----------
    stiffness : ndarray of float, shape (6, 6)

    Returns
    -------
    float
        ``|C_ij| / sqrt(C_ii C_jj)``, below 1.
    """
    scale = 1.0 / np.sqrt(np.diag(stiffness))
    share = np.abs(stiffness * np.outer(scale, scale))
    np.fill_diagonal(share, 0.0)
    share[:3, :3] = 0.0
    return float(share.max())


def _compliance(stiffness: NDArray[np.float64]) -> NDArray[np.float64]:
    # Scaled to ones on the diagonal first, so that a failed direction does not cost the others their digits.
    scale = 1.0 / np.sqrt(np.diag(stiffness))
    try:
        inverse = np.linalg.inv(stiffness * np.outer(scale, scale))
    except np.linalg.LinAlgError:
        raise ValueError("the stiffness is singular: it has no engineering constants") from None
    return np.asarray(inverse * np.outer(scale, scale), dtype=np.float64)
