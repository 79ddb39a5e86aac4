"""Notes what was missing in the bags that were read, for the end of any verb."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from rotcal_ros.bags.storage_scan import FileVerdict

_sentences: Final[ContextVar[dict[str, bool] | None]] = ContextVar("unread", default=None)


@contextmanager
def collect_unread() -> Iterator[dict[str, bool]]:
    """Yield what is noted until the end: sentence -> whether it was printed already."""
    sentences: dict[str, bool] = {}
    token = _sentences.set(sentences)
    try:
        yield sentences
    finally:
        _sentences.reset(token)


def note_unread(sentences: Iterable[str]) -> None:
    """Note that something of a bag was not read; ignored outside of :func:`collect_unread`."""
    noted = _sentences.get()
    if noted is not None:
        for sentence in sentences:
            noted.setdefault(sentence, False)


def note_verdict(verdict: FileVerdict) -> None:
    """Note what a file that was read to its end lacks."""
    if not verdict.whole:
        note_unread([f"{verdict.path.name}: {verdict.describe()}"])


def note_printed(line: str) -> None:
    """Note a line that was printed."""
    noted = _sentences.get() or {}
    noted.update((sentence, True) for sentence in noted if sentence in line)
