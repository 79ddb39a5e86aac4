"""Small and large harm to bytes, texts and plain data; every choice comes from one ``Random``."""

from __future__ import annotations

import copy
import datetime
import struct
from collections.abc import Callable, Iterator, Sequence
from random import Random
from typing import Any, Final

EDGES: Final = (0, 1, 2, 3, 7, 0x7F, 0xFF, 0x7FFF, 0xFFFF, 0x7FFF_FFFF, 0xFFFF_FFFF,
                0x7FFF_FFFF_FFFF_FFFF, 0xFFFF_FFFF_FFFF_FFFF, 1 << 32, 1 << 40)  # fmt: skip
"""Numbers at which lengths, counts and offsets go wrong."""

HOSTILE: Final = ("", " ", "\x00", "\x1b]0;owned\x07\x1b[31m", "a\nb", "\u202egnp.exe", "\ud800",
                  "$\\frac{x}$", "[red]x[/red]", "=1+1", "n" * 255, "../../etc", "{{ 7 }}", "%s%n",
                  "<script>", "NaN", "2026-02-30", "1e400", "\uffff", "ﷺ" * 30)  # fmt: skip
"""Texts that one medium or another takes for more than a text."""


def _nested(depth: int) -> Any:
    value: Any = 1
    for _ in range(depth):
        value = [value]
    return value


ODD: Final = (
    None, True, False, 0, -1, 1, 2, 3.5, -0.0, 1e308, -1e308, 5e-324, float("nan"), float("inf"),
    float("-inf"), 1 << 31, 1 << 63, -(1 << 63), 10**30, [], {}, [[]], [None], [1, "a"], ["a"],
    {"a": 1}, {1: 2}, [[1, 2], [3]], [0.0] * 3, [float("nan")] * 3, list(range(400)), _nested(40),
    datetime.date(2026, 1, 1), datetime.datetime(2026, 1, 1), b"\xff\x00", *HOSTILE,
)  # fmt: skip
"""Values that nobody expects where they stand."""


def harmed_bytes(rng: Random, data: bytes, tokens: Sequence[bytes] = ()) -> bytes:
    """Return ``data`` with one to four changes of bytes, ``tokens`` among what comes in."""
    harmed = bytearray(data)
    for _ in range(rng.randint(1, 4)):
        change = rng.choice(_CHANGES)
        change(rng, harmed, tokens)
    return bytes(harmed)


def _place(rng: Random, data: bytearray) -> int:
    return rng.randrange(len(data) + 1)


def _flip(rng: Random, data: bytearray, _tokens: Sequence[bytes]) -> None:
    if data:
        data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)


def _cut(rng: Random, data: bytearray, _tokens: Sequence[bytes]) -> None:
    start = _place(rng, data)
    del data[start : start + int(rng.paretovariate(0.6))]


def _truncate(rng: Random, data: bytearray, _tokens: Sequence[bytes]) -> None:
    del data[_place(rng, data) :]


def _double(rng: Random, data: bytearray, _tokens: Sequence[bytes]) -> None:
    start, goal = _place(rng, data), _place(rng, data)
    data[goal:goal] = data[start : start + min(int(rng.paretovariate(0.5)), 4096)]


def _insert(rng: Random, data: bytearray, tokens: Sequence[bytes]) -> None:
    place = _place(rng, data)
    data[place:place] = rng.choice(tokens) if tokens else rng.randbytes(rng.randint(1, 8))


def _edge(rng: Random, data: bytearray, _tokens: Sequence[bytes]) -> None:
    form = rng.choice(("<B", "<H", "<I", "<Q", ">I", ">Q"))
    size, place = struct.calcsize(form), _place(rng, data)
    data[place : place + size] = struct.pack(form, rng.choice(EDGES) & ((1 << 8 * size) - 1))


_CHANGES: Final[Sequence[Callable[[Random, bytearray, Sequence[bytes]], None]]] = (
    _flip, _flip, _cut, _truncate, _double, _insert, _insert, _edge, _edge,
)  # fmt: skip


def harmed_tree(rng: Random, tree: Any) -> Any:
    """Return plain data with one to three changes of values, keys and their places."""
    harmed = copy.deepcopy(tree)
    for _ in range(rng.randint(1, 3)):
        places = list(_places(harmed))
        if not places:
            return rng.choice(ODD)
        parent, key = rng.choice(places)
        _change(rng, parent, key, places)
    return harmed


def _change(rng: Random, parent: Any, key: Any, places: list[tuple[Any, Any]]) -> None:
    how = rng.randrange(8)
    if how <= 3:
        parent[key] = copy.deepcopy(rng.choice(ODD))
    elif how == 4:
        del parent[key]
    elif how == 5:
        other, its = rng.choice(places)
        parent[key] = copy.deepcopy(other[its])
    elif isinstance(parent, list):
        parent.insert(key, copy.deepcopy(rng.choice(ODD)))
    elif how == 6:
        parent[rng.choice(HOSTILE)] = parent.pop(key)
    else:
        value = parent[key]
        number = isinstance(value, int | float) and not isinstance(value, bool)
        parent[key] = value * rng.choice((-1, 0, 1e-9, 10, 1e6)) if number else [value]


def _places(tree: Any) -> Iterator[tuple[Any, Any]]:
    """Yield every (container, key); those of plain data."""
    stack = [tree] if isinstance(tree, dict | list) else []
    while stack:
        value = stack.pop()
        keys = value if isinstance(value, dict) else range(len(value))
        for key in list(keys):
            yield value, key
            if isinstance(value[key], dict | list):
                stack.append(value[key])
