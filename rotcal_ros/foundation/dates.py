"""Days (UTC), as 2026-03-31, and moments in ns since 1970."""

from __future__ import annotations

from datetime import datetime, timezone
from typing import Final

from rotcal_ros.foundation.errors import ConfigurationError

_NS: Final = 1_000_000_000


def day_of(time_ns: int) -> str:
    """Return the day of a moment.

    >>> day_of(1_774_915_200_000_000_000)
    '2026-03-31'
    """
    return datetime.fromtimestamp(time_ns // _NS, timezone.utc).date().isoformat()


def time_of(day: str) -> int:
    """Return the first moment of a day; raises ConfigurationError.

    >>> time_of("2026-03-31")
    1774915200000000000
    """
    try:
        begun = datetime.fromisoformat(day).replace(tzinfo=timezone.utc)
    except ValueError:
        raise ConfigurationError(f"{day!r} is no date: expected one like 2026-03-31") from None
    return int(begun.timestamp()) * _NS


def today() -> str:
    """Return the day that it is."""
    return datetime.now(timezone.utc).date().isoformat()
