"""A service written from the specification alone, in the place of md_service: it must couple, and outlive the run."""

from __future__ import annotations

import ast
import json
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import msgpack
import numpy as np
import pytest
import zmq

PROGRAM = Path(__file__).with_name("foreign_atomistic.py")
APPLIED = np.array([0.005, 0.01])
# Statics of this very ring (a harmonic lattice in finite elements of equal constants, weight 0.2) leave the atoms up
# to 3.5 % behind the continuum: the ring is six atoms wide, and the lattice ends half a row from where the weight
# changes. The rest of the bound is the motion that is not yet damped out when the run ends, about 0.5 %.
BOUND = 0.05

SCENE = """
title = "A foreign lattice in its continuum"

[run]
steps = 600
output_every = 10
checkpoint_every = 300
seed = 1

[continuum]
backend = "mpm_service"
assumption = "plane_stress"
lower = ["-40 angstrom", "-40 angstrom"]
upper = ["40 angstrom", "40 angstrom"]
cell_size = "4 angstrom"
points_per_cell = 2
damping_rate = "10 1/ps"
initial_velocity = "follow_edges"

[[continuum.edges]]
edge = "left"
component = "x"
times = ["0 ps", "1 ps"]
displacements = ["0 angstrom", "-0.2 angstrom"]

[[continuum.edges]]
edge = "right"
component = "x"
times = ["0 ps", "1 ps"]
displacements = ["0 angstrom", "0.2 angstrom"]

[[continuum.edges]]
edge = "bottom"
component = "y"
times = ["0 ps", "1 ps"]
displacements = ["0 angstrom", "-0.4 angstrom"]

[[continuum.edges]]
edge = "top"
component = "y"
times = ["0 ps", "1 ps"]
displacements = ["0 angstrom", "0.4 angstrom"]

[atomistic]
backend = "foreign_lattice"
force_field = "harmonic"
material = "hexagonal"
width = "40 angstrom"
height = "41 angstrom"
temperature = "0 K"
time_step = "1 fs"
equilibration = "0.1 ps"
reference = "0.1 ps"

[handshake]
width = "12 angstrom"
weight = 0.2
steps_per_exchange = 4
ivc_size = "6 angstrom"
damping_time = "0.05 ps"
spread = "anchor"
"""

Arrays = dict[str, np.ndarray]


class RawClient:
    """A DEALER and msgpack: as foreign as the service."""

    def __init__(self, endpoint: str) -> None:
        self._context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
        self._socket = self._context.socket(zmq.DEALER)
        self._socket.connect(endpoint)
        self.count = 0

    def exchange(self, frames: list[bytes], seconds: int = 20) -> list[bytes]:
        self._socket.send_multipart(frames)
        assert self._socket.poll(1000 * seconds), "no reply"
        return self._socket.recv_multipart()

    def frames(self, kind: str, body: dict[str, Any], arrays: Arrays | None = None) -> list[bytes]:
        self.count += 1
        table, data = [], []
        for name, array in (arrays or {}).items():
            table.append({"name": name, "dtype": array.dtype.str, "shape": list(array.shape), "order": "C"})
            data.append(array.tobytes())
        header = {"protocol": [1, 0], "kind": "request", "type": kind, "id": f"{id(self)}-{self.count}"}
        return [msgpack.packb({**header, "body": body, "arrays": table}), *data]

    def send(self, kind: str, body: dict[str, Any], arrays: Arrays | None = None) -> tuple[str, dict[str, Any], Arrays]:
        header_frame, *data = self.exchange(self.frames(kind, body, arrays))
        header = msgpack.unpackb(header_frame)
        table = header["arrays"]
        answer = {e["name"]: np.frombuffer(f, e["dtype"]).reshape(e["shape"]) for e, f in zip(table, data, strict=True)}
        return header["kind"], header["body"], answer

    def ask(self, kind: str, body: dict[str, Any], arrays: Arrays | None = None) -> tuple[dict[str, Any], Arrays]:
        answered, reply, answer = self.send(kind, body, arrays)
        assert answered == "reply", reply
        return reply, answer

    def hello(self) -> dict[str, Any]:
        versions = {"oldest": [1, 0], "newest": [1, 0]}
        return self.ask("hello", {"versions": versions, "role": "atomistic", "client": "test"})[0]

    def close(self) -> None:
        self._context.destroy(linger=0)


