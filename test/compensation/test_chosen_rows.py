"""How far apart the rows are: the lines between them leave less than a third of U.

The curve is a sum of sines that is made here, and what a control leaves is worked out from the
numbers in the file.
"""

from datetime import datetime, timezone

import numpy as np
import pytest
from compensation_examples import even, result_of

from rotcal_ros.compensation.export import prepare_export
from rotcal_ros.compensation.table import table_from_result
from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.units import ARCSEC, DEGREE

NOW = datetime(2026, 1, 2, tzinfo=timezone.utc)
PARTS = ((1, 40.0, 0.2), (2, 15.0, 1.0), (5, 6.0, 0.5), (9, 2.0, 2.0))


def curve(angle):
    return sum(a * np.sin(k * angle + p) for k, a, p in PARTS) * ARCSEC


def exported(std_arcsec, name="linuxcnc", n=72, spacing=None, **settings):
    result = result_of(even(n), curve(even(n)) - curve(0.0), std_arcsec * ARCSEC)
    return prepare_export(
        table_from_result(result), name, now=NOW, settings=settings, spacing=spacing,
        accept_unverified=True,
    )  # fmt: skip


def left(done):
    """What LinuxCNC's straight lines leave of the curve, rad, from the numbers in its file."""
    rows = np.loadtxt(done.files["c_linuxcnc.comp"].splitlines())
    at = np.linspace(0.0, 360.0, 36_001)
    trims = np.interp(at, rows[:, 0], rows[:, 1]) * DEGREE
    return np.max(np.abs(trims + curve(at * DEGREE) - curve(0.0)))


def widest(done):
    return max(np.diff(np.loadtxt(done.files["c_linuxcnc.comp"].splitlines())[:, 0]))


@pytest.mark.parametrize("std_arcsec", [0.4, 0.6, 1.2])
def test_less_than_a_third_of_u_is_left_between_the_rows(std_arcsec):
    done = exported(std_arcsec)
    # the standard uncertainty of a difference of two values
    third = 2.0 * np.sqrt(2.0) * std_arcsec * ARCSEC / 3.0
    assert left(done) < third
    assert not any("between rows" in text for text in done.warnings)


def test_ten_degrees_would_leave_more_and_are_told():
    """As a bridge had it: rows every 10 degrees of a curve measured every 5."""
    done = exported(0.3, spacing=10.0 * DEGREE)
    assert left(done) > 2.0 * np.sqrt(2.0) * 0.3 * ARCSEC
    told = [text for text in done.warnings if text.startswith("between rows 10 deg apart")]
    assert len(told) == 1
    assert "more than a third of U (0.85 arcsec): leave out the spacing" in told[0]


def test_narrower_rows_than_the_measured_ones_where_these_are_too_wide():
    """Straight lines 10 deg apart leave a third of a good U; the curve between is known."""
    wide = exported(0.1, n=36)
    assert widest(wide) < 10.0
    assert left(wide) < left(exported(0.1, n=36, spacing=10.0 * DEGREE)) / 2.0


def test_the_limits_of_the_controller_come_first():
    """256 rows for seven turns: nothing below 10 degrees, and the file says what that leaves."""
    done = exported(0.05, turns=7)
    assert widest(done) == pytest.approx(10.0)
    told = [text for text in done.warnings if text.startswith("between rows 10 deg apart")]
    assert len(told) == 1
    assert told[0].endswith("no rows that the controller takes leave less")  # none were stated
    with pytest.raises(ConfigurationError, match="256"):
        exported(0.05, turns=200)
