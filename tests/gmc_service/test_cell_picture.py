"""Pictures of cells: what is painted is what the cell holds."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.image import imread

from gmc_service.architectures import hexagonal_pack, layered, random_pack, square_pack
from gmc_service.cell import Cell
from gmc_service.constituents import find_constituent
from gmc_service.picture import COLOURS, draw_cell

MATERIALS = (find_constituent("E-glass"), find_constituent("3501-6"))
CASES = {
    "2x2": square_pack(2, 0.5),
    "7x7": square_pack(7, 0.4),
    "26x26": square_pack(26, 0.6),
    "hexagonal": hexagonal_pack(0.5),
    "random": random_pack(0.5, 6, 1, 64),
    "layers": layered(0.25, 3),
}


@pytest.mark.parametrize("name", CASES)
def test_every_subcell_has_the_colour_of_its_phase_where_it_lies(name: str, tmp_path: Path) -> None:
    built = CASES[name]
    cell = Cell(built.heights, built.widths, built.phase, MATERIALS)
    draw_cell(cell, tmp_path / "cell.png")
    pixels = imread(tmp_path / "cell.png")[..., :3]
    distance = np.array([np.abs(pixels - np.array(to_rgb(colour))).max(axis=-1) for colour in COLOURS[:2]])
    painted = (distance < 0.02).any(axis=0)
    # The frame of the cell: lines of pixels in which most that can be painted is.
    rows, columns = (np.flatnonzero(painted.sum(axis=axis) > 0.5 * painted.sum(axis=axis).max()) for axis in (1, 0))
    up = 1.0 - (np.cumsum(cell.heights) - 0.5 * cell.heights) / cell.heights.sum()
    right = (np.cumsum(cell.widths) - 0.5 * cell.widths) / cell.widths.sum()
    # Beside the middle, where a label may stand.
    down = np.round(rows[0] + (rows[-1] - rows[0]) * (up - 0.25 * cell.heights / cell.heights.sum())).astype(int)
    along = np.round(columns[0] + (columns[-1] - columns[0]) * right).astype(int)
    np.testing.assert_array_equal(distance[:, down][:, :, along].argmin(axis=0), cell.phase)


def test_a_field_is_drawn_beside_its_colour_bar(tmp_path: Path) -> None:
    built = square_pack(7, 0.4)
    cell = Cell(built.heights, built.widths, built.phase, MATERIALS)
    field = np.linspace(-1.0, 1.0, cell.subcells)
    draw_cell(cell, tmp_path / "field.png", "stress", field, "stress 22 (MPa)")
    painted = imread(tmp_path / "field.png")[..., :3].reshape(-1, 3)
    # The ends of the colour map are in the picture: the first subcell dark violet, the last yellow.
    for colour in ("#440154", "#fde725"):
        assert (np.abs(painted - np.array(to_rgb(colour))).max(axis=-1) < 0.02).sum() > 500
    draw_cell(cell, tmp_path / "even.png", field=np.zeros(cell.subcells), field_label="nothing")


def test_bad_input_is_refused(tmp_path: Path) -> None:
    built = square_pack(2, 0.4)
    cell = Cell(built.heights, built.widths, built.phase, MATERIALS)
    with pytest.raises(ValueError, match=r"its suffix must be \.png"):
        draw_cell(cell, tmp_path / "cell.pdf")
    with pytest.raises(ValueError, match=r"field has shape \(3,\); it must have \(4,\)"):
        draw_cell(cell, tmp_path / "cell.png", field=np.zeros(3))
    with pytest.raises(ValueError, match="field holds a number that is not finite"):
        draw_cell(cell, tmp_path / "cell.png", field=np.array([0.0, np.nan, 0.0, 0.0]))
