"""Reading a scene needs no solver, no file formats and nothing of the wire."""

from __future__ import annotations

import subprocess
import sys


def test_import_is_light() -> None:
    code = (
        "import sys, coordinator.scene; "
        "print([m for m in ('pint', 'numpy', 'matplotlib', 'h5py', 'zmq', 'msgpack', 'protocol.messages') "
        "if m in sys.modules])"
    )
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert out.stdout.strip() == "[]"
