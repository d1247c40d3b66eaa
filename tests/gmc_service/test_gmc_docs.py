"""What the guide of the microstructure shows as code, cell file and commands runs."""

import re
import shlex
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from gmc_service.cell_file import read_cell
from gmc_service.commands import micro

ROOT = Path(__file__).resolve().parents[2]
GUIDE = ROOT / "docs" / "micromechanics.md"


@pytest.fixture(autouse=True)
def checkout(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "scenes").symlink_to(ROOT / "scenes")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_examples_of_the_guide_run(capsys: pytest.CaptureFixture[str]) -> None:
    library, service = re.findall(r"```python\n(.*?)```", GUIDE.read_text(), flags=re.DOTALL)
    exec(library, {})
    largest, tangents = re.fullmatch(r"([\d.]+) MPa; (\d+) different tangents\n", capsys.readouterr().out).groups()  # type: ignore[union-attr]
    # Strain 22 alone stretches the matrix between the fibres; its strength bounds the stress of the cell.
    assert 50.0 < float(largest) < 250.0 and int(tangents) > 1
    names: dict[str, object] = {}
    exec(service, names)
    answer = names["answer"]
    assert np.ptp(answer.stress, axis=0).max() == 0.0  # type: ignore[attr-defined]


def test_cell_file_of_the_guide_is_read(checkout: Path) -> None:
    (text,) = re.findall(r"```toml\n(.*?)```", GUIDE.read_text(), flags=re.DOTALL)
    given = text.replace('from_file = "epoxy.toml"', 'kind = "isotropic"\nE = "3 GPa"\nnu = 0.35')
    (checkout / "cell.toml").write_text(given)
    cell = read_cell(checkout / "cell.toml")
    assert cell.subcells == 26 * 26
    assert cell.phase_fractions()[0] == pytest.approx(0.6, abs=1e-12)


def test_commands_of_the_guide_are_there() -> None:
    blocks = "".join(re.findall(r"```\n(scalebridge micro.*?)```", GUIDE.read_text(), flags=re.DOTALL))
    commands = [shlex.split(re.split(r"\s{2,}", line)[0]) for line in blocks.splitlines()]
    assert len(commands) == 5
    for words in commands:
        done = CliRunner().invoke(micro, [words[2], "--help"])
        assert done.exit_code == 0 and all(word in done.output for word in words[3:] if word.startswith("--")), words
