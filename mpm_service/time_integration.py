"""One explicit step of the material point method (Eqs 17-24).

The update schemes differ in when stress is computed::

    USF    nodes <- points | stress | forces | new velocities | points <- nodes
    USL    nodes <- points | forces | new velocities | points <- nodes | stress
    MUSL   as USL, with nodal velocities mapped again from the new points for the stress
    USAVG  half of it as in USF, half as in MUSL

Transfers from nodes to points form one family. With S the way from nodes to points, S+ the mass-weighted way back
and ``Q_k u = sum_j (I - S+ S)^j u``, j = 0 ... k - 1:

    FLIP     v_p <- v_p + S (v_new - v_old)          XPIC(k)  v_p <- S (Q_k v_old + v_new - v_old)
    PIC      v_p <- S v_new                          FMPM(k)  v_p <- S Q_k v_new

Q_k is the k-th approximation of the inverse of the full mass matrix times the lumped one. With FMPM(k > 1) the
strain of MUSL and USAVG at the end of a step follows ``(1 - a) v + a Q_k v``, v the velocity mapped again and
a = `STRAIN_SHARE`: on a uniform lattice with two points a cell waves of number k then have
``omega^2 = c^2 k^2 (1 + k^2 h^2 (-1/12 + 3 a/16 + (c dt/h)^2 / 12))``, so a = 0 leaves ripples behind a front and
a = 1 sends them ahead of it. Filtering v_new itself, without mapping it again, would do the same to long waves, but
it amplifies the shortest ones, which the mapping suppresses: it is unstable from a Courant number of about 0.4.

Energy. With K the kinetic energy of the points and the sums over nodes, a step of any scheme keeps the account

    K_after = K_before + dt sum (f_int + f_ext) (v_old + v_new)/2 + edge work - damping loss - filter loss

to round-off: the change of the nodes' kinetic energy is the work of their forces and impulses with the mean of old
and new velocity, and the filter loss is what is left. It holds the way to the nodes and back: K_before less the energy
of v_old, and the energy of v_new less K_after. All works are booked in this way.

What is not of this account is that strain energy grows by the velocities of the strain update. With T = S+ S these are
``T Q v_new`` or, for FMPM, ``(1 + a (1 - T))`` times that. The sum of all energies and works then

- swings by ``a (1 - T)``, 0.13 (k h)^2, of the strain energy of a wave of number k with FMPM(2), whatever dt is;
- grows by ``dt^2/4 sum m a (1 - T)^2 a`` a step with FMPM(2), a the nodes' acceleration, which is of the order of dt
  and comes from face nodes and the shortest waves; by ``dt^2/2 sum m a (1 - T) a`` with FLIP and MUSL or USF, which is
  all of its filter loss: what the points lose there, their strain energy gets.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from . import nodes as node_kernels
from .boundary_set import BoundarySet
from .cracks import CrackSet
from .damping import Damping, ForceBalance, damp_points, scale_forces
from .mapping import TRAVEL, Mapping
from .scheme import Integration, Scheme

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

#: Share of the filtered velocity in the strain update of FMPM(k > 1).
STRAIN_SHARE = 0.7
#: How far ahead of the time of the velocities the stresses are between two steps [steps].
STRESS_LEAD: dict[Integration, float] = {"usf": -0.5, "usl": 0.5, "musl": 0.5, "usavg": 0.0}


class Nodes(NamedTuple):
    """Nodal tables; one row per grid node, then one per extra velocity field."""

    momentum: FloatArray
    """(R, 1 + 2 d) mass, momentum, force."""
    motion: FloatArray
    """(R, 2 d) velocity that moves the points, and what is added to or becomes their velocity."""
    velocity: FloatArray
    """(R, d) nodal velocity of the strain update."""
    filtered: FloatArray
    """(R, d) Q_k of a velocity."""
    returned: FloatArray
    """(R, d) zero between passes of the filter."""

    @classmethod
    def zeros(cls, rows: int, dimension: int) -> Nodes:
        """Empty tables."""
        return cls(
            np.zeros((rows, 1 + 2 * dimension)),
            np.zeros((rows, 2 * dimension)),
            *(np.zeros((rows, dimension)) for _ in range(3)),
        )


@dataclass
class Totals:
    """What a run has summed up since step 0 [J]."""

    edge_work: float = 0.0
    damping_loss: float = 0.0
    friction_loss: float = 0.0
    unfiltered: float = 0.0
    """Kinetic energy that the points would have, had none been lost on the way to the nodes and back."""


class NodalLoad(Protocol):
    """A load that puts forces on nodes and books their work."""

    def add_forces(self, step: int, momentum: FloatArray) -> None:
        """Add forces [N] to the force columns."""

    def book(self, momentum: FloatArray, halfway: FloatArray, duration: float) -> None:
        """Add the work of the forces on nodes that move with velocities (R, d) [m/s] for a time [s]."""


class Rider(Protocol):
    """What moves with the nodes."""

    def follow(self, motion: FloatArray, time_step: float) -> None:
        """Move with the velocities in the first columns of a table [m/s]."""


@dataclass
class TimeIntegration:
    """Everything a step works on.

    Parameters
    ----------
    mapping : Mapping
        Points and their sweeps.
    nodes : Nodes
        Nodal tables.
    scheme : Scheme
    boundary : BoundarySet
    cracks : CrackSet or None
    stress : callable
        Updates the stress of a slice of rows from their deformation.
    time_step : float
        [s]
    least_mass : float
        Nodes with no more mass count as empty [kg].
    damping : Damping
    balance : ForceBalance
        Measures the residual of each step.
    loads : sequence of NodalLoad
    rider : Rider or None
    """

    mapping: Mapping
    nodes: Nodes
    scheme: Scheme
    boundary: BoundarySet
    cracks: CrackSet | None
    stress: Callable[[slice], None]
    time_step: float
    least_mass: float
    damping: Damping
    balance: ForceBalance
    loads: Sequence[NodalLoad] = ()
    rider: Rider | None = None
    totals: Totals = field(default_factory=Totals)
    largest_increment: float = 0.0
    residual: float = np.inf
    watches_balance: bool = False
    """Is the residual of each step wanted? It costs two looks at all nodes."""
    at_rest: bool = False
    """Have all points just been stopped?"""

    def must_sort(self) -> bool:
        """Have points travelled, or cracks changed, so that points must be sorted before the next step?"""
        if self.cracks is not None:
            self.cracks.follow()
            if self.cracks.changed:
                return True
        return self.mapping.travel > TRAVEL * self.mapping.smallest_cell

    def sort(self) -> None:
        """Sort the points."""
        self.make_room()
        self.mapping.sort(self.nodes)
        if self.cracks is not None:
            self.cracks.changed = False

    def make_room(self) -> None:
        """Enlarge the nodal tables where cracks have grown beyond them."""
        if self.cracks is not None and self.cracks.row_count > self.nodes.momentum.shape[0]:
            self.nodes = Nodes.zeros(self.cracks.row_count, self.mapping.columns.dimension)
            self.mapping.make_room(self.cracks.row_count)

    def gather_state(self) -> None:
        """Bring nodal masses, momenta and internal forces up to date outside a step."""
        if self.cracks is not None:
            self.cracks.follow()
        self.mapping.tabulate(0)
        node_kernels.clear(self.mapping.active, self.nodes.momentum)
        self.mapping.scatter_state(self.nodes.momentum)

    def stress_power(self) -> float:
        """Power of the internal forces on the nodes' velocities as they are between two steps [W]."""
        self.gather_state()
        node_kernels.drop_slivers(self.mapping.active, self.nodes.momentum, self.least_mass)
        return float(node_kernels.force_power(self.mapping.active, self.nodes.momentum))

    def step(self, number: int) -> None:
        """Make the step from `number` to `number` + 1; sets `largest_increment` [m].

        If that is not below a cell the step was stopped half done.
        """
        mapping, tables, scheme, dt = self.mapping, self.nodes, self.scheme, self.time_step
        mapping.tabulate(number)
        self._locate(number)
        active = mapping.active
        node_kernels.clear(active, tables.momentum)
        if scheme.integration != "usl":
            node_kernels.clear(active, tables.velocity)

        mapping.scatter_state(tables.momentum)
        if scheme.integration in ("usf", "usavg"):
            node_kernels.drop_slivers(active, tables.momentum, self.least_mass)
            node_kernels.divide(active, tables.momentum, 1, tables.momentum, tables.velocity)
            self._constrain(tables.velocity, before=True)
            mapping.deform(tables.velocity, dt if scheme.integration == "usf" else 0.5 * dt, False, self.stress)
            # All again and not the forces alone: domains that convect have changed with the strain.
            node_kernels.clear(active, tables.momentum)
            node_kernels.clear(active, tables.velocity)
            if scheme.interpolation == "cpgimp":
                mapping.tabulate(number)
                active = mapping.active
            mapping.scatter_state(tables.momentum)
        if self.watches_balance:
            self.balance.before_loads(tables.momentum, (active,))
        for load in self.loads:
            load.add_forces(number, tables.momentum)
        active = mapping.active  # loads may reach further nodes
        node_kernels.drop_slivers(active, tables.momentum, self.least_mass)
        # Velocities lag half a step behind positions, so points that are started from rest take half an impulse.
        impulse = 0.5 if self.at_rest else 1.0
        share = self.damping.force_factor * impulse
        self.at_rest = False
        if share != 1.0:
            scale_forces(active, tables.momentum, share)
        self._accelerate(active, share)
        self._book(active, impulse * dt)
        if self.watches_balance:
            self.residual = self.balance.residual(tables.momentum, tables.motion, (active,), dt, share)
        keep = self._choose_transfer(number, active)
        if scheme.integration in ("musl", "usavg"):
            self.largest_increment = mapping.update_remap(tables.motion, keep, dt, tables.velocity)
        elif scheme.integration == "usl":
            self.largest_increment = mapping.update_deform(tables.motion, keep, dt, self.stress)
        else:
            self.largest_increment = mapping.update(tables.motion, keep, dt)
        if not self.largest_increment < mapping.smallest_cell:
            return
        if self.rider is not None:
            self.rider.follow(tables.motion, dt)
        if scheme.integration in ("musl", "usavg"):
            node_kernels.divide(active, tables.momentum, 0, tables.velocity, tables.velocity)
            self._constrain(tables.velocity)
            if scheme.transfer == "fmpm" and scheme.order > 1 and scheme.filters(number):
                node_kernels.copy_velocity(active, tables.velocity, tables.filtered)
                self._filter(active, tables.velocity, before=False)
                node_kernels.blend(active, tables.filtered, STRAIN_SHARE, tables.velocity)
            mapping.deform(tables.velocity, dt if scheme.integration == "musl" else 0.5 * dt, True, self.stress)
        elif scheme.integration == "usf":
            mapping.move()
        if self.cracks is not None:
            self.cracks.move(mapping.points.rows, mapping.points.row_of)
        if self.damping.point_rate > 0.0:
            c = mapping.columns
            lost = damp_points(mapping.points.rows, mapping.alive, c.velocity, c.mass, self.damping.point_factor(dt))
            self.totals.damping_loss += lost
            self.totals.unfiltered -= lost
        mapping.travel += self.largest_increment

    def _locate(self, number: int) -> None:
        if self.cracks is None:
            self.boundary.locate(number)
        else:
            self.boundary.locate(number, self.cracks.field_map)

    def _constrain(self, velocity: FloatArray, before: bool = False) -> None:
        """Impose boundary conditions and contact on a table of nodal velocities."""
        self.boundary.impose(self.nodes.momentum, velocity, before)
        if self.cracks is not None:
            self.cracks.hold(self.nodes.momentum, velocity, self.time_step)

    def _accelerate(self, active: IntArray, share: float) -> None:
        """New nodal velocities under `share` of all forces, damping, boundary conditions and contact."""
        momentum, motion, dt = self.nodes.momentum, self.nodes.motion, self.time_step
        keep = self.damping.grid_factor(dt)
        node_kernels.accelerate(active, momentum, dt, keep, motion)
        work, not_lost = self.boundary.accelerate(momentum, motion, keep, share)
        self.totals.edge_work += work
        if keep < 1.0:
            # A node's kinetic energy before damping is its energy after it over keep^2.
            after = node_kernels.kinetic_energy(active, momentum, motion)
            self.totals.damping_loss += after * (1.0 / keep**2 - 1.0) - not_lost
        if self.cracks is not None:
            self.totals.friction_loss += self.cracks.hold(momentum, motion, dt, motion.shape[1] // 2)

    def _book(self, active: IntArray, duration: float) -> None:
        """Add what the nodes gained and the work of the loads; leaves velocities halfway in `filtered`."""
        tables = self.nodes
        keep = self.damping.grid_factor(self.time_step)
        self.totals.unfiltered += node_kernels.halfway(active, tables.momentum, tables.motion, keep, tables.filtered)
        for load in self.loads:
            load.book(tables.momentum, tables.filtered, duration)

    def _choose_transfer(self, number: int, active: IntArray) -> float:
        """Turn new velocity and increment into what moves the points and what becomes of their velocity.

        Returns the share of its old velocity that a point keeps.
        """
        scheme, tables = self.scheme, self.nodes
        if not scheme.filters(number):
            return 1.0
        dimension = tables.velocity.shape[1]
        if scheme.transfer == "xpic":
            node_kernels.old_velocity(active, tables.motion, tables.filtered)
            self._filter(active, tables.filtered.copy(), before=True)
            node_kernels.add_to_increment(active, tables.filtered, tables.motion)
            return 0.0
        node_kernels.copy_velocity(active, tables.motion, tables.filtered)
        if scheme.transfer == "fmpm" and scheme.order > 1:
            self._filter(active, tables.motion[:, :dimension], before=False)
        node_kernels.replace_motion(active, tables.filtered, tables.motion)
        return 0.0

    def _filter(self, active: IntArray, start: FloatArray, before: bool) -> None:
        """Turn `filtered`, which holds `start`, into Q_k of it."""
        tables = self.nodes
        for _ in range(self.scheme.passes):
            self.mapping.scatter_filtered(tables.filtered, tables.returned)
            node_kernels.filter_step(active, tables.momentum, start, tables.returned, tables.filtered)
            self._constrain(tables.filtered, before)
