"""The order of components everywhere in this room; strains of shear are engineering ones, axis 1 runs along the fibre.

Standard library only: the command line reads it for its help.
"""

from __future__ import annotations

from typing import Final

COMPONENTS: Final = ("11", "22", "33", "23", "13", "12")
