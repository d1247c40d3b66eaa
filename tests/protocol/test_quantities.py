"""Quantities with units against hand conversions."""

from __future__ import annotations

import math
import subprocess
import sys

import pytest

from protocol.quantities import to_si

ELEMENTARY_CHARGE = 1.602176634e-19  # C, exact by definition of the SI


@pytest.mark.parametrize(
    ("text", "dimension", "value"),
    [
        ("2.5 angstrom", "length", 2.5e-10),
        ("-3e-1 nm", "length", -3e-10),
        (".5fs", "time", 5e-16),
        ("300 K", "temperature", 300.0),
        ("25 degC", "temperature", 298.15),
        ("1 TPa", "pressure", 1e12),
        ("20 eV/angstrom^2", "stiffness", 20 * ELEMENTARY_CHARGE / 1e-20),
        ("3 N/m", "stiffness", 3.0),
        ("0.5 1/ps", "rate", 5e11),
        ("0.5 /ps", "rate", 5e11),
        ("2.2 g/cm^3", "density", 2200.0),
    ],
)
def test_conversion(text: str, dimension: str, value: float) -> None:
    assert math.isclose(to_si(text, dimension), value, rel_tol=1e-14)


@pytest.mark.parametrize(
    ("text", "dimension", "said"),
    [
        ("5", "length", "the unit is missing"),
        ("five angstrom", "length", "no number with a unit"),
        ("nan angstrom", "length", "no number with a unit"),
        ("2*3 angstrom", "length", "'*3 angstrom' is unknown"),
        ("5 angstroem", "length", "'angstroem' is unknown"),
        ("5 A", "length", "A is ampere"),
        ("5 fs", "length", "'fs' is none of length"),
        ("1e308 km", "length", "too large"),
    ],
)
def test_what_is_no_quantity_is_refused(text: str, dimension: str, said: str) -> None:
    with pytest.raises(ValueError, match="with its unit, such as") as caught:
        to_si(text, dimension)
    assert said in str(caught.value)


def test_import_is_light() -> None:
    code = (
        "import sys, protocol.quantities; print([m for m in ('pint', 'numpy', 'pydantic', 'zmq') if m in sys.modules])"
    )
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert out.stdout.strip() == "[]"
