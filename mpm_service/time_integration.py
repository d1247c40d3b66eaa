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

Energy. Sums over nodes of force times velocity hold what a step does with it. With K the kinetic energy of the points,
V their strain energy, v_old and v_new the nodal velocities before and after the momentum update, v_s that of the
strain update, f the internal force at its start and f' that after it (found in the next step):

    nodes     K(v_new) - K(v_old) = dt sum (f + f_ext) (v_old + v_new)/2 + edge work - damping loss
    strain    V' - V              = -dt sum (f + f')/2 v_s
    anchors   W' - W              =  dt sum g (v_a + v_a')/2

The first is exact, and all works but that of the anchors are booked with the same mean velocity; the second is exact
for a law that is linear. Anchors ride with v_s, v_a and v_a' are their velocities in the step before and in this one,
and g the forces on them: their springs are strained as the points are, so what they give is told in the same way.
What the way to the nodes and back takes is the rest of each:

    filter    [K - K(v_old)] + [K(v_new) - K'] - dt sum f (v_old + v_new)/2 + dt sum (f + f')/2 v_s
              - dt sum g (v_old + v_new)/2 + (W' - W)

All but its first two terms matter: what points lose with FLIP and MUSL or USF their strain energy gets, and with FMPM
short waves that are forced put more into strain than the nodes gave. A velocity lies half a step before the place and
the stress that it leads to, so V is told less the half of the last strain update that f' has not been booked for:
otherwise K + V would swing by the first order of dt. (USF updates the strain at the start of a step; with it the swing
is in the filter loss.)

Neither f nor g goes through a filter on its way to the nodes. On points that stay where they are v_s = F v_new, with F
self-adjoint in the nodal masses m: strain and springs then belong to one conservative system of the masses m F^-1, and
only the smoothing of velocities takes energy from it. Spread through F as well, g and f would have no common energy,
and g would lose its moment where masses are uneven, since F keeps constants there but not linear functions.
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
from .scheme import Scheme

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

#: Share of the filtered velocity in the strain update of FMPM(k > 1).
STRAIN_SHARE = 0.7


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
    internal: FloatArray
    """(R, d) internal force."""

    @classmethod
    def zeros(cls, rows: int, dimension: int) -> Nodes:
        """Empty tables."""
        return cls(
            np.zeros((rows, 1 + 2 * dimension)),
            np.zeros((rows, 2 * dimension)),
            *(np.zeros((rows, dimension)) for _ in range(4)),
        )


@dataclass
class Totals:
    """What a run has summed up since step 0 [J]."""

    edge_work: float = 0.0
    damping_loss: float = 0.0
    friction_loss: float = 0.0
    unfiltered: float = 0.0
    """Kinetic energy that the points would have, had the way to the nodes and back taken nothing."""
    pending: float = 0.0
    """Duration of the last strain update as long as the second half of its work is not known [s]."""
    half: float = 0.0
    """Work of the internal forces in the first half, or in the second, where that had to be found already."""


class NodalLoad(Protocol):
    """A load that puts forces on nodes and books their work."""

    def add_forces(self, step: int, momentum: FloatArray) -> None:
        """Add forces [N] to the force columns."""

    def book(self, momentum: FloatArray, halfway: FloatArray, duration: float) -> None:
        """Add the work of the forces on nodes that move with velocities (R, d) [m/s] for a time [s]."""


class Rider(Protocol):
    """What moves with the nodes."""

    def follow(self, motion: FloatArray, time_step: float) -> float:
        """Move with the velocities in the first columns of a table [m/s].

        Returns by how much the work of its forces on it exceeds that on the nodes in this step [J].
        """


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

    def settle(self) -> None:
        """Find what is pending, before the order of points or nodes changes."""
        self.totals.half = self.pending_work()
        self.totals.pending = 0.0

    def pending_work(self) -> float:
        """Work of the internal forces, as they are between two steps, in the second half of the last strain update.

        That of the first half where forces cannot be had: points have left the grid, or cracks lie near other nodes.
        """
        if self.totals.pending == 0.0:
            return self.totals.half
        self.must_sort()
        if (self.cracks is not None and self.cracks.changed) or not self.mapping.may_sweep():
            return self.totals.half
        self.gather_state()
        force = self.nodes.momentum[:, 1 + self.mapping.columns.dimension :]
        return float(0.5 * self.totals.pending * node_kernels.power(self.mapping.active, force, self.strain_velocity))

    @property
    def strain_velocity(self) -> FloatArray:
        """Nodal velocity of the last strain update, in the first columns."""
        return self.nodes.motion if self.scheme.integration == "usl" else self.nodes.velocity

    def sort(self) -> None:
        """Sort the points; `settle` first."""
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

    def step(self, number: int) -> None:
        """Make the step from `number` to `number` + 1; sets `largest_increment` [m].

        If that is not below a cell the step was stopped half done.
        """
        mapping, tables, scheme, dt = self.mapping, self.nodes, self.scheme, self.time_step
        mapping.tabulate(number)
        self._locate(number)
        active = mapping.active
        node_kernels.clear(active, tables.momentum)

        mapping.scatter_state(tables.momentum)
        self._take_internal(active)
        if scheme.integration in ("usf", "usavg"):
            share = 1.0 if scheme.integration == "usf" else 0.5
            node_kernels.drop_slivers(active, tables.momentum, self.least_mass)
            node_kernels.divide(active, tables.momentum, 1, tables.momentum, tables.velocity)
            self._constrain(tables.velocity, before=True)
            self._book_strain(active, share * dt)
            mapping.deform(tables.velocity, share * dt, False, self.stress)
            # All again and not the forces alone: domains that convect have changed with the strain.
            node_kernels.clear(active, tables.momentum)
            if scheme.interpolation == "cpgimp":
                mapping.tabulate(number)
                active = mapping.active
            mapping.scatter_state(tables.momentum)
            self._take_internal(active)
        if scheme.integration != "usl":
            node_kernels.clear(active, tables.velocity)
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
        self._book_forces(active, impulse * dt)
        if self.watches_balance:
            self.residual = self.balance.residual(tables.momentum, tables.motion, (active,), dt, share)
        keep = self._choose_transfer(number, active)
        if scheme.integration in ("musl", "usavg"):
            self.largest_increment = mapping.update_remap(tables.motion, keep, dt, tables.velocity)
        elif scheme.integration == "usl":
            self._book_strain(active, dt)
            self.largest_increment = mapping.update_deform(tables.motion, keep, dt, self.stress)
        else:
            self.largest_increment = mapping.update(tables.motion, keep, dt)
        if not self.largest_increment < mapping.smallest_cell:
            return
        if scheme.integration in ("musl", "usavg"):
            node_kernels.divide(active, tables.momentum, 0, tables.velocity, tables.velocity)
            self._constrain(tables.velocity)
            if scheme.transfer == "fmpm" and scheme.order > 1 and scheme.filters(number):
                node_kernels.copy_velocity(active, tables.velocity, tables.filtered)
                self._filter(active, tables.velocity, before=False)
                node_kernels.blend(active, tables.filtered, STRAIN_SHARE, tables.velocity)
            share = 1.0 if scheme.integration == "musl" else 0.5
            self._book_strain(active, share * dt)
            mapping.deform(tables.velocity, share * dt, True, self.stress)
        elif scheme.integration == "usf":
            mapping.move()
        if self.rider is not None:
            # With the strain: the gradient of what they have moved by is then the one that the points carry.
            carrier = tables.motion if scheme.integration in ("usf", "usl") else tables.velocity
            self.totals.unfiltered += self.rider.follow(carrier, dt)
        if self.cracks is not None:
            self.cracks.move(mapping.points.rows, mapping.points.row_of)
        if self.damping.point_rate > 0.0:
            c = mapping.columns
            lost = damp_points(mapping.points.rows, mapping.alive, c.velocity, c.mass, self.damping.point_factor(dt))
            self.totals.damping_loss += lost
            self.totals.unfiltered -= lost / self.damping.force_factor
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

    def _take_internal(self, active: IntArray) -> None:
        """Keep the internal forces, and book the second half of the strain update that led to them."""
        tables, totals = self.nodes, self.totals
        power = node_kernels.keep_forces(active, tables.momentum, self.strain_velocity, tables.internal)
        if totals.pending > 0.0:
            totals.half = 0.5 * totals.pending * power
        totals.unfiltered += totals.half
        totals.pending = totals.half = 0.0

    def _book_strain(self, active: IntArray, duration: float) -> None:
        """Book the first half of a strain update."""
        power = node_kernels.power(active, self.nodes.internal, self.strain_velocity)
        self.totals.pending, self.totals.half = duration, 0.5 * duration * float(power)
        self.totals.unfiltered += self.totals.half

    def _book_forces(self, active: IntArray, duration: float) -> None:
        """Book what forces other than internal ones gave the nodes; leaves velocities halfway in `filtered`."""
        tables = self.nodes
        keep = self.damping.grid_factor(self.time_step)
        gain = node_kernels.halfway(active, tables.momentum, tables.motion, keep, tables.filtered)
        self.boundary.hold_halfway(tables.filtered, keep)
        power = float(node_kernels.power(active, tables.internal, tables.filtered))
        self.totals.unfiltered += gain / self.damping.force_factor - duration * power
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
