"""What docs/settings.md says about a setting, for the tests of the rooms that declare them.

The page is a document of its own: who changes a default or a range by accident does not change it.
"""

from __future__ import annotations

import math
from dataclasses import MISSING, dataclass
from pathlib import Path
from typing import Any

from rotcal_ros.foundation.settings import Declaration, declarations

PAGE = Path(__file__).parents[1] / "docs" / "settings.md"
FIRST = "## What to state first"
KINDS = {"whole": int, "number": float, "text": str, "true or false": bool}


@dataclass(frozen=True)
class Row:
    """The cells of a row: is the name bold, then kind, default and range as they are printed."""

    required: bool
    kind: str
    default: str
    range: str


def rows(method: str = "") -> dict[str, Row]:
    """Return the rows of the groups that all methods share, or those of one method, by name.

    The short tables at the beginning repeat some of them, in other columns, and are left out. One
    row with a ``*`` in its name is that of each place with which its meaning ends.
    """
    found: dict[str, Row] = {}
    section = ""
    for line in PAGE.read_text().splitlines():
        if line.startswith("## "):
            section = "first" if line == FIRST else line.partition("`method: ")[2].rstrip("`")
        if section == method and line.lstrip("| *").startswith("`") and line.startswith("| "):
            name, kind, default, limits = [cell.strip() for cell in line.split(" | ")[:4]]
            row = Row(name.removeprefix("| ").startswith("**"), kind, default, limits)
            places = line.rpartition("; *: ")[2].rstrip(" |").split(", ")
            for place in places if ".*." in name else ("",):
                found[name.strip("| *`").replace("*", place)] = row
    return found


def assert_documented(cls: type[Any], prefix: str, method: str = "") -> int:
    """Hold kind, default and range of each setting of ``cls`` against the page; count them.

    ``prefix`` is the group, dotted below it where ``cls`` is nested: ``plan.plate``.
    """
    page = rows(method)
    declared = list(declarations(cls))
    for one in declared:
        name = f"{prefix}.{one.name}"
        assert name in page, f"{name} does not stand on the page"
        _assert_row(one, page[name], name)
    return len(declared)


def _assert_row(declared: Declaration, row: Row, name: str) -> None:
    words = row.kind.removeprefix("list of ").split(" ", 1)
    length = int(words[0]) if words[0].isdigit() else None
    kind = " ".join(words[1:] if words[0].isdigit() else words)
    assert declared.kind is KINDS[kind], name
    assert declared.is_list == row.kind.startswith("list of "), name
    assert declared.length == length, name
    assert (declared.default is MISSING) == row.required, name
    if not row.required:
        _assert_default(declared, row.default, name)
    info = declared.info
    if "`" in row.range:
        assert info.named_choices == tuple(
            choice.strip("` ") for choice in row.range.split(",")
        ), name
        return
    low, dots, high = (part.strip() for part in row.range.partition("..."))
    assert bool(row.range) == bool(dots)
    assert info.choices == (), name
    for limit, text in ((info.minimum, low), (info.maximum, high)):
        assert (limit is not None) == bool(text), name
        assert limit is None or _same(limit, float(text)), f"{name}: {limit} against {text}"


def _assert_default(declared: Declaration, text: str, name: str) -> None:
    default = declared.default
    if text == "none":
        assert declared.optional, name
        assert default is None, name
    elif declared.is_list:
        assert isinstance(default, tuple), name
        parts = [part for part in text.strip("[]").split(", ") if part]
        assert [*default] == [_parsed(declared.kind, part) for part in parts], name
    elif declared.kind is float:
        assert _same(default, float(text)), f"{name}: {default} against {text}"
    else:
        assert default == _parsed(declared.kind, text), f"{name}: {default} against {text}"
        assert type(default) is declared.kind, name


def _parsed(kind: type, text: str) -> Any:
    """Return the value that is printed so."""
    if kind is bool:
        return {"true": True, "false": False}[text]
    return ("" if text == "empty" else text.strip("`")) if kind is str else kind(text)


def _same(value: float, printed: float) -> bool:
    """Is it the same number? The page prints six digits."""
    return math.isclose(value, printed, rel_tol=5e-6)
