"""Pictures of samples: atoms as shaded balls in their box, seen from above or at an angle."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import EllipseCollection, LineCollection
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from numpy.typing import NDArray

from md_service.atoms import Atoms, Box

#: Colours in which chemists know the elements.
COLOURS: Final = {
    "H": "#e9e9ee", "C": "#4b5158", "N": "#3b62d8", "O": "#d8372f", "Cu": "#c77c3c", "Al": "#a9b1bb", "Ar": "#4fb3c8",
    "Si": "#d8b06a", "B": "#e0a39a",
}  # fmt: skip
_OTHER = "#9a78b4"
#: Radii of the drawn balls, angstrom.
_RADII = {"H": 0.42, "C": 0.70, "N": 0.68, "O": 0.66, "Ar": 1.55, "Cu": 1.15, "Al": 1.25}
_OTHER_RADIUS = 1.0
_WIDTH, _BAND = 8.0, 0.55  # inches: of the picture, and of the bands above and below it
_PAPER = "white"
_INK = "#2b2f36"
_STICK = "#8a9099"
_FILLER = "#0b6e6e"
_AZIMUTH, _ELEVATION = np.radians(-62.0), np.radians(20.0)
_MOST_RINGS, _DISCS = 12, 60_000  # rings in the shading of a ball, and how many discs a picture has time for


def draw_sample(atoms: Atoms, path: Path, title: str = "", highlighted: NDArray[np.bool_] | None = None) -> None:
    """Draw a sample into a PNG file.

    A sheet is seen from above, other samples at an angle, with distant atoms paler. Highlighted atoms are drawn as
    balls in one colour inside the others, which are then thin sticks.

    Parameters
    ----------
    atoms : Atoms
        The sample; atoms in periodic directions are drawn inside the box.
    path : Path
        File to write; its suffix must be ``.png``.
    title : str
        Line above the picture.
    highlighted : ndarray of bool, shape (n,), optional
        Atoms to show inside the others.

    Raises
    ------
    ValueError
        If the suffix is another one, or the sample has no atoms.
    """
    if path.suffix != ".png":
        raise ValueError(f"picture is {str(path)!r}; its suffix must be .png")
    if len(atoms) == 0:
        raise ValueError("the sample has no atoms to draw")
    if highlighted is not None:
        # In the middle, so that no face of a periodic box cuts through what is to be seen.
        middle = atoms.position[highlighted].mean(axis=0)
        atoms = atoms.at(
            atoms.position + np.where(atoms.box.periodic, 0.5 * (atoms.box.low + atoms.box.high) - middle, 0.0)
        )
    view = _View(atoms)
    low, high = view.limits(atoms.box)
    width, height = high - low
    picture_height = _WIDTH * float(np.clip(height / width, 0.3, 1.5))
    figure = Figure(figsize=(_WIDTH, picture_height + 2.0 * _BAND), dpi=160, facecolor=_PAPER)
    FigureCanvasAgg(figure)
    band = _BAND / figure.get_figheight()
    axes = figure.add_axes((0.02, band, 0.96, 1.0 - 2.0 * band))
    axes.set_aspect("equal")
    axes.axis("off")
    for edge, hidden in view.box_edges(atoms.box):
        axes.plot(*edge.T, color=_INK, lw=0.8, ls=(0, (4, 3)) if hidden else "-", alpha=0.55, zorder=0 if hidden else 9)

    seen = view.seen
    depth = view.depth
    shown = np.ones(len(atoms), dtype=bool) if highlighted is None else highlighted
    if highlighted is not None:
        axes.add_collection(_sticks(atoms, view, ~highlighted))
    elif view.flat or atoms.topology is not None:
        axes.add_collection(_sticks(atoms, view, shown))
    colour = np.array([to_rgb(COLOURS.get(name, _OTHER)) for name in atoms.elements])[atoms.kind]
    radius = np.array([_RADII.get(name, _OTHER_RADIUS) for name in atoms.elements])[atoms.kind]
    if view.flat and atoms.spacing is not None:
        radius = np.full(len(atoms), 0.30 * atoms.spacing * 1e10)
    if highlighted is not None:
        colour = np.where((np.array(atoms.elements) == "C")[atoms.kind][:, None], to_rgb(_FILLER), colour)
    order = np.flatnonzero(shown)[np.argsort(depth[shown])]
    haze = 0.0 if view.flat or highlighted is not None else 0.55
    axes.add_collection(_balls(axes, seen[order], radius[order], colour[order], depth[order], haze))
    margin = 0.03 * (high - low).max() + radius.max()
    axes.set_xlim(low[0] - margin, high[0] + margin)
    axes.set_ylim(low[1] - margin, high[1] + margin)
    _legend(figure, atoms, highlighted is not None, 0.5 * band)
    if title:
        figure.text(0.5, 1.0 - 0.5 * band, title, ha="center", va="center", fontsize=12, color=_INK)
    figure.savefig(path)


class _View:
    """Orthographic projection of a sample; lengths in angstrom."""

    def __init__(self, atoms: Atoms) -> None:
        self.flat = atoms.thickness is not None
        position = atoms.box.wrapped(atoms.position)[0] * 1e10
        self._centre = 0.5e10 * (atoms.box.low + atoms.box.high)
        if self.flat:
            self._axes = np.eye(3)
        else:
            ca, sa, ce, se = np.cos(_AZIMUTH), np.sin(_AZIMUTH), np.cos(_ELEVATION), np.sin(_ELEVATION)
            right, forward = np.array([-sa, ca, 0.0]), np.array([ca * ce, sa * ce, se])
            self._axes = np.stack([right, np.cross(forward, right), forward])
        turned = self._turned(position)
        self.seen, self.depth = turned[:, :2], turned[:, 2]

    def _turned(self, position: NDArray[np.float64]) -> NDArray[np.float64]:
        turned: NDArray[np.float64] = (position - self._centre) @ self._axes.T
        return turned

    def _corners(self, box: Box) -> NDArray[np.float64]:
        where = np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)])
        return self._turned((box.low + where @ box.edges) * 1e10)

    def limits(self, box: Box) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Lower left and upper right of what is seen."""
        both = np.concatenate([self._corners(box)[:, :2], self.seen])
        return both.min(axis=0), both.max(axis=0)

    def box_edges(self, box: Box) -> list[tuple[NDArray[np.float64], bool]]:
        """Edges of the box as seen, (2, 2), and whether they are behind the atoms."""
        corners = self._corners(box)
        farthest = int(np.argmin(corners[:, 2]))
        if self.flat:
            corners = corners[[0, 2, 6, 4]]
            return [(corners[[i, (i + 1) % 4], :2], False) for i in range(4)]
        pairs = [(a, b) for a in range(8) for b in range(a) if bin(a ^ b).count("1") == 1]
        return [(corners[[a, b], :2], farthest in (a, b)) for a, b in pairs]


