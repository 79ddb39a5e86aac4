"""The database of a history: opened, converted to its present form, queried, added to.

SQLite (one file, WAL) or PostgreSQL, by one schema. What was added is on the medium when ``add``
returns, once, whoever adds it at the same time or again. Every row stays as it was written:
triggers refuse UPDATE, DELETE and TRUNCATE. Times are integer nanoseconds since 1970, numbers SI.
Arrays are little-endian float64, row by row: a curve of 36 angles is read 250 times as fast as
from Parquet, from fewer bytes (benchmarks/bench_history.py).
"""

from __future__ import annotations

import getpass
import json
import os
import sqlite3
import time
import zlib
from collections.abc import Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, closing, contextmanager, suppress
from dataclasses import dataclass, fields, replace
from functools import cache, partial
from hashlib import sha256
from pathlib import Path
from typing import Any, Final

import numpy as np
import sqlalchemy as sa
from alembic import command
from alembic.config import Config
from alembic.runtime.migration import MigrationContext
from alembic.script import ScriptDirectory
from alembic.util import CommandError
from sqlalchemy.dialects import postgresql, sqlite
from sqlalchemy.engine import make_url

from rotcal_ros.evaluation.marks import tolerance_of
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.components import check_axis
from rotcal_ros.foundation.curves.measured import MeasuredCurve, measured_curve
from rotcal_ros.foundation.dates import day_of
from rotcal_ros.foundation.errors import BagError, ConfigurationError, DataError
from rotcal_ros.foundation.files import sync_folder
from rotcal_ros.foundation.language import noted
from rotcal_ros.foundation.results import Result
from rotcal_ros.foundation.untrusted import (
    LARGEST_FILE,
    load_json,
    require_no_secret,
    require_plain,
)

RESULT: Final = noted("result")
EVENT: Final = noted("event")
WITHDRAWAL: Final = noted("withdrawal")
REPLACED: Final = "replaced"
_AT_ONCE: Final = 1 << 24
"""Bytes that are unpacked at once to see how large a content is."""
PATIENCE_S: Final = 60
"""Time to wait for another writer."""
_OF_ITEM: Final = ("serial", "axis")
_OF_CURVE: Final = ("angles", "deviation", "covariance")
_VERB: Final = "rotcal history"

METADATA: Final = sa.MetaData()
WHOLE: Final = sa.BigInteger().with_variant(sa.Integer, "sqlite")
NUMBER: Final[sa.types.TypeEngine[float]] = sa.Double().with_variant(sa.REAL, "sqlite")


def _table(name: str, *parts: Any) -> sa.Table:
    return sa.Table(name, METADATA, *parts, sqlite_strict=True)


def _own(name: str, kind: Any, *more: Any) -> sa.Column[Any]:
    return sa.Column(name, kind, *more, primary_key=True)


def _given(kind: Any, *names: str) -> list[sa.Column[Any]]:
    return [sa.Column(name, kind, nullable=False) for name in names]


ITEMS: Final = _table(
    "items", _own("id", WHOLE), *_given(sa.Text, *_OF_ITEM), sa.UniqueConstraint(*_OF_ITEM)
)
"""A rotary axis of one machine."""

ENTRIES: Final = _table(
    "entries",
    _own("id", WHOLE),
    sa.Column("item_id", WHOLE, sa.ForeignKey("items.id"), nullable=False),
    *_given(sa.Text, "kind", "what"),
    *_given(WHOLE, "measured_ns", "added_ns"),
    *_given(sa.Text, "added_by", "why", "content_sha256", "sha256"),
    sa.Column("replaces", WHOLE, sa.ForeignKey("entries.id"), unique=True),
    *_given(sa.LargeBinary, "content"),
    sa.UniqueConstraint("sha256"),
    sa.CheckConstraint("length(sha256) = 64"),
    sa.Index("entries_of_item", "item_id", "measured_ns"),
    sa.Index(
        "entries_once",
        "content_sha256",
        unique=True,
        sqlite_where=sa.text("replaces IS NULL"),
        postgresql_where=sa.text("replaces IS NULL"),
    ),
)
"""``content`` is compressed by zlib, ``content_sha256`` of what is in it, ``sha256`` of the entry.

The same content is added once; only a correction, which ``replaces`` another entry, may have it
again. An entry is replaced once.
"""