@dataclass
class Running:
    endpoint: str
    process: subprocess.Popen[bytes]
    client: RawClient


@pytest.fixture
def service() -> Iterator[Running]:
    # An ipc path must be short; pytest's own folders can be too long for it.
    with tempfile.TemporaryDirectory() as folder:
        endpoint = f"ipc://{folder}/atoms"
        process = subprocess.Popen([sys.executable, str(PROGRAM), endpoint])
        client = RawClient(endpoint)
        try:
            client.hello()
            yield Running(endpoint, process, client)
        finally:
            client.close()
            if process.poll() is None:
                process.kill()
            process.wait()


def scalebridge(*words: str) -> subprocess.CompletedProcess[str]:
    program = str(Path(sys.executable).with_name("scalebridge"))
    return subprocess.run([program, *words], capture_output=True, text=True, timeout=120)


def ready(client: RawClient, temperature: float) -> tuple[int, np.ndarray]:
    """Configure, anchor the left quarter of the atoms, equilibrate; number of anchors, their positions."""
    sample = {"material": "hexagonal", "width": 2e-9, "height": 2e-9}
    body = {"force_field": "harmonic", "sample": sample, "temperature": temperature, "time_step": 1e-15, "seed": 7}
    _, built = client.ask("configure", body)
    tied = np.flatnonzero(built["position"][:, 0] < -0.5e-9)
    at = built["position"][tied].copy()
    anchors = {
        "atom_id": built["atom_id"][tied],
        "anchor_position": at,
        "anchor_ivc": (at[:, 1] > 0).astype(np.int64),
        "stiffness": np.full(len(tied), 20.0),
    }
    client.ask("register", {"damping_time": 1e-13}, anchors)
    client.ask("equilibrate", {"steps": 20, "windows": 4, "window_steps": 10})
    return len(tied), at


def test_the_foreign_service_shares_nothing_with_scalebridge() -> None:
    imported = set()
    for node in ast.walk(ast.parse(PROGRAM.read_text())):
        if isinstance(node, ast.Import):
            imported |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0
            imported.add(str(node.module).split(".")[0])
    assert imported - set(sys.stdlib_module_names) == {"zmq", "msgpack", "numpy"}


def test_a_coupled_run_carries_the_applied_strain_into_the_foreign_atoms(service: Running, tmp_path: Path) -> None:
    scene, folder = tmp_path / "foreign.toml", tmp_path / "run"
    scene.write_text(SCENE)
    attach = f"atomistic={service.endpoint}"
    finished = scalebridge("run", str(scene), "--out", str(folder), "--attach", attach)
    assert finished.returncode == 0, finished.stdout + finished.stderr

    summary = json.loads((folder / "summary.json").read_text())
    assert summary["status"] == "finished"
    assert summary["steps"] == 600
    assert summary["measures"]["force_balance_max"] < 1e-10

    with h5py.File(folder / "results.h5") as results:
        atoms = results["particles/atoms"]
        rest = atoms["reference_position"][:, :2]
        last = atoms["position/value"][-15:, :, :2]  # a quarter of the run
        unit = {"nm": 1e-9, "m": 1.0}[atoms["reference_position"].attrs["unit"]]
        inner = results["interface/inner"][:] / unit
    inside = np.all((rest > inner[0]) & (rest < inner[1]), axis=1)
    assert inside.sum() > 50
    plane = np.column_stack([rest[inside], np.ones(inside.sum())])
    gradient = np.mean([np.linalg.lstsq(plane, frame[inside] - rest[inside])[0][:2] for frame in last], axis=0)
    assert np.diag(gradient) == pytest.approx(APPLIED, rel=BOUND)
    assert gradient[0, 1] + gradient[1, 0] == pytest.approx(0.0, abs=BOUND * APPLIED.max())

    assert service.process.poll() is None, "the run stopped a service that it had not started"
    assert service.client.hello()["state"] == "ready"


