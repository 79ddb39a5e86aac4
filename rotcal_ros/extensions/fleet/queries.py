"""The queries of the overview to the dataset of many bags, by DuckDB."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path
from typing import Any, Final

from rotcal_ros.extensions.fleet.results_dataset import parts
from rotcal_ros.foundation.components import COVERAGE_FACTOR
from rotcal_ros.foundation.errors import BagError, ConfigurationError

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
        raise BagError(f"{folder} holds no results yet")
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
