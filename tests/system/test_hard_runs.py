"""Hard cases of the handshake as whole runs: hot atoms, unequal moduli, a load step, a service that stands still."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from small_runs import StartsRuns

from coordinator.local_strain import mean_gradient
from coordinator.results import Results
from coordinator.verification_cases.runs import run_text, shipped

pytestmark = pytest.mark.slow

HIT = """
[[continuum.edges]]
edge = "{edge}"
kind = "traction"
component = "y"
times = ["0 ps"]
tractions = ["{size} GPa"]
"""
SMALL = ("run.steps=60", "run.output_every=60", "run.checkpoint_every=60")


def inner_gradient(results: Results) -> np.ndarray:
    assert results.atoms is not None
    reference = results.atoms.reference[:, :2]
    low, high = results.interface["inner"]
    inside = np.all((reference > low) & (reference < high), axis=1)
    moved = results.atoms.position(len(results.atoms) - 1)[:, :2] - reference
    return mean_gradient(reference[inside], moved[inside])


SLOW_SERVICE = """
import sys, time
from pathlib import Path
from protocol.backend import find
from protocol.server import Server
service = find("atomistic", "lattice").make(Path(sys.argv[2]))
quick, asked = service.advance, []
def slow(request):
    asked.append(request)
    if len(asked) == 10:
        time.sleep(10.0)
    return quick(request)
service.advance = slow
Server(service, sys.argv[1]).run(lambda bound: print(bound, flush=True))
"""


@pytest.fixture
def slow_service(tmp_path: Path) -> Iterator[str]:
    """Endpoint of a lattice that takes ten seconds longer over its tenth exchange."""
    endpoint = f"ipc://{tmp_path}/slow"
    words = [sys.executable, "-c", SLOW_SERVICE, endpoint, str(tmp_path)]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None and process.stdout.readline().strip()
            yield endpoint
        finally:
            process.kill()


def test_a_service_slow_by_ten_seconds_changes_nothing_but_the_time(slow_service: str, tmp_path: Path) -> None:
    text = shipped("free_lattice") + HIT.format(edge="top", size=1.0)
    scene, folder = tmp_path / "scene.toml", tmp_path / "slowed"
    scene.write_text(text)
    words = [word for value in SMALL for word in ("--set", value)]
    command = [sys.executable, "-m", "coordinator.cli", "run", str(scene), "--out", str(folder), *words]
    done = subprocess.run(
        [*command, "--attach", f"atomistic={slow_service}"], capture_output=True, text=True, check=False, timeout=400
    )
    assert done.returncode == 0, done.stderr
    with run_text(text, tmp_path / "left-alone", SMALL) as left_alone:
        wanted = left_alone.series
    with Results(folder / "results.h5") as results:
        assert results.series["seconds_atomistic"].max() > 10.0
        for name in ("atomistic_kinetic", "continuum_kinetic", "continuum_strain", "spring_energy"):
            np.testing.assert_array_equal(results.series[name], wanted[name], err_msg=name)


def test_a_service_that_is_stopped_for_ten_seconds_ends_the_run_in_good_order(
    start: StartsRuns, tmp_path: Path
) -> None:
    """Stopped as a whole, as when its machine hangs, it answers no heartbeat either: the run says so and can go on."""
    scene = tmp_path / "scene.toml"
    scene.write_text(shipped("free_lattice"))
    run = start(scene, tmp_path / "stopped", *(word for value in SMALL for word in ("--set", value)))
    run.wait_for_step(5)
    run.send("atomistic", signal.SIGSTOP)
    time.sleep(10.0)
    run.send("atomistic", signal.SIGCONT)
    assert run.wait(240.0) == 1
    assert "the link to the atomistic service broke" in run.printed
    assert "--resume" in run.printed


def test_a_load_step_in_one_coupling_step_settles_at_its_static_answer(tmp_path: Path) -> None:
    """Tension of 0.1 GPa, there from the first step on: strain sigma / E along the load, a third of it across."""
    text = shipped("free_lattice") + HIT.format(edge="top", size=0.1) + HIT.format(edge="bottom", size=-0.1)
    damped = ("run.steps=800", "run.output_every=800", "run.checkpoint_every=800", "continuum.damping_rate=5 1/ps")
    with run_text(text, tmp_path, damped) as results:
        gradient = inner_gradient(results)
        kinetic = results.series["continuum_kinetic"]
    strain = 0.1e9 / (2.0 * 250.0 / (np.sqrt(3.0) * 2.8169e-10))
    assert kinetic[-1] < 1e-3 * kinetic.max()
    assert gradient[1, 1] == pytest.approx(strain, rel=0.03)
    assert gradient[0, 0] == pytest.approx(-strain / 3.0, rel=0.06)


def test_atoms_at_1000_kelvin_stay_coupled_and_lose_heat_regression(tmp_path: Path) -> None:
    """Stable; heat goes into the light continuum faster than the dampers' thermostat brings it back."""
    hot = ("run.steps=200", "run.output_every=200", "run.checkpoint_every=200", "atomistic.temperature=1000 K",
           "atomistic.equilibration=1 ps", "atomistic.reference=0.2 ps", "handshake.damping_time=0.02 ps")  # fmt: skip
    with run_text(shipped("free_lattice"), tmp_path, hot) as results:
        temperature = results.series["temperature"]
        assert len(temperature) == 200
    # 788 K measured; 642 K with dampers of 0.05 ps, 464 K without. In the plane 621 atoms scatter by 4 %.
    assert np.mean(temperature[-50:]) == pytest.approx(788.0, rel=0.08)


def test_a_continuum_a_fifth_stiffer_than_the_atoms_strains_them_more_but_by_less_than_a_fifth(tmp_path: Path) -> None:
    """A softer inclusion takes more strain than is applied, and less than in series with its surroundings."""
    young = 1.2 * 2.0 * 250.0 / (np.sqrt(3.0) * 2.8169e-10)
    density = 6.6335e-26 / (0.5 * np.sqrt(3.0) * 3.45e-10**2 * 2.8169e-10)
    material = (
        f'\n[continuum.material]\nlaw = "isotropic"\nyoung = "{young:.6g} Pa"\npoisson = 0.3333333\n'
        f'density = "{density:.6g} kg/m^3"\nthickness = "2.8169 angstrom"\n'
    )
    edges = "".join(
        f'\n[[continuum.edges]]\nedge = "{edge}"\ncomponent = "{axis}"\ntimes = ["0 ps", "1 ps"]\n'
        f'displacements = ["{way} angstrom", "{way} angstrom"]\n'
        for edge, axis, way in (("top", "y", 0.064), ("bottom", "y", -0.064), ("left", "x", 0.0), ("right", "x", 0.0))
    )
    preload = '\n[continuum.preload]\nmethod = "static"\ntolerance = 1e-9\nmax_steps = 20\n'
    settings = ("run.steps=600", "run.output_every=600", "run.checkpoint_every=600", "continuum.damping_rate=5 1/ps")
    with run_text(shipped("free_lattice") + material + preload + edges, tmp_path, settings) as results:
        strain = inner_gradient(results)[1, 1] / 1e-3
    assert 1.01 < strain < 1.2
