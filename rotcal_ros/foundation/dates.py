"""Days (UTC), as 2026-03-31, and moments in ns since 1970."""

from __future__ import annotations

from datetime import datetime, timezone
from typing import Final

from rotcal_ros.foundation.errors import ConfigurationError

_NS: Final = 1_000_000_000
_FARTHEST_NS: Final = 292 * 31_556_952 * _NS
"""What integers of 64 bit hold, in whole years."""


def day_of(time_ns: int) -> str:
    """Return the day of a moment.

    >>> day_of(1_774_915_200_000_000_000)
    '2026-03-31'
    """
    return datetime.fromtimestamp(time_ns // _NS, timezone.utc).date().isoformat()


def time_of(day: str) -> int:
    """Return the first moment of a day, or a moment with its zone; raises ConfigurationError.

    >>> time_of("2026-03-31")
    1774915200000000000
    """
    try:
        begun = datetime.fromisoformat(day)
        known = begun if begun.tzinfo else begun.replace(tzinfo=timezone.utc)
        time_ns = int(known.timestamp()) * _NS
    except (ValueError, OverflowError):
        raise ConfigurationError(f"{day!r} is no date: expected one like 2026-03-31") from None
    if abs(time_ns) > _FARTHEST_NS:
        raise ConfigurationError(f"{day!r} is too far away: expected a year from 1678 to 2261")
    return time_ns


def today() -> str:
    """Return the day that it is."""
    return datetime.now(timezone.utc).date().isoformat()
