"""Two small scenes with a crack under a crack-tip field, which the benchmark `coupling` runs with turned knobs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

_EDGE: Final = """
[[continuum.edges]]
kind = "k_field"
edge = "{side}"
field = {{ tip = ["0 angstrom", "{y} angstrom"], k_1 = "{intensity} MPa m^0.5" }}
times = ["0 ps", "{rest} ps", "{time} ps"]
factors = [{start}, {start}, {end}]
"""

_SCENE: Final = """
title = "{name} under a crack-tip field"

[run]
steps = {steps}
output_every = {steps}
checkpoint_every = {steps}
stop_after_crack_growth = "2 angstrom"

[continuum]
assumption = "plane_stress"
lower = ["-{half} angstrom", "-{half} angstrom"]
upper = ["{half} angstrom", "{half} angstrom"]
cell_size = "{cell} angstrom"
damping_rate = "{damping} 1/ps"

[continuum.material]
young = "{young} GPa"
poisson = {poisson}
density = "{density} kg/m^3"
thickness = "{thickness} angstrom"

[continuum.initial_field]
tip = ["0 angstrom", "{y} angstrom"]
k_1 = "{first} MPa m^0.5"
{edges}
[atomistic]
backend = "{backend}"
force_field = "{force_field}"
material = "{material}"
width = "{size} angstrom"
height = "{size} angstrom"
temperature = "{temperature} K"
time_step = "{time_step} fs"
equilibration = "0.1 ps"
reference = "0.1 ps"
hold = "0.2 ps"

[handshake]
width = "{width} angstrom"
steps_per_exchange = {m}
ivc_size = "{ivc} angstrom"
damping_time = "{damper} ps"
{own}
[crack]
tip_x = "0 angstrom"
y = "{y} angstrom"
"""


@dataclass(frozen=True)
class Problem:
    """A body under a crack-tip field whose factor rises, and the middle setting of the knobs.

    Attributes
    ----------
    name, backend, force_field, material : str
    half, cell : float
        Half width of the body and edge of a cell, angstrom.
    young, poisson, density, thickness : float
        Of the continuum, GPa, 1, kg/m3, angstrom: those of the force field at 0 K.
    intensity, start, end, rest, time : float
        Field at a factor of 1, MPa m^0.5; the factor at the start and at the end; when it begins to rise and when the
        run ends, ps.
    temperature, time_step, damper, damping : float
        K, fs, ps, 1/ps.
    size, width, m : float, float, int
        Atomistic sample and handshake in the middle setting, angstrom; steps of an exchange.
    """

    name: str
    backend: str
    force_field: str
    material: str
    half: float
    cell: float
    y: float
    young: float
    poisson: float
    density: float
    thickness: float
    intensity: float
    start: float
    end: float
    rest: float
    time: float
    temperature: float
    time_step: float
    damper: float
    damping: float
    size: float
    width: float
    m: int

    def text(
        self,
        *,
        m: int | None = None,
        width: float | None = None,
        size: float | None = None,
        weight: float | None = None,
        stiffness: float | None = None,
        preset: bool = False,
    ) -> str:
        """Return the scene with knobs turned; what is not given is that of the middle."""
        window = self.m if m is None else m
        ring = self.width if width is None else width
        own = ['preset = "seed"'] if preset else []
        own += [] if weight is None else [f"weight = {weight}"]
        own += [] if stiffness is None else [f'stiffness = "{stiffness} N/m"']
        edges = "".join(
            _EDGE.format(
                side=side,
                y=self.y,
                intensity=self.intensity,
                rest=self.rest,
                time=self.time,
                start=self.start,
                end=self.end,
            )
            for side in ("left", "right", "bottom", "top")
        )
        return _SCENE.format(
            name=self.name, steps=round(1e3 * self.time / (window * self.time_step)), half=self.half, cell=self.cell,
            damping=self.damping, young=self.young, poisson=self.poisson, density=self.density, y=self.y,
            thickness=self.thickness, first=self.intensity * self.start, edges=edges, backend=self.backend,
            force_field=self.force_field, material=self.material, size=self.size if size is None else size,
            temperature=self.temperature, time_step=self.time_step, width=ring, m=window,
            ivc=max(0.5 * ring, self.cell), damper=self.damper, own="\n".join(own),
        )  # fmt: skip


#: A lattice of springs that never break. The load rises slowly, since what is damped grows as the sample shrinks.
LATTICE: Final = Problem(
    name="harmonic lattice", backend="lattice", force_field="harmonic", material="hexagonal", half=120, cell=8, y=-4,
    young=1024.8, poisson=0.3333, density=2284, thickness=2.8169, intensity=4.0, start=0.8, end=1.0, rest=0.2, time=2.2,
    temperature=0, time_step=1.0, damper=0.2, damping=2.0, size=80, width=24, m=10,
)  # fmt: skip
GRAPHENE: Final = Problem(
    name="graphene", backend="md_service", force_field="airebo-sharp", material="graphene", half=82.5, cell=5, y=0,
    young=827, poisson=0.357, density=2345, thickness=3.35, intensity=3.0, start=0.80, end=1.05, rest=0.3, time=2.8,
    temperature=10, time_step=0.5, damper=0.05, damping=2.0, size=73, width=15, m=20,
)  # fmt: skip
