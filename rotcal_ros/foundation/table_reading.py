"""What a table was understood as: which of its columns is what, and what that was judged by."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol, TypeAlias

from rotcal_ros.foundation.table_columns import AS_IT_STANDS, SheetSettings, undecided
from rotcal_ros.foundation.tables import Header, Table

Pass: TypeAlias = "tuple[int, bool]"


"""Number of the run, from 0, and whether it goes down."""


@dataclass(frozen=True, slots=True)
class Use:
    """Where a column is: ``place`` of its cell in a row, from 0, and the units of its heading."""

    place: int
    text: str
    units: tuple[str, ...] = ()


@dataclass(frozen=True)
class Known:
    """What a number in a table may be: ``numbers`` of the plan, ascending, perhaps with gaps.

    ``labels`` maps other names to them; ``angles`` (rad) are those of the positions, ``downward``
    those of them that are reached from above, ``order`` all in the order of the plan. ``listed``:
    no plan knows them, the table lists them all, as one of targets does. ``source`` is the table
    that the labels are from.
    """

    numbers: tuple[int, ...] = ()
    labels: Mapping[str, int] = field(default_factory=dict)
    angles: tuple[float, ...] = ()
    downward: frozenset[int] = frozenset()
    order: tuple[int, ...] = ()
    listed: bool = False
    source: Reading | None = None


@dataclass(frozen=True)
class Reading:
    """A table as it was read, and how that was understood, in words.

    ``columns`` maps our columns to theirs; ``left_out`` are the numbers of rows with why;
    ``remarks`` say what was counted or turned. ``labels`` maps the labels of the first column to
    their numbers. ``angles_deg`` are the table's own, ascending, where no plan had any, with how
    many ``runs`` go through them, in ``both_directions`` or in one. ``form`` is empty for a table
    of our own form, which is read as it stands. ``beside``: other tables that were read for it.
    ``uses`` maps our columns without their units, or TABLE_ANGLE, to where they are, unless that
    is a matrix; ``head`` are the texts at the head of the table. ``passes`` are those of the rows
    where the table came to its angles more than once. ``sources`` say where targets and table
    angles are from, ``stated`` what a person said of the table; ``form_head`` is its head as it
    stands, by which tables of the same form are known.
    """

    table: Table
    form: str = ""
    columns: Mapping[str, str] = field(default_factory=dict)
    aside: tuple[str, ...] = ()
    left_out: tuple[tuple[int, str], ...] = ()
    remarks: tuple[str, ...] = ()
    labels: Mapping[str, int] = field(default_factory=dict)
    angles_deg: tuple[float, ...] = ()
    runs: int = 1
    both_directions: bool = False
    beside: tuple[Reading, ...] = ()
    uses: Mapping[str, Use] = field(default_factory=dict)
    head: tuple[str, ...] = ()
    passes: tuple[Pass, ...] = ()
    sources: tuple[str, ...] = ()
    stated: SheetSettings = AS_IT_STANDS
    form_head: tuple[str, ...] = ()

    def line(self) -> str:
        """Return it in one line; empty for a table of our own form that states everything."""
        if not self.form:
            sources = "; ".join(self.sources)
            return f"{self.table.path} (our own form): {sources}" if sources else ""
        columns = ", ".join(f"{ours} = {theirs}" for ours, theirs in self.columns.items())
        parts = [f"{self.table.path} ({self.form}): {columns}", *self.remarks, *self.sources]
        if self.aside:
            parts.append(f"not needed: {', '.join(self.aside)}")
        if self.left_out:
            rows = "row" if len(self.left_out) == 1 else "rows"
            parts.append(f"{len(self.left_out)} {rows} left out (--explain)")
        return "; ".join(parts)

    def lines(self) -> list[str]:
        """Return it in full, for ``--explain``."""
        if not self.form:
            header = ", ".join(self.table.header)
            return [
                f"{self.table.path}: a table of our own form, read as it stands: {header}",
                *(f"  {source}" for source in self.sources),
            ]
        return [
            f"{self.table.path}: {self.form}, {len(self.table.lines)} rows",
            *(f"  {ours:<16} {theirs}" for ours, theirs in self.columns.items()),
            *(f"  {remark}" for remark in (*self.remarks, *self.sources)),
            *([f"  not needed: {', '.join(self.aside)}"] if self.aside else []),
            *(f"  row {row} left out: {why}" for row, why in self.left_out),
            *(line for other in self.beside for line in other.lines()),
        ]


class FormReader(Protocol):
    """Reads tables of another form than ours."""

    def read(
        self,
        source: Path | Table,
        headers: Sequence[Header],
        settings: SheetSettings,
        known: Callable[[], Mapping[str, Known]],
    ) -> Reading:
        """Return the table with one of our ``headers``; see :func:`~.table_forms.read_any`."""

    def heading_rows(self, path: Path) -> Iterable[tuple[str, ...]]:
        """Yield the rows that may be the head of the table: the cells that are not empty."""


def as_planned(
    where: str, name: str, numbers: Sequence[int], planned: Sequence[int], firsts: str
) -> tuple[list[int], bool]:
    """Return numbers as the plan has them, and whether they count from 1.

    They are those of the plan as they stand, or its first, second and so on; ``firsts``: "0", "1"
    or "01", from what they may count. Raises UndecidedError where both may be.
    """
    if not planned or not numbers:
        return list(numbers), False
    ways = {"0": {n: n for n in planned}, "1": dict(enumerate(planned, start=1))}
    able = [first for first in firsts if ways[first].keys() >= set(numbers)]
    if len(able) > 1:
        readings = (f"counted from 0, {planned[0]} was not measured",
                    "counted from 1, the last was not")  # fmt: skip
        raise undecided(
            f"{where}: {name} {min(numbers)} to {max(numbers)}: {'; '.join(readings)}",
            "sheet.counted_from",
            tuple(zip("01", readings, strict=True)),
        )
    way = ways[able[0]] if able else {}
    return [way.get(n, n) for n in numbers], able == ["1"]
