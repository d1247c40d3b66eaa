"""Scenes of the second open-hole case: what is modelled, and that the variants differ as they say."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from coordinator.laminate_check import plane_elements
from coordinator.laminate_scene import load_laminate
from protocol.backend import find

SCENES = Path(__file__).parents[2] / "scenes"
LAYERED, TIED = SCENES / "oht_quasi_isotropic.toml", SCENES / "oht_quasi_isotropic_tied.toml"
#: Table 6.1: Young's modulus, GPa, and strength, MPa, neat and with 2 wt%.
MODULI, STRENGTHS = (2.963, 3.5811), (118.67, 121.02)


def test_the_scene_has_the_elements_that_the_text_counts() -> None:
    scene = load_laminate(LAYERED)
    assert scene.modelled_angles == (45.0, 0.0, -45.0, 90.0) * 2
    assert 7 * plane_elements(scene) == 3920  # cohesive elements
    small = load_laminate(LAYERED, ["laminate.layup=[45/0/-45/90]s"])
    plies = len(small.modelled_angles)
    assert (plies + plies - 1) * plane_elements(small) == 3920  # bricks and cohesive elements
    assert plies * small.laminate.ply_thickness == pytest.approx(0.5e-3)


def test_the_tied_scene_differs_by_its_layers_alone() -> None:
    layered, tied = load_laminate(LAYERED), load_laminate(TIED)
    assert layered.cohesive is not None and tied.cohesive is None
    left_out = {"title", "cohesive"}
    assert tied.model_dump(exclude=left_out) == layered.model_dump(exclude=left_out)


def test_graphene_changes_the_resin_by_the_ratios_of_table_6_1() -> None:
    read = find("micromechanics", "gmc_service").read_cell
    neat, other = (read(SCENES / "cells" / f"im7_epon862_oht{end}.toml") for end in ("", "_graphene"))
    assert neat.materials[0] == other.materials[0]
    assert np.array_equal(neat.phase, other.phase) and np.array_equal(neat.heights, other.heights)
    resin, changed = neat.materials[1], other.materials[1]
    stiffer = np.array(changed.stiffness[0]) / np.where(np.array(resin.stiffness[0]) == 0.0, np.inf, resin.stiffness[0])
    assert stiffer[stiffer > 0.0] == pytest.approx(MODULI[1] / MODULI[0], rel=1e-4)
    (before,), (after,) = resin.failures, changed.failures
    for name in ("tension", "shear"):
        ratios = np.array(getattr(after, name)) / np.array(getattr(before, name))
        assert ratios == pytest.approx(STRENGTHS[1] / STRENGTHS[0], rel=1e-4)
