"""The overview of many bags: pages of plain HTML that stay small however many bags there are.

The dataset is asked by DuckDB. The trend of one figure over time is a small drawing: thousands of
them in seconds.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import datetime, timezone
from functools import partial
from itertools import groupby
from pathlib import Path
from typing import Any, Final, TypeVar

from rotcal_ros.extensions.fleet.results_dataset import parts
from rotcal_ros.foundation.components import COMPONENTS, COVERAGE_FACTOR, unit_of
from rotcal_ros.foundation.errors import BagError, ConfigurationError
from rotcal_ros.foundation.files import write_atomically
from rotcal_ros.report import template

OVERVIEW: Final = "overview.html"
FOLDER: Final = "overview"
"""Folder beside the page, for the pages that it links to."""
PAGE: Final = 200
"""Rows of a page."""
Row = TypeVar("Row")
render = partial(template.render, package="rotcal_ros.extensions.fleet")


@dataclass
class TableRow:
    """One rotary table: its bags that count, the newest of them, and how many have an alarm."""

    name: str
    page: str
    bags: int = 0
    bad: int = 0
    alarms: int = 0
    last: Bag | None = None


@dataclass
class OverviewCounts:
    """The counts at the top of the overview."""

    bags: int = 0
    bad: int = 0
    twins: int = 0
    alarms: list[tuple[Bag, str]] = field(default_factory=list)
    tables: list[TableRow] = field(default_factory=list)


def write_overview(dataset: Path, configuration_text: str, path: Path) -> OverviewCounts:
    """Write the page at ``path`` and those it leads to, in a folder beside it; return the counts.

    One page for each table with its trend and its bags, pages of alarms, and a search.
    """
    counts = OverviewCounts()
    folder = path.parent / FOLDER
    new = path.parent / f".{FOLDER}-new"
    shutil.rmtree(new, ignore_errors=True)
    new.mkdir()
    with connected(dataset) as connection, (new / "bags.js").open("w", encoding="utf-8") as index:
        index.write("const BAGS = [\n")
        for number, (name, bags) in enumerate(
            groupby(bags_by_table(connection), key=lambda bag: bag.table)
        ):
            _write_table(new, number, name, list(bags), counts, index)
        index.write("];\n")
    _write_pages(new, "alarms", "Alarms", "alarms", counts.alarms)
    _write_pages(new, "tables", "Tables", "tables", counts.tables)
    shutil.rmtree(folder, ignore_errors=True)
    new.rename(folder)
    text = render(
        "overview",
        counts=counts,
        alarms=counts.alarms[:PAGE],
        tables=counts.tables[:PAGE],
        folder=FOLDER,
        configuration_text=configuration_text,
    )
    write_atomically(path, text)
    return counts


def _write_table(
    folder: Path, number: int, name: str, bags: Sequence[Bag], counts: OverviewCounts, index: Any
) -> None:
    """Write the pages of one table and its lines of the search; count it."""
    stem = f"table-{number}"
    row = TableRow(name, f"{stem}-1.html")
    figures = list(_figures(bags))
    for page, total, some in _paged(bags):
        file = f"{stem}-{page}.html"
        for bag in some:
            _count(counts, row, bag, file)
            line = [bag.source, name, bag.begin, bag.standing, _verdict(bag), file]
            index.write(_script(line) + ",\n")
        text = render(
            "overview_table", title=name or "no table", rows=[_shown(bag) for bag in some],
            figures=figures if page == 1 else [], page=page, total=total, stem=stem,
        )  # fmt: skip
        (folder / file).write_text(text, encoding="utf-8")
    counts.tables.append(row)


def _count(counts: OverviewCounts, row: TableRow, bag: Bag, file: str) -> None:
    counts.bags += 1
    if bag.twin_of:
        counts.twins += 1
        return
    row.bags += 1
    row.bad += bool(bag.error)
    counts.bad += bool(bag.error)
    if bag.alarm:
        row.alarms += 1
        counts.alarms.append((bag, file))
    if bag.start_ns is not None:
        row.last = bag


def _write_pages(folder: Path, stem: str, title: str, kind: str, rows: Sequence[Any]) -> None:
    for page, total, some in _paged(rows):
        text = render(
            "overview_list", title=title, kind=kind, rows=some, page=page, total=total, stem=stem
        )
        (folder / f"{stem}-{page}.html").write_text(text, encoding="utf-8")


def _paged(rows: Sequence[Row]) -> Iterator[tuple[int, int, Sequence[Row]]]:
    """Yield (page from 1, pages in all, its rows)."""
    total = max(1, -(-len(rows) // PAGE))
    for page in range(total):
        yield page + 1, total, rows[page * PAGE : (page + 1) * PAGE]


def _figures(bags: Iterable[Bag]) -> Iterator[tuple[str, str]]:
    """Yield (component, drawing) of the range over time, for what was measured twice."""
    points: dict[str, list[Point]] = {}
    for bag in bags:
        if bag.start_ns is None or bag.twin_of:
            continue
        for span in bag.spans:
            factor, _ = unit_of(span.component)
            points.setdefault(span.component, []).append(
                Point(bag.start_ns, span.range / factor, span.u / factor, span.jumps)
            )
    for name in COMPONENTS:
        if len(points.get(name, ())) > 1:
            yield name, drawn(points[name], f"{name}, range / {unit_of(name)[1]}")


def _shown(bag: Bag) -> dict[str, Any]:
    """Return what a row of a table's page shows."""
    spans = []
    for span in bag.spans:
        factor, unit = unit_of(span.component)
        spans.append(f"{span.component} {span.range / factor:.3g} {unit}")
    notes = [f"the same session as {bag.twin_of}"] if bag.twin_of else []
    notes += [bag.alarm] if bag.alarm else []
    notes += [text for text in bag.warnings if text not in notes]
    return {
        "source": bag.source,
        "start": bag.begin,
        "standing": bag.standing,
        "span": ", ".join(spans),
        "verdict": _verdict(bag),
        "notes": notes,
    }


