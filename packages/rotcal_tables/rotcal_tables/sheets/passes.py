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
class TableStop:
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


def resolve_directions(stops: Sequence[TableStop], up: str, where: str) -> Sequence[TableStop]:
    """Return the stops with the directions of two words of either sign, as clockwise.

    The angle grows with the word ``up``, or as the order of the rows shows; else it is asked.
    """
    words = list({folded(stop.way): stop.way for stop in stops if stop.way}.values())
    if not words or (len(words) == 1 and is_direction_word(words[0])):
        return stops
    if len(words) != 2 or not all(stop.way for stop in stops):
        row = next(stop.row for stop in stops if stop.way)
        raise DataError(
            f"{where}, row {row}: the direction must be up or down, found {words[0]!r}: "
            "write one of these"
        )
    signs = {word: set[float]() for word in words}
    for group in _groups(stops):
        for a, b in pairwise(stops[k] for k in group):
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
    return [replace(stop, down=folded(stop.way) != folded(up)) for stop in stops]


def close_full_turns(stops: Sequence[TableStop]) -> list[TableStop]:
    """Return the stops with a last angle that closes a turn counted on: 360 degrees after 330."""
    found = list(stops)
    for group in _groups(stops):
        steps = [remainder(b.angle - a.angle, TURN) for a, b in pairwise(stops[k] for k in group)]
        around = len(steps) > 2 and (min(steps) > 0.0 or max(steps) < 0.0)
        if around and isclose(abs(turned := sum(steps)), TURN, abs_tol=1e-9):
            last, first = group[-1], stops[group[0]].angle
            found[last] = replace(stops[last], angle=first + turned)
    return found


def has_repeated_angles(stops: Sequence[TableStop]) -> bool:
    """Return whether anything was measured at an angle more than once."""
    return len({(stop.what, stop.number) for stop in stops}) < len(stops)


def assign_passes(stops: Sequence[TableStop], where: str, *, both: bool = False) -> list[Pass]:
    """Return the pass of each stop, each direction with runs from 0.

    What is measured once more at the end is measured as it was at first.
    ``both``: there are known to be passes up and down. Without columns, everything that was
    measured at the same angles must have been measured equally often there, in whole passes: a
    missing row could be of any. Else raises DataError, which begins with ``where``.
    """
    stops = _with_runs_of_a_plan(stops)
    runs = {text: n for n, text in enumerate(dict.fromkeys(stop.run for stop in stops))}
    found, again, alone = dict[int, Pass](), dict[int, Counter[bool]](), list[list[int]]()
    shapes = dict[tuple[frozenset[int], str, bool | None], list[int]]()
    for group in _groups(stops):
        run, down = stops[group[0]].run, stops[group[0]].down
        numbers = frozenset(stops[k].number for k in group)
        if down is not None and (run or len(numbers) == len(group)):
            found |= dict.fromkeys(group, (runs[run], down))
            continue
        parts = _parts(stops, group)
        shape = [len(part) for part in parts]
        if not _are_whole(stops, parts) or shapes.setdefault((numbers, run, down), shape) != shape:
            raise _ambiguous(stops, group, where)
        if len(group) == 1 and down is None:
            alone.append(group)
        count = Counter[bool]()
        for part in parts:
            if part is parts[-1] is not parts[0] and len(part) == 1:
                again[part[0]] = count
                continue
            side = _is_down(stops, part) if down is None else down
            found |= dict.fromkeys(part, (runs[run] if run else count[side], side))
            count[side] += 1
            if run and count[side] > 1:
                raise _ambiguous(stops, group, where)
    if alone and (both or any(down for _, down in found.values())):
        raise _ambiguous(stops, alone[0], where)
    for k, count in again.items():
        side = next(found[n][1] for n in sorted(found) if stops[n].number == stops[k].number)
        found[k] = count[side], side
    every = sorted(set(found.values()))
    of_side = {side: [run for run, s in every if s is side] for side in (False, True)}
    return [(of_side[side].index(run), side) for _, (run, side) in sorted(found.items())]


def _with_runs_of_a_plan(stops: Sequence[TableStop]) -> Sequence[TableStop]:
    """Return the stops without their runs where these are more than the visits of an angle."""
    visits = Counter((stop.what, stop.number) for stop in stops)
    if len({stop.run for stop in stops}) <= max(visits.values()):
        return stops
    return [replace(stop, run="") for stop in stops]


def _groups(stops: Sequence[TableStop]) -> Iterator[list[int]]:
    """Yield which stops measured the same, in their order; columns part them further."""
    groups = dict[object, list[int]]()
    for k, stop in enumerate(stops):
        groups.setdefault((stop.what, stop.run, stop.down), []).append(k)
    yield from groups.values()


def _parts(stops: Sequence[TableStop], group: list[int]) -> list[list[int]]:
    """Return the passes of a group: a new one begins where the table turns, or comes again."""
    parts, seen = [group[:1]], {stops[group[0]].number}
    for k in group[1:]:
        part = parts[-1]
        turns = len(part) > 1 and _is_down(stops, part) != _is_down(stops, [part[-1], k])
        if turns or stops[k].number in seen:
            parts.append([])
            seen.clear()
        parts[-1].append(k)
        seen.add(stops[k].number)
    return parts


def _is_down(stops: Sequence[TableStop], part: Sequence[int]) -> bool:
    """Return whether a pass goes down; one stop alone counts as up."""
    ends = [stops[k].angle for k in part[:2]]
    return remainder(ends[-1] - ends[0], TURN) < 0.0


def _are_whole(stops: Sequence[TableStop], parts: Sequence[Sequence[int]]) -> bool:
    """Return whether several passes have all angles, but for that at which the table turned.

    One stop alone may close them.
    """
    if len(parts) == 1:
        return True
    every = {stops[k].number for part in parts for k in part}
    for part, before in zip(parts, [(), *parts], strict=False):
        lacking = every - {stops[k].number for k in part}
        turned = {stops[before[-1]].number} if before else set()
        closes = part is parts[-1] and len(part) == 1
        if lacking and lacking != turned and not closes:
            return False
    return True


def _ambiguous(stops: Sequence[TableStop], group: Sequence[int], where: str) -> DataError:
    visits = Counter(stops[k].number for k in group)
    number, _ = visits.most_common(1)[0]
    at = [stops[k] for k in group if stops[k].number == number]
    rows = f"row{'s' * (len(at) > 1)} " + " and ".join(str(stop.row) for stop in at)
    return DataError(
        f"{where}: the table angle {at[0].angle / DEGREE:g} degrees, {rows}: the order of the "
        "rows shows the run, and the way up or down, only where all was measured equally often. "
        "Add a column 'direction' (up or down) and, for several runs, a column 'run', or keep one "
        "row"
    )
