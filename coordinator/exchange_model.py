"""The exchange in one dimension, without services: a light continuum on a grid and a chain of atoms.

It makes the same coupling step as the services do (`coordinator.coupling`): the continuum advances by explicit steps
under the last reactions, its nodes give the anchors' places by linear shape functions, the atoms integrate M steps
of velocity Verlet with their anchors held, and the mean reaction goes back by the same shape functions. It is small
enough for 10^5 coupling steps in a second, which whole scenes are not.

Lengths are in widths L of the overlap, speeds in (E / rho)^(1/2), masses in rho L per area. Places count from the
outer border; the continuum lies to the left and in the overlap (0, 1), the atoms in it and to the right.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numba import njit

from coordinator.handshake import Scheme, damping_share
from coordinator.weight_profile import WeightProfile
from protocol.arrays import FloatArray

#: Energy beyond which a run that started with about one has blown up.
_RUNAWAY = 1e12


@dataclass(frozen=True)
class Model:
    """Two bars, their springs and dampers, and the time scheme.

    Attributes
    ----------
    profile : WeightProfile
    stiffness : float
        kappa L^2 / E at the outer border.
    coupling_step : float
        Dt, in L / c.
    steps_per_exchange : int
        M.
    damping : float
        L / (c tau); the damper follows the weight as in `coordinator.handshake.damping_share`.
    cells, atoms : int
        In one L.
    continuum_length, atoms_length : float
        Beyond the overlap, in L.
    scheme : {"serial", "parallel"}
    continuum_steps : int
        In one exchange.
    impulse : bool
        Whether the force acts in the first of them alone, or evenly in all.
    """

    profile: WeightProfile
    stiffness: float
    coupling_step: float
    steps_per_exchange: int
    damping: float = 0.0
    cells: int = 4
    atoms: int = 16
    continuum_length: float = 1.0
    atoms_length: float = 1.0
    scheme: Scheme = "serial"
    continuum_steps: int = 1
    impulse: bool = True

    @property
    def nodes(self) -> FloatArray:
        """Places of the nodes, shape (nodes,); the first one is held."""
        return np.arange(-round(self.continuum_length * self.cells), self.cells + 1) / self.cells

    @property
    def places(self) -> FloatArray:
        """Places of the atoms, shape (atoms,); beyond the last one is a held one."""
        return (np.arange(round((1.0 + self.atoms_length) * self.atoms)) + 0.5) / self.atoms

    def element_weights(self) -> FloatArray:
        """Mean factor on the mass of each element, shape (nodes - 1,)."""
        return self._mean(self.profile.at)

    def element_stiffness(self) -> FloatArray:
        """Mean factor on the stiffness of each element, shape (nodes - 1,)."""
        return self._mean(self.profile.stiffness_at)

    def _mean(self, factor: Callable[[FloatArray], FloatArray]) -> FloatArray:
        fine = self.nodes[:-1, None] + (np.arange(64) + 0.5) / 64 / self.cells
        return np.asarray(np.where(fine < 0.0, 1.0, factor(1.0 - fine)).mean(axis=1))


@dataclass
class State:
    """Displacements and velocities of nodes and atoms, reactions, and what the last steps left behind.

    Attributes
    ----------
    node, node_velocity : float64 array, shape (nodes,)
    atom, atom_velocity : float64 array, shape (atoms,)
    reaction : float64 array, shape (anchors,)
        Mean force on the continuum.
    velocity, last_velocity : float64 array, shape (anchors,)
        Of the anchors in the last step and in the one before, for the prediction of the parallel scheme.
    """

    node: FloatArray
    node_velocity: FloatArray
    atom: FloatArray
    atom_velocity: FloatArray
    reaction: FloatArray
    velocity: FloatArray
    last_velocity: FloatArray


def at_rest(model: Model) -> State:
    """Return the state without displacement."""
    nodes, atoms = len(model.nodes), len(model.places)
    anchors = int((model.places < 1.0).sum())
    return State(*(np.zeros(n) for n in (nodes, nodes, atoms, atoms, anchors, anchors, anchors)))


def shaken(model: Model, seed: int = 1) -> State:
    """Return a state of random velocities of unit variance in nodes and atoms."""
    state = at_rest(model)
    generator = np.random.default_rng(seed)
    state.node_velocity[1:] = generator.standard_normal(len(state.node) - 1)
    state.atom_velocity[:] = generator.standard_normal(len(state.atom))
    return state


def advance(model: Model, state: State, steps: int) -> FloatArray:
    """Make coupling steps; the state is changed.

    Returns
    -------
    energy : float64 array, shape (done, 3)
        Of the continuum, of the atoms, and in the springs, after each step; shorter than `steps` where the
        exchange blew up.
    """
    nodes, places = model.nodes, model.places
    h, a = 1.0 / model.cells, 1.0 / model.atoms
    weight = model.element_weights()
    mass = np.zeros(len(nodes))
    mass[:-1] += 0.5 * weight * h
    mass[1:] += 0.5 * weight * h
    share = 1.0 - places[places < 1.0]
    spring = model.stiffness * model.profile.at(share) / model.profile.at_border * a
    damper = model.damping * damping_share(model.profile, share) * a
    way = (places[places < 1.0] - nodes[0]) / h
    left = np.minimum(way.astype(np.int64), len(nodes) - 2)
    energy = np.zeros((steps, 3))
    done = _advance(
        steps, model.coupling_step, model.steps_per_exchange, model.continuum_steps, model.impulse,
        model.scheme == "parallel", model.element_stiffness() / h, mass, 1.0 / a, a, spring, damper, left, way - left,
        state.node, state.node_velocity, state.atom, state.atom_velocity, state.reaction, state.velocity,
        state.last_velocity, energy,
    )  # fmt: skip
    return energy[:done]


@njit(nogil=True, cache=True)
def _bar_forces(place, stiffness, force):  # type: ignore[no-untyped-def]  # numba
    """Add the forces of springs between neighbours; returns twice their energy."""
    energy = 0.0
    for e in range(len(place) - 1):
        stretch = place[e + 1] - place[e]
        pull = stiffness[e] * stretch
        force[e] += pull
        force[e + 1] -= pull
        energy += pull * stretch
    return energy


@njit(nogil=True, cache=True)
def _atom_forces(place, bond, spring, anchor, force):  # type: ignore[no-untyped-def]  # numba
    """Set the forces of bonds and springs on the atoms."""
    last = len(place) - 1
    force[:] = 0.0
    for i in range(last):
        pull = bond * (place[i + 1] - place[i])
        force[i] += pull
        force[i + 1] -= pull
    force[last] -= bond * place[last]
    for i in range(len(spring)):
        force[i] += spring[i] * (anchor[i] - place[i])


@njit(nogil=True, cache=True)
def _advance(  # type: ignore[no-untyped-def]  # numba
    steps, coupling_step, m_steps, n_steps, impulse, parallel, element, mass, bond, atom_mass, spring, damper, left,
    far, u, v, r, s, reaction, velocity, last_velocity, energy,
):  # fmt: skip
    anchors, nodes, atoms = len(spring), len(u), len(r)
    dt, sub = coupling_step / m_steps, coupling_step / n_steps
    force, pull = np.zeros(nodes), np.zeros(atoms)
    anchor, before = np.zeros(anchors), np.zeros(anchors)
    for step in range(steps):
        for i in range(anchors):
            j = left[i]
            before[i] = u[j] * (1.0 - far[i]) + u[j + 1] * far[i]
        if parallel:  # the anchors' place at the end of this step, predicted from what is known at its start
            for i in range(anchors):
                anchor[i] = before[i] + coupling_step * (2.0 * velocity[i] - last_velocity[i])
        for n in range(n_steps):
            force[:] = 0.0
            _bar_forces(u, element, force)
            if n == 0 or not impulse:
                for i in range(anchors):
                    given = reaction[i] * (n_steps if impulse else 1.0)
                    force[left[i]] += given * (1.0 - far[i])
                    force[left[i] + 1] += given * far[i]
            for k in range(1, nodes):
                v[k] += sub * force[k] / mass[k]
                u[k] += sub * v[k]
        for i in range(anchors):
            j = left[i]
            place = u[j] * (1.0 - far[i]) + u[j + 1] * far[i]
            moved = (place - before[i]) / coupling_step
            if parallel:
                last_velocity[i] = velocity[i]  # the damper still works against the velocity known at the start
                before[i] = moved
            else:
                anchor[i], velocity[i] = place, moved
            reaction[i] = 0.0
        # Atoms: half a friction step, kick, drift, kick, half a friction step, as the services have it.
        _atom_forces(r, bond, spring, anchor, pull)
        for _ in range(m_steps):
            for i in range(anchors):
                x = 0.5 * dt * damper[i] / atom_mass
                reaction[i] -= 0.5 * damper[i] * (velocity[i] - s[i]) / m_steps
                s[i] += x * (velocity[i] - s[i])
            for k in range(atoms):
                s[k] += 0.5 * dt * pull[k] / atom_mass
                r[k] += dt * s[k]
            for i in range(anchors):
                reaction[i] -= 0.5 * spring[i] * (anchor[i] - r[i] + dt * s[i]) / m_steps
            _atom_forces(r, bond, spring, anchor, pull)
            for i in range(anchors):
                reaction[i] -= 0.5 * spring[i] * (anchor[i] - r[i]) / m_steps
            for k in range(atoms):
                s[k] += 0.5 * dt * pull[k] / atom_mass
            for i in range(anchors):
                x = 0.5 * dt * damper[i] / atom_mass
                s[i] = (s[i] + x * velocity[i]) / (1.0 + x)
                reaction[i] -= 0.5 * damper[i] * (velocity[i] - s[i]) / m_steps
        if parallel:
            for i in range(anchors):
                velocity[i] = before[i]
        # Books.
        force[:] = 0.0
        energy[step, 0] = 0.5 * _bar_forces(u, element, force)
        for k in range(nodes):
            energy[step, 0] += 0.5 * mass[k] * v[k] ** 2
        energy[step, 1] = 0.5 * bond * r[atoms - 1] ** 2
        for k in range(atoms):
            energy[step, 1] += 0.5 * atom_mass * s[k] ** 2
        for k in range(atoms - 1):
            energy[step, 1] += 0.5 * bond * (r[k + 1] - r[k]) ** 2
        for i in range(anchors):
            j = left[i]
            gap = r[i] - u[j] * (1.0 - far[i]) - u[j + 1] * far[i]
            energy[step, 2] += 0.5 * spring[i] * gap**2
        if not energy[step, 0] + energy[step, 1] < _RUNAWAY:
            return step + 1
    return steps
