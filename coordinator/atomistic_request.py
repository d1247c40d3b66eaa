"""The requests that a scene makes of the atomistic service."""

from __future__ import annotations

from typing import Any

import numpy as np

from coordinator.atomistic_tables import Atomistic
from coordinator.frame import Frame
from coordinator.handshake import HandshakeError
from coordinator.interface import Interface
from coordinator.scene import Scene
from coordinator.scene_tables import Handshake
from coordinator.table import Point
from coordinator.units import LENGTHS, readable
from protocol import atomistic as a
from protocol.arrays import FloatArray, IntArray

#: Windows of the reference average at least, so that its standard error can be estimated.
FEWEST_WINDOWS = 8


def configure_request(
    scene: Scene, frame: Frame, lattice_constant: float | None, keep: list[Point]
) -> a.AtomisticConfigure:
    """Return the whole atomistic problem of one region of a scene.

    Parameters
    ----------
    scene : Scene
    frame : Frame
        Where the sample lies.
    keep : list of tuple of float
        Polygon that holds the atoms, in the sample's frame, m; empty: all stay.
    lattice_constant : float or None
        As it was measured at the temperature of the run, m; None for that of the force field.

    Raises
    ------
    OSError
        If the file of the sample cannot be read.
    """
    table = scene.atomistic
    assert table is not None
    crack = crack_cut(scene, frame)
    what: dict[str, Any]
    if table.sample is None:
        what = {
            "sample": a.Sample(
                material=table.material, width=table.width, height=table.height, lattice_constant=lattice_constant,
                crack=crack, layers=table.layers, orientation=table.orientation,
            )
        }  # fmt: skip
    elif table.from_file:
        content = np.frombuffer((scene.folder / table.sample).read_bytes(), np.uint8)
        what = {"sample_file": a.SampleFile(periodic_z=table.periodic_z, crack=crack), "sample_data": content}
    else:
        what = {"sample_file": a.SampleFile(name=table.sample, periodic_z=table.periodic_z, crack=crack)}
    own = table.commands
    return a.AtomisticConfigure(
        force_field=table.force_field,
        temperature=table.temperature,
        time_step=table.time_step,
        seed=scene.run.seed,
        keep=keep,
        commands=None
        if own is None
        else a.ForceFieldCommands(unit_style=own.unit_style, atom_style=own.atom_style, commands=own.lines),
        **what,
    )


def crack_cut(scene: Scene, frame: Frame) -> a.CrackCut | None:
    """Return the crack of a scene as a sample has it from the start, in the sample's frame.

    None where the scene has none, or its tip on that side lies outside the sample.
    """
    crack, table = scene.crack, scene.atomistic
    if crack is None or table is None:
        return None
    tip = crack.start_x if frame.mirrored else crack.tip_x
    if tip is None:
        return None
    x, y = frame.x_to_sample(tip), crack.y - frame.centre[1]
    inside = abs(x) < 0.5 * table.width and abs(y) < 0.5 * table.height
    return a.CrackCut(tip_x=x, y=y) if inside else None


def register_request(
    handshake: Handshake,
    atom_id: IntArray,
    position: FloatArray,
    interface: Interface,
    stiffness: FloatArray,
    damping_share: FloatArray,
) -> a.AtomisticRegister:
    """Return the anchors of a scene.

    Parameters
    ----------
    handshake : Handshake
    atom_id : int64 array, shape (atoms,)
        As the service named them.
    position : float64 array, shape (anchors, 3)
        Of the anchors, m.
    interface : Interface
    stiffness : float64 array, shape (anchors,)
        N/m.
    damping_share : float64 array, shape (anchors,)
        Factor on the damper of each.
    """
    kinds = interface.anchor_kind
    return a.AtomisticRegister(
        atom_id=atom_id[interface.anchor],
        anchor_position=position,
        anchor_ivc=interface.anchor_ivc,
        stiffness=stiffness,
        damping_time=handshake.damping_time,
        # A service of an older protocol knows springs only.
        anchor_kind=kinds if (kinds != a.SPRING).any() else None,
        damping_share=damping_share if handshake.damping_time is not None and (damping_share != 1.0).any() else None,
        motion=handshake.motion,
    )


