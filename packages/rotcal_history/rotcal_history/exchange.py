"""A history as Parquet, for another history and for any tool; dates for calendars and monitoring.

``entries.parquet`` is the whole history, from which it is restored to the last bit;
``deviations.parquet`` has a row for each angle, for DuckDB, pandas and the like.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict
from datetime import datetime, timezone
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any, Final

from rotcal_history.database import HistoryEntry, ParkHistory
from rotcal_history.outlook import Outlook
from rotcal_ros.foundation.arrays import std_of
from rotcal_ros.foundation.dataframes import arrow
from rotcal_ros.foundation.errors import BagError
from rotcal_ros.foundation.escapes import printable
from rotcal_ros.foundation.files import replace_atomically

ENTRIES: Final = "entries.parquet"
DEVIATIONS: Final = "deviations.parquet"
_GROUP: Final = 500
_IN_CALENDAR: Final = str.maketrans({"\\": r"\\", ";": r"\;", ",": r"\,"})
_IN_LABEL: Final = str.maketrans({"\\": r"\\", '"': r"\""})
_OPTIONS: Final = {"compression": "zstd", "write_page_checksum": True}


def export_history(history: ParkHistory, folder: Path) -> int:
    """Write both files into ``folder``, each whole or not at all; return the entries' number."""
    folder.mkdir(parents=True, exist_ok=True)
    for (name, schema), batches in zip(_schemas().items(), (_entries, _deviations), strict=True):
        replace_atomically(folder / name, partial(_write, schema, batches(history, schema)))
    return int(arrow()[1].read_metadata(folder / ENTRIES).num_rows)


def restore_history(history: ParkHistory, folder: Path) -> tuple[int, int]:
    """Add the entries of an export; return how many are new, and how many were there before.

    Raises BagError for files that are damaged, DataError for entries that do not fit.
    """
    pa, parquet = arrow()
    path = folder / ENTRIES if folder.is_dir() else folder
    new = old = 0
    try:
        with parquet.ParquetFile(path, page_checksum_verification=True) as file:
            for batch in file.iter_batches(batch_size=_GROUP):
                with history.transaction():
                    for row in batch.to_pylist():
                        replaced = row.pop("replaces")
                        added = history.restore(HistoryEntry(**row, replaces=None), replaced)
                        new, old = new + added.new, old + (not added.new)
    except (OSError, pa.ArrowException, KeyError, TypeError) as error:
        raise BagError(f"{path} is no whole export of a history: {error}; export again") from error
    return new, old


def due_calendar(outlooks: Sequence[Outlook], now: datetime) -> str:
    """Return the due dates as an iCalendar (RFC 5545): a whole day for each table."""
    lines = ["BEGIN:VCALENDAR", "VERSION:2.0", "PRODID:-//rotcal_ros//history//EN"]
    for view in outlooks:
        lines += [
            "BEGIN:VEVENT",
            f"UID:{printable(view.title).translate(_IN_CALENDAR)}@rotcal",
            f"DTSTAMP:{now.astimezone(timezone.utc):%Y%m%dT%H%M%SZ}",
            f"DTSTART;VALUE=DATE:{view.due.replace('-', '')}",
            f"SUMMARY:Calibrate {printable(view.title).translate(_IN_CALENDAR)}",
            f"DESCRIPTION:{printable(view.reason).translate(_IN_CALENDAR)}",
            "END:VEVENT",
        ]
    return "".join(f"{part}\r\n" for line in [*lines, "END:VCALENDAR"] for part in _folded(line))


def reminder_mail(outlooks: Sequence[Outlook], before: str) -> str:
    """Return the due tables as the text of an e-mail, its subject first."""
    tables = "1 table is" if len(outlooks) == 1 else f"{len(outlooks)} tables are"
    lines = [f"Subject: {tables} due before {before}", ""]
    for view in outlooks:
        lines += [printable(f"{view.due}  {view.title}: {view.reason}")]
        lines += [printable(f"            {found.words}") for found in view.urgent[1:]]
    return "\n".join(lines) + "\n"


