"""The results of many bags as a Parquet dataset: parts that are written as bags are done."""

from __future__ import annotations

import hashlib
import shutil
import time
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Any, Final
from uuid import uuid4

import numpy as np

from rotcal_ros.bags.parquet import arrow
from rotcal_ros.extensions.fleet.batch_solving import BagOutcome
from rotcal_ros.foundation.escapes import encodable
from rotcal_ros.foundation.files import FolderLock, replace_atomically

RESULTS_TABLE: Final = "results.parquet"
"""The folder of parts, beside the overview of what they hold."""
ROWS: Final = 50_000
"""Rows after which a part is written."""
PATIENCE_S: Final = 30.0
"""Seconds after which a part is written, however small."""


class ResultsDataset:
    """The rows of all bags of a call in ``folder``; one row per bag, angle and component.

    SI; deviation = actual - commanded. A bag without a result has one row with its error. Rows of
    an earlier call stay where the same outcome comes again, and are removed at the end where it
    does not. Every part is written whole: a second call continues after a crash. ``broken``
    counts parts that were damaged; their rows come again. One process writes at a time: raises
    BagError.
    """

    def __init__(self, folder: Path) -> None:
        arrow()
        folder.mkdir(parents=True, exist_ok=True)
        self.folder = folder
        self.broken = 0
        self._lock = FolderLock(folder)
        self._known: set[bytes] = set()
        self._confirmed: set[bytes] = set()
        self._seen: set[bytes] = set()
        self._batches: list[Any] = []
        self._rows, self._since = 0, time.monotonic()
        self._earlier = tuple(path for path in parts(folder) if self._read(path))
        for unfinished in folder.glob(".*"):
            shutil.rmtree(unfinished, ignore_errors=True)

    def __enter__(self) -> ResultsDataset:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        _error: BaseException | None,
        _traceback: TracebackType | None,
    ) -> None:
        """Write the waiting rows; those that an interrupted call did not reach stay."""
        try:
            self._write()
            for path in self._earlier:
                self._tidy(path, complete=kind is None)
        finally:
            self._lock.release()

    def add(self, outcome: BagOutcome) -> None:
        """Take the outcome of a bag; it is on the medium within PATIENCE_S and ROWS."""
        source = encodable(outcome.source)
        self._seen.add(_digest(source))
        identity = _digest(source, outcome.key)
        if not outcome.error and identity in self._known:
            self._confirmed.add(identity)
            return
        batch = _batch(outcome)
        self._batches.append(batch)
        self._rows += batch.num_rows
        if self._rows >= ROWS or time.monotonic() > self._since + PATIENCE_S:
            self._write()

    def _write(self) -> None:
        if self._batches:
            table = arrow()[0].Table.from_batches(self._batches)
            _write(table, self.folder / f"part-{uuid4().hex}.parquet")
        self._batches, self._rows, self._since = [], 0, time.monotonic()

    def _read(self, path: Path) -> bool:
        """Read what a part of an earlier call holds; a damaged one is removed."""
        try:
            table = _whole(path)
            pairs = _bags_of(table)
        except (OSError, ValueError, KeyError):
            path.unlink()
            self.broken += 1
            return False
        self._known |= {_digest(source, key) for source, key, error in pairs if not error}
        return True

    def _tidy(self, path: Path, *, complete: bool) -> None:
        """Keep those rows of an earlier part that are still valid."""
        table = _whole(path)
        stale = [
            source
            for source, key, error in _bags_of(table)
            if (complete or _digest(source) in self._seen)
            and (error or _digest(source, key) not in self._confirmed)
        ]
        if not stale:
            return
        import pyarrow.compute as compute

        table = table.filter(
            compute.invert(compute.is_in(table["source"], arrow()[0].array(stale)))
        )
        if table.num_rows:
            _write(table, path)
        else:
            path.unlink()


def parts(folder: Path) -> list[Path]:
    """Return the files of a dataset."""
    return sorted(folder.glob("part-*.parquet"))


def _write(table: Any, path: Path) -> None:
    parquet = arrow()[1]
    options = {"compression": "zstd", "write_page_checksum": True}
    replace_atomically(path, lambda new: parquet.write_table(table, new, **options))


def _whole(path: Path) -> Any:
    """Return all rows of a part, checked; raises OSError or ValueError."""
    _, parquet = arrow()
    return parquet.read_table(path, page_checksum_verification=True, partitioning=None)


def _bags_of(table: Any) -> list[tuple[str, str, str | None]]:
    """Return source, key and error of each bag in a part."""
    bags = table.group_by(["source", "key", "error"]).aggregate([])
    columns = (bags[name].to_pylist() for name in ("source", "key", "error"))
    return list(zip(*columns, strict=True))


def _batch(outcome: BagOutcome) -> Any:
    """Return the rows of one bag."""
    pa, _ = arrow()
    outcome = replace(outcome, source=encodable(outcome.source))
    result = outcome.deviations()
    common: dict[str, Any] = {
        "source": outcome.source,
        "table": outcome.table or outcome.source.rpartition("/")[0].rpartition("/")[2],
        "key": outcome.key,
        "session": outcome.session,
        "start": outcome.start_ns,
        "seconds": outcome.seconds,
        "warnings": "\n".join(outcome.warnings),
        "error": outcome.error or None,
    }
    columns: dict[str, Any] = {}
    count = 1
    if result is not None:
        names, n = result.components, len(result.angles)
        count = n * len(names)
        common |= {
            "warnings": "\n".join(dict.fromkeys((*outcome.warnings, *result.warnings))),
            "verdict": result.verdict,
            "verdict_line": result.verdict_line,
            "covered": bool(result.protections) and not result.unprotected,
            "sigma0": result.sigma0,
            "n_observations": result.n_observations,
            "n_rejected": len(result.rejected),
        }
        columns = {
            "component": np.repeat(np.array(names, dtype=object), n),
            "angle_rad": np.tile(result.angles, len(names)),
            "deviation": np.concatenate([result.deviations[name] for name in names]),
            "std": np.concatenate([result.std[name] for name in names]),
        }
    arrays = [
        pa.array(columns[field.name], field.type)
        if field.name in columns
        else pa.repeat(pa.scalar(common.get(field.name), field.type), count)
        for field in _schema()
    ]
    return pa.RecordBatch.from_arrays(arrays, schema=_schema())


def _schema() -> Any:
    pa, _ = arrow()
    return pa.schema(
        [
            ("source", pa.string()),
            ("table", pa.string()),
            ("key", pa.string()),
            ("session", pa.string()),
            ("start", pa.timestamp("ns", tz="UTC")),
            ("verdict", pa.string()),
            ("verdict_line", pa.string()),
            ("covered", pa.bool_()),
            ("error", pa.string()),
            ("warnings", pa.string()),
            ("seconds", pa.float64()),
            ("sigma0", pa.float64()),
            ("n_observations", pa.int64()),
            ("n_rejected", pa.int64()),
            ("component", pa.string()),
            ("angle_rad", pa.float64()),
            ("deviation", pa.float64()),
            ("std", pa.float64()),
        ]
    )


def _digest(*texts: str) -> bytes:
    return hashlib.blake2b(
        "\0".join(texts).encode(errors="surrogateescape"), digest_size=16
    ).digest()
