"""Lengths and angles of a table that turned without orders: all are kept until the end."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from rotcal_ros.capture.settings import CaptureSettings
from rotcal_ros.capture.window import Beam, ReadingFault, classify_readings
from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.foundation.errors import DataError
from rotcal_ros.foundation.observations import Observation
from rotcal_ros.foundation.units import NANOSECOND, TURN

_MOST_BACK: Final = 0.01
"""Share of a stream that may come late, or twice."""

Rows = tuple[NDArray[Any], ...]
"""Columns (n,) of records in the order of arrival."""


class UnorderedStreams:
    """Takes what a capture takes, and decides nothing; ``counts`` as of a capture."""

    def __init__(self) -> None:
        self._tracer, self._table = list[Rows](), list[Rows]()

    @property
    def counts(self) -> Mapping[str, Mapping[str, int]]:
        """How many lengths and feedbacks have come."""
        streams = {"tracer": self._tracer, "table": self._table}
        return {name: {"received": sum(len(r[0]) for r in rows)} for name, rows in streams.items()}

    def feed(self, record: Any) -> tuple[Observation, ...]:
        """Take one record, which is none of a length or an angle."""
        return ()

    def feed_tracer(
        self, stamp_ns: Ints, sequence: NDArray[Any], length: NDArray[Any], status: NDArray[Any]
    ) -> tuple[Observation, ...]:
        """Take many tracer readings."""
        self._tracer.append((stamp_ns, sequence, length, status))
        return ()

    def feed_table(
        self, stamp_ns: Ints, angle: NDArray[Any], velocity: NDArray[Any]
    ) -> tuple[Observation, ...]:
        """Take many feedbacks of the table."""
        self._table.append((stamp_ns, angle))
        return ()

    def readings(self, settings: CaptureSettings) -> tuple[Ints, Floats, Floats, Ints]:
        """Return stamps (n,), angles (n,), rad, without a wrap, ``values`` (n, 3), and beams (n,).

        The table is where its feedback, interpolated to the stamp, says; readings beyond it, or
        in a pause of it that is too long, are left out. ``values`` are those of an admitted tracer
        stream. A beam is how often the zero was lost before.
        """
        stamps, sequence, length, status = _in_order(self._tracer, "the lengths")
        shown, angle = _in_order(self._table, "the feedback of the table", finite=1)
        fault = classify_readings(status, length, settings.max_length_m)
        beam = Beam(settings.max_silence_s, settings.max_length_speed_m_s)
        usable, broken = fault == ReadingFault.NONE, fault == ReadingFault.BEAM_BROKEN
        beam.follow(stamps, sequence, length, usable, broken)
        begun = np.searchsorted(beam.begins, stamps, side="right")
        behind = np.searchsorted(shown, stamps).clip(1, len(shown) - 1)
        pause_s = (shown[behind] - shown[behind - 1]) * NANOSECOND
        known = (stamps >= shown[0]) & (stamps <= shown[-1])
        known &= pause_s <= settings.table_silence_s
        since = stamps - shown[0]
        at = np.interp(since, shown - shown[0], np.unwrap(angle, period=TURN))
        values = np.column_stack([sequence, length, fault])
        if not known.any():
            raise DataError(
                "no length was read while the table's feedback came, without a pause of over "
                f"{settings.table_silence_s:g} s (capture.table_silence_s): have both one clock?"
            )
        return stamps[known], at[known], values[known], begun[known]


def _in_order(rows: list[Rows], what: str, finite: int = 0) -> Rows:
    """Return the columns of a stream whose stamps ascend, all of the column ``finite`` numbers.

    Raises DataError where there are fewer than two, or many stamps that go back.
    """
    columns = tuple(np.concatenate(each) for each in zip(*rows, strict=True))
    count = len(columns[0]) if columns else 0
    if count < 2:
        raise DataError(
            f"{what}: {count} messages with stamps that grow; which topic is it? State the group "
            "topics; where stamps are not set, that the time of sending counts (table_clock: sent)"
        )
    before = np.maximum.accumulate(columns[0])
    good = np.append(True, columns[0][1:] > before[:-1])
    if np.count_nonzero(~good) > _MOST_BACK * count:
        raise DataError(
            f"{what}: {np.count_nonzero(~good)} of {count} stamps do not grow: two publishers, or "
            "a clock that was set"
        )
    good &= np.isfinite(columns[finite])
    return tuple(column[good] for column in columns)
