"""One run of a scene, from its file to its report: the command `run`."""

from __future__ import annotations

import contextlib
import shlex
import time
import uuid
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from coordinator.checkpoint import CheckpointError, read_checkpoint, write_checkpoint
from coordinator.coupling import Coupling, StepRecord
from coordinator.display_units import units_of
from coordinator.interruption import Interrupted, Interruption
from coordinator.laminate_material import laminate_of, plain_cell, read_cell
from coordinator.launcher import ServiceDied, Services
from coordinator.output import RunOutput
from coordinator.scene import Scene, load_scene
from coordinator.summary import Status as SummaryStatus
from coordinator.units import LENGTHS, readable
from protocol.atomistic import Properties
from protocol.backend import find
from protocol.client import Client
from protocol.errors import ConnectionProblem, ProtocolError
from protocol.messages import Acknowledged, Status

#: Exit status after Ctrl-C, as shells have it.
INTERRUPTED_STATUS = 130
#: Name of the service that the continuum asks, and the coordinator does not.
MICROMECHANICS = "micromechanics"
#: Seconds between two looks at the progress of a long operation.
STATUS_EVERY = 0.5
#: What may end a run before its end; anything else is a fault of this program.
ENDINGS = (Interrupted, ServiceDied, ConnectionProblem, ProtocolError)


class RunError(Exception):
    """The run cannot start, or what it was asked for contradicts what is in its folder."""


class Ending(NamedTuple):
    """How a run ended: for programs, for people, and the exit status."""

    status: SummaryStatus
    sentence: str
    code: int

    def tell(self, console: Console) -> None:
        """Print the sentence, unwrapped: a command in it is there to be copied."""
        style = "bold red" if self.status == "failed" else "bold"
        console.print(self.sentence, style=style, markup=False, highlight=False, soft_wrap=True)


def run_scene(
    scene_path: Path,
    folder: Path,
    *,
    resume: bool = False,
    overrides: Sequence[str] = (),
    attached: dict[str, str] | None = None,
    keys: Path | None = None,
    console: Console | None = None,
) -> int:
    """Run a scene and return the exit status.

    Parameters
    ----------
    scene_path, folder : Path
        Scene file, and folder of the run.
    resume : bool
        Go on from the last checkpoint in the folder, or start anew where there is none yet.
    overrides : sequence of str
        ``key=value`` changes of the scene.
    attached : dict of str to str
        Endpoints of services that run already, by role.
    keys : Path, optional
        Folder with keys for attached services.

    Raises
    ------
    SceneError, BackendError, RunError, CheckpointError, ValueError
        Before anything has started; the last for mistakes in a cell file.
    """
    scene = load_scene(scene_path, overrides)
    for wanted in _wanted(scene):
        if wanted.name not in (attached or {}):
            find(wanted.role, wanted.backend).launch_words(wanted.ranks)
    run = Run(
        scene,
        folder,
        attached or {},
        keys,
        console or Console(stderr=True),
        command_line(scene_path, folder, overrides, attached or {}, keys),
    )
    if resume:
        run.load_checkpoint()
    else:
        set_aside(folder)
    return run.execute()


def command_line(
    scene_path: Path, folder: Path, overrides: Sequence[str], attached: dict[str, str], keys: Path | None
) -> str:
    """Return the command that repeats a run."""
    words = ["scalebridge", "run", str(scene_path), "--out", str(folder)]
    for override in overrides:
        words += ["--set", override]
    for role, endpoint in attached.items():
        words += ["--attach", f"{role}={endpoint}"]
    if keys is not None:
        words += ["--keys", str(keys)]
    return shlex.join(words)


class Wanted(NamedTuple):
    """A service that a scene needs; its name is its role, or the region of atoms that it has."""

    name: str
    role: str
    backend: str
    ranks: int = 1
    workers: int = 1


def _wanted(scene: Scene) -> list[Wanted]:
    """Return the services that a scene needs."""
    wanted = [Wanted("continuum", "continuum", scene.continuum.backend)]
    cells = scene.micromechanics
    if cells is not None:
        wanted.append(Wanted(MICROMECHANICS, "micromechanics", cells.backend, workers=cells.workers))
    if scene.atomistic is not None:
        atoms = scene.atomistic
        wanted += [Wanted(place.name, "atomistic", atoms.backend, atoms.ranks) for place in scene.places]
    return wanted


