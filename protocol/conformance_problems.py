"""A small valid problem for each role, on which the conformance kit works."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from protocol import continuum as c
from protocol.messages import Message

#: Steps of one `advance` of the kit.
STEPS = 5
#: Requests with their operations, in the order in which they are sent.
Requests = list[tuple[str, Message]]


@dataclass(frozen=True)
class Wrong:
    """A request that breaks a rule which the types alone do not tell.

    Parameters
    ----------
    label : str
    operation : str
    paths : tuple of str
        Fields of which the error may name any.
    message : Message
        Made without validation, since it is wrong.
    """

    label: str
    operation: str
    paths: tuple[str, ...]
    message: Message


@dataclass(frozen=True)
class Problem:
    """Valid requests in the order in which a coordinator sends them.

    Parameters
    ----------
    steps : list of (operation, request)
        From the state `new` to `ready`.
    advance : callable
        From the number of the exchange to the request.
    whole : list of (operation, request)
        Requests with every optional field given, to be made wrong one field at a time.
    wrong : list of Wrong
    long : (operation, request)
        Takes many seconds; will be aborted.
    sizes : dict of str to int
        Named sizes that are known once the problem is set.
    kinds : list of (label, requests)
        Valid requests, from `configure` on, one of which holds what a service may have or refuse as unsupported.
    operation : str
        That `advance` makes requests of.
    """

    steps: Requests
    advance: Callable[[int], Message]
    whole: Requests
    wrong: list[Wrong]
    long: tuple[str, Message]
    sizes: dict[str, int]
    kinds: list[tuple[str, Requests]] = field(default_factory=list)
    operation: str = "advance"

    def request(self, operation: str) -> Message:
        """Return the request of an operation of `steps`."""
        return dict(self.steps)[operation]


def continuum_kinds(configure: c.ContinuumConfigure) -> list[tuple[str, Message]]:
    """Return variants of a problem, each with one thing that not every continuum can do."""
    h, times = configure.cell_size, [0.0, 1e-9]
    plain = configure.model_copy(update={"overlap": None})
    crack = c.CrackLine(points=[(-7 * h, 0.5 * h), (-h, 0.5 * h)])
    growth = c.CrackGrowth(critical_energy_release_rate=1.0, rule="max_hoop", interval=5)
    materials: list[c.Material] = [
        c.OrthotropicMaterial(
            young_1=2e9, young_2=1e9, young_3=1e9, poisson_12=0.3, poisson_13=0.3, poisson_23=0.2, shear_12=4e8,
            angle=0.5, density=2e3,
        ),
        c.NeoHookeanMaterial(young=1e9, poisson=0.3, density=1e3),
        c.J2PlasticityMaterial(
            young=1e9, poisson=0.3, density=1e3, yield_stress=1e7, hardening=1e8, saturation=1e6, saturation_rate=10.0
        ),
    ]  # fmt: skip
    edges: list[c.AnyEdge] = [
        c.EdgeVelocity(edge="top", component=1, times=times, velocities=[0.0, 1e-3]),
        c.EdgeSymmetry(edge="bottom"),
        c.EdgeTraction(edge="top", component=0, times=times, tractions=[0.0, 1e3]),
        c.EdgePressure(edge="top", times=times, pressures=[0.0, 1e3]),
        c.EdgeAbsorbing(edge="bottom"),
    ]
    level = c.Rectangle(lower=(-3 * h, -2 * h), upper=(3 * h, 2 * h))

    def changed(**values: object) -> Message:
        return plain.model_copy(update=values)

    return [
        ("another scheme", changed(scheme=c.Scheme(interpolation="linear", integration="usl", transfer="flip"))),
        *((f"material {material.law}", changed(material=material)) for material in materials),
        *((f"edge {edge.kind}", changed(edges=[*plain.edges, edge])) for edge in edges),
        ("a finer level", changed(refinement=[level])),
        ("two cracks", changed(cracks=[crack, crack.model_copy(update={"points": [(7 * h, -h / 2), (h, -h / 2)]})])),
        ("a crack with friction", changed(cracks=[crack.model_copy(update={"contact": "coulomb", "friction": 0.3})])),
        ("a crack that may grow", changed(cracks=[crack.model_copy(update={"growth": growth})])),
        ("a measured crack", changed(cracks=[crack.model_copy(update={"measure_every": 5})])),
        ("a body force", changed(body_force=c.BodyForce(acceleration=(0.0, -9.81), times=times, factors=[0.0, 1.0]))),
        ("damping of points", changed(point_damping_rate=1e9)),
        ("force scaling", changed(force_scaling=0.25)),
        ("a preload", changed(preload=c.Preload(tolerance=1e-2, max_steps=20), initial_velocity_gradient=None)),
        ("an end when points are lost", changed(on_lost_points="stop")),
    ]


def _with_everything(configure: c.ContinuumConfigure, kinds: list[tuple[str, Message]]) -> list[c.ContinuumConfigure]:
    """Return requests that hold every kind of part between them."""
    variants = [request for _, request in kinds if isinstance(request, c.ContinuumConfigure)]
    edges = [edge for request in variants for edge in request.edges[len(configure.edges) :]]
    first = configure.model_copy(
        update={
            "edges": [*configure.edges[:1], *edges],
            "cracks": [crack for request in variants for crack in request.cracks if crack.growth is not None],
            **{
                name: next(value for request in variants if (value := getattr(request, name)))
                for name in ("refinement", "body_force", "preload")
            },
        }
    )
    laws = [request.material for request in variants if request.material.law != "isotropic"]
    return [first.model_copy(update={"material": law} if k == 0 else {"material": law, "edges": [], "cracks": []})
            for k, law in enumerate(laws)]  # fmt: skip


def continuum_problem() -> Problem:
    """Return a plate of 12 x 8 cells with a hole, a ring of four IVCs around it and eight anchors."""
    h = 1e-9
    body = c.Rectangle(lower=(-6 * h, -4 * h), upper=(6 * h, 4 * h))
    configure = c.ContinuumConfigure(
        assumption="plane_stress",
        thickness=h,
        body=body,
        cell_size=h,
        points_per_cell=2,
        material=c.IsotropicMaterial(young=1e9, poisson=0.3, density=1e3),
        overlap=c.Overlap(
            inner=c.Rectangle(lower=(-h, -h), upper=(h, h)),
            outer=c.Rectangle(lower=(-2 * h, -2 * h), upper=(2 * h, 2 * h)),
            weight=0.5,
        ),
        edges=[
            c.EdgeCondition(edge="left", component=0, times=[0.0, 1e-9], displacements=[0.0, 0.0]),
            c.EdgeCondition(edge="right", component=0, times=[0.0, 1e-9], displacements=[0.0, 0.05 * h]),
        ],
        initial_velocity_gradient=(1e6, 0.0, 0.0, 0.0),
        damping_rate=1e9,
        time_step=0.1 * h / 1e3,
    )
    crack = c.CrackLine(points=[(-7 * h, 2.5 * h), (-4 * h, 2.5 * h)])
    signs = ((1, 1), (1, -1), (-1, 1), (-1, -1))
    anchors = [(1.5 * sx * h, 0.5 * sy * h, 0.0) for sx, sy in signs]
    anchors += [(0.5 * sx * h, 1.5 * sy * h, 0.0) for sx, sy in signs]
    register = c.ContinuumRegister(
        anchor_position=np.array(anchors),
        anchor_ivc=np.array([0, 0, 1, 1, 2, 3, 2, 3]),
        ivc_lower=h * np.array([[1, -2, -1], [-2, -2, -1], [-1, 1, -1], [-1, -2, -1]], dtype=float),
        ivc_upper=h * np.array([[2, 2, 1], [-1, 2, 1], [1, 2, 1], [1, -1, 1]], dtype=float),
    )
    ivc_force = 1e-11 * np.array([[1, 0.5, 0], [-1, 0.25, 0], [0.5, 1, 0], [-0.5, -1, 0]])
    anchor_force = 1e-12 * np.arange(24.0).reshape(8, 3)

    def advance(number: int) -> c.ContinuumAdvance:
        return c.ContinuumAdvance(steps=STEPS, ivc_force=ivc_force * (1 + 0.1 * number))

    def changed(**values: object) -> c.ContinuumConfigure:
        return configure.model_copy(update=values)

    upside_down = c.Rectangle.model_construct(lower=body.upper, upper=body.lower)
    edge = configure.edges[0]
    outside = register.anchor_position.copy()
    outside[0] = (100 * h, 0.0, 0.0)
    wrong = [
        Wrong("body upside down", "configure", ("body.upper", "body.lower"), changed(body=upside_down)),
        Wrong("time step above the stable one", "configure", ("time_step",), changed(time_step=1e4 * h / 1e3)),
        Wrong("times that descend", "configure", ("edges.0.times",),
              changed(edges=[edge.model_copy(update={"times": [1e-9, 0.0]})])),
        Wrong("more displacements than times", "configure", ("edges.0.displacements", "edges.0.times"),
              changed(edges=[edge.model_copy(update={"displacements": [0.0, 0.0, 0.0]})])),
        Wrong("overlap.inner beyond outer", "configure", ("overlap.inner", "overlap.outer"),
              changed(overlap=configure.overlap.model_copy(update={"inner": body}) if configure.overlap else None)),
        Wrong("a finer level beyond the body", "configure", ("refinement.0",),
              changed(refinement=[c.Rectangle(lower=(-7 * h, 0.0), upper=(0.0, h))])),
        Wrong("friction without coulomb", "configure", ("cracks.0.friction", "cracks.0.contact"),
              changed(cracks=[crack.model_copy(update={"friction": 0.5})])),
        Wrong("an IVC that is not there", "register", ("anchor_ivc",),
              register.model_copy(update={"anchor_ivc": register.anchor_ivc + 1})),
        Wrong("a negative IVC", "register", ("anchor_ivc",),
              register.model_copy(update={"anchor_ivc": register.anchor_ivc - 1})),
        Wrong("IVC upside down", "register", ("ivc_upper", "ivc_lower"),
              register.model_copy(update={"ivc_lower": register.ivc_upper, "ivc_upper": register.ivc_lower})),
        Wrong("an anchor outside the body", "register", ("anchor_position",),
              register.model_copy(update={"anchor_position": outside})),
        Wrong("both forces", "advance", ("anchor_force", "ivc_force"),
              advance(0).model_copy(update={"anchor_force": anchor_force})),
    ]  # fmt: skip
    kinds = continuum_kinds(configure)
    return Problem(
        steps=[("configure", configure), ("register", register)],
        advance=advance,
        kinds=[
            (label, [("configure", request), ("advance", c.ContinuumAdvance(steps=STEPS))]) for label, request in kinds
        ],
        whole=[
            ("configure", changed(cracks=[crack])),
            *(("configure", request) for request in _with_everything(configure, kinds)),
            ("register", register),
            ("advance", advance(0)),
            ("advance", c.ContinuumAdvance(steps=STEPS, anchor_force=anchor_force)),
        ],
        wrong=wrong,
        long=("advance", c.ContinuumAdvance(steps=1_000_000)),
        sizes={"anchors": 8, "ivcs": 4, "edges": 2},
    )