RESULTS: Final = _table(
    "results",
    _own("entry_id", WHOLE, sa.ForeignKey("entries.id")),
    *_given(sa.Text, "method", "verdict", "verdict_line"),
    *_given(WHOLE, "covered", "simulated"),
    *_given(sa.Text, "measured_on", "instruments"),
    sa.Column("temperature_c", NUMBER),
    *_given(NUMBER, "tolerance_rad", "tolerance_m"),
)
"""What is asked of a result without reading all of it. It follows from the content."""

CURVES: Final = _table(
    "curves",
    _own("entry_id", WHOLE, sa.ForeignKey("entries.id")),
    _own("component", sa.Text),
    *_given(NUMBER, "period"),
    *_given(sa.LargeBinary, *_OF_CURVE),
)
"""The deviation curves of a result. They follow from its content."""

FORECASTS: Final = _table(
    "forecasts",
    _own("basis", sa.Text),
    *_given(sa.Text, "content"),
)
"""What was forecast of an axis; ``basis`` hashes the entries and settings it was made from."""

TABLES: Final = tuple(table.name for table in METADATA.sorted_tables)


@dataclass(frozen=True)
class AxisIdentity:
    """What is of a rotary axis of one machine."""

    serial: str
    axis: str

    @property
    def title(self) -> str:
        """Serial number and axis for people."""
        return f"{self.serial}/{self.axis}"


@dataclass(frozen=True)
class RegisteredAxis(AxisIdentity):
    """An axis, and its number in the database."""

    id: int


@dataclass(frozen=True)
class HistoryEntry(AxisIdentity):
    """One entry; ``content`` as it was added, times in ns since 1970.

    ``what``: the method of a result, the kind of an event, the name of a file. ``replaces`` is
    the entry that it corrects; a withdrawal puts nothing in its place. ``state`` is REPLACED, or
    the verdict of a result in a line.
    """

    id: int
    kind: str
    what: str
    measured_ns: int
    added_ns: int
    added_by: str
    why: str
    content_sha256: str
    sha256: str
    replaces: int | None
    content: bytes = b""
    state: str = ""

    @property
    def day(self) -> str:
        """The day (UTC) that it is about."""
        return day_of(self.measured_ns)

    def hashed(self, replaced: str) -> str:
        """Return the hash of the entry; ``replaced``: that of the entry it replaces, or empty."""
        parts = [
            self.serial, self.axis, self.kind, self.what, self.measured_ns, self.added_ns,
            self.added_by, self.why, self.content_sha256, replaced,
        ]  # fmt: skip
        return _hash(json.dumps(parts).encode())


@dataclass(frozen=True)
class AdditionOutcome:
    """What became of an addition: the entry, and whether it is new."""

    entry: HistoryEntry
    new: bool

    def describe(self) -> str:
        """Return it in a line."""
        entry, but = self.entry, ", but replaced" * (self.entry.state == REPLACED)
        state = "added" if self.new else f"there already{but}"
        return f"entry {entry.id}: {entry.kind} of {entry.title}, {entry.day}, {state}"


@dataclass(frozen=True)
class Campaign:
    """A result of a series, as far as statistics need it; ``curves`` by component.

    ``instruments`` maps what was used to its serial number.
    """

    entry_id: int
    measured_ns: int
    method: str
    verdict: str
    verdict_line: str
    covered: bool
    simulated: bool
    measured_on: str
    instruments: Mapping[str, str]
    temperature_c: float | None
    tolerance_rad: float
    tolerance_m: float
    curves: Mapping[str, MeasuredCurve]