def set_aside(folder: Path) -> None:
    """Rename the folder of an earlier run to the first free `NAME-1`, `NAME-2`, ...: nothing is lost."""
    if not folder.exists() or not any(folder.iterdir()):
        return
    number = 1
    while (kept := folder.with_name(f"{folder.name}-{number}")).exists():
        number += 1
    folder.rename(kept)


class Run:
    """One run of a scene in a folder."""

    def __init__(
        self,
        scene: Scene,
        folder: Path,
        attached: dict[str, str],
        keys: Path | None,
        console: Console,
        command: str,
    ) -> None:
        names = [wanted.name for wanted in _wanted(scene)]
        unknown = set(attached) - set(names)
        if unknown:
            raise RunError(f"--attach {unknown.pop()}: this scene has the services {' and '.join(names)}")
        self.scene = scene
        self.folder = folder
        self._attached = attached
        self._keys = keys
        self._console = console
        self._command = command
        self._cell = read_cell(scene)
        self._checkpoint: tuple[dict[str, Any], dict[str, Any]] | None = None
        self._state_step = -1

    def load_checkpoint(self) -> None:
        """Read the checkpoint of the folder and hold it against the scene.

        Raises
        ------
        RunError
            Where the scene differs from the one that the checkpoint was made with.
        CheckpointError
            Where the file is damaged.
        """
        try:
            header, state = read_checkpoint(self.folder)
        except CheckpointError as error:
            if (self.folder / "checkpoint.npz").exists():
                raise
            self._console.print(f"{error}: the run starts anew")
            return
        changed = differences(header["scene"], self.scene.model_dump(mode="json"))
        changed -= {"run.steps", "run.stop_after_crack_growth"}
        if changed:
            raise RunError(
                f"the scene differs from that of the checkpoint in {', '.join(sorted(changed))}; only run.steps and "
                "run.stop_after_crack_growth may change on --resume"
            )
        if self._cell is not None:
            changed = differences(header["cell"], plain_cell(self._cell))
            if changed:
                raise RunError(
                    f"the cell file differs from what the checkpoint was made with in {', '.join(sorted(changed))}"
                )
        self._checkpoint = header, state

    def execute(self) -> int:
        """Run to the end, to the first failure, or to Ctrl-C; return the exit status."""
        self.folder.mkdir(parents=True, exist_ok=True)
        run_id = uuid.uuid4().hex[:12]
        resumed_at = self._checkpoint[0]["step"] if self._checkpoint else None
        output = RunOutput(self.folder, self.scene, resumed_at, self._command)
        services = Services(self.folder, run_id)
        began = time.perf_counter()
        end = Ending("finished", "", 0)
        with Interruption() as interruption:
            try:
                self._run(services, output, interruption)
            except ENDINGS as error:
                kept = f"results up to step {output.step} are in {self.folder}" if self._state_step >= 0 else ""
                end = ending(error, services, f"coupling step {output.step}", kept, self._command)
            except BaseException as error:
                sentence = f"failed after coupling step {output.step}: {str(error) or type(error).__name__}"
                end = Ending("failed", sentence, 1)
                raise
            finally:
                timing = {role: client.timing for role, client in _driven(services).items()}
                services.stop()
                output.close(end.status, end.sentence, time.perf_counter() - began, timing)
        if end.sentence:
            end.tell(self._console)
        if end.status != "interrupted":
            report = output.write_report()
            if report is not None:
                self._console.print(f"report: {report}", markup=False, soft_wrap=True)
        return end.code

    # --- the run itself ----------------------------------------------------------------------------------

    def _run(self, services: Services, output: RunOutput, interruption: Interruption) -> None:
        with progress_bar(self._console) as progress:
            task = progress.add_task("start services", total=None)

            def tell(text: str) -> None:
                if interruption.wanted:
                    raise Interrupted
                progress.update(task, description=text, total=None, completed=0)

            coupling = self._prepare(services, output, interruption, progress, task, tell)
            progress.reset(task, description="coupled run", total=self.scene.run.steps, completed=coupling.step)
            self._loop(coupling, services, output, interruption, lambda text: progress.update(
                task, completed=coupling.step, description=text))  # fmt: skip

    def _prepare(
        self,
        services: Services,
        output: RunOutput,
        interruption: Interruption,
        progress: Progress,
        task: Any,
        tell: Callable[[str], None],
    ) -> Coupling:
        """Start and connect services, build both models, equilibrate or restore."""
        self._start(services, interruption)
        watch = _Watch(services, interruption, lambda done, total: progress.update(task, total=total, completed=done))
        driven = _driven(services)
        for role, client in driven.items():
            client.watch_with(lambda role=role: watch(role))  # type: ignore[misc]
        header = self._checkpoint[0] if self._checkpoint else None
        coupling = Coupling(
            self.scene, driven.pop("continuum"), driven,
            Properties.model_validate(header["properties"]) if header and header["properties"] else None,
            header["steps_per_exchange"] if header else None, tell,
            None if self._cell is None else laminate_of(self.scene, self._cell, self._endpoint(services)),
        )  # fmt: skip
        watch.abortable = True
        try:
            coupling.configure()
            if self._checkpoint is None:
                coupling.equilibrate()
        except ProtocolError as error:
            if error.code == "aborted" and interruption.wanted:
                raise Interrupted from None
            raise
        watch.abortable = False
        output.scene = coupling.scene  # with M as chosen
        if interruption.wanted:
            raise Interrupted
        output.begin(coupling)
        if self._checkpoint is not None:
            coupling.restore(self._checkpoint[1])
            self._state_step = coupling.step
        else:
            output.frames(coupling)
            self._save(coupling, output)
        return coupling

    def _endpoint(self, services: Services) -> str:
        """Where the continuum finds the microstructure of its plies."""
        started = services.processes.get(MICROMECHANICS)
        return self._attached[MICROMECHANICS] if started is None else started.endpoint

    def _start(self, services: Services, interruption: Interruption) -> None:
        """Start what the scene needs and is not attached; wait until each answers."""

        def watch() -> None:
            services.check()
            if interruption.wanted:
                raise Interrupted

        wanted = _wanted(self.scene)
        for one in wanted:
            if one.name not in self._attached:
                keys = self._keys if one.role == "continuum" and self._cell is not None else None
                services.start(one.name, one.role, one.backend, one.ranks, one.workers, keys)
        for one in wanted:
            if one.name in self._attached:
                services.attach(one.name, one.role, self._attached[one.name], self._keys, watch)
            else:
                services.connect(one.name, watch)

    def _loop(
        self,
        coupling: Coupling,
        services: Services,
        output: RunOutput,
        interruption: Interruption,
        show: Callable[[str], None],
    ) -> None:
        scene = self.scene
        # A step's time counts from the end of the last one, so frames and checkpoints are in it.
        ended_at, computed_before = time.perf_counter(), _computing(services)
        while coupling.step < scene.run.steps:
            record = coupling.advance()
            now, computed = time.perf_counter(), _computing(services)
            spent = {role: seconds - computed_before[role] for role, seconds in computed.items()}
            output.row(coupling, record, spent, now - ended_at)
            ended_at, computed_before = now, computed
            grown = coupling.crack_growth(record)
            stop_after = scene.run.stop_after_crack_growth
            # A crack grows by steps whose sum may miss the stated growth by round-off.
            ended = stop_after is not None and grown >= stop_after * (1.0 - 1e-9)
            if coupling.step % scene.run.output_every == 0 or ended:
                output.frames(coupling)
            if ended:
                output.note(f"the crack grew by {readable(grown, LENGTHS, 4)}")
                break
            if coupling.step % 10 == 0 or coupling.step == scene.run.steps:
                show(_progress_text(coupling, record))
            if interruption.wanted:
                self._save(coupling, output)
                raise Interrupted
            if coupling.step % scene.run.checkpoint_every == 0:
                self._save(coupling, output)
        if self._state_step != coupling.step:
            self._save(coupling, output)

    def _save(self, coupling: Coupling, output: RunOutput) -> None:
        """Commit results, then the checkpoint: a kill between the two leaves results that resume cuts back."""
        state = coupling.state()
        output.flush()
        header = {
            "step": coupling.step,
            "scene": self.scene.model_dump(mode="json"),
            "properties": coupling.properties.model_dump() if coupling.properties else None,
            "steps_per_exchange": coupling.scene.handshake.steps_per_exchange if coupling.scene.handshake else None,
            "cell": None if self._cell is None else plain_cell(self._cell),
        }
        write_checkpoint(self.folder, header, state)
        self._state_step = coupling.step


