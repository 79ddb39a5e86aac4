"""Motion against closed forms of uniformly accelerated motion."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rotcal_ros.methods.simulation.motion import Motion, MotionLimits

SECOND = 1_000_000_000
STIFF = MotionLimits(speed=2.0, acceleration=4.0, lag=0.0, settling_time=0.1)


def stamps(*seconds):
    return np.array([round(s * SECOND) for s in seconds])


def test_long_way_ramps_cruises_and_brakes():
    motion = Motion(0, [1.0, 7.0], STIFF)  # ramps of 0.5 s over 0.5 m each, 2.5 s at 2 m/s
    assert motion.end_ns == round(3.5 * SECOND)
    position, velocity = motion.state(stamps(-1, 0, 0.25, 0.5, 1.5, 3.0, 3.25, 3.5, 9))
    assert position == pytest.approx([1, 1, 1.125, 1.5, 3.5, 6.5, 6.875, 7, 7])
    assert velocity == pytest.approx([0, 0, 1, 2, 2, 2, 1, 0, 0])


def test_short_way_never_reaches_full_speed():
    motion = Motion(0, [0.0, -0.25], STIFF)  # 0.25 s up, 0.25 s down
    assert motion.end_ns == SECOND // 2
    position, velocity = motion.state(stamps(0.125, 0.25, 0.375))
    assert position == pytest.approx([-1 / 32, -1 / 8, -7 / 32])
    assert velocity == pytest.approx([-0.5, -1.0, -0.5])


def test_legs_follow_each_other():
    motion = Motion(SECOND, [0.0, 0.25, 0.0], STIFF)
    assert motion.end_ns == 2 * SECOND
    position, _ = motion.state(stamps(1.25, 1.5, 1.75, 2.0))
    assert position == pytest.approx([0.125, 0.25, 0.125, 0.0])


def test_lag_decays_exponentially_after_the_end():
    limits = MotionLimits(speed=2.0, acceleration=4.0, lag=0.01, settling_time=0.1)
    motion = Motion(0, [0.0, 0.25], limits)
    position, velocity = motion.state(stamps(0.4, 0.5, 0.6, 0.7, 5.0))
    decay = np.exp([0, -1, -2, -45])
    assert position[1:] == pytest.approx(0.25 - 0.01 * decay, abs=1e-15)
    assert velocity[1:] == pytest.approx(0.1 * decay, abs=1e-12)
    assert position[0] == pytest.approx(0.25 - 0.5 * 4 * 0.01)


def test_at_rest_without_legs():
    position, velocity = Motion(0, [3.0], STIFF).state(stamps(-1, 0, 1))
    assert position.tolist() == [3, 3, 3]
    assert velocity.tolist() == [0, 0, 0]


@settings(max_examples=50, deadline=None)
@given(
    start=st.floats(-10, 10),
    way=st.floats(0.01, 10) | st.floats(-10, -0.01),
    speed=st.floats(0.1, 100),
    acceleration=st.floats(0.1, 100),
)
def test_velocity_is_the_derivative_and_keeps_the_limits(start, way, speed, acceleration):
    motion = Motion(0, [start, start + way], MotionLimits(speed, acceleration, 0.0, 1.0))
    times = np.linspace(-0.1, 1.1, 997) * motion.end_ns
    h = round(1e-4 * motion.end_ns)
    before, at, after = (motion.state((times + d).astype(np.int64)) for d in (-h, 0, h))
    slope = (after[0] - before[0]) / (2 * h / SECOND)
    assert np.abs(slope - at[1]).max() < 2 * acceleration * h / SECOND + 1e-9
    assert np.abs(at[1]).max() <= speed * (1 + 1e-9)
    assert after[0][-1] == start + way
