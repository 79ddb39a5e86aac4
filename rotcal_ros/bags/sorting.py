"""Messages in the order of a time, out of files that have another order, in bounded memory.

Runs of messages are sorted and laid into a temporary file, then merged.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from typing import IO, Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from rotcal_ros.arrays import Ints
from rotcal_ros.bags.blocks import HEADER_TYPE, Block

RUN_BYTES: Final = 32 << 20
"""Messages that are sorted at once, and about what is held while runs are merged."""
_PIECE: Final = 1 << 18
_ROWS: Final = 1 << 16
_LEAST_BYTES: Final = 1 << 16
_Taken = tuple[NDArray[Any], bytes]
_ROW: Final = np.dtype([("key", "<i8"), ("size", "<i8"), ("header", HEADER_TYPE)])


class Sorting:
    """Takes blocks with a key for each message, gives all messages by ascending key.

    Messages of equal key keep their order. ``run_bytes`` bounds the memory that is taken.
    """

    def __init__(self, run_bytes: int = RUN_BYTES) -> None:
        self._run_bytes = run_bytes
        self._waiting: list[tuple[NDArray[Any], bytes]] = []
        self._size = 0
        self._file: IO[bytes] | None = None
        self._runs: list[_Run] = []

    def add(self, block: Block, keys: Ints) -> None:
        """Take the messages of ``block``; ``keys`` has one time (ns) for each."""
        begin = 0
        ends = np.cumsum(block.size)
        while begin < len(block):
            before = int(ends[begin - 1]) if begin else 0
            end = int(np.searchsorted(ends, before + _PIECE)) + 1
            rows = np.arange(begin, min(end, begin + _ROWS, len(block)))
            self._add(block.select(rows), keys[rows])
            begin = int(rows[-1]) + 1

    def blocks(self) -> Iterator[Block]:
        """Yield all messages, then forget them."""
        if self._waiting:
            self._close_run()
        portion = self._run_bytes // max(1, len(self._runs))
        for run in self._runs:
            run.portion = max(_LEAST_BYTES, portion)
        while runs := [run for run in self._runs if run.fill()]:
            # Behind the first run whose portion ends something smaller may follow.
            safe = min((r.last_key for r in runs if r.more), default=None)
            parts = []
            limited = False
            for run in runs:
                parts.append(run.up_to(safe, "left" if limited else "right"))
                limited |= run.more and run.last_key == safe
            for run in runs:
                run.drop_taken()
            yield _joined([part for part in parts if len(part[0])])
        if self._file is not None:
            self._file.close()
        self._runs, self._file = [], None

    def _add(self, block: Block, keys: Ints) -> None:
        rows = np.zeros(len(block), _ROW)
        rows["key"], rows["size"], rows["header"] = keys, block.size, block.headers
        data = _payloads(np.frombuffer(block.data, np.uint8), block.start, block.size)
        self._waiting.append((rows, data))
        self._size += len(data) + rows.nbytes
        if self._size >= self._run_bytes:
            self._close_run()

    def _close_run(self) -> None:
        """Lay what waits into the file, sorted."""
        if self._file is None:
            self._file = tempfile.TemporaryFile(prefix="rotcal_")  # noqa: SIM115 - kept open
        rows = np.concatenate([rows for rows, _ in self._waiting])
        raw = np.frombuffer(b"".join(data for _, data in self._waiting), np.uint8)
        self._waiting, self._size = [], 0
        start = np.cumsum(rows["size"]) - rows["size"]
        order = np.argsort(rows["key"], kind="stable")
        begin = self._file.seek(0, 2)
        self._file.write(rows[order].tobytes())
        for part in _pieces(order, rows["size"]):
            self._file.write(_payloads(raw, start[part], rows["size"][part]))
        self._runs.append(_Run(self._file, begin, len(rows)))


class _Run:
    """A sorted run in the file, of which a portion is in memory."""

    def __init__(self, file: IO[bytes], begin: int, count: int) -> None:
        self.portion = _LEAST_BYTES
        self._file = file
        self._rows_at, self._left = begin, count
        self._data_at = begin + count * _ROW.itemsize
        self._rows, self._data, self._taken = np.zeros(0, _ROW), b"", 0

    @property
    def more(self) -> bool:
        """Whether something stands in the file behind the portion."""
        return self._left > 0

    @property
    def last_key(self) -> int:
        return int(self._rows["key"][-1])

    def fill(self) -> bool:
        """Read the next portion where none is left; return whether there is one."""
        if not len(self._rows) and self._left:
            self._file.seek(self._rows_at)
            count = min(self._left, _ROWS, max(1, self.portion // _ROW.itemsize))
            rows = np.frombuffer(self._file.read(count * _ROW.itemsize), _ROW)
            within = int(np.searchsorted(np.cumsum(rows["size"]), self.portion)) + 1
            self._rows = rows[:within]
            self._file.seek(self._data_at)
            self._data = self._file.read(int(self._rows["size"].sum()))
            self._rows_at += self._rows.nbytes
            self._data_at += len(self._data)
            self._left -= len(self._rows)
        return len(self._rows) > 0

    def up_to(self, key: int | None, side: Literal["left", "right"]) -> _Taken:
        """Return what of the portion has keys below ``key`` ("right": or equal; None: all)."""
        keys = self._rows["key"]
        self._taken = len(keys) if key is None else int(np.searchsorted(keys, key, side))
        taken = self._rows[: self._taken]
        return taken, self._data[: int(taken["size"].sum())]

    def drop_taken(self) -> None:
        """Forget what was returned last."""
        self._data = self._data[int(self._rows["size"][: self._taken].sum()) :]
        self._rows = self._rows[self._taken :]


def _joined(parts: list[_Taken]) -> Block:
    """Return what was taken of all runs as one block; its log times are the keys."""
    rows = np.concatenate([rows for rows, _ in parts])
    data = b"".join(data for _, data in parts)
    start = np.cumsum(rows["size"]) - rows["size"]
    order = np.argsort(rows["key"], kind="stable")
    headers = rows["header"][order]
    headers["log_time"] = np.maximum(rows["key"][order], 0).astype(np.uint64)
    return Block(data, start[order], rows["size"][order], headers)


def _pieces(order: Ints, size: Ints) -> Iterator[Ints]:
    """Yield ``order`` in parts of about ``_PIECE`` bytes of messages."""
    number = np.cumsum(size[order]) // _PIECE
    yield from np.split(order, np.flatnonzero(np.diff(number)) + 1)


def _payloads(raw: NDArray[np.uint8], start: Ints, size: Ints) -> bytes:
    """Return the bytes of messages one behind the other."""
    if not len(start):
        return b""
    shift = start - (np.cumsum(size) - size)
    return raw[np.repeat(shift, size) + np.arange(int(size.sum()))].tobytes()
