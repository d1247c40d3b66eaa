"""Constituent files: written, read, refused."""

import tomllib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from protocol.constituent import KINDS, Constituent, Figure, Strength, read_constituent, write_constituent

EPOXY = {
    "name": "epoxy",
    "source": "molecular dynamics",
    "temperature": Figure(300.0),
    "density": Figure(1191.0, 3.0),
    "kind": "isotropic",
    "elastic": {"E": Figure(3.1e9, 1e8), "nu": Figure(0.36, 0.01)},
}


def test_what_is_written_is_read(tmp_path):
    written = Constituent(
        **EPOXY,
        expansion={"alpha": Figure(6e-5, 4e-6)},
        strength=Strength(Figure(1.2e8, 5e6), Figure(0.08), Figure(1e9), passed=True),
        provenance={"force_field": "opls-aa", "seed": 3, "command": "a 'b' \"c\"\n\\", "odd key": 0.25, "done": True},
    )
    write_constituent(tmp_path / "epoxy.toml", written)
    assert read_constituent(tmp_path / "epoxy.toml") == written


@settings(max_examples=30, deadline=None)
@given(
    kind=st.sampled_from(sorted(KINDS)),
    values=st.lists(st.floats(0.5, 2.0), min_size=9, max_size=9),
    error=st.none() | st.floats(0.0, 1e9),
    name=st.text(st.characters(exclude_categories=["Cs"]), min_size=1),
)
def test_every_kind_goes_through_the_file(tmp_path_factory, kind, values, error, name):
    scale = {"Pa": 1e10, "1": 0.1, "m": 3e-10}
    elastic = {
        key: Figure(float(f"{value * scale[unit]:.6g}"), error if error is None else float(f"{error:.6g}"))
        for (key, unit), value in zip(KINDS[kind].items(), values, strict=False)
    }
    written = Constituent(name, "test", Figure(0.0), Figure(1e3), kind, elastic)
    path = tmp_path_factory.mktemp("constituent") / "material.toml"
    write_constituent(path, written)
    assert read_constituent(path) == written
    np.testing.assert_allclose(written.compliance() @ written.stiffness(), np.eye(len(written.stiffness())), atol=1e-9)


def test_isotropic_compliance_is_hookes():
    inverse = Constituent(**EPOXY).compliance()
    assert inverse[0, 0] == pytest.approx(1 / 3.1e9)
    assert inverse[0, 1] == inverse[1, 2] == pytest.approx(-0.36 / 3.1e9)
    assert inverse[3, 3] == pytest.approx(2 * 1.36 / 3.1e9)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('format = "scalebridge constituent"', 'format = "x"', "format is 'x'"),
        ("version = 1", "version = 2", "version is 2"),
        ('kind = "isotropic"', 'kind = "cubic"', "elastic.kind is 'cubic'; it must be one of isotropic"),
        ("E = {", "Y = {", "elastic.E is missing"),
        ("nu = {", "G12 = { value = 1e9, unit = \"Pa\" }\nnu = {", "elastic.G12 is unknown; known are E, nu"),
        ("value = 0.36", "value = 0.5", "no stable material"),
        ("value = 0.36", "value = -1.0", "no stable material"),
        ("value = 3100000000.0", "value = -3e9", "elastic.E is -3000000000.0; it must be positive"),
        ("value = 3100000000.0", "value = nan", "elastic.E is nan; it must be finite"),
        ("error = 100000000.0", "error = -1.0", "elastic.E.error is -1.0"),
        ('unit = "Pa"', 'unit = "GPa"', "elastic.E.unit is 'GPa'; it must be 'Pa'"),
        ('{ value = 1191.0, error = 3.0, unit = "kg/m^3" }', "1191", "density is 1191; it must be a table such as"),
        ("value = 1191.0", 'value = "heavy"', "density.value is 'heavy'; it must be a number"),
        ("value = 300.0", "value = -1.0", "temperature is -1.0 K"),
        ('name = "epoxy"', "name = 3", "constituent.name is 3"),
        ("[constituent.elastic]", "[constituent.strength]\n[constituent.elastic]", "strength.tension is missing"),
        ("[constituent]", "[constituent", "Expected ']'"),
    ],
)  # fmt: skip
def test_bad_files_name_the_field(tmp_path, old, new, message):
    path = tmp_path / "epoxy.toml"
    write_constituent(path, Constituent(**EPOXY))
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(ValueError) as caught:
        read_constituent(path)
    assert str(path) in str(caught.value)
    assert message in str(caught.value)


def test_the_example_of_the_documentation_is_one(tmp_path):
    """The file in the module's docstring, which the user guide repeats, is read."""
    from protocol import constituent

    text = constituent.__doc__.split("::\n", 1)[1].split("\nAxis 1", 1)[0]
    lines = [line[4:] for line in text.splitlines()]
    path = tmp_path / "example.toml"
    path.write_text("\n".join(lines))
    assert tomllib.loads(path.read_text())["version"] == 1
    example = read_constituent(path)
    assert example.elastic["nu"] == Figure(0.36, 0.01)
    assert example.strength is not None and example.strength.passed