class ParkHistory(AbstractContextManager["ParkHistory"]):
    """An open history; a context manager. ``place`` is its file or URL.

    Raises BagError where the database does not answer.
    """

    def __init__(self, database: str, *, must_exist: bool = False) -> None:
        self._engine = _engine(database, must_exist=must_exist)
        self.place = database
        self._joint: sa.Connection | None = None
        with self._connected() as connection:
            _upgrade(connection, database, must_exist=must_exist)

    def __exit__(self, *_: object) -> None:
        self._engine.dispose()

    @contextmanager
    def transaction(self) -> Iterator[None]:
        """Add all that is added meanwhile, or nothing; it is on the medium at the end."""
        with self._connected(writing=True) as self._joint:
            try:
                yield
            finally:
                self._joint = None

    def add_result(
        self,
        result: Result,
        serial: str = "",
        axis: str = "",
        *,
        measured_ns: int = 0,
        why: str = "",
        corrects: HistoryEntry | None = None,
        where: str = "the result",
    ) -> AdditionOutcome:
        """Add a result, or put it in place of the entry ``corrects``; ``why`` is for people.

        ``serial``, ``axis`` and ``measured_ns`` give what it does not state itself. Raises
        DataError for a result without identity or date, or of another table than it says, and for
        one that is there as the result of another table.
        """
        serial, axis = _identified(result, serial, axis, where)
        measured_ns = result.circumstances.from_ns or measured_ns
        if not measured_ns:
            raise DataError(
                f"{where} does not say when it was measured: give the day with --measured, or "
                "state identity.measured in the configuration"
            )
        entry = _entry(
            serial, axis, RESULT, result.method, measured_ns, why, canonical_json(result)
        )
        return self._add(entry, corrects, where, result)

    def add_event(
        self, item: AxisIdentity, what: str, measured_ns: int, why: str
    ) -> AdditionOutcome:
        """Add an event of EVENTS, such as a crash, which cuts the series or lets it jump."""
        of = item.serial, item.axis
        content = json.dumps([*of, what, measured_ns, why]).encode()
        return self._add(_entry(*of, EVENT, what, measured_ns, why, content), None, what)

    def add_document(
        self, item: AxisIdentity, kind: str, name: str, measured_ns: int, content: bytes
    ) -> AdditionOutcome:
        """Add a file of one of the kinds DOCUMENTS, byte by byte."""
        entry = _entry(item.serial, item.axis, kind, name, measured_ns, "", content)
        return self._add(entry, None, name)

    def correct(
        self, entry_id: int, why: str, *, serial: str = "", axis: str = ""
    ) -> AdditionOutcome:
        """Move an entry to another table, or withdraw it where neither is given.

        In the place of a withdrawal what was withdrawn comes back.
        """
        if not why:
            raise ConfigurationError("a correction says why: give the reason")
        old = counted = self.entry(entry_id)
        if not (serial or axis):
            new = _entry(old.serial, old.axis, WITHDRAWAL, "", old.measured_ns, why, b"")
            return self._add(new, old, f"entry {entry_id}")
        if old.kind == WITHDRAWAL and old.replaces is not None:
            counted = self.entry(old.replaces)
        what, day, content = counted.what, counted.measured_ns, counted.content
        new = _entry(serial or old.serial, axis or old.axis, counted.kind, what, day, why, content)
        return self._add(new, old, f"entry {entry_id}")

    def restore(self, entry: HistoryEntry, replaced: str) -> AdditionOutcome:
        """Add an entry of another history as it is there; ``replaced``: hash of what it replaces.

        Raises DataError if it is not as its hashes say.
        """
        where = f"entry {entry.sha256[:12]}"
        whole = _hash(entry.content) == entry.content_sha256
        if not whole or entry.hashed(replaced) != entry.sha256:
            raise DataError(f"{where} is not as its hash says: copy the export again")
        old = next(self.entries(ENTRIES.c.sha256 == replaced), None)
        if replaced and old is None:
            raise DataError(f"{where} replaces an entry that is missing: export all of them")
        return self._add(entry, old, where)

    def items(self, *wanted: Any, valid: bool = True) -> list[RegisteredAxis]:
        """Return all axes with a valid entry, or with any, by serial number."""
        kept = sa.exists().where(ENTRIES.c.item_id == ITEMS.c.id, _VALID if valid else sa.true())
        asked = sa.select(ITEMS).where(kept, *wanted).order_by(ITEMS.c.serial, ITEMS.c.axis)
        with self._connected() as connection:
            return [RegisteredAxis(**row._asdict()) for row in connection.execute(asked)]

    def item(self, serial: str, axis: str = "") -> RegisteredAxis:
        """Return an axis; DataError if there is none, or more than one without ``axis``.

        One of which all has been withdrawn is found, too.
        """
        named = ITEMS.c.serial == serial, *([ITEMS.c.axis == axis] if axis else [])
        found = self.items(*named) or self.items(*named, valid=False)
        if len(found) == 1:
            return found[0]
        if found:
            axes = ", ".join(item.axis for item in found)
            raise DataError(f"{serial!r} has the axes {axes}: say which with --axis")
        near = ", ".join(item.serial for item in self.items()[:10]) or "none yet"
        raise DataError(f"no table {serial!r} in {self.place}; there are: {near}")

    def entry(self, entry_id: int) -> HistoryEntry:
        """Return an entry with its content; DataError if there is none, BagError if damaged."""
        entry = next(self.entries(ENTRIES.c.id == entry_id, content=True), None)
        if entry is None:
            raise DataError(f"no entry {entry_id} in {self.place}: `{_VERB} show` lists them")
        if _hash(entry.content) != entry.content_sha256:
            raise BagError(f"entry {entry_id} is not what was added: take it from an export")
        return entry

    def of_item(self, item: RegisteredAxis, *, valid: bool = True) -> list[HistoryEntry]:
        """Return the entries of an axis by time of measurement, without their content."""
        wanted = [ENTRIES.c.item_id == item.id, *([_VALID] if valid else [])]
        return sorted(self.entries(*wanted), key=lambda entry: (entry.measured_ns, entry.id))

    def entries(self, *wanted: Any, content: bool = False) -> Iterator[HistoryEntry]:
        """Yield entries in the order in which they were added."""
        columns = {**ITEMS.c, **ENTRIES.c, "state": _STATE}
        names = [f.name for f in fields(HistoryEntry) if content or f.name != "content"]
        asked = sa.select(*(columns[name].label(name) for name in names)).where(*wanted)
        joined = asked.select_from(ENTRIES.join(ITEMS).outerjoin(RESULTS))
        with self._connected() as connection:
            at_once = 10 if content else 200
            streamed = joined.order_by(ENTRIES.c.id).execution_options(yield_per=at_once)
            for row in connection.execute(streamed):
                facts = row._asdict()
                if content:
                    facts["content"] = _opened(facts["content"])
                yield HistoryEntry(**facts)

    def campaigns(self, item: RegisteredAxis) -> list[Campaign]:
        """Return the valid results of an axis with their curves, by time of measurement."""
        of_item = sa.and_(ENTRIES.c.item_id == item.id, _VALID)
        asked = sa.select(ENTRIES.c.measured_ns, RESULTS).join(RESULTS).where(of_item)
        asked = asked.order_by(ENTRIES.c.measured_ns, ENTRIES.c.id)
        measured = sa.select(CURVES).join(ENTRIES).where(of_item)
        curves: dict[int, dict[str, MeasuredCurve]] = {}
        with self._connected() as connection:
            for row in connection.execute(measured):
                curves.setdefault(row.entry_id, {})[row.component] = _unpacked(row)
            return [_campaign(row, curves) for row in connection.execute(asked)]

    def bases(self) -> dict[int, str]:
        """Return, by number of an axis, the hash of its valid entries."""
        asked = sa.select(ENTRIES.c.item_id, ENTRIES.c.sha256).where(_VALID)
        hashes: dict[int, Any] = {}
        with self._connected() as connection:
            for item_id, own in connection.execute(asked.order_by(ENTRIES.c.id)):
                hashes.setdefault(item_id, sha256()).update(own.encode())
        return {item_id: found.hexdigest() for item_id, found in hashes.items()}

    def forecasts(self, bases: Iterable[str]) -> dict[str, str]:
        """Return what was forecast before, by its basis."""
        asked = sa.select(FORECASTS).where(FORECASTS.c.basis.in_(bases))
        with self._connected() as connection:
            return {row.basis: row.content for row in connection.execute(asked)}

    def note_forecasts(self, forecasts: Mapping[str, str]) -> None:
        """Keep forecasts by their basis."""
        rows = [{"basis": basis, "content": text} for basis, text in forecasts.items()]
        if rows:
            with self._connected(writing=True) as connection:
                connection.execute(_insertion(connection.dialect.name, FORECASTS), rows)

    def check(self) -> list[str]:
        """Return what is wrong, in a sentence each: hashes, references, curves, the file."""
        wrong = self._file_faults()
        known: dict[int, str] = {}
        for entry in self.entries(content=True):
            where = f"entry {entry.id} ({entry.title}, {entry.day})"
            known[entry.id] = entry.sha256
            replaced = "" if entry.replaces is None else known.get(entry.replaces, "missing")
            if _hash(entry.content) != entry.content_sha256:
                wrong.append(f"{where}: its content is not what was added")
            elif entry.hashed(replaced) != entry.sha256:
                wrong.append(f"{where}: it is not as it was added")
            elif entry.kind == RESULT:
                wrong += [f"{where}: {text}" for text in self._derived_faults(entry)]
        return wrong

    def _derived_faults(self, entry: HistoryEntry) -> list[str]:
        """Compare the rows that follow from a result with its content, bit by bit."""
        result, faults = result_of(entry), []
        for table, wanted, what in (
            (CURVES, _curve_rows(entry.id, result), "curves"),
            (RESULTS, [_result_row(entry.id, result)], "verdict, tolerance or circumstances"),
        ):
            asked = sa.select(table).where(table.c.entry_id == entry.id)
            with self._connected() as connection:
                found = [row._asdict() for row in connection.execute(asked)]
            if sorted(found, key=str) != sorted(wanted, key=str):
                faults.append(f"its {what} are not those of its content")
        return faults

    def _file_faults(self) -> list[str]:
        if self._engine.dialect.name != "sqlite":
            return []  # PostgreSQL checks references and pages itself
        with self._connected() as connection:
            whole = connection.exec_driver_sql("PRAGMA integrity_check").scalars().all()
            loose = connection.exec_driver_sql("PRAGMA foreign_key_check").all()
        faults = [f"SQLite: {text}" for text in whole if text != "ok"]
        return faults + [f"{row[0]}, row {row[1]}: it belongs to no {row[2]}" for row in loose]

    def _add(
        self,
        entry: HistoryEntry,
        old: HistoryEntry | None,
        where: str,
        result: Result | None = None,
    ) -> AdditionOutcome:
        """Write an entry, in place of the ``old`` one, and what follows from it: all of it."""
        hashed = entry.hashed(old.sha256 if old else "")
        entry = replace(entry, sha256=hashed, replaces=old.id if old else None)
        row = {name: value for name, value in vars(entry).items() if name in ENTRIES.c}
        if len(entry.content) > LARGEST_FILE:
            raise DataError(
                f"{where} has {len(entry.content):,} bytes, a history takes {LARGEST_FILE:,}: "
                "keep it elsewhere"
            )
        row |= {"content": zlib.compress(row.pop("content"))}
        del row["id"]  # the database gives it
        own = {name: getattr(entry, name) for name in _OF_ITEM}
        with self._connected(writing=True) as connection:
            insert = partial(_insertion, connection.dialect.name)
            if (known := connection.execute(_ITEM, own).scalar()) is None:
                connection.execute(insert(ITEMS), own)
                known = connection.execute(_ITEM, own).scalar_one()
            entry_id = connection.execute(insert(ENTRIES), row | {"item_id": known}).scalar()
            if entry_id is not None and entry.kind == RESULT:
                result = result or result_of(entry)
                connection.execute(sa.insert(RESULTS), _result_row(entry_id, result))
                if rows := _curve_rows(entry_id, result):
                    connection.execute(sa.insert(CURVES), rows)
        if entry_id is not None:
            return AdditionOutcome(replace(entry, id=entry_id), new=True)
        return AdditionOutcome(self._there_already(entry, where), new=False)

    def _there_already(self, entry: HistoryEntry, where: str) -> HistoryEntry:
        """Return the entry that was there before; DataError if it says something else."""
        did, same = f"entry {entry.replaces} was corrected", ENTRIES.c.replaces == entry.replaces
        if entry.replaces is None:
            did = f"{where} is there"
            same = sa.and_(same, ENTRIES.c.content_sha256 == entry.content_sha256)
        (old,) = self.entries(sa.or_(ENTRIES.c.sha256 == entry.sha256, same))
        facts = ("serial", "axis", "kind", "content_sha256")
        if any(getattr(old, name) != getattr(entry, name) for name in facts):
            raise DataError(
                f"{did} already, by entry {old.id} as {old.kind} of {old.title} "
                f"({old.added_by}, {day_of(old.added_ns)}): correct that one"
            )
        return old

    @contextmanager
    def _connected(self, *, writing: bool = False) -> Iterator[sa.Connection]:
        """Give a connection in a transaction; errors of the database become a BagError."""
        try:
            if self._joint is not None:
                yield self._joint
                return
            with self._engine.connect() as plain:
                connection = plain.execution_options(rotcal_writing=writing)
                with connection.begin():
                    yield connection
        except OverflowError as error:
            raise DataError(
                f"the history {self.place} has no room for such a number: {error}; nothing was "
                "changed"
            ) from error
        except sa.exc.DBAPIError as error:
            raise BagError(
                f"the history {self.place} does not take or give this: "
                f"{' '.join(str(error.orig).split())}; nothing was changed"
            ) from error


