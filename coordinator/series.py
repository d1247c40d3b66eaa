"""Time series that a run writes: their names, units and meaning, and how the report scales them."""

from __future__ import annotations

import re
from dataclasses import dataclass


@dataclass(frozen=True)
class Series:
    """What a time series is.

    Parameters
    ----------
    unit : str
        Unit in the file, SI.
    description : str
        What it measures, for labels.
    """

    unit: str
    description: str


SERIES: dict[str, Series] = {
    "time": Series("s", "time since the start of the coupled run"),
    "continuum_kinetic": Series("J", "kinetic energy of the continuum"),
    "continuum_strain": Series("J", "strain energy of the continuum"),
    "continuum_edge_work": Series("J", "work done on the continuum by its edges"),
    "continuum_interface_work": Series("J", "work done on the continuum by the atoms"),
    "continuum_damping_loss": Series("J", "energy taken from the continuum by damping"),
    "continuum_load_work": Series("J", "work done on the continuum by tractions, body force and absorbing edges"),
    "continuum_dissipated": Series("J", "energy taken by plastic flow, failure and friction"),
    "atomistic_potential": Series("J", "potential energy of the atoms against the start"),
    "atomistic_kinetic": Series("J", "kinetic energy of the atoms"),
    "spring_energy": Series("J", "energy in the anchor springs"),
    "anchor_work": Series("J", "work done on the springs by moving anchors"),
    "temperature": Series("K", "temperature of all atoms"),
    "handshake_temperature": Series("K", "temperature of the anchored atoms"),
    "force_sum_x": Series("N", "sum of the interface forces, x"),
    "force_sum_y": Series("N", "sum of the interface forces, y"),
    "force_balance": Series("1", "imbalance between cell forces and anchor forces, relative"),
    "ivc_force_rms": Series("N", "force on an interface volume cell, root mean square"),
    "ivc_error_rms": Series("N", "standard error of that force, root mean square"),
    "continuum_filter_loss": Series("J", "energy taken by the way from points to grid and back"),
    "continuum_momentum_x": Series("kg m/s", "momentum of the continuum, x"),
    "continuum_momentum_y": Series("kg m/s", "momentum of the continuum, y"),
    "atomistic_momentum_x": Series("kg m/s", "momentum of the atoms, x"),
    "atomistic_momentum_y": Series("kg m/s", "momentum of the atoms, y"),
    "reference_work": Series("J", "work of the reference forces on the anchors"),
    "residual_continuum": Series("J", "what the books of the continuum miss by"),
    "residual_atoms": Series("J", "what the books of the atoms miss by"),
    "residual_interface": Series("J", "what the books of the interface miss by"),
    "residual_momentum_x": Series("kg m/s", "momentum of the atoms that no reaction explains, x"),
    "residual_momentum_y": Series("kg m/s", "momentum of the atoms that no reaction explains, y"),
    "crack_leg": Series("1", "who carries the crack tip: 0 continuum, 1 atoms, 2 at the far side, 3 continuum beyond"),
    "applied_strain": Series("1", "strain applied by the edges"),
    "edge_force": Series("N", "force of the top edge on the body, or of the right one where that pulls"),
    "plies_queried": Series("1", "plies of points of which the microstructure was asked in this step"),
    "plies_spared": Series("1", "plies of points that could not fail and were not asked for"),
    "j_boundary": Series("J/m^2", "J integral estimated from the displacement of the edges"),
    "crack_tip": Series("m", "x of the crack tip in the atoms"),
    "broken_bonds": Series("1", "bonds broken since the start"),
    "longest_bond": Series("m", "longest bond"),
    "thermostat_work": Series("J", "work of dampers and thermostats on the atoms"),
    "exchange_windows": Series("1", "windows that the forces of this step are the mean of"),
    "correlation_time": Series("s", "correlation time of the interface forces"),
    "j_tip": Series("m", "x of the tip that the contours of J are around"),
    "courant": Series("1", "Courant number of the continuum step"),
    "points_lost": Series("1", "material points that left the grid since the start"),
    "seconds_continuum": Series("s", "wall time of the continuum in this step"),
    "seconds_atomistic": Series("s", "wall time of the atoms in this step"),
    "seconds_exchange": Series("s", "wall time of the step outside the solvers, writing included"),
}


#: What is known of a crack tip in the continuum, beside its place x, y; keys are fields of `CrackTip`.
TIP_SERIES: dict[str, Series] = {
    "length": Series("m", "length of the crack"),
    "j": Series("J/m^2", "dynamic J-integral"),
    "k_1": Series("Pa m^0.5", "stress intensity, opening"),
    "k_2": Series("Pa m^0.5", "stress intensity, sliding"),
    "g_1": Series("J/m^2", "energy release rate by crack closure, opening"),
    "g_2": Series("J/m^2", "energy release rate by crack closure, sliding"),
    "hoop_stress": Series("Pa", "hoop stress ahead of the tip"),
}
#: J from the atoms, by contour.
J_SERIES: dict[str, Series] = {
    "j_contour": Series("J/m^2", "J from the atoms along contour"),
    "j_contour_error": Series("J/m^2", "standard error of J along contour"),
    "j_domain": Series("J/m^2", "J from the atoms over the domain inside contour"),
    "j_domain_error": Series("J/m^2", "standard error of J over the domain inside contour"),
}
_PLACES = {"x": Series("m", "x of the crack tip"), "y": Series("m", "y of the crack tip")}


def series_name(name: str, region: str, alone: bool) -> str:
    """Return the name of a series of one region: its own where that is the only one."""
    return name if alone else f"{name}@{region}"


def series_of(name: str) -> Series:
    """Return what is known of a series; an unknown one has no unit and no description."""
    name, of, region = name.partition("@")
    if of:
        known = series_of(name)
        return Series(known.unit, f"{known.description}, {region}")
    tip = re.fullmatch(r"tip_(\d+)_([01])_(\w+)", name)
    if tip is not None:
        known = {**_PLACES, **TIP_SERIES}.get(tip[3], Series("", ""))
        return Series(known.unit, f"{known.description}, crack {tip[1]}, {('first', 'last')[int(tip[2])]} end")
    contour = re.fullmatch(r"(j_\w+)_(\d+)", name)
    if contour is not None and contour[1] in J_SERIES:
        known = J_SERIES[contour[1]]
        return Series(known.unit, f"{known.description} {contour[2]}")
    return SERIES.get(name, Series("", ""))
