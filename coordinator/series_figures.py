"""Curves of a run over time, and where its wall time went."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from coordinator.display_units import ANGSTROM, ELECTRONVOLT, NANONEWTON, units_of
from coordinator.figures import (
    BLUE,
    GREEN,
    INK,
    ORANGE,
    PALE,
    PURPLE,
    RED,
    SKY,
    WIDTH,
    Picture,
    panels,
    picture,
)
from coordinator.results import Results
from coordinator.scene import Scene
from coordinator.summary import Summary
from protocol.arrays import FloatArray

#: Points of a curve; more are not seen.
_MOST_POINTS = 3000
#: Rows of the running mean, as a share of all rows.
_SMOOTHING = 0.03

#: Series that some figure shows; the others are listed.
SHOWN = frozenset(
    {
        "time", "continuum_kinetic", "continuum_strain", "continuum_edge_work", "continuum_interface_work",
        "continuum_damping_loss", "continuum_load_work", "continuum_dissipated", "atomistic_potential",
        "atomistic_kinetic", "spring_energy", "anchor_work", "temperature", "handshake_temperature", "force_sum_x",
        "force_sum_y", "force_balance", "ivc_error_rms", "ivc_force_rms", "applied_strain", "edge_force",
        "j_boundary", "crack_tip", "broken_bonds", "longest_bond", "seconds_continuum", "seconds_atomistic",
        "seconds_exchange", "j_tip",
    }
)  # fmt: skip

#: Energies that are drawn only where there are some.
_OFTEN_ABSENT = (
    "continuum_load_work", "continuum_interface_work", "continuum_dissipated", "continuum_filter_loss",
)  # fmt: skip


def shown(name: str) -> bool:
    """Return whether some figure shows a series."""
    return name in SHOWN or re.fullmatch(r"tip_\d+_[01]_(j|k_1|k_2|length)|j_(contour|domain)_.*", name) is not None


class Curves:
    """Time series as the figures draw them.

    Parameters
    ----------
    results : Results
        At least two rows.
    scene : Scene
        Its scale decides the units.
    """

    def __init__(self, results: Results, scene: Scene) -> None:
        self._series = results.series
        self._every = max(1, len(results.step) // _MOST_POINTS)
        self.units = units_of(scene)
        self.time: FloatArray = self._series["time"] / self.units.time[0]
        self.time_label = f"time ({self.units.time[1]})"

    def has(self, *names: str) -> bool:
        """Whether any of the series is there with a finite value."""
        return any(name in self._series and np.isfinite(self._series[name]).any() for name in names)

    def acts(self, name: str) -> bool:
        """Whether the series is there and not zero throughout."""
        return self.has(name) and bool(np.nanmax(np.abs(self._series[name])) > 0)

    def parts(self, name: str) -> list[str]:
        """Return the names of a series of each region of atoms."""
        return sorted(one for one in self._series if one.split("@")[0] == name)

    def tips(self) -> list[str]:
        """Return the names of the continuum's crack tips, as their series begin."""
        return sorted({name[: -len("length")] for name in self._series if re.fullmatch(r"tip_\d+_[01]_length", name)})

    def get(self, name: str, unit: float = 1.0) -> FloatArray:
        """Return a series in multiples of `unit`."""
        value: FloatArray = self._series[name] / unit
        return value

    def draw(self, axes: Axes, name: str, label: str, colour: str, unit: float = 1.0, dash: str = "-") -> None:
        """Draw a series, if it is there."""
        if self.has(name):
            self.line(axes, self.get(name, unit), label, colour, dash)

    def line(self, axes: Axes, value: FloatArray, label: str, colour: str, dash: str = "-", **more: Any) -> None:
        """Draw values of every row."""
        axes.plot(self.time[:: self._every], value[:: self._every], dash, color=colour, label=label, **more)

    def smooth(self, name: str, unit: float = 1.0) -> FloatArray:
        """Return the centred running mean of a series; at the ends over what is there."""
        value = self.get(name, unit)
        good = np.isfinite(value)
        half = max(1, int(_SMOOTHING * len(value) / 2))
        kernel = np.ones(2 * half + 1)
        total = np.convolve(np.where(good, value, 0.0), kernel, mode="full")[half:-half]
        count = np.convolve(good.astype(float), kernel, mode="full")[half:-half]
        mean: FloatArray = np.where(count > 0, total / np.maximum(count, 1.0), np.nan)
        return mean


def series_pictures(results: Results, scene: Scene, summary: Summary | None) -> list[Picture]:
    """Draw all groups of curves that the run has series for."""
    found: list[Picture | None] = []
    if len(results.step) >= 2 and "time" in results.series:
        curves = Curves(results, scene)
        found = [
            _load(curves, scene),
            _crack(curves, scene),
            _atomistic_j(curves, scene),
            _tips(curves, scene),
            _energies(curves),
            _books(curves),
            _temperatures(curves, scene),
            _interface(curves),
            _errors(curves),
            _seconds(curves),
        ]
    if summary is not None and summary.services:
        found.append(_services(summary))
    return [item for item in found if item is not None]


