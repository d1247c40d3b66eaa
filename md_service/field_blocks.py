"""Running sums of an array in blocks of equal length, for standard errors of what is not linear in it."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

#: Blocks at most; then neighbours are merged, so there are at least half as many.
MOST_BLOCKS: Final = 8


class FieldBlocks:
    """Sums of consecutive samples, merged as they become many.

    Attributes
    ----------
    total : ndarray, shape (...)
        Sum of all samples.
    samples : int
        Their number.
    """

    def __init__(self, shape: tuple[int, ...]) -> None:
        self.total = np.zeros(shape)
        self.samples = 0
        self._blocks: list[NDArray[np.float64]] = []
        self._counts: list[int] = []
        self._length = 1  # additions in a whole block
        self._open = 0  # additions in the last block, which is whole at `_length`

    def add(self, value: NDArray[np.float64], samples: int = 1) -> None:
        """Add the sum of so many samples."""
        if self._open in (0, self._length):
            if len(self._blocks) == MOST_BLOCKS:
                self._merge()
            self._blocks.append(np.zeros_like(self.total))
            self._counts.append(0)
            self._open = 0
        self._blocks[-1] += value
        self._counts[-1] += samples
        self._open += 1
        self.total += value
        self.samples += samples

    def _merge(self) -> None:
        self._blocks = [a + b for a, b in zip(self._blocks[::2], self._blocks[1::2], strict=True)]
        self._counts = [a + b for a, b in zip(self._counts[::2], self._counts[1::2], strict=True)]
        self._length *= 2

    def means(self) -> list[NDArray[np.float64]]:
        """Means of the whole blocks, in order of time."""
        whole = len(self._blocks) - (self._open < self._length)
        return [block / count for block, count in zip(self._blocks[:whole], self._counts[:whole], strict=True)]

    def state(self) -> dict[str, NDArray[np.float64]]:
        """Everything `restored` needs."""
        return {
            "total": self.total.copy(),
            "blocks": np.array(self._blocks).reshape(-1, *self.total.shape),
            "counts": np.array([self.samples, self._length, self._open, *self._counts], dtype=np.float64),
        }

    @classmethod
    def restored(cls, state: dict[str, NDArray[np.float64]], shape: tuple[int, ...]) -> FieldBlocks:
        """Blocks from a state.

        Raises
        ------
        ValueError
            If the state is of an array of another shape.
        """
        found = cls(shape)
        blocks, counts = state["blocks"], state["counts"]
        if state["total"].shape != shape or blocks.shape[1:] != shape or counts.shape != (3 + len(blocks),):
            raise ValueError(f"state of blocks has shape {state['total'].shape}; it must have {shape}")
        found.total = np.array(state["total"])
        found.samples, found._length, found._open = (int(value) for value in counts[:3])
        found._blocks = [np.array(block) for block in blocks]
        found._counts = [int(count) for count in counts[3:]]
        return found
