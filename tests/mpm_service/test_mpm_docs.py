"""What the documentation shows as code runs."""

import doctest
import re
from pathlib import Path

import pytest

import mpm_service

GUIDE = Path(__file__).resolve().parents[2] / "docs" / "continuum.md"


def test_library_example_of_the_guide_runs(capsys: pytest.CaptureFixture[str]) -> None:
    (example,) = re.findall(r"```python\n(.*?)```", GUIDE.read_text(), flags=re.DOTALL)
    names: dict[str, object] = {}
    exec(example, names)
    solver = names["solver"]
    assert isinstance(solver, mpm_service.MaterialPointSolver)
    assert "Energies" in capsys.readouterr().out
    energies = solver.energies()
    # What the traction put in is there, less what FMPM takes.
    assert 0.85 * energies.load_work < energies.kinetic + energies.strain < 1.01 * energies.load_work


def test_example_of_the_package_runs() -> None:
    failed, tried = doctest.testmod(mpm_service)
    assert tried > 5 and failed == 0
