"""Pictures of a run in space: the scene, stress, atoms around the crack, strain."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.patches import Polygon, Rectangle

from coordinator.display_units import ANGSTROM, units_of
from coordinator.figures import (
    BLUE,
    GREEN,
    INK,
    PALE,
    RED,
    Picture,
    map_axes,
    panels,
    picture,
)
from coordinator.local_strain import local_strain, mean_gradient
from coordinator.results import Results
from coordinator.scene import Scene
from coordinator.vtkhdf import PointsFrame
from protocol.arrays import FloatArray

#: Colours of material points, full and shared, and of anchored atoms.
POINT, SHARED, ANCHORED = "#6aaed6", "#f0b84a", "#7a5195"

Window = tuple[tuple[float, float], tuple[float, float]]
#: Bin for the local strain of atoms: nine of them hold about thirty atoms of graphene.
ATOM_BIN = 3e-10
#: Pairs of atoms up to this multiple of the nearest distance are drawn as bonds.
BOND_STRETCH = 1.42


@dataclass(frozen=True)
class InnerStrain:
    """Strain of the atoms inside the handshake, least squares over all of them."""

    xx: float
    yy: float


def applied_strain(results: Results) -> float | None:
    """Return the applied strain at the last frame of points; None where it is not known."""
    applied = results.series.get("applied_strain")
    if applied is None or results.points is None or not len(results.points):
        return None
    row = int(np.searchsorted(results.step, results.points.step[-1], side="right")) - 1
    return float(applied[row]) if row >= 0 and np.isfinite(applied[row]) else None


def inner_strain(results: Results) -> InnerStrain | None:
    """Return the mean strain of the atoms inside the handshake at the last frame; None without atoms."""
    if results.atoms is None or not len(results.atoms) or "inner" not in results.interface:
        return None
    low, high = results.interface["inner"]
    flat = results.atoms.reference[:, :2]
    inside = np.all((flat > low) & (flat < high), axis=1)
    if inside.sum() < 3:
        return None
    moved = results.atoms.position(len(results.atoms) - 1)[:, :2]
    gradient = mean_gradient(flat[inside], (moved - flat)[inside])
    return InnerStrain(float(gradient[0, 0]), float(gradient[1, 1]))


def scene_pictures(results: Results, scene: Scene) -> list[Picture]:
    """Draw what stands where at the start: the whole body, and a corner of the handshake."""
    if results.points is None or not len(results.points):
        return []
    points = results.points.frame(0)
    atoms = results.atoms.position(0) if results.atoms is not None and len(results.atoms) else None
    body = body_window(scene)
    found = [_scene_picture(results, scene, points, atoms, body, "The whole body", False)]
    overlap = results.interface.get("outer")
    if overlap is not None:
        corner, ring = overlap[1] / ANGSTROM, (overlap[1] - results.interface["inner"][1]) / ANGSTROM
        if ring.min() > 0.0:  # a ring that has a corner there
            reach = 1.9 * ring.max()
            x, y = ((corner[k] - reach, corner[k] + 0.45 * reach) for k in (0, 1))
            found.append(_scene_picture(results, scene, points, atoms, (x, y), "A corner of the handshake", True))
    return found


def _scene_picture(
    results: Results,
    scene: Scene,
    points: PointsFrame,
    atoms: FloatArray | None,
    window: Window,
    title: str,
    close: bool,
) -> Picture:
    unit, name = units_of(scene).length
    figure, axes, _, scale = map_axes(*window, bar=False, unit=name)
    _grid(axes, scene, window, lines=close)
    flat = points.position[:, :2] / unit
    seen = _inside(flat, window)
    shared = points.weight < 1.0
    spacing = spacing_of(scene, points) / unit
    size = ((0.42 if close else 1.3) * spacing * scale) ** 2  # apart from each other, or as an area
    partly = "material point, shared" if scene.atomistic is not None else "material point, cut by a hole"
    for part, colour, label in ((~shared, POINT, "material point"), (shared, SHARED, partly)):
        chosen = seen & part
        if chosen.any():
            axes.scatter(
                flat[chosen, 0],
                flat[chosen, 1],
                s=size[chosen],
                marker="s",
                color=colour,
                linewidths=0,
                label=label,
            )
    if atoms is not None:
        _atoms(axes, results, atoms[:, :2] / ANGSTROM, window, scale, close)
    for low, high in zip(results.interface.get("ivc_lower", ()), results.interface.get("ivc_upper", ()), strict=True):
        _rectangle(axes, low, high, GREEN, 1.0 if close else 0.5, None, unit)
    if "ivc_lower" in results.interface:
        axes.plot([], [], color=GREEN, label="interface volume cell")
    if scene.crack is not None:
        start, tip, y = (v / unit for v in (scene.continuum.lower[0], scene.crack.tip_x, scene.crack.y))
        if window[0][0] < tip and window[1][0] < y < window[1][1]:
            axes.plot([start, tip], [y, y], color=RED, linewidth=1.4, label="crack")
    for number, crack in enumerate(scene.continuum.cracks):
        x, y = np.array(crack.points).T / unit
        axes.plot(x, y, color=RED, linewidth=1.4, label="crack" if number == 0 and scene.crack is None else None)
    if not close:
        _edge_arrows(axes, scene)
    handles, labels = axes.get_legend_handles_labels()
    if handles:
        rows = -(-len(handles) // 3)
        height = figure.get_figheight()
        extra = 0.19 * rows + 0.06
        _shift_up(figure, axes, extra)
        legend = figure.legend(
            handles, labels, loc="lower center", ncols=3, bbox_to_anchor=(0.5, 0.0), borderaxespad=0.2,
            handletextpad=0.5, columnspacing=1.2,
        )  # fmt: skip
        for handle in legend.legend_handles:
            if handle is not None and hasattr(handle, "set_sizes"):
                handle.set_sizes([22.0])
        assert figure.get_figheight() > height
    caption = "Material points, atoms, anchors and cells in their true places; thin lines are the grid."
    if not close:
        caption = "Arrows: edges that are moved or loaded."
        if shared.any():
            beside = "beside the atoms" if scene.atomistic is not None else "outside the hole"
            caption += f" Points of the second colour carry part of stiffness and mass, {beside}."
    return picture(figure, title, caption, raster=True)


def _shift_up(figure: Any, axes: Axes, extra: float) -> None:
    """Make a figure taller at its lower end."""
    width, height = figure.get_size_inches()
    box = axes.get_position()
    figure.set_size_inches(width, height + extra)
    total = height + extra
    axes.set_position((box.x0, (box.y0 * height + extra) / total, box.width, box.height * height / total))


def _atoms(axes: Axes, results: Results, flat: FloatArray, window: Window, scale: float, close: bool) -> None:
    seen = _inside(flat, window)
    anchored = np.zeros(len(flat), dtype=bool)
    anchors = results.interface.get("anchor_position")
    if anchors is not None and results.atoms is not None:
        # Anchors are stored by place; each lies on the reference position of its atom.
        keys = {tuple(np.round(place / (0.01 * ANGSTROM)).astype(int)) for place in anchors[:, :2]}
        rest = np.round(results.atoms.reference[:, :2] / (0.01 * ANGSTROM)).astype(int)
        anchored = np.array([tuple(place) in keys for place in rest])
    if close:
        axes.add_collection(LineCollection(list(_bonds(flat[seen])[0]), colors=PALE, linewidths=1.0))
    size = (0.9 * scale) ** 2 if close else (1.1 * scale) ** 2
    for part, colour, label in ((~anchored, INK, "atom"), (anchored, ANCHORED, "anchored atom")):
        chosen = seen & part
        if chosen.any():
            axes.scatter(flat[chosen, 0], flat[chosen, 1], s=size, color=colour, linewidths=0, label=label, zorder=3)


def stress_pictures(results: Results, scene: Scene, most: int = 3) -> list[Picture]:
    """Draw stress along the pull on the material points, atoms over it, at several times around the atoms."""
    points, atoms = results.points, results.atoms
    if points is None or len(points) < 2:
        return []
    frames = _chosen(len(points), most)
    shown = np.concatenate([points.frame(frame).stress[:, _stress_axis(scene)] for frame in frames])
    limit = _limits(shown / units_of(scene).stress[0])
    found = []
    whole = body_window(scene)
    around = whole
    if results.rings:
        outer = np.concatenate([borders["outer"] for borders in results.rings.values()]) / ANGSTROM
        centre, half = 0.5 * (outer.min(axis=0) + outer.max(axis=0)), 0.8 * np.ptp(outer, axis=0)
        x, y = ((float(centre[k] - half[k]), float(centre[k] + half[k])) for k in (0, 1))
        around = (x, y)
    for frame in frames:
        data = points.frame(frame)
        position = None
        if atoms is not None and len(atoms):
            position = atoms.position(int(np.argmin(np.abs(atoms.step - data.step))))
        if around is not whole:
            found.append(_stress_picture(data, position, scene, around, limit, "around the atoms"))
        if around is whole or frame == frames[-1]:
            found.append(_stress_picture(data, position, scene, whole, limit, "the whole body"))
    return found


def _stress_picture(
    data: PointsFrame,
    atoms: FloatArray | None,
    scene: Scene,
    window: Window,
    limit: tuple[float, float, str],
    where: str,
) -> Picture:
    units = units_of(scene)
    unit, name = units.length
    figure, axes, side, scale = map_axes(*window, bar=True, unit=name)
    flat = data.position[:, :2] / unit
    spacing = spacing_of(scene, data) / unit
    seen = _inside(flat, window, margin=spacing)
    axis = _stress_axis(scene)
    drawn = axes.scatter(
        flat[seen, 0], flat[seen, 1], c=data.stress[seen, axis] / units.stress[0],
        s=(1.04 * spacing[seen] * scale) ** 2, marker="s", linewidths=0, vmin=limit[0], vmax=limit[1], cmap=limit[2],
    )  # fmt: skip
    if atoms is not None:
        place = atoms[:, :2] / ANGSTROM
        chosen = _inside(place, window)
        axes.scatter(
            place[chosen, 0], place[chosen, 1], s=max(0.3, (0.55 * scale) ** 2), color=INK, linewidths=0, zorder=3
        )
    assert side is not None
    letter = "xy"[axis]
    figure.colorbar(drawn, cax=side, extend="both").set_label(f"σ$_{{{2 * letter}}}$ ({units.stress[1]})")
    time = f"{data.time / units.time[0]:.3g} {units.time[1]}"
    caption = f"Step {data.step}, {time}. " + (
        "Dots are atoms; stress is drawn on material points only." if atoms is not None else "True displacements."
    )
    return picture(figure, f"Stress along {letter}, {where}, {time}", caption, raster=True)


def _stress_axis(scene: Scene) -> int:
    """Axis of the stress that is drawn: that of the pull, else y."""
    return 1 if scene.continuum.pull_axis is None else scene.continuum.pull_axis


def crack_pictures(results: Results, scene: Scene, most: int = 4) -> list[Picture]:
    """Draw the atoms around the crack's tip at several times, bonds coloured by their length."""
    atoms = results.atoms
    if scene.crack is None or atoms is None or not len(atoms):
        return []
    found = []
    tips = results.series.get("crack_tip")
    last = scene.crack.tip_x if tips is None or not np.isfinite(tips).any() else np.nanmax(tips)
    # The tip may begin in the continuum, far from the atoms.
    start = max(scene.crack.tip_x, float(atoms.reference[:, 0].min()))
    left, right = start / ANGSTROM - 18.0, max(last, start) / ANGSTROM + 18.0
    y = scene.crack.y / ANGSTROM
    half = 0.36 * (right - left)
    window = ((float(left), float(right)), (float(y - half), float(y + half)))
    nearest = _nearest(atoms.reference[:, :2] / ANGSTROM)
    for frame in _chosen(len(atoms), most):
        flat = atoms.position(frame)[:, :2] / ANGSTROM
        seen = flat[_inside(flat, window, margin=2.0)]
        figure, axes, side, scale = map_axes(*window, bar=True)
        lines, lengths = _bonds(seen, BOND_STRETCH * nearest)
        bonds = LineCollection(list(lines), array=lengths, cmap="viridis_r", linewidths=0.34 * scale, zorder=2)
        bonds.set_clim(0.95 * nearest, 1.3 * nearest)
        axes.add_collection(bonds)
        axes.scatter(seen[:, 0], seen[:, 1], s=(0.5 * scale) ** 2, color=INK, linewidths=0, zorder=3)
        assert side is not None
        figure.colorbar(bonds, cax=side, extend="both").set_label("bond length (Å)")
        time = atoms.time[frame] / 1e-12
        caption = f"Step {atoms.step[frame]}. Pairs closer than {BOND_STRETCH * nearest:.2f} Å are drawn as bonds."
        found.append(picture(figure, f"Crack tip in the atoms, {time:.3g} ps", caption, raster=True))
    return found


