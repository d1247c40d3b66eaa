"""The mesh of a plate's plane, where a file gives it instead of keys of the scene."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from coordinator.units import LENGTHS, readable
from protocol.arrays import FloatArray, IntArray
from protocol.backend import find

#: Metres of the units that a file may be in.
FILE_UNITS: Final = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "inch": 25.4e-3}
#: Part of the plate's extent by which the mesh may end beside it; the structure service sets such nodes on the side.
_BESIDE: Final = 1e-6


@dataclass(frozen=True, eq=False)
class GivenPlane:
    """Quadrilaterals of the whole plate or of its quarter; the origin is the middle of the plate.

    Attributes
    ----------
    nodes : float64 array, shape (nodes, 2)
        m.
    elements : int64 array, shape (elements, 4)
        Nodes of each, counterclockwise.
    quarter : bool
        Whether it is the quarter with x and y above 0.
    """

    nodes: FloatArray
    elements: IntArray
    quarter: bool

    @property
    def digest(self) -> str:
        """Equal for equal meshes, different for others."""
        found = hashlib.sha256(self.nodes.tobytes())
        found.update(self.elements.tobytes())
        return found.hexdigest()


def read_given_plane(file: Path, unit: str, backend: str, length: float, width: float) -> GivenPlane:
    """Read a mesh by the backend of the role `structure`.

    Parameters
    ----------
    file : Path
    unit : str
        A key of `FILE_UNITS`.
    backend : str
    length, width : float
        Of the plate, m.

    Raises
    ------
    BackendError
        If the backend is not installed or reads no meshes.
    ValueError
        If the file is no mesh that can be used, or does not span the plate or its quarter.
    """
    nodes, elements = find("structure", backend).read_plane(file, FILE_UNITS[unit])
    low, high = nodes.min(axis=0), nodes.max(axis=0)
    half = 0.5 * np.array([length, width])
    for quarter, start in ((True, np.zeros(2)), (False, -half)):
        near = _BESIDE * float((half - start).max())
        if max(float(np.abs(low - start).max()), float(np.abs(high - half).max())) <= near:
            return GivenPlane(nodes, elements, quarter)
    raise ValueError(
        f"spans {_spans(low, high)}; the plate spans {_spans(-half, half)}, its quarter {_spans(np.zeros(2), half)}; "
        f"the file is read in {unit} (mesh.file_unit)"
    )


def _spans(low: FloatArray, high: FloatArray) -> str:
    parts = [
        f"{name} from {readable(float(a), LENGTHS)} to {readable(float(b), LENGTHS)}"
        for name, a, b in zip("xy", low, high, strict=True)
    ]
    return " and ".join(parts)
