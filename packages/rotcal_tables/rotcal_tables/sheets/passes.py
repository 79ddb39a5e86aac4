"""Which pass through the table angles a row belongs to, where a table comes to an angle again.

A pass goes through the angles in one direction. Columns of directions and runs state it, or the
order of the rows: the angles at which the same thing was measured, one after the other.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from math import copysign, isclose, remainder

from rotcal_ros.foundation.errors import DataError
from rotcal_ros.foundation.table_columns import folded, undecided
from rotcal_ros.foundation.table_reading import Pass
from rotcal_ros.foundation.units import DEGREE, TURN
from rotcal_tables.sheets.words import is_direction_word


@dataclass(frozen=True, slots=True)
class Stop:
    """The table stood at ``angle`` (rad), which has a ``number``, when a ``row`` was measured.

    ``what`` was measured, as its target and station. ``run`` and ``down`` are what columns state,
    empty and None where there are none; ``way`` is a word for a direction that is not known.
    """

    row: int
    angle: float
    number: int
    what: tuple[str, ...]
    run: str = ""
    down: bool | None = None
    way: str = ""


def resolve_directions(halts: Sequence[Stop], up: str, where: str) -> Sequence[Stop]:
    """Return the halts with the directions of two words of either sign, as clockwise.

    The angle grows with the word ``up``, or as the order of the rows shows; else it is asked.
    """
    words = list({folded(halt.way): halt.way for halt in halts if halt.way}.values())
    if not words or (len(words) == 1 and is_direction_word(words[0])):
        return halts
    if len(words) != 2 or not all(halt.way for halt in halts):
        row = next(halt.row for halt in halts if halt.way)
        raise DataError(
            f"{where}, row {row}: the direction must be up or down, found {words[0]!r}: "
            "write one of these"
        )
    signs = {word: set[float]() for word in words}
    for group in _groups(halts):
        for a, b in pairwise(halts[k] for k in group):
            if a.way == b.way:
                step = remainder(b.angle - a.angle, TURN)
                signs.setdefault(a.way, set()).add(copysign(step != 0.0, step))
    shown = [word for word in words if signs[word] == {1.0}]
    if len(shown) == 1 and {-1.0} in signs.values() and not up:
        up = shown[0]
    if folded(up) not in map(folded, words):
        first, second = words
        raise undecided(
            f"{where}: in which direction the table angle grows, {first!r} and {second!r} do not "
            "say",
            "sheet.up",
            [(word, f"it grows with {word}") for word in words],
        )
    return [replace(halt, down=folded(halt.way) != folded(up)) for halt in halts]


def close_full_turns(halts: Sequence[Stop]) -> list[Stop]:
    """Return the halts with a last angle that closes a turn counted on: 360 degrees after 330."""
    found = list(halts)
    for group in _groups(halts):
        steps = [remainder(b.angle - a.angle, TURN) for a, b in pairwise(halts[k] for k in group)]
        around = len(steps) > 2 and (min(steps) > 0.0 or max(steps) < 0.0)
        if around and isclose(abs(turned := sum(steps)), TURN, abs_tol=1e-9):
            last, first = group[-1], halts[group[0]].angle
            found[last] = replace(halts[last], angle=first + turned)
    return found


def has_repeated_angles(halts: Sequence[Stop]) -> bool:
    """Return whether anything was measured at an angle more than once."""
    return len({(halt.what, halt.number) for halt in halts}) < len(halts)


def assign_passes(halts: Sequence[Stop], where: str, *, both: bool = False) -> list[Pass]:
    """Return the pass of each halt, each direction with runs from 0.

    What is measured once more at the end is measured as it was at first.
    ``both``: there are known to be passes up and down. Without columns, everything that was
    measured at the same angles must have been measured equally often there, in whole passes: a
    missing row could be of any. Else raises DataError, which begins with ``where``.
    """
    halts = _with_runs_of_a_plan(halts)
    runs = {text: n for n, text in enumerate(dict.fromkeys(halt.run for halt in halts))}
    found, again, alone = dict[int, Pass](), dict[int, Counter[bool]](), list[list[int]]()
    shapes = dict[tuple[frozenset[int], str, bool | None], list[int]]()
    for group in _groups(halts):
        run, down = halts[group[0]].run, halts[group[0]].down
        numbers = frozenset(halts[k].number for k in group)
        if down is not None and (run or len(numbers) == len(group)):
            found |= dict.fromkeys(group, (runs[run], down))
            continue
        parts = _parts(halts, group)
        shape = [len(part) for part in parts]
        if not _are_whole(halts, parts) or shapes.setdefault((numbers, run, down), shape) != shape:
            raise _ambiguous(halts, group, where)
        if len(group) == 1 and down is None:
            alone.append(group)
        count = Counter[bool]()
        for part in parts:
            if part is parts[-1] is not parts[0] and len(part) == 1:
                again[part[0]] = count
                continue
            side = _is_down(halts, part) if down is None else down
            found |= dict.fromkeys(part, (runs[run] if run else count[side], side))
            count[side] += 1
            if run and count[side] > 1:
                raise _ambiguous(halts, group, where)
    if alone and (both or any(down for _, down in found.values())):
        raise _ambiguous(halts, alone[0], where)
    for k, count in again.items():
        side = next(found[n][1] for n in sorted(found) if halts[n].number == halts[k].number)
        found[k] = count[side], side
    every = sorted(set(found.values()))
    of_side = {side: [run for run, s in every if s is side] for side in (False, True)}
    return [(of_side[side].index(run), side) for _, (run, side) in sorted(found.items())]


def _with_runs_of_a_plan(halts: Sequence[Stop]) -> Sequence[Stop]:
    """Return the halts without their runs where these are more than the visits of an angle."""
    visits = Counter((halt.what, halt.number) for halt in halts)
    if len({halt.run for halt in halts}) <= max(visits.values()):
        return halts
    return [replace(halt, run="") for halt in halts]


def _groups(halts: Sequence[Stop]) -> Iterator[list[int]]:
    """Yield which halts measured the same, in their order; columns part them further."""
    groups = dict[object, list[int]]()
    for k, halt in enumerate(halts):
        groups.setdefault((halt.what, halt.run, halt.down), []).append(k)
    yield from groups.values()


def _parts(halts: Sequence[Stop], group: list[int]) -> list[list[int]]:
    """Return the passes of a group: a new one begins where the table turns, or comes again."""
    parts, seen = [group[:1]], {halts[group[0]].number}
    for k in group[1:]:
        part = parts[-1]
        turns = len(part) > 1 and _is_down(halts, part) != _is_down(halts, [part[-1], k])
        if turns or halts[k].number in seen:
            parts.append([])
            seen.clear()
        parts[-1].append(k)
        seen.add(halts[k].number)
    return parts


def _is_down(halts: Sequence[Stop], part: Sequence[int]) -> bool:
    """Return whether a pass goes down; one halt alone counts as up."""
    ends = [halts[k].angle for k in part[:2]]
    return remainder(ends[-1] - ends[0], TURN) < 0.0


def _are_whole(halts: Sequence[Stop], parts: Sequence[Sequence[int]]) -> bool:
    """Return whether several passes have all angles, but for that at which the table turned.

    One halt alone may close them.
    """
    if len(parts) == 1:
        return True
    every = {halts[k].number for part in parts for k in part}
    for part, before in zip(parts, [(), *parts], strict=False):
        lacking = every - {halts[k].number for k in part}
        turned = {halts[before[-1]].number} if before else set()
        closes = part is parts[-1] and len(part) == 1
        if lacking and lacking != turned and not closes:
            return False
    return True


def _ambiguous(halts: Sequence[Stop], group: Sequence[int], where: str) -> DataError:
    visits = Counter(halts[k].number for k in group)
    number, _ = visits.most_common(1)[0]
    at = [halts[k] for k in group if halts[k].number == number]
    rows = f"row{'s' * (len(at) > 1)} " + " and ".join(str(halt.row) for halt in at)
    return DataError(
        f"{where}: the table angle {at[0].angle / DEGREE:g} degrees, {rows}: the order of the "
        "rows shows the run, and the way up or down, only where all was measured equally often. "
        "Add a column 'direction' (up or down) and, for several runs, a column 'run', or keep one "
        "row"
    )