def prometheus_metrics(outlooks: Sequence[Outlook]) -> str:
    """Return what monitoring needs, in the text format of Prometheus."""
    families = (
        ("due_timestamp_seconds", "When the axis is due.", lambda o: o.due_ns / 1e9),
        ("last_timestamp_seconds", "When it was measured last.", lambda o: o.last_ns / 1e9),
        ("ok", "1 if the newest result is ok.", lambda o: int(o.verdict == "ok")),
        ("findings", "What a person has to look at.", lambda o: len(o.urgent)),
        ("results", "Results in the history.", lambda o: o.results),
    )
    lines = []
    for name, words, value in families:
        full = f"rotcal_calibration_{name}"
        lines += [f"# HELP {full} {words}", f"# TYPE {full} gauge"]
        for view in outlooks:
            texts = map(printable, (view.serial, view.axis))
            serial, axis = (text.translate(_IN_LABEL) for text in texts)
            lines.append(f'{full}{{serial="{serial}",axis="{axis}"}} {value(view):.15g}')
    return "\n".join(lines) + "\n"


def _folded(line: str) -> Iterator[str]:
    """Yield the lines of at most 75 bytes that a long one is folded into."""
    part = ""
    for character in line:
        if len((part + character).encode()) > 74:
            yield part
            part = " "
        part += character
    yield part


def _write(schema: Any, batches: Iterable[Any], path: Path) -> None:
    with arrow()[1].ParquetWriter(path, schema, **_OPTIONS) as writer:
        for batch in batches:
            writer.write_batch(batch)


def _entries(history: ParkHistory, schema: Any) -> Iterator[Any]:
    """Yield the entries in batches, in the order in which they were added."""
    pa, _ = arrow()
    known: dict[int | None, str] = {None: ""}
    every = history.entries(content=True)
    while group := list(islice(every, _GROUP)):
        known |= {entry.id: entry.sha256 for entry in group}
        rows = [asdict(entry) | {"replaces": known[entry.replaces]} for entry in group]
        yield pa.RecordBatch.from_pylist(rows, schema)


def _schemas() -> dict[str, Any]:
    """Return the columns of both files, by name."""
    pa, _ = arrow()
    entry = dict.fromkeys(HistoryEntry.__dataclass_fields__, "string") | {"content": "binary"}
    entry |= dict.fromkeys(("id", "measured_ns", "added_ns"), "int64")
    texts = ("serial", "axis", "method", "why", "verdict", "verdict_line", "component")
    numbers = ("temperature_c", "angle_rad", "deviation", "std")
    kinds = {"entry": "int64", "measured": pa.timestamp("ns", tz="UTC"), "covered": "bool"}
    kinds |= dict.fromkeys(texts, "string") | dict.fromkeys(numbers, "float64")
    return {ENTRIES: pa.schema(entry), DEVIATIONS: pa.schema(kinds)}


def _deviations(history: ParkHistory, schema: Any) -> Iterator[Any]:
    """Yield the deviations of each axis as a batch of columns, a row for each angle."""
    pa, _ = arrow()
    for item in history.items():
        why = {entry.id: entry.why for entry in history.of_item(item)}
        parts = []
        for campaign in history.campaigns(item):
            entry = campaign.entry_id
            known = {"entry": entry, "measured": campaign.measured_ns, "why": why[entry]}
            known |= vars(item) | vars(campaign)
            for component, curve in campaign.curves.items():
                known["component"] = component
                size = len(curve.angles)
                columns = {n: pa.repeat(known[n], size) for n in schema.names if n in known}
                columns |= {"angle_rad": curve.angles, "deviation": curve.deviation}
                columns |= {"std": std_of(curve.covariance)}
                parts.append(pa.RecordBatch.from_pydict(columns, schema))
        yield from pa.Table.from_batches(parts, schema).combine_chunks().to_batches()