def strain_pictures(results: Results, scene: Scene) -> list[Picture]:
    """Draw strain along y of points and atoms at the last frame: a map, and a section along x.

    Only where points and atoms meet and no crack disturbs the strain; else there is nothing uniform to look for.
    """
    points = results.points
    if scene.atomistic is None or scene.crack is not None or points is None or len(points) < 2:
        return []
    data = points.frame(len(points) - 1)
    continuum = local_strain(
        (data.position - data.displacement)[:, :2], data.displacement[:, :2], scene.continuum.cell_size
    )
    parts = [("material points", continuum, scene.continuum.cell_size, BLUE)]
    if results.atoms is not None and len(results.atoms):
        rest = results.atoms.reference[:, :2]
        moved = results.atoms.position(len(results.atoms) - 1)[:, :2]
        parts.append(("atoms", local_strain(rest, moved - rest, ATOM_BIN), ATOM_BIN, RED))
    if not all(len(part.yy) for _, part, _, _ in parts):  # a row of cells or of atoms has no strain across
        return []
    applied = applied_strain(results)
    middle = 100 * (applied if applied is not None else float(np.median(continuum.yy)))
    errors = np.concatenate([100 * part.yy - middle for _, part, _, _ in parts])
    spread = max(float(np.percentile(np.abs(errors), 98)), 0.02 * abs(middle), 1e-6)
    figure, axes, side, scale = map_axes(*body_window(scene), bar=True)
    for _, part, size, _ in parts:
        drawn = axes.scatter(
            part.centre[:, 0] / ANGSTROM, part.centre[:, 1] / ANGSTROM, c=100 * part.yy, marker="s", linewidths=0,
            s=(1.04 * size / ANGSTROM * scale) ** 2, cmap="RdBu_r", vmin=middle - spread, vmax=middle + spread,
        )  # fmt: skip
    for borders in results.rings.values():
        for corners in borders.values():
            axes.add_patch(Polygon(corners / ANGSTROM, fill=False, edgecolor=INK, linewidth=0.8, linestyle="--"))
    assert side is not None
    figure.colorbar(drawn, cax=side, extend="both").set_label("ε$_{yy}$ (%)")
    title = "Strain along y" + (f", applied {middle:.3g} %" if applied is not None else "")
    white = "the applied strain" if applied is not None else "the median"
    caption = (
        f"Least squares over neighbourhoods of points and of atoms; atoms lie over points. White is {white};"
        " dashed lines bound the handshake."
    )
    return [picture(figure, title, caption, raster=True), _strain_section(results, parts, middle, applied)]


