"""What was missing in the bags that were read, noted for the end of any verb."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from rotcal_ros.bags.verdict import FileVerdict

_found: Final[ContextVar[dict[str, bool] | None]] = ContextVar("unread", default=None)


@contextmanager
def unread() -> Iterator[dict[str, bool]]:
    """Yield what is noted until the end: sentences, and whether they were printed already."""
    found: dict[str, bool] = {}
    token = _found.set(found)
    try:
        yield found
    finally:
        _found.reset(token)


def note_unread(sentences: Iterable[str]) -> None:
    """Note that something of a bag was not read; ignored outside of :func:`unread`."""
    known = _found.get()
    if known is not None:
        for sentence in sentences:
            known.setdefault(sentence, False)


def note_verdict(verdict: FileVerdict) -> None:
    """Note what a file that was read to its end lacks."""
    if not verdict.whole:
        note_unread([f"{verdict.path.name}: {verdict.sentence()}"])


def note_told(line: str) -> None:
    """Note a line that people have read."""
    known = _found.get() or {}
    known.update((sentence, True) for sentence in known if sentence in line)
