"""How probably a beam is free: less near a blocked one, more near free ones."""

import numpy as np
import pytest

from rotcal_ros.methods.tracer.policy.until_goal import FreeBeams


def beams(*degrees):
    angles = np.deg2rad(degrees)
    return FreeBeams(np.column_stack([np.cos(angles), np.sin(angles), 0.0 * angles]))


def test_where_nothing_was_blocked_every_beam_is_free():
    found = beams(0.0, 10.0)
    found.note_free(0)
    assert found.clear_probability.tolist() == [1.0, 1.0]


def test_fifteen_degrees_from_a_blocked_beam_it_is_as_likely_blocked_as_free():
    found = beams(0.0, 15.0, 30.0, 90.0)
    found.note_blocked(0)
    assert found.allowed.tolist() == [False, True, True, True]
    # A normal curve of the angle: 1/2 at 15 degrees, so (1/2)**4 at twice as much.
    expected = [0.0, 0.5, 1.0 - 0.5**4, 1.0]
    assert found.clear_probability == pytest.approx(expected, abs=1e-6)


def test_a_free_beam_nearer_than_the_blocked_one_makes_another_likely():
    found = beams(0.0, 15.0, 20.0)
    found.note_blocked(0)
    found.note_free(2)
    # 5 degrees to the free one against 15 to the blocked one: a third of the doubt.
    assert found.clear_probability[1] == pytest.approx(1.0 - 0.5 / 3.0)
    assert found.clear_probability[2] == 1.0
