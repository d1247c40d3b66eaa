"""Anchors inside LAMMPS: per-atom arrays, the forces made of them, window means.

``fix addforce`` applies c + w n - k r from per-atom arrays, with c = k a + gamma v_a + f and, for moving anchors,
w = k v dt and n the steps since the window's start; ``fix langevin`` applies -gamma v and the noise that belongs to
gamma at the run's temperature. Per window of M steps ``fix ave/atom`` averages positions and velocities, from which
the mean reaction follows. Nothing of this runs in Python within a window, and every part works under MPI.

Passive atoms are no part of the integration: ``fix nve/noforce`` carries them along with the anchors.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from md_service.anchors import Anchors
from md_service.atom_system import AtomSystem

HANDSHAKE: Final = "handshake"
PASSIVE: Final = "passive"
MOBILE: Final = "mobile"
ANCHORED: Final = "anchored"
_INNER_NUMBER, _HANDSHAKE_NUMBER, _PASSIVE_NUMBER = 0, 1, 2


#: Groups in LAMMPS are few.
_MOST_DAMPERS: Final = 16


def damper_group(number: int) -> str:
    """Name of the group of anchored atoms that have one damping time."""
    return f"damper_{number}"


class LammpsAnchors:
    """Anchors of one built `AtomSystem`.

    Parameters
    ----------
    system : AtomSystem
        The atoms.
    anchors : Anchors
        As registered; their position and velocity change between windows.
    """

    def __init__(self, system: AtomSystem, anchors: Anchors) -> None:
        self._system = system
        self._anchors = anchors
        self.row_of_atom = np.full(system.n_atoms, -1, dtype=np.int64)
        self.row_of_atom[anchors.atom_id] = np.arange(len(anchors.atom_id))
        #: 0 for inner, 1 for anchored, 2 for passive atoms, shape (n,)
        self.group_of_atom = np.full(system.n_atoms, _INNER_NUMBER, dtype=np.int64)
        self.group_of_atom[anchors.atom_id] = np.where(anchors.passive, _PASSIVE_NUMBER, _HANDSHAKE_NUMBER)
        mass = system.atoms.atom_mass[anchors.atom_id]
        #: Distinct damping times, s; atoms of each are the group `damper_group`.
        self.damping_times, which = anchors.damping_times(mass)
        if len(self.damping_times) > _MOST_DAMPERS:
            raise ValueError(
                f"damping_share gives {len(self.damping_times)} distinct damping times; LAMMPS takes {_MOST_DAMPERS}"
            )
        self._damper_of_atom = np.full(system.n_atoms, -1, dtype=np.int64)
        self._damper_of_atom[anchors.atom_id] = which
        self._start = 0  # LAMMPS step at which moving anchors began their way
        self.has_passive = bool(anchors.passive.any())
        self.has_springs = not anchors.passive.all()
        self._periodic = system.atoms.box.periodic
        self._current = [
            f"c_anchor_unwrapped[{column}]" if periodic else axis
            for column, (axis, periodic) in enumerate(zip("xyz", self._periodic, strict=True), start=1)
        ]

    def install(self) -> None:
        """Make arrays, groups and forces in LAMMPS; once after each build."""
        arrays = "i_anchor_group i_anchor_damper d_anchor_k d2_anchor_c 3 d2_anchor_w 3"
        self._command([f"fix anchor_data all property/atom {arrays}"])
        rows = self._system.local_rows()
        self._system.session.lmp.numpy.extract_atom("i_anchor_group")[: len(rows)] = self.group_of_atom[rows]
        self._system.session.lmp.numpy.extract_atom("i_anchor_damper")[: len(rows)] = self._damper_of_atom[rows]
        for group, number in ((HANDSHAKE, _HANDSHAKE_NUMBER), (PASSIVE, _PASSIVE_NUMBER)):
            self._command(
                [
                    f"variable of_group atom i_anchor_group=={number}",
                    f"group {group} variable of_group",
                    "variable of_group delete",
                ]
            )
        for number in range(len(self.damping_times)):
            self._command(
                [
                    f"variable of_damper atom i_anchor_damper=={number}",
                    f"group {damper_group(number)} variable of_damper",
                    "variable of_damper delete",
                ]
            )
        self._command([f"group {MOBILE} subtract all {PASSIVE}", f"group {ANCHORED} union {HANDSHAKE} {PASSIVE}"])
        if any(self._periodic):
            self._command([f"compute anchor_unwrapped {ANCHORED} property/atom xu yu zu"])
        if self.has_passive:
            self._command([f"fix carried {PASSIVE} nve/noforce"])
        if self._anchors.moving:
            self._command(["variable anchor_start internal 0.0"])
        self.write()
        self._command(self._force_commands())

    def write(self, forces_known: bool = False) -> None:
        """Hand the anchors' positions and velocities to LAMMPS and put passive atoms to their places.

        Parameters
        ----------
        forces_known : bool
            Whether LAMMPS goes on from the forces that it has, of the last step's end. Those of the springs are then
            brought to the new anchors here, since the first half kick is made with them. What passive atoms pull at
            their new places is in it half a step late: a setup would know it, and draw the noise of that step anew.
        """
        system, anchors = self._system, self._anchors
        row = self.row_of_atom[system.local_rows()]
        local = np.flatnonzero(row >= 0)
        row = row[local]
        units = system.units
        stiffness = anchors.stiffness[row] / units.stiffness
        extract = system.session.lmp.numpy.extract_atom
        extract("d_anchor_k")[local] = stiffness
        constant = (anchors.damping[row, None] * anchors.velocity[row] + anchors.force[row]) / units.force
        carrying = extract("d2_anchor_c")
        before = carrying[local].copy()
        carrying[local] = stiffness[:, None] * (anchors.position[row] / units.length) + constant
        after = carrying[local]
        if anchors.moving:
            now = int(system.session.lmp.extract_global("ntimestep"))
            moved = extract("d2_anchor_w")
            before += moved[local] * (now - self._start)
            moved[local] = stiffness[:, None] * (anchors.velocity[row] * (system.time_step / units.length))
            self._start = now
            system.session.lmp.set_internal_variable("anchor_start", float(now))
        passive = anchors.passive[row]
        if forces_known:
            system.local("f")[local[~passive]] += (after - before)[~passive]
        if self.has_passive:
            local, row = local[passive], row[passive]
            here = system.local_position()[local]
            system.local("x")[local] += anchors.position[row] / units.length - here
            speed = anchors.velocity[row] if anchors.moving else np.zeros((len(row), 3))
            system.local("v")[local] = speed / units.velocity

    def _force_commands(self) -> list[str]:
        terms = []
        for column, current in enumerate(self._current, start=1):
            moved = f"+d2_anchor_w[{column}]*(step-v_anchor_start)" if self._anchors.moving else ""
            terms.append(f"d2_anchor_c[{column}]{moved}-d_anchor_k*{current}")
        lines = [f"variable anchor_f{axis} atom {term}" for axis, term in zip("xyz", terms, strict=True)]
        if not self.has_springs:
            return []
        return [*lines, f"fix anchor_force {HANDSHAKE} addforce v_anchor_fx v_anchor_fy v_anchor_fz"]

    def energy_commands(self) -> list[str]:
        """Commands that put anchors at rest with their energy in place of `install`'s force, for minimisation."""
        commands = [f"fix held {PASSIVE} setforce 0.0 0.0 0.0"] if self.has_passive else []
        if not self.has_springs:
            return commands
        # With anchors at rest c / k is the anchor's position; where k = 0, c is a constant force.
        far = "+".join(
            f"({x}-d2_anchor_c[{i}]/(d_anchor_k+(d_anchor_k==0)))^2" for i, x in enumerate(self._current, start=1)
        )
        push = "+".join(f"d2_anchor_c[{i}]*{x}" for i, x in enumerate(self._current, start=1))
        return [
            *commands,
            "unfix anchor_force",
            f"variable anchor_energy atom 0.5*d_anchor_k*({far})-(d_anchor_k==0)*({push})",
            f"fix anchor_force {HANDSHAKE} addforce v_anchor_fx v_anchor_fy v_anchor_fz energy v_anchor_energy",
            "fix_modify anchor_force energy yes",
        ]

    def averaging_commands(self, window: int) -> list[str]:
        """``fix ave/atom`` over windows of M steps: positions and velocities, and forces on passive atoms."""
        place = " ".join(self._current)
        lines = [f"fix window_mean {ANCHORED} ave/atom 1 {window} {window} {place} vx vy vz"]
        if self.has_passive:
            lines.append(f"fix window_force {PASSIVE} ave/atom 1 {window} {window} fx fy fz")
        return lines

    def removal_commands(self) -> list[str]:
        """Undo `averaging_commands`."""
        return ["unfix window_mean", *(["unfix window_force"] if self.has_passive else [])]

    def _command(self, lines: list[str]) -> None:
        self._system.session.commands(lines)

    def local_means(self) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Of this rank's anchored atoms: rows (l,) of the anchors, and mean position and velocity, mean force on
        passive atoms, position and velocity now, (l, 15), in LAMMPS units."""
        row = self.row_of_atom[self._system.local_rows()]
        local = np.flatnonzero(row >= 0)
        extract_fix = self._system.session.lmp.numpy.extract_fix
        means = np.zeros((len(local), 15))
        means[:, :6] = extract_fix("window_mean", 1, 2)[local]
        if self.has_passive:
            means[:, 6:9] = extract_fix("window_force", 1, 2)[local]
        means[:, 9:12] = self._system.local_position()[local]
        means[:, 12:] = self._system.local("v")[local]
        return row[local], means