class _Watch:
    """Called while a client waits: looks at the processes, at Ctrl-C, and at the progress of long operations."""

    def __init__(self, services: Services, interruption: Interruption, show: Callable[[float, float], None]) -> None:
        self.abortable = False
        self._services = services
        self._interruption = interruption
        self._show = show
        self._last = time.monotonic()

    def __call__(self, role: str) -> None:
        self._services.check()
        now = time.monotonic()
        if not self.abortable or now - self._last < STATUS_EVERY:
            return
        self._last = now
        control: Client = self._services.clients[role].control
        with contextlib.suppress(ConnectionProblem):
            if self._interruption.wanted:
                # Again at each look: a request that met an operation at its end is forgotten by the next one.
                control.call("abort", None, Acknowledged)
            status = control.call("status", None, Status, deadline=1.0)
            if status.total:
                self._show(status.done, status.total)


def _driven(services: Services) -> dict[str, Client]:
    """Return the clients of the services that the coordinator drives."""
    return {name: client for name, client in services.clients.items() if name != MICROMECHANICS}


def _computing(services: Services) -> dict[str, float]:
    return {role: client.timing.computing for role, client in _driven(services).items()}


def ending(error: Exception, services: Services, done: str, kept: str, command: str) -> Ending:
    """Return how one of `ENDINGS` ended a run.

    Parameters
    ----------
    error : Exception
    services : Services
    done : str
        The last thing that was done, such as "coupling step 7".
    kept : str
        What is left to go on from, in a sentence; empty if there is nothing.
    command : str
        Command that repeats the run.
    """
    if isinstance(error, Interrupted):
        return Ending("interrupted", f"stopped; go on with: {command} --resume", INTERRUPTED_STATUS)
    sentence = f"failed after {done}: {guilty(error, services)}"
    if kept:
        sentence += f"\n{kept}"
        # A solver that failed would fail again: a run goes on exactly as before.
        if not isinstance(error, ProtocolError):
            sentence += f"; go on with: {command} --resume"
    return Ending("failed", sentence, 1)


