import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

MPIEXEC = Path(sys.prefix) / "bin" / "mpiexec"

SCRIPT = """
import sys
import numpy as np
from md_service.elastic_constants import measure_graphene
from md_service.errors import EngineError
from md_service.force_fields import force_field
from md_service.atoms import CrackCut
from md_service.graphene import graphene
from md_service.parallel import ParallelEngine, follow
from md_service.ranks import MpiRanks

ranks = MpiRanks()
if ranks.rank > 0:
    follow(ranks)
    sys.exit(0)
folder, output = sys.argv[1:]
crack = CrackCut(0.0)
profile = force_field("airebo")
atoms = graphene(30e-10, 30e-10, spacing=profile.lattice_constant, crack=crack)
x = atoms.position
ids = np.flatnonzero(np.abs(x[:, :2]).max(axis=1) > 9e-10)
ivc = (x[ids, 0] > 0).astype(np.int64)
young = measure_graphene("tersoff", 0.0, folder).young
engine = ParallelEngine(ranks, folder, profile, atoms, temperature=0.0, seed=1, time_step=profile.time_step)
engine.register_anchors(ids, x[ids], np.full(len(ids), 30.0), ivc, 4e-14)
told = []
engine.measure_reference(8, 10, progress=lambda done, total: told.append(done))
engine.collect_fields(True)
for i in range(8):
    engine.advance(10, x[ids] * (1 + 1e-3 * i), x[ids] * 1e-3 / 5e-15)
fields = engine.fields(["position", "velocity", "stress", "mean_position"])
state = engine.state()
a = engine.advance(10, x[ids] * 1.01, 0 * x[ids])
engine.restore(state)
b = engine.advance(10, x[ids] * 1.01, 0 * x[ids])
assert np.array_equal(a.anchor_force, b.anchor_force)
try:
    engine.advance(0, x[ids], x[ids])
    raise SystemExit("no error")
except ValueError as error:
    assert "window is 0" in str(error)
def stop(done, total):
    raise EngineError("user stop")
try:
    engine.measure_reference(8, 10, progress=stop)
    raise SystemExit("no stop")
except EngineError as error:
    assert "user stop" in str(error)
last = engine.advance(10, x[ids] * 1.01, 0 * x[ids])
energies = [last.potential_energy, last.kinetic_energy, last.spring_energy, last.anchor_work, last.temperature]
assert told == list(range(1, 9))
np.savez(output, force=a.anchor_force, error=a.ivc_standard_error, last=last.anchor_force, energies=energies,
         young=young, size=ranks.size, **fields)
"""


@pytest.mark.skipif(not MPIEXEC.exists(), reason="mpiexec of the mpich wheel is not installed")
def test_two_ranks_answer_as_one(tmp_path):
    script = tmp_path / "run.py"
    script.write_text(SCRIPT)
    answers = []
    for ranks in (1, 2):
        output = tmp_path / f"answer{ranks}.npz"
        command = [MPIEXEC, "-n", str(ranks), sys.executable, script, tmp_path / f"work{ranks}", output]
        done = subprocess.run([str(word) for word in command], capture_output=True, text=True, timeout=120)
        assert done.returncode == 0, done.stdout + done.stderr
        answers.append(dict(np.load(output)))
    one, two = answers
    assert (one.pop("size"), two.pop("size")) == (1, 2)
    for name, value in one.items():
        np.testing.assert_allclose(two[name], value, atol=1e-10 * np.abs(value).max(), err_msg=name)