def _opened(packed: bytes) -> bytes:
    """Return what was compressed; what is damaged or too large stays, and its hash shows it."""
    opening, rest, size = zlib.decompressobj(), packed, 0
    with suppress(zlib.error):
        while size <= LARGEST_FILE:  # a few kilobytes may unpack to any size
            size += len(content := opening.decompress(rest, _AT_ONCE))
            if opening.eof:
                return content if size == len(content) else zlib.decompress(packed)
            if not (content or opening.unconsumed_tail):
                break  # cut off
            rest = opening.unconsumed_tail
    return packed


def result_of(entry: HistoryEntry) -> Result:
    """Return the result that an entry holds, to the last bit."""
    return Result.from_dict(load_json(entry.content))


def canonical_json(result: Result) -> bytes:
    """Return a result as text: the same for the same result, every number to the last bit."""
    return json.dumps(result.to_dict(), separators=(",", ":"), allow_nan=False).encode()


def _engine(database: str, *, must_exist: bool) -> sa.Engine:
    """Return the engine; raises ConfigurationError for a URL or a file that cannot be one."""
    require_no_secret(database, "the history (--database, history.database)")
    if "://" in database:
        try:
            url = make_url(database).set(drivername="postgresql+psycopg")
        except (sa.exc.ArgumentError, ValueError) as error:
            raise ConfigurationError(f"the URL of the history cannot be read: {error}") from None
        if not database.startswith("postgresql"):
            raise ConfigurationError(f"{database}: expected a file or postgresql://USER@HOST/NAME")
        return sa.create_engine(url, pool_pre_ping=True, connect_args={"connect_timeout": 10})
    path = Path(database).expanduser().absolute()
    if must_exist and not path.is_file():
        raise BagError(f"there is no history {path}: `{_VERB} add` begins one")
    try:
        require_plain(path)
        if path.is_symlink() and not path.exists():
            raise BagError(f"no history at {path}: it is a link to nothing; name the file itself")
        if path.exists():
            _refuse_foreign(path, must_exist=must_exist)
        else:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.touch()
            sync_folder(path.parent)
    except OSError as error:
        raise BagError(f"no history at {path}: {error.strerror}; name another file") from error
    engine = sa.create_engine(
        sa.URL.create("sqlite", database=str(path)), connect_args={"timeout": PATIENCE_S}
    )
    sa.event.listen(engine, "connect", _prepare)
    sa.event.listen(engine, "begin", _begin)
    return engine


