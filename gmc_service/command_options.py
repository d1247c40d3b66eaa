"""What the commands ``scalebridge micro ...`` have in common: types of options, and mistakes as messages."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import click

from protocol.quantities import to_si

CELL_FILE: Final = click.Path(path_type=Path, exists=True, dir_okay=False)
NEW_FILE: Final = click.Path(path_type=Path, dir_okay=False)
NEW_FOLDER: Final = click.Path(path_type=Path, file_okay=False)


class Temperature(click.ParamType):
    """A temperature with its unit, such as ``"80 degC"``, read as K; 0 K or greater."""

    name = "temperature"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Return K; a mistake is told with the name of the option."""
        try:
            kelvin = to_si(str(value), "temperature")
        except ValueError as error:
            self.fail(f"{value!r}: {error}", param, ctx)
        if kelvin < 0.0:
            self.fail(f"{value!r}: must be 0 K or greater", param, ctx)
        return kelvin


@contextmanager
def told_mistakes() -> Iterator[None]:
    """Turn mistakes of the user's files and values into messages of the command line."""
    try:
        yield
    except (ValueError, OSError) as error:
        raise click.ClickException(str(error)) from None
