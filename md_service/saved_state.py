"""States of engines: positions, velocities, counters, ensemble, anchors as named arrays."""

from __future__ import annotations

from typing import Any, Final, cast

import numpy as np
from numpy.typing import NDArray

from md_service.anchors import Anchors, finite_array
from md_service.cuts import Cut
from md_service.dynamics import State
from md_service.ensembles import THERMOSTATS, Ensemble, Thermostat

_ANCHOR_ARRAYS: Final = ("atom_id", "position", "velocity", "stiffness", "ivc", "damping", "kind", "force")


def packed_state(
    position: NDArray[np.float64],
    velocity: NDArray[np.float64],
    counters: tuple[int, ...],
    ensemble: Ensemble | None,
    anchors: Anchors | None,
    cuts: tuple[Cut, ...] = (),
) -> State:
    """Arrays of their own from what an engine holds.

    Parameters
    ----------
    position, velocity : ndarray, shape (n, 3)
        m and m/s.
    counters : tuple of int
        Step first, then whatever the engine counts.
    ensemble : Ensemble or None
    anchors : Anchors or None
    cuts : tuple of Cut
    """
    state = {
        "position": np.array(position),
        "velocity": np.array(velocity),
        "counters": np.array(counters, dtype=np.float64),
        "ensemble": np.zeros(0),
        "cuts": np.array([[cut.from_x, cut.to_x, cut.y] for cut in cuts]).reshape(-1, 3),
    }
    if ensemble is not None:
        kind, held = THERMOSTATS.index(ensemble.thermostat), ensemble.pressure is not None
        bath = [kind, ensemble.temperature, ensemble.damping_time]
        state["ensemble"] = np.array([*bath, held, ensemble.pressure if held else 0.0, ensemble.pressure_time])
    if anchors is not None:
        for name in _ANCHOR_ARRAYS:
            state[f"anchor_{name}"] = np.array(getattr(anchors, name), dtype=np.float64)
        state["anchor_moving"] = np.array([float(anchors.moving)])
    return state


def unpacked_state(
    state: State, n_atoms: int, n_counters: int
) -> tuple[NDArray[np.float64], NDArray[np.float64], list[int], Ensemble | None, Anchors | None]:
    """Undo `packed_state`.

    Raises
    ------
    ValueError
        If an array is missing, has another shape than this system's, or holds values that are not finite.
    """
    missing = [name for name in ("position", "velocity", "counters", "ensemble") if name not in state]
    if missing:
        raise ValueError(f"state lacks {', '.join(missing)}; only what the method state answers can be restored")
    position = finite_array("state.position", state["position"], (n_atoms, 3))
    velocity = finite_array("state.velocity", state["velocity"], (n_atoms, 3))
    counters = finite_array("state.counters", state["counters"], (n_counters,))
    ensemble = None
    if np.size(state["ensemble"]):
        kind, temperature, damping_time, held, pressure, pressure_time = finite_array(
            "state.ensemble", state["ensemble"], (6,)
        ).tolist()
        if kind not in range(len(THERMOSTATS)):
            raise ValueError(f"state.ensemble holds thermostat {kind}; allowed are 0 to {len(THERMOSTATS) - 1}")
        thermostat = cast(Thermostat, THERMOSTATS[int(kind)])
        ensemble = Ensemble(thermostat, temperature, damping_time, pressure if held else None, pressure_time)
    return position, velocity, [int(value) for value in counters], ensemble, _anchors_of(state, n_atoms)


def cuts_of(state: State) -> tuple[Cut, ...]:
    """The cuts in a state of `packed_state`.

    Raises
    ------
    ValueError
        If they are missing or no lines.
    """
    if "cuts" not in state:
        raise ValueError("state lacks cuts; only what the method state answers can be restored")
    lines = finite_array("state.cuts", state["cuts"], (len(np.atleast_1d(state["cuts"])), 3))
    return tuple(Cut(*line) for line in lines.tolist())


def _anchors_of(state: State, n_atoms: int) -> Anchors | None:
    if "anchor_atom_id" not in state:
        return None
    missing = [name for name in (*_ANCHOR_ARRAYS, "moving") if f"anchor_{name}" not in state]
    if missing:
        raise ValueError(f"state lacks anchor_{missing[0]}; only what the method state answers can be restored")
    count = np.size(state["anchor_atom_id"])
    values: dict[str, Any] = {}
    for name in _ANCHOR_ARRAYS:
        shape = (count, 3) if name in ("position", "velocity", "force") else (count,)
        array = finite_array(f"state.anchor_{name}", state[f"anchor_{name}"], shape)
        values[name] = array.astype(np.int64) if name in ("atom_id", "ivc", "kind") else array
    outside = values["atom_id"][(values["atom_id"] < 0) | (values["atom_id"] >= n_atoms)]
    if len(outside):
        raise ValueError(f"state.anchor_atom_id holds {outside[0]}; allowed are 0 to {n_atoms - 1}")
    return Anchors(**values, moving=bool(np.ravel(state["anchor_moving"])[0]))
