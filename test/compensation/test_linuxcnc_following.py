"""The trim of LinuxCNC between its table and the motor: figures read off the real program."""

from dataclasses import replace
from datetime import datetime, timezone

import numpy as np
import pytest
from compensation_examples import TAU, even, result_of, wavy

from rotcal_ros.compensation.controllers import make_controller
from rotcal_ros.compensation.export import prepare_export
from rotcal_ros.compensation.linuxcnc import JointLimits
from rotcal_ros.compensation.table import table_from_result
from rotcal_ros.foundation.units import ARCSEC, DEGREE

NOW = datetime(2026, 1, 2, tzinfo=timezone.utc)
FAST = JointLimits(20000 * DEGREE, 2000 * DEGREE, 0.001)
SLOW = JointLimits(3600 * DEGREE, 360 * DEGREE, 0.001)


def exported(reversal_arcsec, **settings):
    table = table_from_result(result_of(even(36), wavy(even(36))))
    table = replace(
        table, correction_reverse=table.correction_forward + reversal_arcsec * ARCSEC
    )  # a constant reversal, as of play
    return prepare_export(table, "linuxcnc", now=NOW, spacing=TAU / 72, settings=settings)


def trims(following, wanted):
    """Return the trim (n, ...) rad in every servo period, for what the table asks (n, ...)."""
    trim = np.zeros(wanted.shape[1:])
    speed, trims = np.zeros_like(trim), np.empty_like(wanted)
    for period, goal in enumerate(wanted):
        trim, speed = step(following, goal, trim, speed)
        trims[period] = trim
    return trims


def step(following, goal, trim, speed):
    """Return trim and speed after one servo period."""
    limit, half = 0.5 * following.velocity, 0.5 * following.acceleration
    side = np.where(goal >= trim, 1.0, -1.0)
    left, ahead, gain = np.abs(goal - trim), side * speed, half * following.period
    moved = ahead * following.period
    near = left <= (ahead + gain) ** 2 / (2.0 * half) + moved
    slows = near & (ahead > gain)
    more = np.minimum(gain, limit - ahead)
    extra = 0.5 * more * following.period
    gains = ~near & (left > (ahead + more) ** 2 / (2.0 * half) + moved + extra)
    change = np.where(slows, -gain, np.where(gains, more, 0.0))
    arrives = near & ~slows
    new = trim + side * (moved + 0.5 * change * following.period)
    stays = left == 0.0
    return (
        np.where(arrives | stays, goal, new),
        np.where(stays, speed, np.where(arrives, 0.0, side * (ahead + change))),
    )


@pytest.mark.parametrize(
    ("following", "low", "high"), [(FAST, 18.0, 36.0), (SLOW, 3.24, 6.48)]
)  # a quarter and half of MAX_ACCELERATION * SERVO_PERIOD^2, in arcsec
def test_the_dead_band_is_a_quarter_to_half_of_what_the_acceleration_gives(following, low, high):
    assert following.largest_step / ARCSEC == pytest.approx(low)
    assert following.in_motion / ARCSEC == pytest.approx(high)
    changes = np.array([0.97 * low, 1.03 * low, 0.97 * high, 1.03 * high, 9 * high]) * ARCSEC
    made = trims(following, np.tile(changes, (300, 1)))[-1]
    assert made == pytest.approx(changes * [1, 0, 0, 1, 1], abs=1e-12)
    assert list(following.stands(-changes)) == [False, True, True, False, False]


def test_a_joint_of_little_speed_has_no_dead_band():
    slow = JointLimits(20000 * DEGREE, 8 * DEGREE, 0.001)  # 4 deg/s are reached in half a period
    assert slow.in_motion < slow.largest_step
    changes = np.linspace(1.0, 60.0, 60) * ARCSEC
    assert not np.any(slow.stands(changes))
    assert trims(slow, np.tile(changes, (400, 1)))[-1] == pytest.approx(changes, abs=1e-12)


