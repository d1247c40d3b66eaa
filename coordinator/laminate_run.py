"""One run of a laminate scene, from its file to its report."""

from __future__ import annotations

import json
import time
import uuid
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from coordinator.checkpoint import CheckpointError, read_checkpoint, write_checkpoint
from coordinator.interruption import Interrupted, Interruption
from coordinator.laminate_report import make_laminate_report
from coordinator.laminate_request import configure_request
from coordinator.laminate_results import SERIES, Frame, LaminateResults
from coordinator.laminate_scene import LaminateScene, load_laminate
from coordinator.launcher import Services
from coordinator.output import versions
from coordinator.run import (
    ENDINGS,
    Ending,
    RunError,
    command_line,
    differences,
    ending,
    progress_bar,
    set_aside,
)
from coordinator.summary import Summary, WallTime
from coordinator.watched_places import WatchedPlaces
from protocol import structure as s
from protocol.backend import find
from protocol.client import Client, Timing
from protocol.messages import CheckpointReply, FieldsReply, FieldsRequest, Restored, RestoreRequest
from protocol.micromechanics import RegisterCell

FIELDS = ["displacement", "stress", "failed"]
_UNITS = {
    "peak_stress": "Pa", "strain_at_peak": "1", "first_failure_strain": "1", "first_failure_stress": "Pa",
    "initial_stiffness": "Pa", "failed_points": "1", "queries_spared": "1", "residual_max": "1",
    "work": "J", "viscous_share": "1",
}  # fmt: skip


def run_laminate(
    scene_path: Path,
    folder: Path,
    *,
    resume: bool = False,
    overrides: Sequence[str] = (),
    attached: dict[str, str] | None = None,
    keys: Path | None = None,
    console: Console | None = None,
) -> int:
    """Run a laminate scene and return the exit status; arguments are those of `coordinator.run.run_scene`."""
    run = LaminateRun(
        load_laminate(scene_path, overrides),
        folder,
        command_line(scene_path, folder, overrides, attached or {}, keys),
        resume=resume,
        attached=attached or {},
        keys=keys,
        console=console or Console(stderr=True),
    )
    return run.execute()