def _strain_section(
    results: Results, parts: list[tuple[str, Any, float, str]], middle: float, applied: float | None
) -> Picture:
    figure, (axes,) = panels(1, 2.9)
    for name in ("inner", "outer"):
        if name in results.interface:
            for edge in results.interface[name][:, 0] / ANGSTROM:
                axes.axvline(edge, color=PALE, linewidth=0.8, linestyle=":")
    for name, part, size, colour in parts:
        near = np.abs(part.centre[:, 1]) < 0.25 * np.ptp(part.centre[:, 1])
        column = np.floor(part.centre[near, 0] / size).astype(int)
        columns = np.unique(column)
        value = [100 * part.yy[near][column == c].mean() for c in columns]
        place = [part.centre[near][column == c, 0].mean() / ANGSTROM for c in columns]
        axes.plot(place, value, color=colour, label=name, marker="o", markersize=2.5)
    if applied is not None:
        axes.axhline(middle, color=INK, linewidth=0.9, linestyle="--", label="applied")
    axes.set(xlabel="x (Å)", ylabel="mean ε$_{yy}$ (%)")
    axes.legend(ncols=3, loc="upper center", bbox_to_anchor=(0.5, 1.14))
    caption = "Mean over the middle half of the height; dotted lines bound the handshake."
    return picture(figure, "Strain along y in a section", caption)