def _sticks(atoms: Atoms, view: _View, chosen: NDArray[np.bool_]) -> LineCollection:
    """Bonds as lines; those that go through a face of the box are left out."""
    if atoms.topology is not None:
        pairs = atoms.topology.bonds[:, 1:]
    else:
        from md_service.graphene import bonds_of

        pairs = bonds_of(atoms.position, atoms.spacing) if atoms.spacing else np.zeros((0, 2), dtype=np.int64)
    pairs = pairs[chosen[pairs].all(axis=1)]
    inside = atoms.box.wrapped(atoms.position)[0]
    crossed = (inside[pairs[:, 1]] - inside[pairs[:, 0]]) @ np.linalg.inv(atoms.box.edges)
    pairs = pairs[(np.abs(crossed) < 0.5).all(axis=1)]
    middle = view.depth[pairs].mean(axis=1)
    pairs = pairs[np.argsort(middle)]
    depth = np.sort(middle)
    near = (depth - depth.min()) / max(float(np.ptp(depth)), 1e-9) if len(depth) else depth
    colour = np.zeros((len(pairs), 4))
    colour[:, :3] = to_rgb(_STICK)
    colour[:, 3] = 0.9 if view.flat else 0.15 + 0.35 * near
    lines = list(view.seen[pairs])
    return LineCollection(lines, colors=colour, linewidths=_points(view, 0.16), zorder=1, capstyle="round")


def _points(view: _View, length: float) -> float:
    """Width of a line of so many angstrom in points, on this page."""
    across = float(np.ptp(view.seen, axis=0).max())
    return max(0.3, length / max(across, 1.0) * _WIDTH * 0.9 * 72.0)


def _balls(
    axes: Axes,
    seen: NDArray[np.float64],
    radius: NDArray[np.float64],
    colour: NDArray[np.float64],
    depth: NDArray[np.float64],
    haze: float,
) -> EllipseCollection:
    """Shaded discs, the farthest first."""
    far = (depth.max() - depth) / max(float(np.ptp(depth)), 1e-9)
    base = colour + (1.0 - colour) * (haze * far)[:, None]
    # Rings that become smaller, lighter and closer to the light make a disc look like a ball.
    rings = int(np.clip(_DISCS // len(seen), 1, _MOST_RINGS))
    inward = np.linspace(0.0, 1.0, rings) if rings > 1 else np.zeros(1)
    size = radius[:, None] * (1.0 - 0.85 * inward)
    centre = seen[:, None, :] + 0.36 * (radius[:, None] * inward)[:, :, None] * np.array([-1.0, 1.0]) / np.sqrt(2.0)
    light = (0.75 * inward**1.8)[None, :, None]
    shade = np.where((inward > 0.0) | (rings == 1), 1.0, 0.72)[None, :, None]  # the outermost is the outline
    faces = shade * (base[:, None, :] + (1.0 - base[:, None, :]) * light)
    diameter = 2.0 * size.ravel()
    return EllipseCollection(
        diameter,
        diameter,
        np.zeros(len(diameter)),
        units="xy",
        offsets=centre.reshape(-1, 2),
        offset_transform=axes.transData,
        facecolors=np.clip(faces.reshape(-1, 3), 0.0, 1.0),
        linewidths=0.0,
        zorder=3,
    )


def _legend(figure: Figure, atoms: Atoms, filler: bool, height: float) -> None:
    names = sorted(set(atoms.elements), key=lambda name: (name not in COLOURS, name))
    entries = [(name, COLOURS.get(name, _OTHER)) for name in names]
    if filler:
        entries = [("platelet", _FILLER)]
    for i, (name, colour) in enumerate(entries):
        x = 0.05 + 0.07 * i
        figure.text(x, height, "●", color=colour, fontsize=16, ha="right", va="center")
        figure.text(x + 0.006, height, name, color=_INK, fontsize=11, ha="left", va="center")
    low, high = atoms.box.low * 1e10, atoms.box.high * 1e10
    size = " x ".join(f"{b - a:.1f}" for a, b in zip(low, high, strict=True))
    figure.text(0.97, height, f"{len(atoms)} atoms, {size} Å", color=_INK, fontsize=11, ha="right", va="center")
