"""Names and texts from elsewhere, made safe to show: one function for each medium.

Texts of a bag, a file name or a configuration may hold line ends, control sequences of a terminal,
characters that reverse the direction of reading, or bytes that are not text. All output for people
goes through here; no text is refused because of such characters.
"""

from __future__ import annotations

import unicodedata
from collections.abc import Mapping
from typing import Any, Final

_UNSEEN: Final = frozenset({"Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp"})
"""Categories of Unicode without a visible sign: controls, directions, halves, line ends."""
_JOINERS: Final = "\u200c\u200d"
"""Invisible, but needed to spell Persian and the scripts of India."""
_FORMULA: Final = ("=", "+", "-", "@", "\t", "\r")
"""First characters of a cell that a spreadsheet would compute."""


def printable(text: str) -> str:
    r"""Return ``text`` in one line of visible characters; all others as Python escapes them.

    The one form for terminal, log, page, figure and XML (whose 1.0 has no control characters).

    >>> printable("table 1\n\x1b[2J \u202etxt.exe")
    'table 1\\n\\x1b[2J \\u202etxt.exe'
    """
    if text.isprintable():
        return text
    return "".join(_escaped(c) if _unseen(c) else c for c in text)


def printable_lines(text: str) -> str:
    """Return ``text`` like :func:`printable`, but with its line ends and tabs as they are."""
    if text.isprintable():
        return text
    return "".join(_escaped(c) if _unseen(c) and c not in "\n\t" else c for c in text)


def printable_data(data: Any) -> Any:
    """Return plain data (mappings, lists, texts, numbers) with every text and key printable."""
    if isinstance(data, str):
        return printable(data)
    if isinstance(data, Mapping):
        return {printable_data(key): printable_data(value) for key, value in data.items()}
    if isinstance(data, list | tuple):
        return [printable_data(value) for value in data]
    return data


def table_cell(text: str) -> str:
    """Return ``text`` for a cell of CSV: printable, and never a formula of a spreadsheet."""
    shown = printable(text)
    return f"'{shown}" if shown.startswith(_FORMULA) else shown


def shortened(text: str, longest: int) -> str:
    """Return ``text`` with at most ``longest`` characters, without its middle if necessary."""
    half = (longest - 1) // 2
    return text if len(text) <= longest else f"{text[:half]}…{text[-half:]}"


def encodable(text: str) -> str:
    """Return ``text`` with bytes that are not text escaped, so that UTF-8 can hold it."""
    return text.encode("utf-8", "backslashreplace").decode("utf-8")


def _unseen(character: str) -> bool:
    return unicodedata.category(character) in _UNSEEN and character not in _JOINERS


def _escaped(character: str) -> str:
    return character.encode("unicode_escape").decode("ascii")
