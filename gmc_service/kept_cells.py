"""What is kept of registered cells: as many as a stated number, the one unused for longest goes first."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable
from typing import Final, Generic, TypeVar

from protocol.errors import ProtocolError

Value = TypeVar("Value")

#: Cells that a process keeps.
MOST_CELLS: Final = 64


class KeptCells(Generic[Value]):
    """Values by the id of their cell; may be used from several threads.

    Parameters
    ----------
    most : int
        Cells that are kept.
    """

    def __init__(self, most: int = MOST_CELLS) -> None:
        self._most = most
        self._values: OrderedDict[str, Value] = OrderedDict()
        self._lock = threading.Lock()

    def get(self, cell: str) -> Value | None:
        """Return the value of a cell, which counts as a use, or None."""
        with self._lock:
            value = self._values.get(cell)
            if value is not None:
                self._values.move_to_end(cell)
            return value

    def keep(self, cell: str, make: Callable[[], Value]) -> Value:
        """Return the value of a cell; it is made where there is none."""
        found = self.get(cell)
        if found is not None:
            return found
        made = make()  # outside the lock: it may compute for long, and two that make the same do no harm
        with self._lock:
            value = self._values.setdefault(cell, made)
            self._values.move_to_end(cell)
            while len(self._values) > self._most:
                self._values.popitem(last=False)
            return value


def unknown_cell(cell: str) -> ProtocolError:
    """Return the error of a cell that is not kept."""
    return ProtocolError(
        "unknown_cell", f"cell {cell!r} is not known here", field="cell", hint="register it and ask again"
    )
