"""J of a run: means of the atoms' fields since the last value, in blocks, and J of them with its standard error."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from md_service.atoms import Atoms
from md_service.bonds import Bonds
from md_service.cuts import Cut
from md_service.field_blocks import FieldBlocks
from md_service.force_fields import ForceField
from md_service.j_meter import AtomFields, JMeter

#: Fields of an engine that J is made of.
J_FIELDS: Final = ("mean_position", "virial", "energy")
#: Blocks from which a standard error can be told.
FEWEST_BLOCKS: Final = 4
_COLUMNS: Final = 10


@dataclass(frozen=True)
class JAnswer:
    """J of each contour, shape (k,), J/m^2; errors are 0 where they are not known.

    Attributes
    ----------
    contour, contour_error : ndarray, shape (k,)
        Along the contours.
    domain, domain_error : ndarray, shape (k,)
        Over the domains inside them.
    """

    contour: NDArray[np.float64]
    contour_error: NDArray[np.float64]
    domain: NDArray[np.float64]
    domain_error: NDArray[np.float64]


class JRecord:
    """Collects what J is made of.

    Parameters
    ----------
    atoms : Atoms
        The sample.
    force_field : ForceField, optional
        Gives the limits of a bond: atoms with broken bonds are left out of J.
    temperature : float
        Of the run, K.
    """

    def __init__(self, atoms: Atoms, force_field: ForceField | None, temperature: float) -> None:
        self._atoms = atoms
        self._temperature = temperature
        self._bonds = Bonds(atoms, force_field)
        self._meter: tuple[tuple[float, ...], JMeter] | None = None
        self.begin()

    def sever(self, cuts: tuple[Cut, ...]) -> None:
        """Take over all cuts through the sample."""
        self._bonds.sever(cuts)

    @property
    def samples(self) -> int:
        """Samples in the present means."""
        return self._blocks.samples

    def begin(self) -> None:
        """Begin new means."""
        self._blocks = FieldBlocks((len(self._atoms), _COLUMNS))

    def forget_reference(self) -> None:
        """The unloaded sample was measured anew."""
        self._meter = None

    def add(self, means: dict[str, NDArray[np.float64]], samples: int) -> None:
        """Add samples.

        Parameters
        ----------
        means : dict of str to ndarray
            The fields `J_FIELDS`, means over all samples since `begin`, as an engine has them.
        samples : int
            How many of these are new.
        """
        sums = np.column_stack([means[name] for name in J_FIELDS]) * (self.samples + samples)
        self._blocks.add(sums - self._blocks.total, samples)

    def measure(
        self,
        tip: tuple[float, float],
        half_sizes: tuple[float, ...],
        rest: dict[str, NDArray[np.float64]],
        position: NDArray[np.float64],
    ) -> JAnswer:
        """J of the present means.

        Parameters
        ----------
        tip : (float, float)
            m.
        half_sizes : tuple of float
            Of the contours, m.
        rest : dict of str to ndarray
            The fields `J_FIELDS` of the unloaded sample.
        position : ndarray, shape (n, 3)
            Of the atoms now, m, which tells broken bonds.

        Raises
        ------
        ValueError
            If there are no samples, or for contours that the sample has no room for.
        """
        if not self.samples:
            raise ValueError("samples are missing; J needs at least one window since the last value")
        meter = self._meter_at(tip, half_sizes, rest, position)
        mean = meter.measure(_atom_fields(self._blocks.total / self.samples))
        blocks = [_atom_fields(block) for block in self._blocks.means()]
        none = np.zeros(len(half_sizes))
        if len(blocks) < FEWEST_BLOCKS:
            return JAnswer(mean.contour, none, mean.domain, none)
        scatter = meter.measure_blocks(blocks)
        assert scatter.contour_error is not None and scatter.domain_error is not None
        return JAnswer(mean.contour, scatter.contour_error, mean.domain, scatter.domain_error)

    def _meter_at(
        self,
        tip: tuple[float, float],
        half_sizes: tuple[float, ...],
        rest: dict[str, NDArray[np.float64]],
        position: NDArray[np.float64],
    ) -> JMeter:
        """The meter at a tip; its matrices are kept until tip, contours or broken bonds change."""
        bonds = self._bonds
        without = np.unique(bonds.pairs[bonds.broken(bonds.lengths(position))])
        key = (*tip, *half_sizes, *without)
        if self._meter is None or self._meter[0] != key:
            meter = JMeter(
                self._atoms, tip, half_sizes, temperature=self._temperature, without=without if len(without) else None
            )
            meter.set_reference(AtomFields(rest["mean_position"], rest["energy"], rest["virial"]))
            self._meter = (key, meter)
        return self._meter[1]

    def state(self) -> dict[str, NDArray[np.float64]]:
        """Everything `restore` needs; empty while there are no samples."""
        return self._blocks.state() if self.samples else {}

    def restore(self, state: dict[str, NDArray[np.float64]]) -> None:
        """Go back to a state.

        Raises
        ------
        ValueError
            If the state is of another sample.
        """
        shape = (len(self._atoms), _COLUMNS)
        try:
            self._blocks = FieldBlocks.restored(state, shape) if state else FieldBlocks(shape)
        except KeyError as error:
            raise ValueError(f"state of J lacks {error}") from None
        self._meter = None


def _atom_fields(columns: NDArray[np.float64]) -> AtomFields:
    """Fields for J from the columns of `J_FIELDS`."""
    return AtomFields(columns[:, :3].copy(), columns[:, 9].copy(), columns[:, 3:9].copy())