def test_energy_of_the_foreign_atoms_changes_by_the_work_of_their_anchors(service: Running) -> None:
    anchors, at = ready(service.client, 0.0)
    total = []
    for shift in (1e-12, 3e-12, -2e-12, 4e-12):
        moved = {"anchor_position": at + np.array([shift, 0, 0]), "anchor_velocity": np.zeros((anchors, 3))}
        reply, arrays = service.client.ask("advance", {"steps": 50}, moved)
        total.append((reply["potential_energy"] + reply["kinetic_energy"], reply["anchor_work"]))
        force = arrays["anchor_force"]
        by_cell = [force[at[:, 1] <= 0].sum(axis=0), force[at[:, 1] > 0].sum(axis=0)]
        assert arrays["ivc_force"] == pytest.approx(np.array(by_cell), rel=1e-12, abs=1e-24)
    energy, work = np.array(total).T
    assert energy.max() > 1e-22
    # The Verlet energy of a step of 1 fs oscillates by (omega dt)^2 / 4, 0.5 % for the fastest mode.
    assert energy == pytest.approx(work, rel=5e-3, abs=5e-3 * energy.max())


def test_restored_foreign_atoms_answer_the_same_bits(service: Running) -> None:
    anchors, at = ready(service.client, 300.0)
    advance = {"anchor_position": at + 1e-12, "anchor_velocity": np.full((anchors, 3), 5.0)}
    service.client.ask("advance", {"steps": 30}, advance)
    kept, state = service.client.ask("checkpoint", {})
    first = service.client.ask("advance", {"steps": 30}, advance)
    ready(service.client, 300.0)
    service.client.ask("restore", {"step": kept["step"]}, state)
    again = service.client.ask("advance", {"steps": 30}, advance)
    assert again[0] == first[0]
    assert first[0]["temperature"] > 0
    assert {k: v.tobytes() for k, v in again[1].items()} == {k: v.tobytes() for k, v in first[1].items()}


def test_the_same_request_is_not_run_twice(service: Running) -> None:
    anchors, at = ready(service.client, 0.0)
    arrays = {"anchor_position": at, "anchor_velocity": np.zeros((anchors, 3))}
    before = service.client.ask("status", {})[0]["step"]
    request = service.client.frames("advance", {"steps": 10}, arrays)
    assert service.client.exchange(request) == service.client.exchange(request)
    assert service.client.ask("status", {})[0]["step"] == before + 10


def test_abort_from_the_control_socket_ends_an_advance_and_shutdown_the_process(service: Running) -> None:
    anchors, at = ready(service.client, 0.0)
    control = RawClient(service.client.hello()["control_endpoint"])
    arrays = {"anchor_position": at, "anchor_velocity": np.zeros((anchors, 3))}
    service.client._socket.send_multipart(service.client.frames("advance", {"steps": 10**9}, arrays))
    while control.ask("status", {})[0]["operation"] != "advance":
        pass
    assert control.ask("abort", {})[0]["operation"] == "advance"
    assert service.client._socket.poll(5000)
    header = msgpack.unpackb(service.client._socket.recv_multipart()[0])
    assert (header["kind"], header["body"]["code"]) == ("error", "aborted")
    assert control.ask("status", {})[0]["state"] == "failed"
    kind, error, _ = service.client.send("advance", {"steps": 1}, arrays)
    assert (kind, error["code"]) == ("error", "wrong_state")
    control.ask("shutdown", {})
    control.close()
    assert service.process.wait(timeout=10) == 0


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"force_field": "airebo"}, "force_field"),
        ({"sample": {"material": "hexagonal", "width": -1.0, "height": 1e-9}}, "sample.width"),
        ({"temperature": None}, "temperature"),
        ({"time_step": "1 fs"}, "time_step"),
        ({"seed": 1.0}, "seed"),
    ],
)
def test_a_wrong_field_is_named_and_leaves_the_service_as_it_was(
    service: Running, change: dict[str, Any], field: str
) -> None:
    sample = {"material": "hexagonal", "width": 1e-9, "height": 1e-9}
    body = {"force_field": "harmonic", "sample": sample, "temperature": 0.0, "time_step": 1e-15, "seed": 1}
    kind, error, _ = service.client.send("configure", body | change)
    assert (kind, error["code"], error["field"]) == ("error", "bad_field", field)
    assert service.client.hello()["state"] == "new"


def test_the_foreign_service_keeps_the_contract(service: Running) -> None:
    finished = scalebridge("conformance", service.endpoint)
    assert finished.returncode == 0, finished.stdout
    assert re.search(r"(\d+) checks, 0 failed", finished.stdout)
    assert "checkpoint: a problem set anew goes on with the same bits" in finished.stdout