def _refuse_foreign(path: Path, *, must_exist: bool) -> None:
    """Raise BagError for a database of something else, in which nothing is to change.

    An empty one is refused if a history ``must_exist``.

    It is looked at for reading alone: our connections set its journal. A file that is no database
    at all is refused by them.
    """
    with (
        suppress(sqlite3.Error),
        closing(
            sqlite3.connect(f"{path.as_uri()}?mode=ro", uri=True, timeout=PATIENCE_S)
        ) as connection,
    ):
        names = {name for (name,) in connection.execute("SELECT name FROM sqlite_master")}
        if must_exist and not names:
            raise BagError(f"there is no history in {path}: `{_VERB} add` begins one")
        if names and not names >= {"items", "entries", "alembic_version"}:
            raise BagError(
                f"{path} is a database of something else (it has {', '.join(sorted(names)[:3])}): "
                "name another file"
            )


def _prepare(connection: Any, _record: Any) -> None:
    connection.isolation_level = None  # transactions begin where we say so
    for pragma in (
        f"busy_timeout = {1000 * PATIENCE_S}", "journal_mode = WAL", "synchronous = FULL",
        "foreign_keys = ON", "recursive_triggers = ON",
    ):  # fmt: skip
        connection.execute(f"PRAGMA {pragma}")


