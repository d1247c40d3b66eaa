"""Samples as the role `atomistic` asks for them: a named material of a given size, or the bytes of a data file."""

from __future__ import annotations

import gzip
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final, Literal

import numpy as np

from md_service.atoms import Atoms, Box, CrackCut
from md_service.crystals import chain, fcc, hexagonal
from md_service.data_file import read_data_file
from md_service.epoxy_opening import opened, repeats_in_plane
from md_service.graphene import graphene

#: Element of each crystal that repeats along z.
_CUBIC: Final = {"copper": "Cu", "aluminium": "Al", "argon": "Ar"}
#: Materials of one plane of atoms, or of layers of these.
FLAT: Final = ("graphene", "hexagonal")
#: One row of atoms along x.
CHAIN: Final = "chain"
MATERIALS: Final = (*FLAT, *_CUBIC, CHAIN)
_SHIPPED: Final = Path(__file__).with_name("data")
_PACKED: Final = b"\x1f\x8b"  # how gzip begins
_OURS: Final = b", scalebridge "  # in the first line of files that `write_data_file` wrote


def build_sample(
    material: str,
    width: float,
    height: float,
    *,
    spacing: float,
    layers: int = 1,
    orientation: Literal["zigzag", "armchair"] | None = None,
    crack: CrackCut | None = None,
) -> Atoms:
    """Build a sample with free edges along x and y, centred on the origin.

    Parameters
    ----------
    material : str
        One of `MATERIALS`.
    width, height : float
        Wanted size along x and y, m; the nearest number of whole cells is built. A chain has no height.
    spacing : float
        Nearest-neighbour distance, m.
    layers : int
        Sheets of graphene on top of each other, or cubes along z of a crystal, which repeats there.
    orientation : {"zigzag", "armchair"}, optional
        Direction of graphene along x; zigzag without it.
    crack : CrackCut, optional
        Slit to cut; of flat samples only.

    Raises
    ------
    ValueError
        For an unknown material, or what it cannot have; the first word names the argument.
    """
    if material not in MATERIALS:
        raise ValueError(f"material is {material!r}; known are {', '.join(MATERIALS)}")
    if material == "graphene":
        return graphene(
            width, height, spacing=spacing, layers=layers, orientation=orientation or "zigzag", crack=crack
        )  # fmt: skip
    if orientation is not None:
        raise ValueError(f"orientation is {orientation!r}; only graphene has one, not {material}")
    if material == "hexagonal":
        if layers != 1:
            raise ValueError(f"layers is {layers}; a hexagonal sample is one layer")
        return hexagonal(spacing, width, height, crack=crack)
    if crack is not None:
        raise ValueError(f"crack is given; only flat samples are cut, {material} is not")
    if material == CHAIN:
        if layers != 1:
            raise ValueError(f"layers is {layers}; a chain is one row")
        return chain(spacing, width)
    edge = 2.0**0.5 * spacing
    cells = (round(width / edge), round(height / edge), layers)
    if min(cells) < 1:
        raise ValueError(f"width {width} m and height {height} m hold less than one cube of {edge:.3e} m")
    return fcc(_CUBIC[material], spacing, cells, (False, False, True))


def shipped_samples() -> dict[str, Path]:
    """Files of the samples that come with the package, by name."""
    return {path.name.removesuffix(".data.gz"): path for path in sorted(_SHIPPED.glob("*.data.gz"))}


def sample_from_bytes(data: bytes, periodic_z: bool | None = None, crack: CrackCut | None = None) -> Atoms:
    """Read a sample from the bytes of a LAMMPS data file; it becomes free along x and y.

    A network whose bonds pass through the faces of its box along x or y is opened there, see
    `md_service.epoxy_opening.opened`, and a crack is cut into it.

    Parameters
    ----------
    data : bytes
        Of the file, plain or packed by gzip.
    periodic_z : bool, optional
        Whether the box repeats along z. Without it as a file of ours says; another file then repeats nowhere.
    crack : CrackCut, optional
        Slit that the file holds, or that an opened network gets; that of the file's own notes without it.

    Raises
    ------
    ValueError
        If this is no such file, or its box is sheared.
    """
    packed = data[:2] == _PACKED
    with TemporaryDirectory() as folder:
        path = Path(folder) / ("sample.data.gz" if packed else "sample.data")
        path.write_bytes(data)
        try:
            atoms, _ = read_data_file(path)
            first_line = (gzip.decompress(data) if packed else data).partition(b"\n")[0]
        except ValueError as error:
            raise ValueError(str(error).replace(f"{path}: ", "")) from None
    if len(atoms) == 0:
        raise ValueError("the file holds no atoms")
    if periodic_z is None:
        periodic_z = atoms.box.periodic[2] if _OURS in first_line else False
    crack = atoms.crack if crack is None else crack
    if repeats_in_plane(atoms):
        if not periodic_z:
            raise ValueError("bonds pass through faces of the box; such a sample repeats along z: leave periodic_z out")
        return opened(atoms, crack)
    return replace(atoms, box=_free_box(atoms, periodic_z), crack=crack)


def _free_box(atoms: Atoms, periodic_z: bool) -> Box:
    """The box of the atoms, free along x and y; along free directions it holds all atoms."""
    box = atoms.box
    if box.tilt.any():
        raise ValueError("the box is sheared; a sample that is free along x and y has a box with right angles")
    low, high = box.low.copy(), box.high.copy()
    free = [0, 1] if periodic_z else [0, 1, 2]
    low[free] = np.minimum(low, atoms.position.min(axis=0))[free]
    high[free] = np.maximum(high, atoms.position.max(axis=0))[free]
    return Box(low, high, (False, False, periodic_z))
