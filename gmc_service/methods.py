"""The methods of homogenisation by name."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:  # the command line reads the names for its help, without numpy
    from gmc_service.homogenised import Homogenise

#: Module of each method; imported when it is asked for, since one needs a sparse solver and another a compiler.
METHODS: Final[dict[str, str]] = {
    "gmc": "gmc_service.gmc_reduced",
    "gmc_dense": "gmc_service.gmc_dense",
    "high_fidelity": "gmc_service.high_fidelity",
    "mori_tanaka": "gmc_service.mori_tanaka",
}


def find_method(name: str) -> Homogenise:
    """Return the function `homogenise` of a method.

    Raises
    ------
    ValueError
        If there is no method of that name.
    """
    if name not in METHODS:
        raise ValueError(f"method is {name!r}; it must be one of {', '.join(METHODS)}")
    found: Homogenise = importlib.import_module(METHODS[name]).homogenise
    return found