def equilibrate_request(scene: Scene) -> a.EquilibrateRequest:
    """Return how the atoms of a scene are brought to rest."""
    table, handshake = scene.atomistic, scene.handshake
    assert table is not None and handshake is not None
    window = handshake.steps_per_exchange
    assert window is not None  # chosen before
    bath = table.ensemble
    return a.EquilibrateRequest(
        steps=round(table.equilibration / table.time_step),
        windows=max(FEWEST_WINDOWS, round(table.reference / (window * table.time_step))),
        window_steps=window,
        ensemble=None
        if bath is None
        else a.Ensemble(
            thermostat=bath.thermostat, damping_time=bath.damping_time, pressure=bath.pressure,
            pressure_time=bath.pressure_time,
        ),
        keep_ensemble=bath is not None and bath.keep,
        settle=table.settle,
    )  # fmt: skip


def advance_request(handshake: Handshake, position: FloatArray, velocity: FloatArray) -> a.AtomisticAdvance:
    """Return one exchange with the anchors at positions, m, moving with velocities, m/s; shapes (anchors, 3)."""
    assert handshake.steps_per_exchange is not None  # chosen before
    return a.AtomisticAdvance(
        steps=handshake.steps_per_exchange,
        anchor_position=position,
        anchor_velocity=velocity,
        until_error=handshake.until_error,
        most_windows=handshake.most_windows if handshake.until_error is not None else 1,
    )


def grid_request(scene: Scene, low: FloatArray, high: FloatArray) -> a.GridFieldsRequest | None:
    """Return the grid of a scene over atoms between two corners, shape (3,), m; None where it has none."""
    table = scene.atomistic.fields if scene.atomistic is not None else None
    if table is None or table.spacing is None:
        return None
    radius = table.radius if table.radius is not None else 2.0 * table.spacing
    # Whole spacings around the middle, so that the grid is as even as the sample.
    counts = np.floor((high - low) / table.spacing).astype(int) + 1
    flat = scene.atomistic is not None and high[2] - low[2] < table.spacing
    if flat:
        counts[2] = 1
    origin = 0.5 * (low + high) - 0.5 * (counts - 1) * table.spacing
    return a.GridFieldsRequest(
        names=["density", "velocity", "displacement", "stress", "temperature"],
        origin=tuple(origin.tolist()),
        spacing=table.spacing,
        counts=tuple(counts.tolist()),
        radius=radius,
    )


def check_extent(table: Atomistic, cell_size: float, low: FloatArray, high: FloatArray) -> None:
    """Hold the sample of a file against what the scene says of it.

    Parameters
    ----------
    table : Atomistic
    cell_size : float
        Of the continuum, m: so far the two may differ.
    low, high : float64 array, shape (2,)
        Corners of the sample, m.

    Raises
    ------
    HandshakeError
        Where size or middle differ.
    """
    for axis, name in ((0, "width"), (1, "height")):
        wanted, found = getattr(table, name), float(high[axis] - low[axis])
        if abs(found - wanted) > cell_size:
            raise HandshakeError(
                f"the sample in {table.sample} extends over {readable(found, LENGTHS)} along {'xy'[axis]}; "
                f"atomistic.{name} is {readable(wanted, LENGTHS)}"
            )
        middle = float(0.5 * (low[axis] + high[axis]))
        if abs(middle) > 0.5 * cell_size:
            raise HandshakeError(
                f"the middle of the sample in {table.sample} lies at {'xy'[axis]} = {readable(middle, LENGTHS)}; "
                "it must be the origin, to half a cell of the continuum"
            )