def guilty(error: Exception, services: Services) -> str:
    """Return the failure in words; a dead process is named before the error that its end caused elsewhere."""
    if isinstance(error, ConnectionProblem):
        # The link breaks a moment before the process can be seen as ended.
        for _ in range(20):
            try:
                services.check()
            except ServiceDied as died:
                return str(died)
            time.sleep(0.05)
    if isinstance(error, ProtocolError) and error.report.traceback_tail:
        return f"{error}\n{error.report.traceback_tail}"
    return str(error)


def differences(one: Any, other: Any, path: str = "") -> set[str]:
    """Return the paths at which two trees of plain values differ."""
    if isinstance(one, dict) and isinstance(other, dict):
        found: set[str] = set()
        for key in one.keys() | other.keys():
            found |= differences(one.get(key), other.get(key), f"{path}.{key}" if path else key)
        return found
    return set() if one == other else {path}


def progress_bar(console: Console) -> Progress:
    return Progress(
        TextColumn("{task.description}"), BarColumn(bar_width=12), TextColumn("{task.percentage:>3.0f} %"),
        TimeRemainingColumn(compact=True), console=console,
    )  # fmt: skip


def _progress_text(coupling: Coupling, record: StepRecord) -> str:
    values, scene = record.values, coupling.scene
    size, name = units_of(scene).time
    parts = [f"{coupling.step * scene.time_step / size:.2f} {name}"]
    if "applied_strain" in values:
        parts.append(f"strain {values['applied_strain'] * 100:.2f} %")
    if "temperature" in values:
        parts.append(f"{values['temperature']:.0f} K")
    if any(name.startswith("crack_tip") for name in values):
        parts.append(f"tip +{coupling.crack_growth(record) * 1e10:.0f} A")
    return ", ".join(parts)