def _begin(connection: sa.Connection) -> None:
    # A writer waits for its turn here, and not in the middle, where it would fail.
    writing = connection.get_execution_options().get("rotcal_writing")
    connection.exec_driver_sql("BEGIN IMMEDIATE" if writing else "BEGIN")


def _upgrade(connection: sa.Connection, database: str, *, must_exist: bool) -> None:
    """Bring the database to the newest form, if it is an older one.

    Raises BagError for one without a history that ``must_exist``.
    """
    place = str(Path(__file__).with_name("migrations"))
    found = MigrationContext.configure(connection).get_current_revision()
    if found == ScriptDirectory(place).get_current_head():
        return
    if found is None and must_exist:
        raise BagError(f"there is no history in {database}: `{_VERB} add` begins one")
    config = Config()
    config.set_main_option("script_location", place)
    # The transaction of this connection only reads: a writer's waits for others from the start.
    writer = connection.engine.connect().execution_options(rotcal_writing=True)
    with writer, writer.begin():
        if writer.dialect.name == "postgresql":
            writer.exec_driver_sql("SELECT pg_advisory_xact_lock(7026)")
        config.attributes["connection"] = writer
        try:
            command.upgrade(config, "head")
        except CommandError as error:
            raise BagError(
                f"{database} was written by a later rotcal ({error}): update rotcal"
            ) from error
        except sa.exc.OperationalError as error:
            if found is None or "readonly" not in str(error.orig):
                raise  # one that may only be read is shown as it is


