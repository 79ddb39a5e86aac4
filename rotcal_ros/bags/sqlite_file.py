"""Opening a rosbag2 sqlite3 file so that it is never changed, and asking whether it is sound."""

from __future__ import annotations

import re
import shutil
import sqlite3
import sys
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final
from urllib.parse import quote_from_bytes

from rotcal_ros.bags import file_compression
from rotcal_ros.bags.reading_limits import DEFAULT_LIMITS, LARGEST_MESSAGE, ReadingLimits
from rotcal_ros.bags.verdict import Damage
from rotcal_ros.foundation.errors import BagError

_LEFT_BESIDE: Final = ("-wal", "-journal")
_MAX_FAULTS: Final = 20
_NO_FAULT: Final = ("ok", "*** in database main ***")
FAILURES: Final = (sqlite3.Error, UnicodeDecodeError, OverflowError)
"""What reading a damaged database raises; Python cannot decode every complaint of sqlite3."""
_AT_PAGE: Final = re.compile(r"page (\d+)")


@dataclass(frozen=True)
class Database:
    """A connection and the file that it reads: the bag's own, or a copy of it.

    ``fault`` says what was wrong while the file was unpacked.
    """

    connection: sqlite3.Connection
    file: Path
    fault: str = ""

    def columns(self, table: str) -> tuple[str, ...]:
        """Return the columns of a table, none when there is no such table."""
        kind = "SELECT 1 FROM sqlite_master WHERE type = 'table' AND lower(name) = ?"
        if self.connection.execute(kind, (table,)).fetchone() is None:
            return ()
        info = self.connection.execute(f"PRAGMA table_info({table})")
        return tuple(text(name).lower() for _, name, *_ in info)

    def damages(self) -> tuple[Damage, ...]:
        """Return what went wrong so far, none when the file is sound."""
        unpacking = (Damage(0, self.fault),) if self.fault else ()
        return (*unpacking, *self._integrity())

    def _integrity(self) -> tuple[Damage, ...]:
        """Return what sqlite3's own integrity check says."""
        try:
            found = self.connection.execute(f"PRAGMA integrity_check({_MAX_FAULTS})").fetchall()
            (page_size,) = self.connection.execute("PRAGMA page_size").fetchone()
        except FAILURES as error:
            return (Damage(0, f"the database cannot be checked: {words(error)}"),)
        lines = [line for (answer,) in found for line in text(answer).splitlines()]
        return tuple(_damage(line, page_size) for line in lines if line not in _NO_FAULT)


@contextmanager
def opened(path: Path, limits: ReadingLimits = DEFAULT_LIMITS) -> Iterator[Database]:
    """Open ``path`` for reading; texts come as bytes. Raises BagError when that is impossible.

    A journal or write-ahead log that was left beside it belongs to the data, but to heed it
    means to write: that happens in a temporary copy.
    """
    try:
        with file_compression.unpacked(path, limits) as (plain, fault):
            if not plain.is_file() or not plain.stat().st_size:
                what = "is empty" if plain.is_file() else "is no file"
                raise BagError(f"cannot read {path}: it {what}; there is nothing in it to be read")
            with (
                _with_what_was_left(plain) as (file, how),
                closing(_connected(file, how)) as connection,
            ):
                yield Database(connection, file, fault)
    except FAILURES as error:
        raise BagError(f"cannot read {path}: {words(error)}") from error
    except OSError as error:
        raise BagError(f"cannot read {path}: {error.strerror or error}") from error


@contextmanager
def _with_what_was_left(path: Path) -> Iterator[tuple[Path, str]]:
    """Yield the file to be opened and how: where something was left beside it, a copy of both."""
    left = [file for end in _LEFT_BESIDE if (file := Path(f"{path}{end}")).is_file()]
    if not any(file.stat().st_size for file in left):
        with path.open("rb"):  # for the system's own words, should it not let us
            pass
        yield path, "mode=ro&immutable=1"
        return
    with TemporaryDirectory(prefix="rotcal_") as folder:
        for file in (path, *left):
            shutil.copyfile(file, Path(folder) / file.name)
        yield Path(folder) / path.name, "mode=rw"


def text(value: object) -> str:
    """Return a text of the database, whatever its bytes; '' for anything else."""
    return value.decode(errors="backslashreplace") if isinstance(value, bytes) else ""


def words(error: Exception) -> str:
    """Return what a failure says, in one line of visible characters."""
    complaint = "its texts are damaged" if isinstance(error, UnicodeDecodeError) else str(error)
    return complaint.encode("unicode_escape").decode()


def _connected(path: Path, how: str) -> sqlite3.Connection:
    address = quote_from_bytes(bytes(path.absolute()))
    connection = sqlite3.connect(f"file:{address}?{how}", uri=True, isolation_level=None)
    connection.text_factory = bytes
    if sys.version_info >= (3, 11):
        connection.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, 2 * LARGEST_MESSAGE)
    # What a stranger's schema says must not run, nor take its time.
    for pragma in (
        "trusted_schema = OFF",
        "ignore_check_constraints = ON",
        "cell_size_check = ON",
    ):
        connection.execute(f"PRAGMA {pragma}")
    return connection


def _damage(line: str, page_size: int) -> Damage:
    page = _AT_PAGE.search(line)
    what = line.encode("unicode_escape").decode()
    return Damage((int(page[1]) - 1) * page_size if page else 0, f"the database: {what}")
