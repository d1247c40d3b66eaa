"""Time series that a coupling step gives, from the replies of the services; names are those of `coordinator.series`."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from coordinator.region import Region
from coordinator.scene import Scene
from coordinator.series import TIP_SERIES, series_name
from coordinator.strip import strip_j
from protocol import atomistic as a
from protocol import continuum as c
from protocol.arrays import FloatArray


def continuum_values(reply: c.ContinuumAdvanced) -> dict[str, float]:
    """Return energies, work and losses of the continuum."""
    values = {
        "continuum_kinetic": reply.kinetic_energy,
        "continuum_strain": reply.strain_energy,
        "continuum_edge_work": reply.edge_work,
        "continuum_interface_work": reply.interface_work,
        "continuum_damping_loss": reply.damping_loss,
        "continuum_load_work": reply.load_work,
        "continuum_dissipated": reply.dissipated_energy,
        "points_lost": float(reply.points_lost),
    }
    if reply.queried or reply.spared:
        values["plies_queried"], values["plies_spared"] = float(reply.queried), float(reply.spared)
    if reply.filter_loss is not None:
        values["continuum_filter_loss"] = reply.filter_loss
    if reply.momentum is not None:
        values["continuum_momentum_x"], values["continuum_momentum_y"] = reply.momentum
    return values


def boundary_values(scene: Scene, elastic: c.IsotropicMaterial | None, reply: c.ContinuumAdvanced) -> dict[str, float]:
    """Return load measures of the edges that pull the body apart, along y or else along x."""
    table = scene.continuum
    found: dict[str, float] = {}
    axis = table.pull_axis
    if axis is None:
        return found
    moved = {
        (edge.edge, edge.axis): (reply.edge_displacement[k], reply.edge_force[k])
        for k, edge in enumerate(table.edges)
        if edge.moves and edge.kind != "k_field"
    }
    top, bottom = (moved["top", 1], moved["bottom", 1]) if axis == 1 else (moved["right", 0], moved["left", 0])
    height = table.upper[axis] - table.lower[axis]
    strain = float(top[0] - bottom[0]) / height
    found["applied_strain"] = strain
    found["edge_force"] = float(top[1])
    if axis == 0:
        return found
    if scene.crack is not None and scene.crack.start_x is None and elastic is not None:
        found["j_boundary"] = strip_j(
            elastic, table.assumption, strain, height, sideways_free=("top", 0) not in moved
        )  # fmt: skip
    return found


def tip_values(tips: Sequence[c.CrackTip]) -> dict[str, float]:
    """Return place and measures of the continuum's crack tips, named by crack and end."""
    found: dict[str, float] = {}
    for tip in tips:
        values = {"x": tip.position[0], "y": tip.position[1], **{name: getattr(tip, name) for name in TIP_SERIES}}
        start = f"tip_{tip.crack}_{tip.end}_"
        found.update({start + name: value for name, value in values.items() if value is not None})
    return found


def atom_values(
    scene: Scene, region: Region, reply: a.AtomisticAdvanced, start_energy: float, *, alone: bool
) -> dict[str, float]:
    """Return what is told of each region apart: crack, bonds, temperature of the handshake.

    Parameters
    ----------
    scene : Scene
    region : Region
    reply : AtomisticAdvanced
    start_energy : float
        Potential energy at the first step, J.
    alone : bool
        Whether it is the only region; else names end with its own.
    """
    values = {
        "handshake_temperature": reply.handshake_temperature,
        "broken_bonds": float(reply.broken_bonds),
        "longest_bond": reply.longest_bond,
    }
    if reply.correlation_time is not None:
        values["correlation_time"] = reply.correlation_time
    if scene.handshake is not None and scene.handshake.until_error is not None:
        values["exchange_windows"] = float(reply.windows)
    if reply.crack_tip is not None:
        values["crack_tip"] = region.frame.x_to_scene(reply.crack_tip)
    if not alone:
        values["temperature"] = reply.temperature
        values["atomistic_potential"] = reply.potential_energy - start_energy
    return {series_name(name, region.name, alone): value for name, value in values.items()}


def regions_values(
    regions: Sequence[Region], replies: Sequence[a.AtomisticAdvanced], start_energy: FloatArray
) -> dict[str, float]:
    """Return energies of all atoms together, and balances of the interface.

    Parameters
    ----------
    regions : sequence of Region
    replies : sequence of AtomisticAdvanced
        One for each region.
    start_energy : float64 array, shape (regions,)
        Potential energies at the first step, J.
    """
    pairs = list(zip(regions, replies, strict=True))
    force = np.concatenate([reply.ivc_force for reply in replies])
    error = np.concatenate([reply.ivc_standard_error for reply in replies])
    atoms = np.array([len(region.atom_id) for region in regions])
    scale = sum(float(np.abs(reply.anchor_force).sum()) for reply in replies)
    imbalance = max(_imbalance(region, reply) for region, reply in pairs)
    values = {
        "atomistic_potential": sum(reply.potential_energy for reply in replies) - float(start_energy.sum()),
        "atomistic_kinetic": sum(reply.kinetic_energy for reply in replies),
        "spring_energy": sum(reply.spring_energy for reply in replies),
        "anchor_work": sum(reply.anchor_work for reply in replies),
        "temperature": float(np.average([reply.temperature for reply in replies], weights=atoms)),
        "force_sum_x": float(force[:, 0].sum()),
        "force_sum_y": float(force[:, 1].sum()),
        "force_balance": imbalance / scale if scale > 0 else 0.0,
        "ivc_force_rms": _rms(force[:, :2]),
        "ivc_error_rms": _rms(error[:, :2]),
    }
    if len(regions) > 1:
        anchors = [len(region.interface.anchor) for region in regions]
        values["handshake_temperature"] = float(
            np.average([reply.handshake_temperature for reply in replies], weights=anchors)
        )
        values["broken_bonds"] = float(sum(reply.broken_bonds for reply in replies))
        values["longest_bond"] = max(reply.longest_bond for reply in replies)
    heat = [reply.thermostat_work for reply in replies if reply.thermostat_work is not None]
    if len(heat) == len(replies):
        values["thermostat_work"] = sum(heat)
    momenta = [reply.momentum for reply in replies if reply.momentum is not None]
    if len(momenta) == len(replies):
        values["atomistic_momentum_x"], values["atomistic_momentum_y"] = np.sum(momenta, axis=0)[:2].tolist()
    return values


def _imbalance(region: Region, reply: a.AtomisticAdvanced) -> float:
    """Return the largest difference between a cell's force and the sum over its anchors, N.

    Summed here from the anchors, so that a service's own sums are checked cell by cell.
    """
    cell, cells = region.interface.anchor_ivc, len(reply.ivc_force)
    by_cell = np.column_stack([np.bincount(cell, reply.anchor_force[:, k], cells) for k in range(3)])
    return float(np.abs(by_cell - reply.ivc_force).max())


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))
