"""What the guide of laminates shows as code runs."""

import re
from pathlib import Path

import pytest

GUIDE = Path(__file__).resolve().parents[2] / "docs" / "laminates.md"


def test_example_of_the_guide_runs(capsys: pytest.CaptureFixture[str]) -> None:
    # The guide's other code needs gmsh, which only its reader may have.
    blocks = re.findall(r"```python\n(.*?)```", GUIDE.read_text(), flags=re.DOTALL)
    (example,) = (block for block in blocks if "import gmsh" not in block)
    exec(example, {})
    # Kirsch: three times at the edge of the hole, of which the points lie half an element inside.
    assert 2.4 < float(capsys.readouterr().out.split()[0]) < 3.1
