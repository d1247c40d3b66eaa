"""Verification cases of the material point solver: the cheap ones in full, the dear ones in part or marked slow."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from mpm_service import NeoHookean, Scheme
from mpm_service.verification import beam, cases, convergence, large_deformation, rigid, stability
from protocol.verification import Check

FLIP_USL = Scheme(integration="usl", transfer="flip")
CHEAP = ("bar-wave", "free-vibration", "rigid", "transition")


def named(name: str) -> Callable[[Path], list[Check]]:
    """Run function of a case."""
    return next(case.run for case in cases.CASES if case.name == name)


@pytest.mark.parametrize("name", CHEAP)
def test_cheap_case_passes_and_draws(name: str, tmp_path: Path) -> None:
    checks = named(name)(tmp_path)
    assert checks
    failed = [(check.quantity, check.value, check.reference) for check in checks if not check.passed]
    assert not failed
    assert name == "rigid" or list(tmp_path.glob("*.png"))


@pytest.mark.slow
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("name", [case.name for case in cases.CASES if case.name not in CHEAP])
def test_dear_case_passes_and_draws(name: str, tmp_path: Path) -> None:
    checks = named(name)(tmp_path)
    assert checks
    failed = [(check.quantity, check.value, check.reference) for check in checks if not check.passed]
    assert not failed
    assert list(tmp_path.glob("*.png"))


def test_names_of_cases_are_those_of_the_command_line() -> None:
    assert [f"{case.group}/{case.name}" for case in cases.CASES] == [
        "mpm/beam", "mpm/bar-wave", "mpm/free-vibration", "mpm/edge-crack", "mpm/convergence", "mpm/rigid",
        "mpm/large-deformation", "mpm/transition", "mpm/stability", "mpm/static",
    ]  # fmt: skip


def test_beam_error_falls_with_second_order() -> None:
    coarse = beam.run_beam(cells=4, samples=100)
    assert coarse.error < 0.05
    # One free period decides: both start alike, so the first second alone shows the order.
    early = coarse.time < 2.0
    fine = beam.run_beam(cells=8, samples=25, duration=2.0)
    scale = np.abs(coarse.exact).max()
    coarse_error = np.abs(coarse.value - coarse.exact)[early].max() / scale
    fine_error = np.abs(fine.value - fine.exact).max() / scale
    assert fine_error < coarse_error / 3.0


@pytest.mark.parametrize("scheme", cases.SECOND_ORDER, ids=convergence.label_of)
def test_second_order_while_points_stay_in_their_cells(scheme: Scheme) -> None:
    coarse, _ = convergence.run_manufactured(scheme, 8, convergence.SMALL)
    fine, _ = convergence.run_manufactured(scheme, 16, convergence.SMALL)
    assert np.log2(coarse / fine) > 1.7


def test_spinning_disk_keeps_its_momentum() -> None:
    run = large_deformation.run_disk(FLIP_USL, crossings=12, radius=5.0)
    assert run.crossings >= 12
    assert run.momentum_error < 1e-13
    assert run.angular_momentum[-1] == pytest.approx(1.0, abs=0.02)


def test_closed_form_of_the_tensile_bar() -> None:
    law = NeoHookean(1.0e6, 0.3, 1000.0, "plane_strain")
    for stretch in (1.001, 1.3, 2.0):
        stress, lateral = large_deformation.uniaxial_stress(law, stretch)
        # No lateral stress, and the axial one from the energy: dW/dstretch at fixed lateral stretch over the area.
        j = stretch * lateral
        assert law.shear_modulus * (lateral**2 - 1) + 0.5 * law.lame * (j**2 - 1) == pytest.approx(0.0, abs=1e-6)

        def energy(s: float, w: float = lateral) -> float:
            trace = s**2 + w**2 - 2.0 - 2.0 * np.log(s * w)
            return 0.5 * law.shear_modulus * trace + 0.25 * law.lame * ((s * w) ** 2 - 1 - 2 * np.log(s * w))

        slope = (energy(stretch + 1e-6) - energy(stretch - 1e-6)) / 2e-6
        assert stress == pytest.approx(slope / lateral, rel=1e-6, abs=1e-3)
    small, _ = large_deformation.uniaxial_stress(law, 1.0 + 1e-6)
    assert small == pytest.approx(1e-6 * law.young / (1 - law.poisson**2), rel=1e-4)


def test_bar_stays_even_at_moderate_stretch() -> None:
    bar = large_deformation.run_tensile_bar(Scheme("cpgimp", "usl"), stretch=1.3, rate=0.03)
    assert bar.stress_error < 0.02
    assert bar.spread == pytest.approx(1.0, abs=0.01)


def test_a_stressed_body_stays_at_rest() -> None:
    still = stability.rest(2000, 1e-3)
    assert still.steps == 2000
    assert still.stress_change < 1e-12
    assert still.moved < 1e-12
    assert stability.rest(200, 0.0).speed == 0.0


def test_stress_of_the_small_strain_law_turned_by_an_angle() -> None:
    assert rigid.turned(0.3, rigid.SMALL_STRAIN, steps=0) == pytest.approx(rigid.false_stress(0.3), rel=1e-12)
    assert rigid.turned(2.0) < 1e-13


def test_time_step_above_the_limit_is_refused() -> None:
    assert stability.refusal_names_limit(0.9)
    with pytest.raises(ValueError, match="time_step"):
        stability.shake(rigid.NEO_HOOKEAN, courant=0.9)
