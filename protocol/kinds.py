"""Parts that come in several kinds, told apart by one word in them, such as the laws of a material."""

from __future__ import annotations

from typing import Any

from pydantic import Discriminator

from protocol.messages import FIELD_RULE

#: Marks of a kind in the place of a validation error; they are no part of a field's path.
_MARK = "<{}>"


def mark(word: str) -> str:
    """Return the tag of a kind; `path_of` knows it from a field's name."""
    return _MARK.format(word)


def told_apart_by(name: str, *words: str) -> Discriminator:
    """Return what picks the kind of a part by its field `name`; left out, it is the first of `words`."""

    def kind_of(value: Any) -> str | None:
        word = value.get(name, words[0]) if isinstance(value, dict) else getattr(value, name, None)
        return mark(word) if isinstance(word, str) and word in words else None

    problem = f"must be one of {', '.join(words)}"
    return Discriminator(
        kind_of,
        custom_error_type=FIELD_RULE,
        custom_error_message="{problem}",
        custom_error_context={"field": name, "problem": problem},
    )


def path_of(place: tuple[str | int, ...]) -> tuple[str | int, ...]:
    """Return the path of a field from the place of a validation error: without the marks of kinds."""
    return tuple(part for part in place if not (isinstance(part, str) and part.startswith("<") and part.endswith(">")))