def _chosen(count: int, most: int) -> list[int]:
    """Return up to `most` frames, evenly spread, the last one among them."""
    return sorted({round(k) for k in np.linspace(0, count - 1, most + 1)[1:]})


def _limits(values: FloatArray) -> tuple[float, float, str]:
    """Return limits and colour map: one-sided where there is next to no compression."""
    low, high = (float(v) for v in np.percentile(values, [1.0, 99.0]))
    if high <= 0.0 and low >= 0.0:
        return -1.0, 1.0, "RdBu_r"
    if low > -0.15 * high:
        return min(low, 0.0), high, "viridis"
    top = max(abs(low), abs(high))
    return -top, top, "RdBu_r"


def body_window(scene: Scene) -> Window:
    unit, _ = units_of(scene).length
    low, high = np.array(scene.continuum.lower) / unit, np.array(scene.continuum.upper) / unit
    margin = 0.05 * (high - low).max()
    x, y = ((float(low[k] - margin), float(high[k] + margin)) for k in (0, 1))
    return x, y


def spacing_of(scene: Scene, points: PointsFrame) -> FloatArray:
    """Return the distance of each point from its neighbours at the start, m, shape (points,)."""
    place = (points.position - points.displacement)[:, :2]
    level = np.zeros(len(place))
    for finer in scene.continuum.refinement:
        level += np.all((place > np.array(finer.lower)) & (place < np.array(finer.upper)), axis=1)
    spacing: FloatArray = scene.continuum.cell_size / scene.continuum.points_per_cell / 2.0**level
    return spacing