_LATER: Final = ENTRIES.alias()
_REPLACED: Final = sa.exists().where(_LATER.c.replaces == ENTRIES.c.id)
_VALID: Final = sa.and_(ENTRIES.c.kind != WITHDRAWAL, ~_REPLACED)
_STATE: Final = sa.case((_REPLACED, REPLACED), else_=sa.func.coalesce(RESULTS.c.verdict_line, ""))
_ITEM: Final = sa.select(ITEMS.c.id).where(
    *(ITEMS.c[name] == sa.bindparam(name) for name in _OF_ITEM)
)


@cache
def _insertion(dialect: str, table: sa.Table) -> Any:
    """Return an insertion that does nothing where the row is there; else it returns the id."""
    kind = sqlite.insert if dialect == "sqlite" else postgresql.insert
    asked = kind(table).on_conflict_do_nothing()
    return asked.returning(table.c.id) if "id" in table.c else asked


def _entry(
    serial: str, axis: str, kind: str, what: str, measured_ns: int, why: str, content: bytes
) -> HistoryEntry:
    """Return an entry as it is now added; it replaces none."""
    if not serial.strip():
        raise ConfigurationError("the serial number is empty: name the table")
    return HistoryEntry(
        serial.strip(), check_axis(axis), 0, kind, what, measured_ns, time.time_ns(), _user(), why,
        _hash(content), "", None, content,
    )  # fmt: skip


