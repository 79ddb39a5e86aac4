"""How the table is turned, what its speed is, and that no way leads through a ball."""

from math import pi, radians

import numpy as np
import pytest

from rotcal_ipp_dme.client import TableAxis, parse_position, table_turn_method
from rotcal_ipp_dme.driver import MoveOrder, TouchOrder, ball_touch_moves
from rotcal_ipp_dme.protocol import DmeError, ProtocolError
from rotcal_ipp_dme.settings import DmeSettings
from rotcal_ros.foundation.observations import Approach
from rotcal_ros.planning.table_feedback import TableSpeed


def axis(turn_by="goto_r", **settings):
    return TableAxis(DmeSettings(**settings), turn_by)


def test_the_version_says_how_a_table_is_turned_unless_a_setting_does():
    assert [table_turn_method(v) for v in ("1.4.3", "1.4", "1.70")] == ["align_part"] * 3
    assert [table_turn_method(v) for v in ("2.0", "2.5", "2")] == ["goto_r"] * 3
    with pytest.raises(DmeError, match=r"set dme\.turn_by to goto_r or align_part"):
        table_turn_method("two")


def test_angles_become_r_with_zero_and_sign():
    assert str(axis().turn(radians(90.0))) == "GoTo(R(90))"
    turned = axis(table_zero_deg=30.0, table_reversed=True)
    assert str(turned.turn(radians(90.0))) == "GoTo(R(-60))"
    assert turned.angle(-60.0, near=0.0) == pytest.approx(radians(90.0))
    assert str(axis("align_part").turn(radians(90.0))) == "AlignPart(1, 0, 0, 0, 1, 0, 0)"


def test_a_server_that_counts_r_from_0_to_360_is_understood():
    assert axis().angle(350.0, near=0.0) == pytest.approx(radians(-10.0))
    assert axis().angle(10.0, near=4 * pi) == pytest.approx(4 * pi + radians(10.0))


def test_the_side_of_approach_is_kept():
    over = radians(2.0)
    stops = axis().stops
    assert stops(1.0, 2.0, Approach.POSITIVE) == [2.0]
    assert stops(3.0, 2.0, Approach.POSITIVE) == [2.0 - over, 2.0]
    assert stops(2.0, 2.0, Approach.POSITIVE) == [2.0 - over, 2.0]
    assert stops(1.0, 2.0, Approach.NEGATIVE) == [2.0 + over, 2.0]
    assert stops(1.0, 2.0, Approach.UNKNOWN) == [2.0]


def test_a_table_that_goes_the_shorter_way_is_led_the_ordered_one():
    stops = axis("align_part").stops(0.0, radians(300.0), Approach.POSITIVE)
    assert stops == pytest.approx([radians(100.0), radians(200.0), radians(300.0)])
    assert axis("align_part").stops(0.0, radians(90.0), Approach.POSITIVE) == [radians(90.0)]


def test_a_table_somewhere_else_is_told_with_the_settings():
    axis().check_arrival(radians(10.5), radians(370.0))
    with pytest.raises(DmeError, match=r"sent to 20\.000 deg and stands \+70\.000 deg from there"):
        axis().check_arrival(radians(90.0), radians(20.0))


def test_speed_is_that_over_the_time_asked_for():
    speed = TableSpeed(0.1)
    assert speed.feed(0, 1.0) is None
    assert speed.feed(50_000_000, 1.1) is None
    assert speed.feed(100_000_000, 1.2).velocity == pytest.approx(2.0)
    assert speed.feed(100_000_000, 1.3) is None  # time stood still
    assert speed.feed(200_000_000, 1.2).velocity == pytest.approx(0.0)
    speed.restart()
    assert speed.feed(300_000_000, 1.2) is None


def test_a_report_is_millimetres_and_degrees():
    standing = parse_position("Z(3), X(1000), R(90), Y(-2.5)", "Get")
    assert standing.position == pytest.approx((1.0, -0.0025, 0.003))
    assert standing.r_deg == 90.0
    with pytest.raises(ProtocolError, match="Get: no Y, R in"):
        parse_position("X(1), Z(2)", "Get")


def test_no_way_leads_through_the_ball_and_every_touch_comes_from_outside():
    centre, diameter, tip, approach = np.array([0.1, -0.2, 0.03]), 0.025, 0.0015, 0.002
    reach, height = 0.5 * diameter + tip, 0.1
    here, touches = np.array([0.0, 0.0, height]), 0
    for move in ball_touch_moves(tuple(centre), diameter, 15, tip, approach, height):
        if isinstance(move, MoveOrder):
            given = (move.x, move.y, move.z)
            there = np.array([h if g is None else g for g, h in zip(given, here, strict=True)])
            way = here + np.linspace(0.0, 1.0, 200)[:, None] * (there - here)
            assert np.linalg.norm(way - centre, axis=1).min() > reach - 1e-9
            here = there
            continue
        assert isinstance(move, TouchOrder)
        touches += 1
        direction = np.array(move.direction)
        assert np.linalg.norm(direction) == pytest.approx(1.0)
        assert np.allclose(np.array(move.nominal) - centre, 0.5 * diameter * direction)
        assert here == pytest.approx(centre + (reach + approach) * direction)
        here = centre + reach * direction
    assert touches == 15
    assert here[2] == height
