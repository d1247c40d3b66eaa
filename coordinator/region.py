"""One sample of atoms in a scene: its service, its place, its anchors.

Everything that a `Region` is given or gives lies in the scene's frame; the service knows its own.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from coordinator.atomistic_request import (
    advance_request,
    check_extent,
    configure_request,
    equilibrate_request,
    register_request,
)
from coordinator.frame import Frame
from coordinator.grid_lines import snapped_overlap
from coordinator.handshake import Handshake, choose
from coordinator.interface import Interface, build_interface
from coordinator.ring import Ring, rectangle_ring, shaped_ring
from coordinator.scene import Scene
from coordinator.scene_tables import Place
from protocol import atomistic as a
from protocol import continuum as c
from protocol.arrays import FloatArray, IntArray
from protocol.client import Client
from protocol.messages import FieldsReply, FieldsRequest

#: Mass between those of hydrogen and of any other element, kg.
HEAVIER_THAN_HYDROGEN = 2 * 1.66e-27


#: Distance above which two places are layers apart, m.
_LAYER = 5e-12
#: Spacings of atoms by which the outermost atom of a strip may lie inside of that of another.
_DEEPEST = 2.0


class Region:
    """Atoms behind one service.

    Parameters
    ----------
    scene : Scene
    place : Place
        Name and place of the sample.
    client : Client
        Of its service.

    Attributes
    ----------
    frame : Frame
    atom_id : int64 array, shape (atoms,)
    atom_mass : float64 array, shape (atoms,)
        kg.
    reference : float64 array, shape (atoms, 3)
        Places as built, m.
    anchor_reference : float64 array, shape (anchors, 3)
        Places of the anchors at rest, m.
    anchor_stiffness : float64 array, shape (anchors,)
        N/m.
    damping_share : float64 array, shape (anchors,)
        Factor on the damper of each.
    handshake : Handshake
    interface : Interface
        In the sample's own frame.
    """

    handshake: Handshake
    interface: Interface
    anchor_stiffness: FloatArray
    damping_share: FloatArray
    anchor_reference: FloatArray

    def __init__(self, scene: Scene, place: Place, client: Client) -> None:
        self.scene = scene
        self.name = place.name
        self.frame = Frame(place.centre, place.mirrored)
        self.client = client
        self.atom_id: IntArray = np.zeros(0, dtype=np.int64)
        self.atom_mass = np.zeros(0)
        self.reference = np.zeros((0, 3))
        self.own_reference = np.zeros((0, 3))

    # --- building ----------------------------------------------------------------------------------------

    def configure(self, lattice_constant: float | None) -> list[str]:
        """Build the sample; returns what a user should know."""
        table, handshake = self.scene.atomistic, self.scene.handshake
        assert table is not None and handshake is not None
        keep = [] if handshake.shape == "rectangle" else self._requested_ring().outer.tolist()
        request = configure_request(self.scene, self.frame, lattice_constant, keep)
        built = self.client.call("configure", request, a.AtomisticConfigured)
        self.atom_id, self.atom_mass, self.own_reference = built.atom_id, built.atom_mass, built.position
        self.reference = self.frame.to_scene(built.position)
        if table.sample is not None:
            low, high = self._corners()
            check_extent(table, self.scene.finest_cell, low, high)
        return built.warnings

    def join(self, material: c.IsotropicMaterial, courant: float) -> None:
        """Choose weight and stiffness of the handshake, anchor atoms, lay out cells.

        Parameters
        ----------
        material : IsotropicMaterial
            Of the continuum.
        courant : float
            Courant number of the continuum's step.

        Raises
        ------
        HandshakeError
            Where the exchange would be unstable.
        RingError
            Where the ring does not fit the sample.
        """
        scene, table = self.scene, self.scene.handshake
        assert table is not None
        ring = self._ring()
        crack_y = None if scene.crack is None else scene.crack.y - self.frame.centre[1]
        self.interface = build_interface(
            self.own_reference, ring, table.ivc_size, crack_y, table.passive_width or 0.0, table.surface_width or 0.0,
            table.anchor_spacing, self.atom_mass > HEAVIER_THAN_HYDROGEN,
        )  # fmt: skip
        self.anchor_reference = np.ascontiguousarray(self.reference[self.interface.anchor])
        # The anchors share the volume of the ring, which that of all its atoms is.
        in_ring = ~ring.inside(self.own_reference[:, :2])
        volume = float(self.atom_mass[in_ring].sum()) / material.density / len(self.interface.anchor)
        self.handshake = choose(
            material.young,
            material.density,
            ring.width,
            scene.time_step,
            damping_time=table.damping_time,
            weight=table.weight,
            stiffness_density=None if table.stiffness is None else table.stiffness / volume,
            profile=table.profile,
            scheme=table.scheme,
            courant=courant,
            stiff=table.preset == "seed",
            stiffness_share=table.stiffness_weight,
        )
        share = ring.share(self.own_reference[self.interface.anchor, :2])
        self.anchor_stiffness = (1.0 - table.alpha) * volume * self.handshake.stiffness_at(share)
        self.damping_share = self.handshake.damping_share_at(share)

    def register(self) -> None:
        """Tie the atoms to their anchors, at rest."""
        assert self.scene.handshake is not None
        self.client.call(
            "register",
            register_request(
                self.scene.handshake, self.atom_id, self.own_reference[self.interface.anchor], self.interface,
                self.anchor_stiffness, self.damping_share,
            ),
            a.AtomisticRegistered,
        )  # fmt: skip

    def equilibrate(self) -> a.Equilibrated:
        """Bring the atoms to temperature, anchors at rest, and measure the reference forces."""
        table = self.scene.atomistic
        assert table is not None
        if table.collects:
            # On before the reference is measured: J counts from the energies and stresses without load.
            self.client.call("collect_fields", a.CollectRequest(active=True), a.Collecting)
        return self.client.call("equilibrate", equilibrate_request(self.scene), a.Equilibrated)

    def displace(self, displacement: FloatArray) -> None:
        """Move all atoms and anchors by displacements, shape (atoms, 3), m."""
        own = np.ascontiguousarray(self.frame.turn(displacement))
        anchor = self.interface.anchor
        request = a.DisplaceRequest(
            displacement=own, anchor_position=np.ascontiguousarray(self.own_reference[anchor] + own[anchor])
        )
        self.client.call("displace", request, a.Displaced)

    def overlap(self) -> c.OverlapRegion:
        """Return the overlap as the continuum sees it."""
        assert self.scene.handshake is not None
        ring = self.interface.ring
        return c.OverlapRegion(
            inner=[tuple(p) for p in self.frame.to_scene(ring.inner).tolist()],
            outer=[tuple(p) for p in self.frame.to_scene(ring.outer).tolist()],
            weight=self.handshake.weight,
            profile=self.handshake.profile.kind,
            exponent=self.handshake.exponent,
            stiffness=self.handshake.stiffness_share,
        )

    def cells(self) -> tuple[FloatArray, FloatArray]:
        """Return lower and upper corners of the volume cells, shape (ivcs, 3), m."""
        ends = self.frame.to_scene(self.interface.ivc_lower), self.frame.to_scene(self.interface.ivc_upper)
        return np.minimum(*ends), np.maximum(*ends)

    # --- one step ----------------------------------------------------------------------------------------

    def advance(self, position: FloatArray, velocity: FloatArray, step: int) -> a.AtomisticAdvanced:
        """Make one exchange with the anchors at positions, m, of velocities, m/s, shape (anchors, 3)."""
        handshake = self.scene.handshake
        assert handshake is not None
        request = advance_request(handshake, self.frame.to_sample(position), self.frame.turn(velocity))
        reply = self.client.call("advance", request, a.AtomisticAdvanced, step=step)
        if not self.frame.mirrored:
            return reply
        turned: dict[str, object] = {
            name: self.frame.turn(getattr(reply, name)) for name in ("anchor_force", "ivc_force")
        }
        if reply.momentum is not None:
            turned["momentum"] = (-reply.momentum[0], *reply.momentum[1:])
        return reply.model_copy(update=turned)

    def positions(self) -> FloatArray:
        """Return places of all atoms now, shape (atoms, 3), m."""
        reply = self.client.call("fields", FieldsRequest(names=["position"]), FieldsReply)
        return self.frame.to_scene(reply.fields["position"])

    # --- inside ------------------------------------------------------------------------------------------

    def _corners(self) -> tuple[FloatArray, FloatArray]:
        return self.own_reference[:, :2].min(axis=0), self.own_reference[:, :2].max(axis=0)

    def _ring(self) -> Ring:
        """Return the ring of the sample as it was built."""
        handshake = self.scene.handshake
        assert handshake is not None
        if handshake.shape != "rectangle":
            return self._requested_ring()
        low, high = self._corners()
        lower = self.frame.grid_corner(self.scene.continuum.lower)
        inner, _ = snapped_overlap(
            lower, self.scene.finest_cell, float(high[0] - low[0]), float(high[1] - low[1]), handshake.width
        )
        low, high = _material_edges(self.own_reference[:, :2])
        return rectangle_ring(inner, low, high, list(handshake.sides))

    def _requested_ring(self) -> Ring:
        """Return a circle's or polygon's ring in the sample that the scene asks for."""
        table, handshake = self.scene.atomistic, self.scene.handshake
        assert table is not None and handshake is not None and handshake.shape != "rectangle"
        half = 0.5 * np.array([table.width, table.height])
        return shaped_ring(handshake.shape, -half, half, handshake.width, handshake.corners)


def _material_edges(places: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return corners of a sample's material, m, from places of its atoms, shape (atoms, 2).

    Each side lies at the mean of its outermost atoms: where they stand in a zigzag, a box around all would count
    material that is not there. The mouth of a crack is no side. A single row of atoms, as theory in one dimension
    has it, ends half a layer beyond the last of them.
    """
    low, high = places.min(axis=0), places.max(axis=0)
    extent = high - low
    if extent.min() < _LAYER:
        return low - 0.5 * extent / (len(places) - 1), high + 0.5 * extent / (len(places) - 1)
    # Strips a little wider than atoms are apart: in a straight row each of them holds one.
    spacing = 1.001 * float(np.median(cKDTree(places).query(places, 2)[0][:, 1]))
    for axis in (0, 1):
        strip = ((places[:, 1 - axis] - low[1 - axis]) / spacing).astype(np.int64)
        for sign, side in ((-1.0, low), (1.0, high)):
            outermost = np.full(strip.max() + 1, -np.inf)
            np.maximum.at(outermost, strip, sign * places[:, axis])
            side[axis] = sign * outermost[outermost > outermost.max() - _DEEPEST * spacing].mean()
    return low, high
