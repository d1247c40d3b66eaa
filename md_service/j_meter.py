"""J of a running sample: contours and the domains inside them around one tip, against a stored reference.

What depends on places alone is computed once, so that a measurement is a few sparse products. Atoms that the crack
passes keep the energy of the bonds they lost, which is no strain energy: leave them out with `JMeter.at_tip`.

At a temperature the mean potential energy stands for the Helmholtz free energy of Eq 76. Its part linear in the
strain, from thermal expansion alpha, shifts J by about ``(4/3) alpha T 2 K sqrt(r / (2 pi))`` on a contour of radius r.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from md_service import units
from md_service.atoms import Atoms
from md_service.j_integral import Contour, Domain
from md_service.weighted_fit import Slit

_FEWEST_BLOCKS = 4
_INNER = 0.5  # inner radius of a domain over its outer one


@dataclass(frozen=True)
class AtomFields:
    """Means of every atom over some time.

    Attributes
    ----------
    position : ndarray, shape (n, 3)
        m, not wrapped.
    energy : ndarray, shape (n,)
        Potential energy, J.
    virial : ndarray, shape (n, 6)
        Of the interatomic forces: xx, yy, zz, xy, xz, yz, tension positive, J.
    """

    position: NDArray[np.float64]
    energy: NDArray[np.float64]
    virial: NDArray[np.float64]

    def __add__(self, other: AtomFields) -> AtomFields:
        return AtomFields(self.position + other.position, self.energy + other.energy, self.virial + other.virial)

    def __sub__(self, other: AtomFields) -> AtomFields:
        return AtomFields(self.position - other.position, self.energy - other.energy, self.virial - other.virial)

    def __truediv__(self, number: float) -> AtomFields:
        return AtomFields(self.position / number, self.energy / number, self.virial / number)


@dataclass(frozen=True)
class JValues:
    """J of a crack.

    Attributes
    ----------
    contour, domain : ndarray, shape (k,)
        J along each contour and over the domain inside it, J/m^2.
    contour_error, domain_error : ndarray, shape (k,), optional
        Standard errors, J/m^2, where blocks were given.
    """

    contour: NDArray[np.float64]
    domain: NDArray[np.float64]
    contour_error: NDArray[np.float64] | None = None
    domain_error: NDArray[np.float64] | None = None


class JMeter:
    """Measures J around the tip of a straight crack that comes from -x.

    Parameters
    ----------
    atoms : Atoms
        The sample, cracked and without load.
    tip : (float, float)
        x and y of the tip, m.
    half_sizes : sequence of float
        Half edges of the square contours, m. Contours must stay clear of anchors, whose springs are body forces. The
        domain inside a contour lies between circles of half its half size and of all of it.
    temperature : float
        K. The thermal part of the reference's stress, -k T of each atom, follows from it.
    without : ndarray of int64, optional
        Rows of atoms that are left out.

    Attributes
    ----------
    half_sizes : tuple of float
        m.
    slit : Slit
        The crack with the width of its gap.

    Raises
    ------
    ValueError
        For a contour that is too small or reaches beyond the atoms, or a bad number.
    """

    def __init__(
        self,
        atoms: Atoms,
        tip: tuple[float, float],
        half_sizes: Sequence[float],
        *,
        temperature: float = 0.0,
        without: NDArray[np.int64] | None = None,
    ) -> None:
        if not half_sizes:
            raise ValueError("half_sizes is empty; at least one contour is needed")
        if not np.isfinite(tip).all():
            raise ValueError(f"tip is {tip} m; it must be finite")
        if not (np.isfinite(temperature) and temperature >= 0.0):
            raise ValueError(f"temperature is {temperature} K; it must be finite and not negative")
        self.half_sizes = tuple(float(half) for half in half_sizes)
        self._atoms = atoms
        self._temperature = temperature
        self._reference: AtomFields | None = None

        place, volume = atoms.position, atoms.atom_volume
        if atoms.thickness is None:
            thickness, spacing = float((atoms.box.high - atoms.box.low)[2]), float(np.cbrt(volume))
        else:
            # Atoms of layers on top of each other are closer in the plane than in a layer.
            thickness, spacing = atoms.thickness, max(float(np.sqrt(volume / atoms.thickness)), atoms.spacing or 0.0)
        self.slit = Slit(tip[0], tip[1], _half_gap(atoms, tip, spacing))
        self._contours = [Contour(place, self.slit, half, spacing, without) for half in self.half_sizes]
        self._domains = [
            Domain(place, self.slit, _INNER * half, half, spacing, volume / thickness, without)
            for half in self.half_sizes
        ]

    def at_tip(self, x: float, without: NDArray[np.int64] | None = None) -> JMeter:
        """A meter with the same reference around a tip that has moved along the crack's line.

        Parameters
        ----------
        x : float
            m.
        without : ndarray of int64, optional
            Rows of the atoms on the faces that the crack has opened.

        Raises
        ------
        ValueError
            If a contour now reaches beyond the atoms.
        """
        moved = JMeter(
            self._atoms,
            (x, self.slit.y),
            self.half_sizes,
            temperature=self._temperature,
            without=without,
        )
        moved._reference = self._reference
        return moved

    def set_reference(self, fields: AtomFields) -> None:
        """Store the unloaded, cracked sample, averaged over a long time, from which J is counted.

        Raises
        ------
        ValueError
            If an array has a wrong shape or is not finite.
        """
        self._check(fields)
        self._reference = fields

    def measure(self, fields: AtomFields) -> JValues:
        """J of averaged fields.

        J holds the product of strain and stress, whose fluctuations do not average out: average the fields, then
        measure, instead of averaging J.

        Raises
        ------
        ValueError
            If there is no reference yet, an array has a wrong shape or is not finite.
        """
        if self._reference is None:
            raise ValueError("J has no reference; call set_reference with the unloaded sample first")
        self._check(fields)
        rest, volume = self._reference, self._atoms.atom_volume
        thermal = units.BOLTZMANN * self._temperature * np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0])
        arguments = (
            fields.position - rest.position,
            (fields.energy - rest.energy) / volume,
            (fields.virial - rest.virial) / volume,
            (rest.virial - thermal) / volume,
        )
        return JValues(
            np.array([contour.j(*arguments) for contour in self._contours]),
            np.array([domain.j(*arguments) for domain in self._domains]),
        )

    def measure_blocks(self, blocks: Sequence[AtomFields]) -> JValues:
        """J of the mean of blocks of equal length, with standard errors by the jackknife over blocks.

        Blocks must be longer than the fields' correlation time, as those of `md_service.field_blocks` grow to be. The
        noise of the reference is not in the standard errors.

        Raises
        ------
        ValueError
            If there are fewer than four blocks, or as `measure`.
        """
        count = len(blocks)
        if count < _FEWEST_BLOCKS:
            raise ValueError(f"{count} blocks given; at least {_FEWEST_BLOCKS} are needed for a standard error")
        for block in blocks:
            self._check(block)
        total = blocks[0]
        for block in blocks[1:]:
            total = total + block
        mean = self.measure(total / count)
        left_out = [self.measure((total - block) / (count - 1)) for block in blocks]
        factor = np.sqrt(count - 1.0)
        return JValues(
            mean.contour,
            mean.domain,
            factor * np.std([values.contour for values in left_out], axis=0),
            factor * np.std([values.domain for values in left_out], axis=0),
        )

    def _check(self, fields: AtomFields) -> None:
        n = len(self._atoms)
        for name, shape in (("position", (n, 3)), ("energy", (n,)), ("virial", (n, 6))):
            values = getattr(fields, name)
            if values.shape != shape:
                raise ValueError(f"{name} has shape {values.shape}; it must have {shape}")
            if not np.isfinite(values).all():
                row = int(np.argwhere(~np.isfinite(values))[0][0])
                raise ValueError(f"{name} of atom {row} is not finite")


def _half_gap(atoms: Atoms, tip: tuple[float, float], spacing: float) -> float:
    """Half the width of the slit: material ends half a spacing beyond its outermost atoms."""
    # Where a crack has grown beyond the slit there is no gap.
    end = tip[0] if atoms.crack is None else min(tip[0], atoms.crack.tip_x)
    behind = atoms.position[:, 0] < end - spacing
    if not behind.any():
        raise ValueError(f"no atom lies behind the tip at x = {tip[0]:.4g} m; the crack must come from -x")
    return max(0.0, float(np.abs(atoms.position[behind, 1] - tip[1]).min()) - 0.5 * spacing)
