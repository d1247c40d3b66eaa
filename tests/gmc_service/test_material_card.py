"""Material cards: read back by the manuals' order of components, and by CalculiX itself where it is installed."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from gmc_service.engineering_constants import EngineeringConstants
from gmc_service.material_card import material_card

PLY = EngineeringConstants(160e9, 9e9, 8e9, 0.3, 0.28, 0.45, 5e9, 4.5e9, 3e9)
EXPANSION = np.array([-0.3e-6, 30e-6, 31e-6, 0.0, 0.0, 0.0])


def tied_stiffness() -> NDArray[np.float64]:
    """A stiffness of which all 21 constants differ."""
    root = np.random.default_rng(5).normal(size=(6, 6)) + 3.0 * np.eye(6)
    return np.asarray(1e9 * root @ root.T)


def data_after(card: str, keyword: str) -> list[float]:
    """Numbers of the lines between a keyword and the next."""
    block = re.split(r"^\*.*$", card[card.index(keyword) :], flags=re.MULTILINE)[1]
    return [float(text) for text in block.replace("\n", ",").split(",") if text.strip()]


def test_engineering_constants_stand_in_the_order_of_the_manual() -> None:
    card = material_card("IM7 / 8552, ply", PLY.stiffness(), EXPANSION, 1571.0, 453.15)
    # E1, E2, E3, nu12, nu13, nu23, G12, G13, G23; MPa.
    expected = [160e3, 9e3, 8e3, 0.3, 0.28, 0.45, 5e3, 4.5e3, 3e3]
    np.testing.assert_allclose(data_after(card, "*ELASTIC, TYPE=ENGINEERING CONSTANTS"), expected, rtol=1e-7)
    np.testing.assert_allclose(data_after(card, "*EXPANSION, TYPE=ORTHO, ZERO=453.15"), EXPANSION[:3], rtol=1e-7)
    np.testing.assert_allclose(data_after(card, "*DENSITY"), 1571e-12, rtol=1e-7)  # tonne / mm3
    assert "*MATERIAL, NAME=IM7_8552_PLY\n" in card and "** Units: mm, N, MPa, tonne, s, K\n" in card
    assert max(len(line) for line in card.splitlines()) < 132


def test_units_of_the_second_system_are_si() -> None:
    card = material_card("8552", PLY.stiffness(), density=1300.0, units="m")
    assert data_after(card, "*ELASTIC, TYPE=ENGINEERING")[0] == pytest.approx(160e9)
    assert data_after(card, "*DENSITY") == [1300.0]
    assert "NAME=M_8552" in card and "*EXPANSION" not in card


def test_a_tied_stiffness_is_written_in_full() -> None:
    """Rows of the upper triangle column by column: D1111, D1122, D2222, D1133, ... with 12, 13, 23 as 4, 5, 6."""
    stiffness = tied_stiffness()
    values = data_after(material_card("tied", stiffness), "*ELASTIC, TYPE=ANISO")
    # Our order has 23, 13, 12 in places 3, 4, 5; names as the Abaqus manual lists them.
    place = {"11": 0, "22": 1, "33": 2, "23": 3, "13": 4, "12": 5}
    pairs = ["11", "22", "33", "12", "13", "23"]
    names = [row + column for last, column in enumerate(pairs) for row in pairs[: last + 1]]
    assert names[:4] == ["1111", "1122", "2222", "1133"] and names[-3:] == ["1223", "1323", "2323"]
    expected = [stiffness[place[name[:2]], place[name[2:]]] / 1e6 for name in names]
    np.testing.assert_allclose(values, expected, rtol=1e-7)


def test_expansion_in_shear_is_left_out_and_said() -> None:
    tilted = EXPANSION + np.array([0.0, 0.0, 0.0, 2e-6, 0.0, 0.0])
    card = material_card("tilted", tied_stiffness(), tilted)
    assert "** Left out: thermal expansion in shear 12, 13, 23 (engineering, 1/K): 0., 0., 2e-06" in card
    np.testing.assert_allclose(data_after(card, "*EXPANSION"), EXPANSION[:3], rtol=1e-7)


def test_bad_input_is_refused() -> None:
    with pytest.raises(ValueError, match="units is 'inch'; it must be one of mm, m"):
        material_card("a", PLY.stiffness(), units="inch")
    with pytest.raises(ValueError, match="expansion holds a number that is not finite"):
        material_card("a", PLY.stiffness(), np.full(6, np.nan))


CUBE = """*NODE, NSET=NALL
1, 0., 0., 0.
2, 1., 0., 0.
3, 1., 1., 0.
4, 0., 1., 0.
5, 0., 0., 1.
6, 1., 0., 1.
7, 1., 1., 1.
8, 0., 1., 1.
*ELEMENT, TYPE=C3D8, ELSET=EALL
1, 1, 2, 3, 4, 5, 6, 7, 8
"""
CORNERS = np.array(
    [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]], dtype=float
)


def calculix_stress(card: str, strain: NDArray[np.float64], change: float, folder: Path) -> NDArray[np.float64]:
    """Stress of a unit cube under a homogeneous strain and a temperature change; both in our order."""
    name = re.search(r"NAME=(\w+)", card).group(1)  # type: ignore[union-attr]
    tensor = np.diag(strain[:3])
    for place, (i, j) in ((3, (1, 2)), (4, (0, 2)), (5, (0, 1))):
        tensor[i, j] = tensor[j, i] = 0.5 * strain[place]
    moves = "".join(
        f"{node + 1}, {axis + 1}, {axis + 1}, {float((tensor @ corner)[axis])!r}\n"
        for node, corner in enumerate(CORNERS)
        for axis in range(3)
    )
    heating = "*TEMPERATURE\n" + f"NALL, {453.15 + change}\n"
    (folder / "cube.inp").write_text(
        CUBE + card + f"*SOLID SECTION, ELSET=EALL, MATERIAL={name}\n"
        "*INITIAL CONDITIONS, TYPE=TEMPERATURE\nNALL, 453.15\n*STEP\n*STATIC\n*BOUNDARY\n"
        + moves + heating + "*EL PRINT, ELSET=EALL\nS\n*END STEP\n"
    )  # fmt: skip
    subprocess.run(["ccx", "-i", "cube"], cwd=folder, check=True, capture_output=True, timeout=60)
    lines = [line.split() for line in (folder / "cube.dat").read_text().splitlines()]
    stresses = np.array([line[2:] for line in lines if len(line) == 8 and line[0] == "1"], dtype=float)
    assert stresses.shape == (8, 6)  # sxx, syy, szz, sxy, sxz, syz at eight points
    return np.asarray(stresses.mean(axis=0)[[0, 1, 2, 5, 4, 3]])


@pytest.mark.skipif(shutil.which("ccx") is None, reason="CalculiX (ccx) is not installed")
@pytest.mark.parametrize("stiffness", [PLY.stiffness(), tied_stiffness()], ids=["orthotropic", "tied"])
def test_calculix_reads_the_card_as_it_is_meant(stiffness: NDArray[np.float64], tmp_path: Path) -> None:
    card = material_card("ply", stiffness, EXPANSION, 1571.0, 453.15)
    cases = [(1e-4 * unit, 0.0) for unit in np.eye(6)] + [(np.zeros(6), 50.0)]
    for number, (strain, change) in enumerate(cases):
        folder = tmp_path / str(number)
        folder.mkdir()
        found = calculix_stress(card, strain, change, folder)
        expected = stiffness @ (strain - EXPANSION * change) / 1e6
        np.testing.assert_allclose(found, expected, atol=2e-6 * np.abs(expected).max())