@pytest.mark.parametrize("feed_deg_s", [1.0, 20.0, 90.0, 360.0])
def test_how_far_the_trim_is_behind_is_bounded(feed_deg_s):
    """A saw-tooth of 2 arcsec per degree, driven past at a steady feed."""
    steepest, period = 2.0 * ARCSEC / DEGREE, SLOW.period
    angle = np.arange(6000) * feed_deg_s * DEGREE * period
    wanted = steepest * np.abs(np.mod(angle + 20 * DEGREE, 40 * DEGREE) - 20 * DEGREE)
    found = np.max(np.abs(trims(SLOW, wanted[:, None])[:, 0] - wanted))
    bound = SLOW.behind(steepest, feed_deg_s * DEGREE)
    assert found <= bound + 1e-15
    follows = feed_deg_s * DEGREE <= SLOW.fastest_feed(steepest)
    assert (found < 1e-15) == (bound == 0.0) == follows


def test_a_table_that_rises_faster_than_the_trim_can_is_farther_and_farther_behind():
    assert SLOW.behind(1.0, 181 * DEGREE) == np.inf  # half of 360 deg/s is the trim's
    assert SLOW.behind(1.0, 179 * DEGREE) < np.inf


def test_what_stays_after_a_reversal_is_that_of_the_worst_place():
    forward = np.zeros(361)
    reverse = np.concatenate([np.full(180, 10.0), np.linspace(10.0, 30.0, 181)]) * ARCSEC
    assert FAST.residual_after_reversal(forward, reverse, closed=False) == pytest.approx(
        30 * ARCSEC
    )
    assert FAST.residual_after_reversal(forward, np.full(361, 17 * ARCSEC), closed=True) == 0.0
    assert FAST.residual_after_reversal(forward, np.full(361, 37 * ARCSEC), closed=True) == 0.0


def test_after_homing_the_trim_waits_at_zero_until_it_may_move():
    """A ramp of 1 arcsec per row, homed in several places; the dead band is 18 to 36 arcsec."""
    ramp = np.arange(61.0) * ARCSEC
    stays = {10: 0.0, 25: 36.0, 50: 0.0}  # upwards it is left at 36, downwards at 18
    for home, left in stays.items():
        found = FAST.residual_after_homing(ramp, ramp, home, closed=False)
        assert found / ARCSEC == pytest.approx(left)
    flat = np.full(61, 25.0) * ARCSEC
    assert FAST.residual_after_homing(flat, 0.0 * flat, 3, closed=True) == pytest.approx(flat[0])


@pytest.mark.parametrize(
    ("reversal", "acceleration"), [(25.0, 20000.0), (5.0, 3600.0), (25.0, 16000.0)]
)
def test_a_reversal_in_the_dead_band_is_in_the_stated_residual(reversal, acceleration):
    made = exported(reversal, max_acceleration_deg_s2=acceleration, max_velocity_deg_s=360.0)
    assert made.residual.stated / ARCSEC > reversal
    assert made.residual.following == pytest.approx(acceleration * DEGREE * 1e-6 / 2, rel=0.011)
    assert made.residual.simulated > 0.9 * reversal * ARCSEC
    assert any("stands still" in warning for warning in made.warnings)


@pytest.mark.parametrize(
    "settings",
    [
        {"max_acceleration_deg_s2": 1000.0},  # 0.9 to 1.8 arcsec
        {"max_acceleration_deg_s2": 100000.0},  # 90 to 180 arcsec
        {"max_acceleration_deg_s2": 20000.0, "servo_period_ns": 500_000},  # 4.5 to 9 arcsec
    ],
)
def test_beside_the_dead_band_nothing_stays(settings):
    made = exported(25.0, **settings)
    assert made.residual.following == 0.0
    assert made.warnings == exported(25.0).warnings[:-1]
    assert "MAX_ACCELERATION of the joint is not known" in exported(25.0).warnings[-1]


def test_a_feed_at_which_the_trim_cannot_follow_is_stated():
    limits = {"max_acceleration_deg_s2": 100.0, "max_velocity_deg_s": 360.0}
    (fast,) = [w for w in exported(25.0, **limits).warnings if "trim" in w]
    assert "at 360 deg/s it is up to" in fast
    made = exported(25.0, **limits, feed_deg_s=1.0)
    assert made.residual.following == 0.0
    assert not [w for w in made.warnings if "trim" in w]


def test_the_limits_are_no_part_of_the_written_table():
    known = exported(25.0, max_acceleration_deg_s2=20000.0).files
    assert known["c_linuxcnc.comp"] == exported(25.0).files["c_linuxcnc.comp"]
    assert make_controller("linuxcnc").for_axis("A") == make_controller("linuxcnc")
