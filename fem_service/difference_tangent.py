"""Consistent tangents of points that soften, by differences of the material's own answers.

A material may answer secant stiffnesses for them. Those are steady, but hide that the stress falls: what follows the
path of a laminate by the energy that it takes needs the derivative.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from fem_service.equilibrium import Response
from fem_service.point_material import PointState
from fem_service.quasi_static import QuasiStatic

#: Change of a component over the largest one of the point.
_PART: Final = 1e-6


def differentiated(
    laminate: QuasiStatic, displacement: NDArray[np.float64], response: Response, start: PointState
) -> Response:
    """A response with the derivative of the stress where the history has grown since the start of the increment.

    Parameters
    ----------
    laminate : QuasiStatic
    displacement : ndarray of float, shape (3 nodes,)
        m.
    response : Response
        At that displacement.
    start : PointState
        Of all points.
    """
    answer = response.answer
    moving = np.flatnonzero((answer.state.history != start.history).any(axis=1))
    if not len(moving):
        return response
    strain = laminate.ply_strains(displacement.reshape(-1, 3))[moving]
    stress = answer.stress[moving]
    change = _PART * np.abs(strain).max(axis=1)
    tangents = np.empty((len(moving), 6, 6))
    state = PointState(start.failed[moving], start.history[moving])
    for component in range(6):
        other = strain.copy()
        other[:, component] += change
        found = laminate.material.respond(other, state, laminate.element_length[moving])
        tangents[:, :, component] = (found.stress - stress) / change[:, None]
    index = answer.index.copy()
    index[moving] = len(answer.tangents) + np.arange(len(moving))
    return replace(response, answer=replace(answer, tangents=np.concatenate([answer.tangents, tangents]), index=index))
