"""What the guide of the atoms shows as code runs."""

import re
from pathlib import Path

import numpy as np
import pytest

GUIDE = Path(__file__).resolve().parents[2] / "docs" / "atoms.md"


def test_examples_of_the_guide_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    coupled, samples = re.findall(r"```python\n(.*?)```", GUIDE.read_text(), flags=re.DOTALL)
    names: dict[str, object] = {}
    exec(coupled, names)
    left, right = names["pulled"].ivc_force[:, 0]  # type: ignore[attr-defined]
    assert left > 0.0 > right  # the sheet pulls its sides together
    assert capsys.readouterr().out.endswith("N\n")
    exec(samples, names)
    read = names["atoms"]
    np.testing.assert_array_equal(read.position, names["sheet"].position)  # type: ignore[attr-defined]
