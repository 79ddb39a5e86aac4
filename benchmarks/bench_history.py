"""The history with many results: adding, listing, the trend of a table, the page; arrays.

100,000 results of 200 tables by ``ROTCAL_RESULTS=100000``; 2,000 otherwise.
"""

import io
import os
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as parquet

from rotcal_history.adding import AT_ONCE
from rotcal_history.database import ParkHistory, float64_bytes
from rotcal_history.outlook import all_outlooks, axis_outlook
from rotcal_history.page import write_park
from rotcal_history.settings import HistorySettings
from rotcal_ros.foundation.circumstances import Circumstances
from rotcal_ros.foundation.identity import Identity
from rotcal_ros.foundation.results import Result
from rotcal_ros.foundation.units import ARCSEC

RESULTS = int(os.environ.get("ROTCAL_RESULTS", "2000"))
TABLES = 200
ANGLES = np.arange(36) * 2.0 * np.pi / 36
DAY_NS = 86_400_000_000_000


@dataclass
class Row:
    """One measurement; ``each_ms`` for one result, table or array."""

    name: str
    count: int
    seconds: float
    each_ms: float
    bytes_each: float = float("nan")


def results() -> Iterator[Result]:
    """Yield results table by table, in order of time."""
    rng = np.random.default_rng(1)
    std = 0.3 * ARCSEC
    for number in range(RESULTS):
        table, nth = number % TABLES, number // TABLES
        identity = Identity(serial=f"T{table:03}", tolerance_arcsec=8.0)
        deviation = np.cos(ANGLES + table) * 2.0 * ARCSEC + std * rng.standard_normal(36)
        begun = 1_600_000_000_000_000_000 + nth * 10 * DAY_NS
        yield Result(
            method="tracer_multistation",
            angles=ANGLES,
            deviations={"ECC": deviation},
            std={"ECC": np.full(36, std)},
            covariance={"ECC": std**2 * (np.eye(36) + 0.1)},
            sigma0=1.0,
            dof=50,
            n_observations=200,
            circumstances=Circumstances(axis="C", identity=identity, begun_ns=begun),
        )


def add_all(history: ParkHistory) -> None:
    """Add all results, so many at once as ``rotcal history add`` of files."""
    every = results()
    while group := list(islice(every, AT_ONCE)):
        with history.transaction():
            for each in group:
                history.add_result(each)


def timed(name: str, count: int, work: Callable[[], object], size: float = float("nan")) -> Row:
    """Return the time of ``work``, in processor time and in all per piece."""
    begun = time.process_time()
    work()
    seconds = time.process_time() - begun
    return Row(name, count, seconds, 1e3 * seconds / count, size)


def rows() -> Iterator[Row]:
    """Yield all measurements; seconds of processor time."""
    yield from arrays()
    settings = HistorySettings()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "history.db")
        with ParkHistory(str(path)) as history:
            yield timed("add", RESULTS, lambda: add_all(history))
            size = path.stat().st_size / RESULTS
            item = history.items()[0]
            trend = timed("trend of a table", 1, lambda: axis_outlook(history, item, settings))
            yield trend
            yield timed("first list of the park", TABLES, lambda: all_outlooks(history, settings))
            yield timed("list of the park", TABLES, lambda: all_outlooks(history, settings), size)
            seen, today = all_outlooks(history, settings), "2026-03-31"
            yield timed(
                "page of the park", TABLES, lambda: write_park(history, seen, Path(folder), today)
            )


def arrays() -> Iterator[Row]:
    """Yield how long it takes to read a curve of 36 angles with its covariance, and its size."""
    rng = np.random.default_rng(2)
    whole = rng.standard_normal(36 + 36 + 36 * 36)
    data, times = float64_bytes(whole), 500
    table = pa.table({"x": whole})
    file, sink = io.BytesIO(), pa.BufferOutputStream()
    parquet.write_table(table, file, compression="zstd")
    with pa.ipc.new_file(sink, table.schema) as writer:
        writer.write_table(table)
    arrow = sink.getvalue()

    def repeat(read: Callable[[], object]) -> Callable[[], object]:
        return lambda: [read() for _ in range(times)]

    yield timed("float64", times, repeat(lambda: np.frombuffer(data, "<f8").sum()), len(data))
    read_parquet = repeat(lambda: parquet.read_table(io.BytesIO(file.getvalue()))["x"].to_numpy())
    yield timed("Parquet", times, read_parquet, len(file.getvalue()))
    read_arrow = repeat(lambda: pa.ipc.open_file(arrow).read_all()["x"].to_numpy())
    yield timed("Arrow", times, read_arrow, len(arrow))
