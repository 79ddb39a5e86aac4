"""Days and moments."""

import pytest

from rotcal_ros.foundation.dates import day_of, time_of
from rotcal_ros.foundation.errors import ConfigurationError


@pytest.mark.parametrize(
    ("day", "time_ns"),
    [("1970-01-01", 0), ("2000-02-29", 951_782_400_000_000_000), ("1969-12-31", -86_400 * 10**9)],
)
def test_a_day_begins_at_midnight_in_utc(day, time_ns):
    assert time_of(day) == time_ns
    assert (day_of(time_ns), day_of(time_ns + 86_400 * 10**9 - 1)) == (day, day)


def test_what_is_no_day_is_refused():
    with pytest.raises(ConfigurationError, match=r"'31\.3\.2026' is no date"):
        time_of("31.3.2026")


def test_a_moment_in_another_zone_is_the_same_moment():
    assert time_of("1970-01-01T02:00:00+02:00") == 0


@pytest.mark.parametrize("day", ["9999-12-31", "0001-01-01"])
def test_what_no_clock_can_show_is_refused(day):
    with pytest.raises(ConfigurationError, match=f"'{day}' is too far away"):
        time_of(day)