def _legend(axes: Axes) -> None:
    """Put the legend above the curves, where it hides none of them."""
    if len(axes.get_legend_handles_labels()[0]) > 0:
        axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), borderaxespad=0.1, ncols=3, columnspacing=1.2)


def _load(curves: Curves, scene: Scene) -> Picture | None:
    if not curves.has("applied_strain", "edge_force"):
        return None
    figure, axes = panels(2, 3.4)
    curves.draw(axes[0], "applied_strain", "applied strain", BLUE, 0.01)
    axes[0].set_ylabel("applied strain (%)")
    curves.draw(axes[1], "edge_force", "force", BLUE, curves.units.force[0])
    edge = "right" if scene.continuum.pull_axis == 0 else "top"
    axes[1].set(ylabel=f"force of {edge} edge ({curves.units.force[1]})", xlabel=curves.time_label)
    return picture(figure, "Load", f"Strain that the edges apply, and the force of the {edge} edge on the body.")


def _crack(curves: Curves, scene: Scene) -> Picture | None:
    tips = curves.parts("crack_tip")
    if scene.crack is None or not curves.has("broken_bonds") or not (tips or curves.has("j_boundary")):
        return None
    load = next((name for name in ("j_boundary", "applied_strain") if curves.has(name)), None)
    figure, axes = panels(3 if load else 2, 4.6 if load else 3.4)
    if load is not None:
        curves.draw(axes[0], load, "load", BLUE, 1.0 if load == "j_boundary" else 0.01)
        axes[0].set_ylabel("J (J/m²)" if load == "j_boundary" else "applied strain (%)")
    tip_axes, bond_axes = axes[-2:]
    for name, colour in zip(tips, (RED, ORANGE, GREEN, PURPLE), strict=False):
        tip = curves.get(name, ANGSTROM)
        first = tip[np.isfinite(tip)][0]
        curves.line(tip_axes, np.abs(tip - first), name.partition("@")[2] or "tip", colour)
    if len(tips) > 1:
        _legend(tip_axes)
    tip_axes.set_ylabel("tip advance (Å)")
    curves.draw(bond_axes, "broken_bonds", "broken bonds", RED)
    bond_axes.set(ylabel="broken bonds", xlabel=curves.time_label)
    if curves.has("broken_bonds"):
        broken = curves.get("broken_bonds")
        more = np.flatnonzero(broken > broken[np.isfinite(broken)][0])
        if len(more):
            for panel in axes:
                panel.axvline(curves.time[more[0]], color=PALE, linewidth=0.9, linestyle="--")
    caption = "J is estimated from the displacement of the edges (long strip). " if load == "j_boundary" else ""
    caption += "Dashed: the first bond breaks."
    return picture(figure, "Crack", caption)


def _atomistic_j(curves: Curves, scene: Scene) -> Picture | None:
    """Draw J from the atoms over time with its standard error (Fig 5.3)."""
    table = scene.atomistic.j if scene.atomistic is not None else None
    if table is None or not curves.has("j_contour_0"):
        return None
    figure, (axes,) = panels(1, 3.2)
    colours = (BLUE, GREEN, PURPLE, SKY, RED)
    for number, size in enumerate(table.half_sizes):
        if not curves.has(f"j_contour_{number}"):
            continue
        colour = colours[number % len(colours)]
        value, error = curves.get(f"j_contour_{number}"), curves.get(f"j_contour_error_{number}")
        there = np.isfinite(value)
        time, value, error = curves.time[there], value[there], error[there]
        axes.fill_between(time, value - error, value + error, color=colour, alpha=0.2, linewidth=0)
        axes.plot(time, value, "-o", color=colour, markersize=2.5, linewidth=1.2, label=f"{size / ANGSTROM:.3g} Å")
        domain = curves.get(f"j_domain_{number}")[there]
        axes.plot(time, domain, ":", color=colour, linewidth=1.0)
    if curves.has("j_boundary"):
        curves.draw(axes, "j_boundary", "edges", INK, dash="--")
    tips = [tip for tip in curves.tips() if curves.has(tip + "j")]
    for number, tip in enumerate(tips):
        curves.draw(axes, tip + "j", "_" if number else "continuum", ORANGE)
    toughness = scene.crack.toughness if scene.crack is not None else None
    if toughness is not None:
        axes.axhline(toughness, color=INK, linewidth=0.9, linestyle=":", label=f"{toughness:.3g} J/m²")
    axes.set(xlabel=curves.time_label, ylabel="J (J/m²)")
    _legend(axes)
    caption = (
        "J from the atoms along square contours of the given half size around the tip, each value of the mean over"
        f" {table.interval} coupling steps, with its standard error as a band; dotted over the domain inside."
        " Dashed: from the displacement of the edges."
    )
    if tips:
        caption += " Orange: where the tip lies in the continuum."
    if toughness is not None:
        caption += " Horizontal: the toughness that the scene states."
    return picture(figure, "J from the atoms", caption)