def _user() -> str:
    try:
        return os.environ.get("ROTCAL_USER") or getpass.getuser()
    except (KeyError, OSError):  # no name for this number, as in a container
        return f"user {os.getuid()}"


def _identified(result: Result, serial: str, axis: str, where: str) -> tuple[str, str]:
    """Return serial number and axis, stated by the result or given; DataError without either."""
    known, found = result.circumstances, []
    for words, option, own, given in (
        ("serial number", "serial", known.identity.serial.strip(), serial.strip()),
        ("axis", "axis", known.axis, axis),
    ):
        if own and given and own != given:
            raise DataError(
                f"{where} is of the {words} {own!r}, not {given!r}: leave out --{option}, or add "
                f"it and correct it with `{_VERB} correct`"
            )
        if not (own or given):
            raise DataError(
                f"{where} does not say which table it is of: it has no {words}; give it with "
                f"--{option}, and set it in the configuration"
            )
        found.append(given or own)
    return found[0], found[1]


def _result_row(entry_id: int, result: Result) -> dict[str, Any]:
    known, identity = result.circumstances, result.circumstances.identity
    used = {n: i.serial for n, i in identity.instruments.known.items() if i.serial}
    return {
        "entry_id": entry_id,
        "method": result.method,
        "verdict": result.verdict,
        "verdict_line": result.verdict_line.text,
        "covered": int(bool(result.protections) and not result.unprotected),
        "simulated": int(result.simulated),
        "measured_on": result.measured_on,
        "instruments": json.dumps(used, sort_keys=True),
        "temperature_c": None if known.temperature_c is None else known.temperature_c.mean,
        "tolerance_rad": tolerance_of("ECC", identity),
        "tolerance_m": tolerance_of("EZC", identity),
    }


def _curve_rows(entry_id: int, result: Result) -> list[dict[str, Any]]:
    """Return the rows of all components that are one curve; the others have no trend."""
    rows = []
    for name in result.components:
        with suppress(DataError):
            curve = measured_curve(result, name)
            if not curve.open_zeros:
                arrays = {part: float64_bytes(getattr(curve, part)) for part in _OF_CURVE}
                facts = {"entry_id": entry_id, "component": name, "period": curve.period}
                rows.append({**facts, **arrays})
    return rows


def float64_bytes(array: Floats) -> bytes:
    """Return an array as bytes: float64, little-endian, row by row."""
    return np.ascontiguousarray(array, dtype="<f8").tobytes()


def _unpacked(row: Any) -> MeasuredCurve:
    arrays = (np.frombuffer(getattr(row, part), dtype="<f8") for part in _OF_CURVE)
    angles, deviation, covariance = arrays
    return MeasuredCurve(angles, deviation, covariance.reshape(2 * angles.shape), row.period)


def _campaign(row: Any, curves: Mapping[int, Mapping[str, MeasuredCurve]]) -> Campaign:
    facts = row._asdict() | {"instruments": json.loads(row.instruments)}
    facts |= {name: bool(facts[name]) for name in ("covered", "simulated")}
    return Campaign(**facts, curves=curves.get(row.entry_id, {}))


def _hash(content: bytes) -> str:
    return sha256(content).hexdigest()