def _verdict(bag: Bag) -> str:
    return bag.line or "no result"


def _script(values: Sequence[str]) -> str:
    """Return JSON that may stand in a script: no tag can begin in it."""
    return json.dumps(values).replace("<", "\\u003c")


WIDTH, HEIGHT = 860, 180
_LEFT, _RIGHT, _TOP, _BOTTOM = 70, 12, 12, 28
MOST_POINTS: Final = 600
"""Points beyond this are drawn as the largest of their neighbours."""


@dataclass(frozen=True)
class Point:
    """A value with its U at a time; ``far`` says that it stands out."""

    time_ns: int
    value: float
    u: float
    far: bool = False


def drawn(points: Sequence[Point], label: str) -> str:
    """Return the drawing as an ``<svg>`` element; values in the unit that ``label`` names."""
    thinned = _thinned(sorted(points, key=lambda point: point.time_ns))
    begin, end = thinned[0].time_ns, thinned[-1].time_ns
    top = max(point.value + point.u for point in thinned) or 1.0

    def x(time_ns: float) -> float:
        share = (time_ns - begin) / (end - begin) if end > begin else 0.5
        return _LEFT + share * (WIDTH - _LEFT - _RIGHT)

    def y(value: float) -> float:
        return HEIGHT - _BOTTOM - value / top * (HEIGHT - _TOP - _BOTTOM)

    times = dict.fromkeys([begin, (begin + end) // 2, end])
    marks = [
        (round(x(p.time_ns), 1), round(y(p.value), 1), round(y(p.value + p.u), 1),
         round(y(max(0.0, p.value - p.u)), 1), p.far)
        for p in thinned
    ]  # fmt: skip
    return render(
        "trend",
        width=WIDTH,
        height=HEIGHT,
        left=_LEFT,
        right=WIDTH - _RIGHT,
        label=label,
        marks=marks,
        ticks=[(round(y(share * top), 1), f"{share * top:.3g}") for share in (0.0, 0.5, 1.0)],
        dates=[(round(x(t), 1), _date(t)) for t in times],
        thinned=len(thinned) < len(points),
    )


def _thinned(points: Sequence[Point]) -> Sequence[Point]:
    """Return at most MOST_POINTS, of each group of neighbours the largest."""
    size = -(-len(points) // MOST_POINTS)
    if size == 1:
        return points
    groups = (points[i : i + size] for i in range(0, len(points), size))
    return [max(group, key=lambda point: (point.far, point.value)) for group in groups]


def _date(time_ns: int) -> str:
    return f"{datetime.fromtimestamp(time_ns // 10**9, timezone.utc):%Y-%m-%d}"


ENOUGH: Final = 5
"""With this many bags of a table or more, one of them can stand out."""
FAR: Final = 3 * 1.4826
"""Median absolute deviations that are three standard deviations of a normal scatter."""
_MEMORY: Final = "1GB"

_BAGS: Final = """
CREATE TABLE bags AS
WITH each AS (
    SELECT source, any_value("table") AS tbl, epoch_ns(any_value("start")) AS start_ns,
           any_value(session) AS session, any_value(verdict) AS verdict,
           any_value(verdict_line) AS line, any_value(covered) AS covered,
           any_value(error) AS error, any_value(warnings) AS warnings,
           any_value(n_observations) AS n
    FROM rows GROUP BY source),
ranked AS (
    SELECT *, first_value(source) OVER twins AS best
    FROM each WINDOW twins AS (
        PARTITION BY CASE WHEN session = '' OR error IS NOT NULL THEN source ELSE session END
        ORDER BY n DESC, length(warnings), source))
SELECT * REPLACE (coalesce(tbl, '') AS tbl),
       CASE WHEN best = source THEN '' ELSE best END AS twin_of
FROM ranked
"""
_SPANS: Final = f"""
CREATE TABLE spans AS
WITH each AS (
    SELECT source, component, max(deviation) - min(deviation) AS span,
           {COVERAGE_FACTOR} * max(std) AS u
    FROM rows WHERE component IS NOT NULL GROUP BY source, component),
scatter AS (
    SELECT tbl, component, count(*) AS n, median(span) AS middle, mad(span) AS spread
    FROM each JOIN bags USING (source) WHERE twin_of = '' GROUP BY tbl, component)
SELECT source, component, span, each.u, middle,
       scatter.n >= {ENOUGH} AND abs(span - middle) > {FAR} * spread + each.u AS jumps
FROM each JOIN bags USING (source) JOIN scatter USING (tbl, component)
"""
_IN_ORDER: Final = """
SELECT tbl, source, start_ns, verdict, line, covered, error, warnings, twin_of, found
FROM bags LEFT JOIN (
    SELECT source, list((component, span, u, middle, jumps) ORDER BY component) AS found
    FROM spans GROUP BY source) USING (source)
ORDER BY tbl, start_ns NULLS LAST, source
"""


@dataclass(frozen=True)
class Span:
    """The range of one component over all angles, its U (k = 2), and the median of all bags.

    ``jumps``: it is far from that median.
    """

    component: str
    range: float
    u: float
    middle: float
    jumps: bool


@dataclass(frozen=True)
class Bag:
    """One bag of the dataset; ``twin_of`` is another of the same session that counts for both."""

    table: str
    source: str
    start_ns: int | None
    verdict: str | None
    line: str | None
    covered: bool
    error: str
    warnings: tuple[str, ...]
    twin_of: str
    spans: tuple[Span, ...]

    @property
    def begin(self) -> str:
        """When it was recorded (UTC)."""
        if self.start_ns is None:
            return ""
        start = datetime.fromtimestamp(self.start_ns // 10**9, timezone.utc)
        return f"{start:%Y-%m-%d %H:%M:%S}"

    @property
    def standing(self) -> str:
        """The style class of its verdict."""
        if self.verdict is None:
            return "no"
        return "partly" if self.verdict == "ok" and not self.covered else self.verdict

    @property
    def alarm(self) -> str | None:
        """Why it needs attention, if it does."""
        if self.error:
            return self.error
        if self.verdict != "ok":
            return f"verdict {self.line}"
        far = [span.component for span in self.spans if span.jumps]
        return f"range of {', '.join(far)} far from the others of this table" if far else None


@contextmanager
def connected(folder: Path) -> Iterator[Any]:
    """Give a connection with the tables ``bags`` and ``spans`` of a dataset."""
    try:
        import duckdb
    except ImportError as error:
        raise ConfigurationError(
            "the overview needs DuckDB: pip install 'rotcal_ros[many]'"
        ) from error
    files = [str(path) for path in parts(folder)]
    if not files:
        raise BagError(f"{folder} holds no results yet; wait for the first bag to be solved")
    with duckdb.connect(config={"memory_limit": _MEMORY, "threads": 2}) as connection:
        connection.execute("SET preserve_insertion_order = false")
        connection.read_parquet(files).create_view("rows")
        connection.execute(_BAGS)
        connection.execute(_SPANS)
        yield connection


def bags_by_table(connection: Any) -> Iterator[Bag]:
    """Yield all bags, table by table, in order of recording."""
    answer = connection.execute(_IN_ORDER)
    while rows := answer.fetchmany(1000):
        for table, source, start_ns, verdict, line, covered, error, notes, twin_of, found in rows:
            yield Bag(
                table, source, start_ns, verdict, line, bool(covered), error or "",
                tuple(filter(None, (notes or "").split("\n"))), twin_of,
                tuple(Span(*span) for span in map(_values, found or ())),
            )  # fmt: skip


def _values(span: Any) -> tuple[Any, ...]:
    return tuple(span.values()) if isinstance(span, dict) else tuple(span)
