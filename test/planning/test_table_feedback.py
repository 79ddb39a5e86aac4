"""The feedback of a table: its unit, and a speed out of angles."""

from math import pi

import pytest

from rotcal_ros.planning.table_feedback import TableSpeed, looks_like_degrees


@pytest.mark.parametrize(
    ("angle", "commanded", "told"),
    [
        (30.0, pi / 6, True),
        (390.0, pi / 6, True),
        (-150.0, 7 * pi / 6, True),
        (359.99, 2 * pi, True),  # 57 turns would be far
        (-0.025, 0.0, False),  # 1.4 degrees beside 0, on the way to it, and no 0.025 degrees
        (2 * pi - 0.025, 2 * pi, False),
        (-0.025, 2 * pi, False),
        (-0.01, 6 * pi, False),
        (0.6, pi / 6, False),
        (float("nan"), pi / 6, False),
    ],
)
def test_a_feedback_in_degrees_is_known_by_its_size(angle, commanded, told):
    assert looks_like_degrees(angle, commanded) is told


def test_a_speed_is_that_of_the_span():
    speed = TableSpeed(0.1)
    told = [speed.feed(k * 25_000_000, pi * k * 0.025) for k in range(9)]
    assert told[:4] == [None] * 4
    assert [sample.velocity for sample in told[4:]] == pytest.approx([pi] * 5)
    assert speed.feed(8 * 25_000_000, 0.0) is None


def test_a_clock_that_was_set_back_begins_anew():
    speed = TableSpeed(0.05)
    early = [speed.feed(10**12 + k * 50_000_000, 0.1 * k) for k in range(3)]
    again = [speed.feed(k * 50_000_000, 0.1 * k) for k in range(3)]
    assert [sample and round(sample.velocity, 6) for sample in early] == [None, 2.0, 2.0]
    assert [sample and round(sample.velocity, 6) for sample in again] == [None, 2.0, 2.0]