def _tips(curves: Curves, scene: Scene) -> Picture | None:
    """Draw J, stress intensities and length of the continuum's cracks that were measured."""
    tips = [tip for tip in curves.tips() if curves.has(tip + "j")]
    if not tips:
        return None
    figure, axes = panels(3, 5.2)
    colours = (BLUE, ORANGE, GREEN, PURPLE, SKY, RED)
    for number, tip in enumerate(tips):
        colour = colours[number % len(colours)]
        _, crack, end, _ = tip.split("_")
        label = f"crack {crack}, {('first', 'last')[int(end)]} end"
        curves.draw(axes[0], tip + "j", label, colour)
        curves.draw(axes[1], tip + "k_1", "_", colour, 1e6)
        curves.draw(axes[1], tip + "k_2", "_", colour, 1e6, "--")
        length = curves.get(tip + "length", curves.units.length[0])
        curves.line(axes[2], length - length[np.isfinite(length)][0], "_", colour)
    laws = [crack.growth for crack in scene.continuum.cracks]
    laws += [scene.crack.growth] if scene.crack is not None else []
    critical = {law.critical_energy_release_rate for law in laws if law is not None}
    for value in critical:
        axes[0].axhline(value, color=INK, linewidth=0.9, linestyle=":")
    axes[0].set_ylabel("J (J/m²)")
    axes[1].set_ylabel("K (MPa m$^{1/2}$)")
    axes[2].set(ylabel=f"growth ({curves.units.length[1]})", xlabel=curves.time_label)
    _legend(axes[0])
    caption = "Dynamic J-integral around each tip; stress intensities, opening solid and sliding dashed; growth."
    if critical:
        caption += " Dotted: the energy release rate at which cracks grow."
    return picture(figure, "Crack tips in the continuum", caption)


def _energies(curves: Curves) -> Picture | None:
    if not curves.has("continuum_kinetic", "continuum_strain"):
        return None
    atoms = curves.has("atomistic_potential", "anchor_work")
    figure, axes = panels(2 if atoms else 1, 4.9 if atoms else 2.8)
    for name, label, colour, dash in (
        ("continuum_strain", "strain energy", BLUE, "-"),
        ("continuum_kinetic", "kinetic energy", SKY, "-"),
        ("continuum_edge_work", "work of edges", INK, "--"),
        ("continuum_load_work", "work of loads", GREEN, "--"),
        ("continuum_interface_work", "work of atoms", ORANGE, "--"),
        ("continuum_damping_loss", "damping loss", PURPLE, ":"),
        ("continuum_filter_loss", "loss of the filter", PALE, ":"),
        ("continuum_dissipated", "plastic flow, friction", RED, ":"),
    ):
        if name in _OFTEN_ABSENT and not curves.acts(name):
            continue
        curves.draw(axes[0], name, label, colour, curves.units.energy[0], dash)
    axes[0].set_ylabel(f"continuum ({curves.units.energy[1]})")
    _legend(axes[0])
    if atoms:
        curves.draw(axes[1], "atomistic_potential", "potential, change", RED, ELECTRONVOLT)
        if curves.has("atomistic_kinetic"):
            kinetic = curves.get("atomistic_kinetic", ELECTRONVOLT)
            curves.line(axes[1], kinetic - kinetic[np.isfinite(kinetic)][0], "kinetic, change", ORANGE)
        curves.draw(axes[1], "spring_energy", "anchor springs", GREEN, ELECTRONVOLT)
        curves.draw(axes[1], "anchor_work", "work of anchors", INK, ELECTRONVOLT, "--")
        axes[1].set_ylabel("atoms (eV)")
        _legend(axes[1])
    axes[-1].set_xlabel(curves.time_label)
    caption = "Solid lines are energies held, dashed lines work done since the start."
    return picture(figure, "Energies", caption)


def _books(curves: Curves) -> Picture | None:
    if not curves.has("residual_continuum"):
        return None
    figure, (axes,) = panels(1, 2.6)
    size, unit = (ELECTRONVOLT, "eV") if curves.has("residual_atoms") else curves.units.energy
    for name, label, colour in (
        ("residual_continuum", "continuum", BLUE),
        ("residual_interface", "interface", GREEN),
        ("residual_atoms", "atoms", RED),
    ):
        if curves.has(name):
            curves.draw(axes, name, label, colour, size)
    axes.set(xlabel=curves.time_label, ylabel=f"missed by ({unit})")
    _legend(axes)
    caption = (
        "What the change of the energy held and the work measured apart from it differ by: time stepping in"
        " continuum and atoms; at the interface the age of the force, and what dampers take there."
    )
    return picture(figure, "Books of energy", caption)