class LaminateRun:
    """One run of a laminate scene in a folder.

    Parameters
    ----------
    scene : LaminateScene
    folder : Path
    command : str
        Command that repeats the run.
    resume : bool
        Go on from the checkpoint of the folder, or start anew where there is none.
    attached : dict of str to str
        Endpoints of services that run already, by role.
    keys : Path, optional
    console : Console

    Raises
    ------
    RunError
        Where the scene differs from that of the checkpoint, or a role is attached that the scene does not have.
    CheckpointError
        Where the checkpoint is damaged.
    ValueError
        Where the cell file has mistakes.
    """

    def __init__(
        self,
        scene: LaminateScene,
        folder: Path,
        command: str,
        *,
        resume: bool,
        attached: dict[str, str],
        keys: Path | None,
        console: Console,
    ) -> None:
        self.scene, self.folder, self._command, self._console = scene, folder, command, console
        self._attached, self._keys = attached, keys
        roles = {"micromechanics": scene.micromechanics.backend, "structure": scene.structure.backend}
        unknown = set(attached) - set(roles)
        if unknown:
            raise RunError(f"--attach {unknown.pop()}: this scene has the services {' and '.join(roles)}")
        for role, backend in roles.items():
            if role not in attached:
                find(role, backend)
        self._cell: RegisterCell = find("micromechanics", scene.micromechanics.backend).read_cell(scene.cell_file)
        self._checkpoint: tuple[dict[str, Any], dict[str, np.ndarray]] | None = None
        if resume:
            self._load_checkpoint()
        if self._checkpoint is None and not resume:
            set_aside(folder)
        self._results: LaminateResults | None = None

    def execute(self) -> int:
        """Run to the end, to the first failure, or to Ctrl-C; return the exit status."""
        self.folder.mkdir(parents=True, exist_ok=True)
        services = Services(self.folder, uuid.uuid4().hex[:12])
        began = time.perf_counter()
        with Interruption() as interruption:
            try:
                end = Ending("finished", self._run(services, interruption), 0)
            except ENDINGS as error:
                kept = f"results up to increment {self._done} are in {self.folder}" if self._done else ""
                end = ending(error, services, f"increment {self._done}", kept, self._command)
            except BaseException as error:
                sentence = f"failed after increment {self._done}: {str(error) or type(error).__name__}"
                end = Ending("failed", sentence, 1)
                raise
            finally:
                timing = {role: client.timing for role, client in services.clients.items()}
                services.stop()
                if self._results is not None:
                    self._close(self._results, end, time.perf_counter() - began, timing)
        end.tell(self._console)
        if self._results is not None and end.status != "interrupted":
            report = make_laminate_report(self.folder)
            self._console.print(f"report: {report}", markup=False, soft_wrap=True)
        return end.code

    def _close(self, results: LaminateResults, end: Ending, seconds: float, timing: dict[str, Timing]) -> None:
        results.write(self.folder / "results.h5")
        walls = {
            role: WallTime(computing=one.computing, sending=one.sending, waiting=one.waiting)
            for role, one in timing.items()
        }
        Summary(
            scene=self.scene.name, title=self.scene.title, status=end.status, reason=end.sentence,
            steps=results.increments, steps_asked=results.increments, wall_seconds=seconds, services=walls,
            measures=measures_of(results), units=_UNITS, warnings=self._warnings(), events=results.events,
            versions=results.versions, seeds={}, command=self._command,
        ).write(self.folder)  # fmt: skip

    @property
    def _done(self) -> int:
        return self._results.increments if self._results is not None else 0

    def _run(self, services: Services, interruption: Interruption) -> str:
        """Return in a sentence why the run ended."""

        def watch() -> None:
            services.check()
            if interruption.wanted:
                raise Interrupted

        with progress_bar(self._console) as progress:
            task = progress.add_task("start services", total=None)
            structure = self._start(services, watch)
            configured = structure.call("configure", self._request(services), s.StructureConfigured)
            self._results = results = self._begin(configured)
            load = 0.0
            if self._checkpoint is not None:
                header, state = self._checkpoint
                structure.call("restore", RestoreRequest(step=header["step"], state=state), Restored)
                load = header["load"]
            progress.reset(task, description=f"{configured.unknowns} unknowns", total=1.0)
            progress.update(task, completed=load)
            while not self._is_over(load):
                asked = s.StructureAdvance(watched=results.watched.bricks.tolist() if results.watched else [])
                made = structure.call("advance", asked, s.StructureAdvanced, step=results.increments)
                load = made.load
                self._note(made, configured.section)
                stress = results.series["stress"]
                if self._is_over(load) or made.step % self.scene.output.fields_every == 0:
                    self._frame(structure, made)
                self._save(structure, made)
                progress.update(
                    task, completed=load, description=f"strain {100 * made.strain:.3g} %, {stress[-1] / 1e6:.4g} MPa"
                )
                if interruption.wanted:
                    raise Interrupted
        if load < 1.0:
            return f"the stress fell below {self.scene.load.stop_below:g} of its peak"
        return "the whole elongation is reached"

    def _is_over(self, load: float) -> bool:
        assert self._results is not None
        stress = self._results.series["stress"]
        return load >= 1.0 or (bool(stress) and stress[-1] < self.scene.load.stop_below * max(stress))

    def _warnings(self) -> list[str]:
        assert self._results is not None
        sudden = {cell.name for cell in self._cell.materials if cell.failures and cell.fracture_energy is None}
        found = sorted(sudden & {event["material"] for event in self._results.events})
        if not found:
            return []
        return [
            f"Subcells of {' and '.join(found)} lose their stiffness at once, so the peak depends on the mesh: compare"
            " meshes, or give the material a fracture energy."
        ]

    def _start(self, services: Services, watch: Callable[[], None]) -> Client:
        wanted = self.scene.micromechanics
        for role, backend, workers in (
            ("micromechanics", wanted.backend, wanted.workers),
            ("structure", self.scene.structure.backend, 1),
        ):
            if role in self._attached:
                client = services.attach(role, role, self._attached[role], self._keys, watch)
            else:
                services.start(role, role, backend, workers=workers, link_keys=self._keys)
                client = services.connect(role, watch)
            client.watch_with(watch)
        return services.clients["structure"]

    def _request(self, services: Services) -> s.StructureConfigure:
        started = services.processes.get("micromechanics")
        endpoint = self._attached["micromechanics"] if started is None else started.endpoint
        return configure_request(self.scene, self._cell, endpoint)

    def _begin(self, configured: s.StructureConfigured) -> LaminateResults:
        if self._checkpoint is not None:
            kept = LaminateResults.read(self.folder / "results.h5")
            kept.cut(self._checkpoint[0]["step"])
            return kept
        scene = self.scene
        angles = np.array(scene.modelled_angles, dtype=np.float64)
        places = [scene.modelled_place(place) for place in scene.output.watched]
        return LaminateResults(
            scene={
                "name": scene.name,
                "title": scene.title,
                "text": scene.text,
                "overrides": list(scene.overrides),
                "resolved": scene.model_dump(mode="json"),
                "command": self._command,
            },
            materials=[material.name for material in self._cell.materials],
            angles=angles,
            nodes=configured.nodes,
            bricks=configured.bricks,
            ply=configured.ply,
            section=configured.section,
            watched=WatchedPlaces.near(places, configured, angles, self._cell) if places else None,
            versions=versions(),
        )

    def _note(self, made: s.StructureAdvanced, section: float) -> None:
        assert self._results is not None
        results = self._results
        values = {
            **{name: float(getattr(made, name)) for name in SERIES if hasattr(made, name)},
            "stress": made.force / section,
            **{f"seconds_{part}": spent for part, spent in made.seconds.items()},
        }
        for name, series in results.series.items():
            series.append(values.get(name, 0.0))
        before = np.sum(results.new_failures, axis=0) if results.new_failures else np.zeros_like(made.new_failures)
        for ply, material in np.argwhere((made.new_failures > 0) & (before == 0)):
            angle, name = results.angles[ply], results.materials[material]
            results.events.append(
                {
                    "step": made.step,
                    "strain": made.strain,
                    "stress": made.force / section,
                    "ply": int(ply),
                    "material": name,
                    "sentence": f"{made.force / section / 1e6:.4g} MPa, strain {100 * made.strain:.4g} %: "
                    f"{name} fails first in ply {ply + 1} ({angle:g}°), {made.new_failures[ply, material]} subcells",
                }
            )
        results.new_failures.append(made.new_failures)
        results.layer_damage.append(made.layer_damage)
        if results.watched is not None:
            results.watched.note(made)

    def _frame(self, structure: Client, made: s.StructureAdvanced) -> None:
        assert self._results is not None
        fields = structure.call("fields", FieldsRequest(names=FIELDS), FieldsReply).fields
        self._results.frames.append(Frame(made.step, made.strain, **{name: fields[name] for name in FIELDS}))

    def _save(self, structure: Client, made: s.StructureAdvanced) -> None:
        """Commit results, then the checkpoint: a kill between the two leaves results that resume cuts back."""
        assert self._results is not None
        state = structure.call("checkpoint", None, CheckpointReply).state
        self._results.write(self.folder / "results.h5")
        header = {"step": made.step, "load": made.load, **self._settings()}
        write_checkpoint(self.folder, header, state)

    def _settings(self) -> dict[str, Any]:
        """Scene, cell and the mesh of a file, as they are read back from a checkpoint."""
        arrays = {name: array.tolist() for name, array in self._cell.array_values().items()}
        cell = json.loads(json.dumps({**self._cell.plain_values(), **arrays}))
        plane = None if self.scene.plane is None else self.scene.plane.digest
        return {"scene": self.scene.model_dump(mode="json"), "cell": cell, "plane": plane}

    def _load_checkpoint(self) -> None:
        try:
            header, state = read_checkpoint(self.folder)
        except CheckpointError as error:
            if (self.folder / "checkpoint.npz").exists():
                raise
            self._console.print(f"{error}: the run starts anew")
            return
        settings = self._settings()
        changed = differences(header["scene"], settings["scene"]) - {"load.stop_below"}
        if changed:
            raise RunError(
                f"the scene differs from that of the checkpoint in {', '.join(sorted(changed))}; only load.stop_below "
                "may change on --resume"
            )
        changed = differences(header["cell"], settings["cell"])
        if changed:
            raise RunError(
                f"{self.scene.cell_file} differs from what the checkpoint was made with in {', '.join(sorted(changed))}"
            )
        if header.get("plane") != settings["plane"]:
            raise RunError(f"the mesh in {self.scene.mesh.file} differs from what the checkpoint was made with")
        self._checkpoint = header, state


def measures_of(results: LaminateResults) -> dict[str, float | None]:
    """Key numbers of a run; units are in the summary."""
    stress, strain = results.series["stress"], results.series["strain"]
    if not stress:
        return dict.fromkeys(_UNITS)
    peak = int(np.argmax(stress))
    first = results.events[0] if results.events else None
    work, viscous = results.series["work"][-1], results.series["viscous_energy"][-1]
    asked, spared = sum(results.series["queried"]), sum(results.series["spared"])
    return {
        "peak_stress": stress[peak],
        "strain_at_peak": strain[peak],
        "first_failure_strain": first["strain"] if first else None,
        "first_failure_stress": first["stress"] if first else None,
        "initial_stiffness": stress[0] / strain[0],
        "failed_points": float(np.sum(results.new_failures)),
        "queries_spared": spared / (asked + spared) if asked + spared else None,
        "residual_max": max(results.series["residual"]),
        "work": work,
        "viscous_share": viscous / work if viscous else None,
    }