def _inside(flat: FloatArray, window: Window, margin: float | FloatArray = 0.0) -> Any:
    (x0, x1), (y0, y1) = window
    x, y = flat.T
    return (x > x0 - margin) & (x < x1 + margin) & (y > y0 - margin) & (y < y1 + margin)


def _nearest(flat: FloatArray) -> float:
    """Return the median distance to the nearest neighbour, from a sample of at most 200 points."""
    sample = flat[:: max(1, len(flat) // 200)]
    distance = np.hypot(*(sample[:, None] - flat[None]).transpose(2, 0, 1))
    distance[distance == 0.0] = np.inf
    return float(np.median(distance.min(axis=1)))


def _bonds(flat: FloatArray, reach: float | None = None) -> tuple[FloatArray, FloatArray]:
    """Return lines, shape (bonds, 2, 2), and lengths of the pairs closer than `reach`, Angstrom."""
    if len(flat) < 2:
        return np.zeros((0, 2, 2)), np.zeros(0)
    within = BOND_STRETCH * _nearest(flat) if reach is None else reach
    order = np.argsort(flat[:, 0], kind="stable")
    sorted_x = flat[order, 0]
    ends = np.searchsorted(sorted_x, sorted_x + within)
    first = np.repeat(np.arange(len(flat)), ends - np.arange(len(flat)) - 1)
    second = np.concatenate([np.arange(k + 1, end) for k, end in enumerate(ends)])
    one, other = flat[order[first]], flat[order[second]]
    lengths = np.hypot(*(one - other).T)
    close = lengths < within
    return np.stack([one, other], axis=1)[close], lengths[close]


def _rectangle(
    axes: Axes, low: FloatArray, high: FloatArray, colour: str, width: float, dash: str | None, unit: float = ANGSTROM
) -> None:
    corner, size = low[:2] / unit, (high - low)[:2] / unit
    axes.add_patch(
        Rectangle(
            (corner[0], corner[1]), size[0], size[1], fill=False, edgecolor=colour, linewidth=width,
            linestyle=dash or "-", zorder=4,
        )
    )  # fmt: skip


def _grid(axes: Axes, scene: Scene, window: Window, lines: bool) -> None:
    """Draw the outline of the body and, close by, the lines of its cells."""
    low, high = np.array(scene.continuum.lower), np.array(scene.continuum.upper)
    unit, _ = units_of(scene).length
    _rectangle(axes, low, high, INK, 1.0, None, unit)
    for level in scene.continuum.refinement:
        _rectangle(axes, np.array(level.lower), np.array(level.upper), PALE, 0.8, "--", unit)
    if not lines:
        return
    for axis, draw in ((0, axes.axvline), (1, axes.axhline)):
        count = round((high[axis] - low[axis]) / scene.continuum.cell_size)
        for k in range(count + 1):
            place = (low[axis] + k * scene.continuum.cell_size) / unit
            if window[axis][0] < place < window[axis][1]:
                draw(place, color="#d5d9de", linewidth=0.6, zorder=0)


def _edge_arrows(axes: Axes, scene: Scene) -> None:
    """Draw the way in which each edge is moved or loaded at last as arrows of fixed length."""
    unit, _ = units_of(scene).length
    low, high = np.array(scene.continuum.lower) / unit, np.array(scene.continuum.upper) / unit
    middle, reach = 0.5 * (low + high), 0.04 * (high - low).max()
    for edge in scene.continuum.edges:
        way = edge.last_way
        if way == 0.0:
            continue
        for share in (-0.3, 0.0, 0.3):
            foot = middle + share * (high - low)
            foot[edge.normal_axis] = (low, high)[edge.edge in ("right", "top")][edge.normal_axis]
            tip = foot.copy()
            tip[edge.axis] += np.sign(way) * reach
            axes.annotate(
                "",
                (tip[0], tip[1]),
                (foot[0], foot[1]),
                arrowprops={"arrowstyle": "-|>", "color": RED, "linewidth": 1.2},
            )
