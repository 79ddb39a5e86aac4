"""Who answers, who is slow, who is lost, and who is back: on a clock of the test."""

import pytest

from rotcal_ros.nodes.runtime.liveness import OVER_S, Liveness, OverloadMonitor
from rotcal_ros.planning.settings import HealthSettings

TURN_S = 0.2
SETTINGS = HealthSettings(lost_after_s=60.0)


class Cell:
    """Nodes that beat five times a second, by name; the test says who does not."""

    def __init__(self, *names):
        self.roll, self.now_s = Liveness(SETTINGS), 100.0
        self.beating, self.gone, self.told = set(names), {}, []
        self.pass_by(TURN_S)

    def pass_by(self, seconds):
        """Let time pass, with a look in every turn."""
        for _ in range(round(seconds / TURN_S)):
            self.now_s += TURN_S
            for name in self.beating:
                self.roll.receive(name, self.now_s)
            self.told += self.roll.poll(self.now_s, self.gone.get)


def test_who_beats_is_neither_slow_nor_lost():
    cell = Cell("a")
    cell.pass_by(100.0)
    assert (cell.roll.slow, cell.roll.lost, cell.told) == ({}, {}, [])


def test_a_late_beat_is_slow_and_over_as_soon_as_it_comes():
    cell = Cell("a", "b")
    cell.beating = {"b"}
    cell.pass_by(1.4)
    assert cell.roll.slow == {}
    cell.pass_by(3.6)
    assert cell.roll.slow == {"a": pytest.approx(5.0)}
    cell.beating = {"a", "b"}
    cell.pass_by(TURN_S)
    assert (cell.roll.slow, cell.roll.lost, cell.told) == ({}, {}, [])


def test_a_process_that_is_gone_is_lost_at_once():
    cell = Cell("a")
    cell.beating, cell.gone = set(), {"a": "its process 7 is gone"}
    cell.pass_by(1.0)
    assert cell.roll.lost == {"a": "its process 7 is gone"}
    assert (cell.roll.slow, cell.told) == ({}, ["a"])
    cell.pass_by(100.0)
    assert cell.told == ["a"]  # once


def test_a_slow_node_is_given_up_only_after_the_settled_time():
    cell = Cell("a")
    cell.beating = set()
    cell.pass_by(59.0)
    assert set(cell.roll.slow) == {"a"}
    assert cell.told == []
    cell.pass_by(2.0)
    assert cell.told == ["a"]
    assert cell.roll.lost == {"a": "no sign of it for 60 s"}
    assert cell.roll.slow == {}


def test_who_was_given_up_or_started_anew_is_back_with_its_next_beat():
    cell = Cell("a")
    cell.beating, cell.gone = set(), {"a": "its process 7 is gone"}
    cell.pass_by(2.0)
    cell.beating, cell.gone = {"a"}, {}
    cell.pass_by(TURN_S)
    assert (cell.roll.slow, cell.roll.lost) == ({}, {})
    cell.beating, cell.gone = set(), {"a": "its process 8 is gone"}
    cell.pass_by(2.0)
    assert cell.told == ["a", "a"]


def test_who_beats_without_taking_turns_is_slow():
    cell = Cell()
    for turn in range(20):
        cell.now_s += TURN_S
        cell.roll.receive(
            "a", cell.now_s - TURN_S * turn
        )  # its executor has stood since the first
        cell.roll.poll(cell.now_s, lambda _: None)
    assert cell.roll.slow == {"a": pytest.approx(3.8)}


def test_who_said_goodbye_is_neither():
    cell = Cell("a")
    cell.beating = set()
    cell.roll.forget("a")
    cell.pass_by(100.0)
    assert (cell.roll.slow, cell.roll.lost, cell.told) == ({}, {}, [])


def test_an_overload_is_one_line_at_its_begin_and_one_at_its_end():
    overload, lines = OverloadMonitor(), []
    for turn in range(3600):  # 12 minutes, in ten of which somebody is slow now and then
        now_s = TURN_S * turn
        slow = {"capture": 1.6, "solver": 2.0 + turn / 1000} if turn % 50 < 10 else {}
        slow = slow if now_s < 600.0 else {}
        lines += filter(None, [overload.poll(slow, now_s, lambda: "load 23.0 on 2 cores")])
    assert len(lines) == 2
    assert lines[0] == (
        "waiting for capture (1.6 s), solver (2.0 s): slow, not lost; load 23.0 on 2 cores; it "
        "resumes by itself"
    )
    assert f"no node has been slow for {OVER_S:g} s: waited 60 times" in lines[1]
    assert "5.0 s" in lines[1]


def test_an_overload_says_who_is_waited_for_as_long_as_it_is():
    overload = OverloadMonitor()
    overload.poll({"recorder": 3.0}, 0.0, lambda: "load 9.0 on 1 core")
    assert overload.text == "waiting for recorder (3.0 s): slow, not lost; load 9.0 on 1 core"
    overload.poll({}, 1.0, lambda: "")
    assert overload.text is None
