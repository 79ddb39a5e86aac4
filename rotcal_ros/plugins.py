"""What installed packages bring: methods, controllers, instruments, found by their entry points.

The built-in ones are found the same way, see ``setup.py``; there is no built-in instrument.
"""

from __future__ import annotations

import difflib
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import Any, Final

from rotcal_ros.errors import ConfigurationError

METHODS: Final = "rotcal_ros.methods"
CONTROLLERS: Final = "rotcal_ros.controllers"
INSTRUMENTS: Final = "rotcal_ros.instruments"
_LONGEST: Final = 80
"""Characters of a name that is compared with those that are known."""


@cache
def _found(group: str) -> dict[str, EntryPoint]:
    return {point.name: point for point in sorted(entry_points(group=group))}


def names(group: str) -> tuple[str, ...]:
    """Return the names that ``group`` offers, in alphabetical order; loads nothing."""
    return tuple(_found(group))


@cache
def load(group: str, name: str, what: str) -> Any:
    """Return what the entry point ``name`` of ``group`` names.

    Raises ConfigurationError, with the nearest name, when there is none; ``what`` says in words
    what was looked for.
    """
    found = _found(group)
    if name not in found:
        raise ConfigurationError(f"unknown {what} {name!r:.80}{nearest(name, found)}")
    try:
        return found[name].load()
    except ImportError as error:
        raise ConfigurationError(f"the {what} {name!r} cannot be loaded: {error}") from error


def nearest(name: str, known: Any) -> str:
    """Return a hint at the name that was probably meant, or at all that are known."""
    near = difflib.get_close_matches(name[:_LONGEST], list(known), n=1)
    if near:
        return f"; did you mean {near[0]!r}?"
    return f"; known: {', '.join(known) or 'none'}"
