"""Fields on a grid as VTKHDF 2.0 images, one file a frame: ParaView opens the files of a folder as one series.

Lengths are in Angstrom and stresses in GPa, as in the file of the material points; the attribute `unit` names them.
"""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np

from coordinator.atom_measurements import Grid
from protocol.arrays import FloatArray

ANGSTROM = 1e-10
#: Arrays in the file: name, unit and its SI size.
ARRAYS = {
    "density": ("Density", "kg/m3", 1.0),
    "velocity": ("Velocity", "Angstrom/ps", 1e2),
    "displacement": ("Displacement", "Angstrom", ANGSTROM),
    "stress": ("Stress", "GPa", 1e9),
    "temperature": ("Temperature", "K", 1.0),
}


def write_grid(path: Path, grid: Grid, fields: dict[str, FloatArray]) -> None:
    """Write fields on a grid, in one move.

    Parameters
    ----------
    path : Path
        Its folder is made if missing.
    grid : Grid
    fields : dict of str to float64 array, shape (x, y, z, ...)
        By name, SI; of six components are xx, yy, zz, xy, xz, yz.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(path.name + ".tmp")
    with h5py.File(temporary, "w") as file:
        group = file.create_group("VTKHDF")
        group.attrs["Version"] = np.array([2, 0])
        kind = b"ImageData"
        group.attrs.create("Type", kind, dtype=h5py.string_dtype("ascii", len(kind)))
        group.attrs["WholeExtent"] = np.array([end for count in grid.counts for end in (0, count - 1)])
        group.attrs["Origin"] = np.array(grid.origin) / ANGSTROM
        group.attrs["Spacing"] = np.full(3, grid.spacing / ANGSTROM)
        group.attrs["Direction"] = np.eye(3).ravel()
        group.attrs["unit"] = "Angstrom"
        data = group.create_group("PointData")
        for name, values in fields.items():
            label, unit, size = ARRAYS[name]
            # The format counts z first, x last, and has no axis for a single layer.
            ordered = np.swapaxes(values, 0, 2) / size
            if grid.counts[2] == 1:
                ordered = ordered[0]
            data.create_dataset(label, data=ordered.astype(np.float32))
            data[label].attrs["unit"] = unit
    temporary.replace(path)
