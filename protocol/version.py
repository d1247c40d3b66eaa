"""Protocol version, and the rule by which two sides agree on one.

The version of the protocol is apart from the version of the package: it changes only when the wire
does. Sides of the same major version talk; the smaller minor is the one both use, and fields that a
newer minor added are ignored by the older side.
"""

from __future__ import annotations

from importlib import metadata
from typing import NamedTuple


class Version(NamedTuple):
    """A protocol version, `major.minor`."""

    major: int
    minor: int

    def __str__(self) -> str:
        return f"{self.major}.{self.minor}"


OLDEST = Version(1, 0)
NEWEST = Version(1, 5)


def agree(
    theirs_oldest: Version, theirs_newest: Version, oldest: Version = OLDEST, newest: Version = NEWEST
) -> Version | None:
    """Return the newest version that both ranges hold, or None where they do not meet."""
    common = min(newest, theirs_newest)
    # A range that spans a minor step of the same major holds every minor between its ends.
    return common if common >= max(oldest, theirs_oldest) else None


def package_version() -> str:
    """Return the version of the installed scalebridge package."""
    return metadata.version("scalebridge")
