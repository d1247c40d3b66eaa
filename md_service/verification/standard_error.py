"""Standard errors against the scatter of the means over replicas."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from md_service.verification.framed_sheet import framed_sheet
from protocol.verification import Case, Check

_REPLICAS: Final = 40
_WINDOW: Final = 20
_WINDOWS: Final = 128


class _Pair:
    """Means of the replicas, and the standard errors told with them."""

    def __init__(self) -> None:
        self._told: list[NDArray[np.float64]] = []
        self._means: list[NDArray[np.float64]] = []

    def add(self, mean: NDArray[np.float64], told: NDArray[np.float64]) -> None:
        self._means.append(mean)
        self._told.append(told)

    def ratio(self) -> float:
        """Root mean square of the errors told over that of the scatter, over all components."""
        scatter = np.var(self._means, axis=0, ddof=1)
        return float(np.sqrt(np.mean(np.square(self._told)) / np.mean(scatter)))


def standard_error(folder: Path) -> list[Check]:
    """Of one window's mean reaction, of that over many windows, and of the reference.

    Each replica starts where the last one ended, with noise of its own, and its windows are long against the memory
    of that. Twelve components of 40 replicas tell the scatter within 5 %.
    """
    # Strong dampers, so that 1.3 ps are long against the swinging of the sheet.
    sheet = framed_sheet(folder, size=16e-10, frame=4e-10, stiffness=80.0, damping_time=2e-14)
    engine = sheet.engine
    engine.equilibrate(2000)
    engine.measure_reference(16, _WINDOW)
    still = np.zeros_like(sheet.anchor)
    single, many, reference = _Pair(), _Pair(), _Pair()
    # Forces are told against one and the same reference.
    common = {name: value for name, value in engine.state().items() if name.startswith("engine_reference_")}
    for replica in range(_REPLICAS):
        state = {**engine.state(), **common}
        state["counters"][1] = 100.0 + replica  # seed of the thermostat
        engine.restore(state)
        # No error is as small as this, so all windows are run.
        mean = engine.advance(_WINDOW, sheet.anchor, still, until_error=1e-30, most_windows=_WINDOWS)
        many.add(mean.ivc_force, mean.ivc_standard_error)
        one = engine.advance(_WINDOW, sheet.anchor, still)
        single.add(one.ivc_force, one.ivc_standard_error)
        measured = engine.measure_reference(_WINDOWS, _WINDOW)
        reference.add(measured.ivc_force, measured.ivc_standard_error)
    engine.close()
    source = f"scatter of that mean over {_REPLICAS} replicas with noise of their own, 12 components"
    return [
        Check(f"standard error of {what} over its scatter", pair.ratio(), 1.0, 0.2, source)
        for what, pair in (
            (f"the mean reaction over {_WINDOW} steps", single),
            (f"the mean reaction over {_WINDOWS} windows of {_WINDOW} steps", many),
            (f"the reference over {_WINDOWS} windows of {_WINDOW} steps", reference),
        )
    ]


CASES = [Case("md", "standard-error", "standard error of means against their scatter over 40 replicas", standard_error)]