def _temperatures(curves: Curves, scene: Scene) -> Picture | None:
    if scene.atomistic is None or not curves.has("temperature"):
        return None
    figure, (axes,) = panels(1, 2.6)
    for name, label, colour in (
        ("temperature", "all atoms", BLUE),
        ("handshake_temperature", "anchored atoms", ORANGE),
    ):
        if curves.has(name):
            curves.line(axes, curves.get(name), "_", colour, alpha=0.28, linewidth=0.7)
            curves.line(axes, curves.smooth(name), label, colour)
    axes.axhline(scene.atomistic.temperature, color=INK, linewidth=0.9, linestyle="--", label="asked")
    axes.set(xlabel=curves.time_label, ylabel="temperature (K)")
    _legend(axes)
    return picture(figure, "Temperature", "Thin lines are single steps, thick lines their running mean.")


def _interface(curves: Curves) -> Picture | None:
    if not curves.has("force_balance", "force_sum_x", "force_sum_y"):
        return None
    figure, axes = panels(2, 3.6)
    curves.draw(axes[0], "force_sum_x", "x component", BLUE, NANONEWTON)
    curves.draw(axes[0], "force_sum_y", "y component", ORANGE, NANONEWTON)
    axes[0].set_ylabel("sum of forces (nN)")
    _legend(axes[0])
    if curves.has("force_balance"):
        balance = curves.get("force_balance")
        if np.nanmax(balance) > 0:
            # An exact balance has no place on a logarithmic axis.
            curves.line(axes[1], np.where(balance > 0, balance, np.nan), "imbalance", RED)
            axes[1].set_yscale("log")
    axes[1].set(ylabel="relative imbalance", xlabel=curves.time_label)
    caption = (
        "Sum of all interface forces on the continuum, and the difference between the sums over cells and over"
        " anchors, relative to the forces: what is lost in the exchange."
    )
    return picture(figure, "Interface force balance", caption)


def _errors(curves: Curves) -> Picture | None:
    if not curves.has("ivc_force_rms", "ivc_error_rms"):
        return None
    figure, (axes,) = panels(1, 2.6)
    for name, label, colour in (
        ("ivc_force_rms", "force on a cell", BLUE),
        ("ivc_error_rms", "its standard error", RED),
    ):
        if curves.has(name):
            value = curves.get(name, NANONEWTON)
            curves.line(axes, np.where(value > 0, value, np.nan), label, colour)
    axes.set_yscale("log")
    axes.set(xlabel=curves.time_label, ylabel="root mean square (nN)")
    _legend(axes)
    caption = "Where the lines meet, thermal noise is as large as what the atoms tell the continuum in one exchange."
    return picture(figure, "Interface force and its statistical error", caption)


def _seconds(curves: Curves) -> Picture | None:
    names = (
        ("seconds_atomistic", "atoms", RED),
        ("seconds_continuum", "continuum", BLUE),
        ("seconds_exchange", "exchange", PALE),
    )
    present = [row for row in names if curves.has(row[0])]
    if not present:
        return None
    figure, (axes,) = panels(1, 2.4)
    values = [np.nan_to_num(curves.smooth(name, 1e-3)) for name, _, _ in present]
    axes.stackplot(curves.time, values, labels=[label for _, label, _ in present], colors=[c for _, _, c in present])
    axes.set(xlabel=curves.time_label, ylabel="wall time a step (ms)")
    axes.margins(x=0)
    _legend(axes)
    return picture(figure, "Wall time of a coupling step", "Running mean, stacked.")


def _services(summary: Summary) -> Picture:
    figure = Figure(figsize=(WIDTH, 0.95 + 0.42 * len(summary.services)), layout="constrained")
    axes = figure.subplots()
    names = list(summary.services)
    left = np.zeros(len(names))
    for part, colour in (("computing", BLUE), ("sending", ORANGE), ("waiting", GREEN)):
        value = np.array([getattr(summary.services[name], part) for name in names])
        axes.barh(names, value, left=left, color=colour, label=part, height=0.55)
        left += value
    rest = np.maximum(summary.wall_seconds - left, 0.0)
    axes.barh(names, rest, left=left, color="#e6e9ed", label="not called", height=0.55)
    axes.invert_yaxis()
    axes.grid(axis="y", visible=False)
    axes.set(xlabel="wall time (s)")
    axes.legend(ncols=4, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    caption = (
        "Whole run, preparation included. Waiting: the message was on its way, or the service had no processor."
        " Not called: the coordinator was busy with others, or wrote files."
    )
    return picture(figure, "Wall time by service", caption)
