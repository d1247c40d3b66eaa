"""The list of cases of this package for `scalebridge verify`."""

from __future__ import annotations

from md_service.verification import overhead
from protocol.verification import Case

CASES: list[Case] = [*overhead.CASES]
