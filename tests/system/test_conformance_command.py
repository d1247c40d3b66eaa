"""The command `conformance` on the real services, at the default limit of a message."""

import subprocess
import sys
import time
from pathlib import Path

import pytest

SCALEBRIDGE = str(Path(sys.executable).parent / "scalebridge")


@pytest.mark.parametrize("role", ["continuum", "atomistic", "micromechanics"])
def test_real_services_hold_their_contract(role: str, tmp_path: Path) -> None:
    endpoint = f"ipc://{tmp_path / 's'}"
    log = tmp_path / "log.txt"
    with log.open("wb") as file:
        service = subprocess.Popen(
            [SCALEBRIDGE, "serve", role, "--bind", endpoint, "--folder", str(tmp_path)], stdout=file, stderr=file
        )
    try:
        deadline = time.monotonic() + 60
        while "listens at" not in log.read_text():
            assert service.poll() is None and time.monotonic() < deadline, log.read_text()
            time.sleep(0.1)
        held = subprocess.run(
            [SCALEBRIDGE, "conformance", endpoint, "--shutdown"],
            capture_output=True,
            text=True,
            timeout=200,
            check=False,
        )
        assert held.returncode == 0, held.stdout
        # The check of the size limit would need a message beyond 1 GiB.
        assert "0 failed, 1 not tried" in held.stdout
        assert service.wait(20) == 0
    finally:
        service.kill()
        service.wait(10)
