"""Roles: which operations a role has, with their messages, and in which states they are allowed."""

from __future__ import annotations

from dataclasses import dataclass, field

from protocol import atomistic as a
from protocol import continuum as c
from protocol import micromechanics as m
from protocol import structure as s
from protocol.messages import (
    Acknowledged,
    CheckpointReply,
    Empty,
    FieldsReply,
    FieldsRequest,
    Hello,
    Message,
    Restored,
    RestoreRequest,
    Status,
    Welcome,
)
from protocol.version import Version

FIRST, ATOMS, COUPLING, CELLS = Version(1, 0), Version(1, 2), Version(1, 3), Version(1, 4)
ANY = frozenset({"new", "configured", "registered", "ready", "failed"})
CONFIGURED = frozenset({"configured", "registered", "ready"})
REGISTERED = frozenset({"registered", "ready"})
READY = frozenset({"ready"})


@dataclass(frozen=True)
class Operation:
    """One type of request.

    Parameters
    ----------
    request, reply : type of Message
    allowed : frozenset of str
        States in which the service takes it.
    leads_to : str or None
        State after it. None: the operation does not work on the solver's state, so it cannot harm it either.
    deadline : float
        Seconds that a client waits by default.
    since : Version
        Version of the protocol that brought it.
    optional : bool
        A service has it only where `capabilities.operations` names it.
    """

    request: type[Message]
    reply: type[Message]
    allowed: frozenset[str]
    leads_to: str | None = None
    deadline: float = 60.0
    since: Version = FIRST
    optional: bool = False


@dataclass(frozen=True)
class Role:
    """A role on the wire."""

    name: str
    purpose: str
    operations: dict[str, Operation] = field(default_factory=dict)


HELLO = Operation(Hello, Welcome, ANY, deadline=10.0)
SHUTDOWN = Operation(Empty, Acknowledged, ANY, deadline=10.0)

#: Operations of the control socket, the same for every role.
CONTROL: dict[str, Operation] = {
    "hello": HELLO,
    "status": Operation(Empty, Status, ANY, deadline=5.0),
    "abort": Operation(Empty, Acknowledged, ANY, deadline=5.0),
    "shutdown": SHUTDOWN,
}

ROLES: dict[str, Role] = {
    role.name: role
    for role in (
        Role(
            "continuum",
            "advance a continuum under interface reaction forces; displacement and velocity at anchors; fields",
            {
                "hello": HELLO,
                "configure": Operation(c.ContinuumConfigure, c.ContinuumConfigured, ANY, "configured", 3600.0),
                "register": Operation(c.ContinuumRegister, c.ContinuumRegistered, CONFIGURED, "ready", 120.0),
                "advance": Operation(c.ContinuumAdvance, c.ContinuumAdvanced, CONFIGURED, "ready", 600.0),
                "extend_crack": Operation(
                    c.CrackExtension, c.CrackExtended, CONFIGURED, None, 120.0, since=COUPLING, optional=True
                ),
                "fields": Operation(FieldsRequest, FieldsReply, CONFIGURED),
                "checkpoint": Operation(Empty, CheckpointReply, CONFIGURED, "ready", 120.0),
                "restore": Operation(RestoreRequest, Restored, CONFIGURED, "ready", 120.0),
                "status": Operation(Empty, Status, ANY, deadline=5.0),
                "shutdown": SHUTDOWN,
            },
        ),
        Role(
            "atomistic",
            "run M steps under anchors; time-averaged reaction forces with their standard error; fields",
            {
                "hello": HELLO,
                "properties": Operation(a.PropertiesRequest, a.Properties, ANY, None, 600.0),
                "configure": Operation(a.AtomisticConfigure, a.AtomisticConfigured, ANY, "configured", 120.0),
                "register": Operation(a.AtomisticRegister, a.AtomisticRegistered, CONFIGURED, "registered", 120.0),
                "equilibrate": Operation(a.EquilibrateRequest, a.Equilibrated, REGISTERED, "ready", 3600.0),
                "advance": Operation(a.AtomisticAdvance, a.AtomisticAdvanced, READY, "ready", 3600.0),
                "fields": Operation(FieldsRequest, FieldsReply, CONFIGURED),
                "collect_fields": Operation(
                    a.CollectRequest, a.Collecting, CONFIGURED, None, 120.0, since=ATOMS, optional=True
                ),
                "grid_fields": Operation(
                    a.GridFieldsRequest, a.GridFields, CONFIGURED, None, 600.0, since=ATOMS, optional=True
                ),
                "j_integral": Operation(
                    a.JIntegralRequest, a.JIntegral, READY, None, 600.0, since=ATOMS, optional=True
                ),
                "displace": Operation(
                    a.DisplaceRequest, a.Displaced, READY, "ready", 120.0, since=COUPLING, optional=True
                ),
                "cut": Operation(a.CutRequest, a.Severed, READY, "ready", 120.0, since=COUPLING, optional=True),
                "checkpoint": Operation(Empty, CheckpointReply, READY, "ready", 120.0),
                "restore": Operation(RestoreRequest, Restored, REGISTERED, "ready", 120.0),
                "status": Operation(Empty, Status, ANY, deadline=5.0),
                "shutdown": SHUTDOWN,
            },
        ),
        Role(
            "micromechanics",
            "stress, tangent and failure of a periodic cell at many points; stateless",
            {
                "hello": HELLO,
                "register": Operation(m.RegisterCell, m.CellRegistered, ANY, None, 600.0, since=CELLS),
                "evaluate": Operation(m.EvaluateRequest, m.Evaluated, ANY, None, 3600.0, since=CELLS),
                "localise": Operation(m.LocaliseRequest, m.Localised, ANY, None, 3600.0, since=CELLS),
                "properties": Operation(m.CellPropertiesRequest, m.CellProperties, ANY, None, 600.0, since=CELLS),
                "status": Operation(Empty, Status, ANY, deadline=5.0),
                "shutdown": SHUTDOWN,
            },
        ),
        Role(
            "structure",
            "pull a laminate that asks its microstructure at every integration point",
            {
                "hello": HELLO,
                "configure": Operation(
                    s.StructureConfigure, s.StructureConfigured, ANY, "configured", 600.0, since=CELLS
                ),
                "advance": Operation(s.StructureAdvance, s.StructureAdvanced, CONFIGURED, "ready", 3600.0, since=CELLS),
                "fields": Operation(FieldsRequest, FieldsReply, CONFIGURED, since=CELLS),
                "checkpoint": Operation(Empty, CheckpointReply, CONFIGURED, "ready", 120.0, since=CELLS),
                "restore": Operation(RestoreRequest, Restored, CONFIGURED, "ready", 120.0, since=CELLS),
                "status": Operation(Empty, Status, ANY, deadline=5.0),
                "shutdown": SHUTDOWN,
            },
        ),
    )
}
