"""Scenes and tables of the cases that hold the coupling against theory in one dimension."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from coordinator.scene import load_scene
from coordinator.verification_cases import chain, stability, theory_1d

SCHEMES = [*theory_1d.STATICS, *theory_1d.WAVES]


def load(text: str, folder: Path):  # type: ignore[no-untyped-def]
    path = folder / "scene.toml"
    path.write_text(text, encoding="utf-8")
    return load_scene(path)


@pytest.mark.parametrize("scheme", SCHEMES, ids=[f"{one.label} {one.stiffness:.3g}" for one in SCHEMES])
def test_scenes_of_a_chain_are_read_with_profile_and_springs(scheme: theory_1d.Scheme, tmp_path: Path) -> None:
    bar = chain.Bar(left=2.0, right=2.0, chain=3.0)
    scene = load(bar.text(10, 5, scheme.handshake, chain.pulled(1e-4)), tmp_path)
    assert scene.handshake is not None and scene.atomistic is not None
    assert scene.handshake.profile == scheme.profile.kind
    assert scene.handshake.weight == scheme.profile.weight
    assert scene.handshake.stiffness_weight == scheme.profile.stiffness
    assert scene.time_step == pytest.approx(bar.coupling_step)
    # kappa L^2 / E of that spring, with the volume of one atom of the bar.
    width = chain.ring_width(scheme.profile)
    kappa = scene.handshake.stiffness / (chain.SECTION * chain.SPACING)
    assert kappa * width**2 / chain.YOUNG == pytest.approx(scheme.stiffness)


def test_the_bar_of_the_continuum_has_the_modulus_density_and_section_of_the_chain(tmp_path: Path) -> None:
    scene = load(chain.Bar(2.0, 0.0, 3.0).text(10, 5, "", chain.pulse("left", 1.5, 1e-13)[0]), tmp_path)
    material = scene.continuum.material
    assert material is not None and material.young is not None
    height = scene.continuum.upper[1] - scene.continuum.lower[1]
    section = material.thickness * height
    # A row of springs k at distance a is a bar of stiffness k a and mass m / a for each length.
    assert material.young * section == pytest.approx(chain.BOND * chain.SPACING)
    assert material.density * section == pytest.approx(chain.MASS / chain.SPACING)
    assert pytest.approx(chain.SPACING * math.sqrt(chain.BOND / chain.MASS)) == chain.SPEED


def test_a_bell_ends_where_it_began() -> None:
    table, duration = chain.pulse("left", 1.5, 1e-13)
    ways = [float(word.split()[0].strip('"')) for word in table.split("displacements = [")[1].split("]")[0].split(",")]
    assert ways[0] == 0.0
    assert ways[-1] == pytest.approx(0.0, abs=1e-19)
    assert max(ways) == pytest.approx(1e-13, rel=1e-3)
    assert duration == pytest.approx(12.0 * chain.WIDTH / chain.SPEED)


def test_the_table_of_schemes_names_what_is_unstable_and_what_meets_the_limits() -> None:
    rows = [[cell.strip() for cell in line.strip("| ").split("|")] for line in theory_1d.scheme_table().splitlines()]
    head, body = rows[0], {row[0]: row for row in rows[2:]}
    assert all(len(row) == len(head) for row in rows)
    assert body["constant 0.1"][-3].endswith("unstable")
    reflected = [float(cell.split()[0]) for cell in body["power 8"][4:8]]
    assert (np.array(reflected) <= [12.0, 5.0, 3.0, 1.0]).all()
    assert "unstable" not in body["power 8"][-2]


def test_pictures_are_drawn(tmp_path: Path) -> None:
    along = np.geomspace(3.0, 60.0, 7)
    theory_1d.draw(
        tmp_path / "theory.png", np.zeros(len(theory_1d.STATICS)), along, [0.1 / along for _ in theory_1d.WAVES]
    )
    rows = (stability.WEIGHTS, stability.EXPONENTS, stability.SPRINGS)
    maps = [
        [
            [stability.Point(0.05 * m, m > 30, 1.0 if m < 20 else math.inf) for m in stability.STEPS_PER_EXCHANGE]
            for _ in each
        ]
        for each in rows
        for _ in stability.DAMPING_TIMES
    ]
    stability.draw(tmp_path / "map.png", maps, 10)
    assert (tmp_path / "theory.png").stat().st_size > 20000
    assert (tmp_path / "map.png").stat().st_size > 20000


def test_the_map_has_stable_and_unstable_points() -> None:
    weight = stability.WeightProfile("constant", 0.2)
    kappa = stability.exact_stiffness(weight)
    held = stability.point(weight, kappa, 10, None, 2000)
    lost = stability.point(weight, kappa, 20, None, 2000)
    assert held.number < 0.9 < 1.0 < lost.number
    assert held.growth == pytest.approx(1.0, abs=0.05)
    assert lost.growth == math.inf


def test_a_resonance_needs_a_step_near_a_period_of_the_atoms() -> None:
    period = math.pi / stability.ATOMS  # of the chain's fastest vibration, in units of width over speed
    assert not stability.may_resonate(0.5, 0.5 * period)
    assert stability.may_resonate(0.5, period)
