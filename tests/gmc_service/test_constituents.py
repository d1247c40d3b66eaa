"""The shipped database: every entry has a source, and is complete or says what is missing."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gmc_service.constituents import constituent_entry, constituent_names, constituent_of_file, find_constituent
from gmc_service.engineering_constants import engineering_constants
from gmc_service.toml_table import Mistakes
from protocol.constituent import Constituent, Figure, write_constituent
from protocol.quantities import to_si

INCOMPLETE = {"seed-im7-oht"}


@pytest.mark.parametrize("name", constituent_names())
def test_every_entry_has_a_source_and_gives_back_its_own_constants(name: str) -> None:
    entry = constituent_entry(name)
    assert len(entry["source"]) > 20
    if name in INCOMPLETE:
        with pytest.raises(Mistakes, match="is missing"):
            find_constituent(name)
        return
    material = find_constituent(name)
    of = engineering_constants(material.stiffness_at(float(material.temperatures[0])))
    found = {"E": of.E22, "E1": of.E11, "E2": of.E33, "nu": of.nu23, "nu12": of.nu13, "nu23": of.nu23, "G": of.G13}
    found |= {"G12": of.G13, "G23": of.G23}
    for key in ("E", "E1", "E2", "nu", "nu12", "nu23", "G", "G12", "G23"):
        if key in entry:
            first = entry[key][0] if isinstance(entry[key], list) else entry[key]
            value = first if key.startswith("nu") else to_si(first, "pressure")
            assert found[key] == pytest.approx(value, rel=1e-9, abs=1e-9)
    assert material.expansion_known == any(key.startswith("alpha") for key in entry)
    assert len(material.failures) == len(entry.get("failure", ()))


def test_all_that_the_issue_names_are_there() -> None:
    wanted = {"IM7", "AS4", "T300", "E-glass", "boron", "EPON-862", "3501-6", "8552", "aluminium-6061"}
    wanted |= {"seed-im7-6k", "seed-epon862-neat", "seed-epon862-2wt", "seed-im7-oht", "seed-epon862-oht"}
    assert wanted <= set(constituent_names())


@pytest.mark.parametrize(("name", "shear"), [("3501-6", 1.567e9), ("E-glass", 30.8e9), ("E-glass-21xK43", 33.33e9)])
def test_shear_moduli_follow_from_the_printed_pairs(name: str, shear: float) -> None:
    """Soden, Hinton, Kaddour 1998 print E, nu and G of the isotropic ones: the three agree to the printed digits."""
    assert pytest.approx(shear, rel=2e-3) == engineering_constants(find_constituent(name).stiffness[0]).G12


def test_thermal_expansion_of_aluminium_agrees_with_another_table() -> None:
    """Eurocode 9 against the Aluminum Association: 23.6e-6 from 20 to 100 C, 25.2e-6 from 20 to 300 C."""
    hot = find_constituent("aluminium-6061-hot")
    assert hot.expansion_at(373.15)[0] == pytest.approx(23.6e-6, rel=0.01)
    assert hot.expansion_at(573.15)[0] == pytest.approx(25.2e-6, rel=0.025)
    assert hot.expansion_at(373.15)[3:].tolist() == [0.0, 0.0, 0.0]


def test_between_temperatures_the_table_is_linear_and_beyond_it_is_an_error() -> None:
    hot = find_constituent("aluminium-6061-hot")
    np.testing.assert_allclose(engineering_constants(hot.stiffness_at(398.15)).E11, 66.5e9, rtol=1e-12)
    with pytest.raises(ValueError, match=r"temperature is 600 K; the table of aluminium-6061-hot goes from 293.15 to"):
        hot.stiffness_at(600.0)


def test_the_epoxy_of_example_1a_has_its_own_shear_modulus() -> None:
    of = engineering_constants(find_constituent("example-1a-epoxy").stiffness[0])
    assert (of.G12, of.E11, of.nu12) == pytest.approx((1.278e9, 3.45e9, 0.35), rel=1e-12)


def test_what_a_source_lacks_is_named() -> None:
    with pytest.raises(Mistakes) as caught:
        find_constituent("seed-im7-oht")
    assert len(caught.value.lines) == 2
    assert "seed-im7-oht.nu23: is missing" in caught.value.lines[0] and "(or G23)" in caught.value.lines[0]
    assert "seed-im7-oht.G12: is missing" in caught.value.lines[1]


def test_an_unknown_name_gets_a_hint() -> None:
    with pytest.raises(ValueError, match="constituent is 'IM-7'; there is none of that name; did you mean 'IM7'"):
        find_constituent("IM-7")


def test_a_measured_resin_becomes_a_table(tmp_path: Path) -> None:
    resin = Constituent(
        name="epoxy_8",
        source="molecular dynamics",
        temperature=Figure(300.0),
        density=Figure(1115.0, 3.0),
        kind="isotropic",
        elastic={"E": Figure(3.1e9, 0.1e9), "nu": Figure(0.36, 0.01)},
        expansion={"alpha": Figure(6e-5)},
    )
    write_constituent(tmp_path / "epoxy.toml", resin)
    entry = constituent_of_file(tmp_path / "epoxy.toml")
    assert set(entry) == {"kind", "density", "E", "nu", "alpha"} and entry["nu"] == 0.36
    assert to_si(entry["E"], "pressure") == 3.1e9 and to_si(entry["alpha"], "thermal expansion") == 6e-5
    assert to_si(entry["density"], "density") == 1115.0


def test_a_sheet_is_no_constituent_of_a_cell(tmp_path: Path) -> None:
    sheet = Constituent(
        name="graphene",
        source="molecular dynamics",
        temperature=Figure(300.0),
        density=Figure(2300.0),
        kind="plane",
        elastic={
            "E1": Figure(9e11),
            "E2": Figure(9e11),
            "nu12": Figure(0.3),
            "G12": Figure(3.5e11),
            "thickness": Figure(3.35e-10),
        },
    )
    write_constituent(tmp_path / "sheet.toml", sheet)
    with pytest.raises(ValueError, match=r"sheet.toml: constituent.elastic.kind is 'plane'; a cell takes isotropic"):
        constituent_of_file(tmp_path / "sheet.toml")
