"""A goal waits for who is slow, says so, and gives up who is lost; on a clock of the test."""

import asyncio
import math
from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")

from rotcal_ros.foundation import machine_load
from rotcal_ros.foundation.node_state import Reason, State, Why
from rotcal_ros.nodes.planner import goal_watch
from rotcal_ros.nodes.planner.goal_watch import Codes, GoalError, GoalWatch, RequiredNodes
from rotcal_ros.nodes.planner.progress import GoalProgress
from rotcal_ros.nodes.runtime import cell_node
from rotcal_ros.nodes.runtime.beat_values import HOPELESS, PREFLIGHT_WAITS, SILENT
from rotcal_ros.planning.settings import HealthSettings, PlannerSettings

TURN_S = 0.2
STEP = Reason.of(Why.MEASURING, "step 3")
LENGTHS = "/cell/tracer_length"


class Cell:
    """A goal that measures, the nodes and streams around it, and what people are shown."""

    def __init__(self, monkeypatch):
        self.now_s, self.slow, self.values, self.publishers = 100.0, {}, {}, ["tracer"]
        self.shown, self.logged, self.told = [], [], []
        self.script, self.published_anew = {}, []
        health = SimpleNamespace(
            slow=self.slow, lost={}, settings=HealthSettings(lost_after_s=30.0), concerns={},
            alarms={}, others={}, missing=lambda _: [],
            sim=SimpleNamespace(is_settled=lambda: True), state=lambda _: State.RECORDING,
            values=lambda _: self.values,
        )  # fmt: skip
        logger = SimpleNamespace(warning=self.logged.append)
        links = SimpleNamespace(
            health=health, node=SimpleNamespace(get_logger=lambda: logger),
            instrument=lambda role: f"/cell/{role}",
            graph=SimpleNamespace(publishers=lambda _: self.publishers),
            idle_nodes=lambda but=(): [], offered=lambda _: {},
            warn=self.warn, publish_anew=lambda: self.published_anew.append(self.now_s - 100.0),
        )  # fmt: skip
        required = RequiredNodes(health, 0.0)
        required.nodes = {"capture", "recorder"}
        self.watch = GoalWatch(
            PlannerSettings(), links, SimpleNamespace(check_stop=lambda: "", latched=""),
            SimpleNamespace(waiting=False), GoalProgress(60, doing=STEP),
            lambda progress: self.shown.append(progress.doing.describe()), lambda: False, required,
            15.0, preflight=False, recording=True,
        )  # fmt: skip

        def patience(seconds):
            return machine_load.WaitBudget(seconds, lambda: 1.0, lambda: self.now_s)

        for module in (cell_node, goal_watch):
            monkeypatch.setattr(module, "WaitBudget", patience)
        monkeypatch.setattr(goal_watch.time, "monotonic", lambda: self.now_s)
        monkeypatch.setattr(cell_node, "_next_turn", self.turn)

    def warn(self, key, texts):
        self.told += [(self.now_s - 100.0, text) for text in texts if key == PREFLIGHT_WAITS]

    async def turn(self):
        self.now_s += TURN_S
        self.watch.links.health.others["capture"] = object()  # a beat
        for since_s in [s for s in self.script if self.now_s - 100.0 >= s]:
            self.script.pop(since_s)()

    def waited(self, timeout_s, condition=lambda: False):
        """Return whether the condition came, and after how many seconds the goal went on."""
        begin_s = self.now_s
        came = asyncio.run(self.watch.wait(condition, timeout_s))
        return came, self.now_s - begin_s


@pytest.fixture
def cell(monkeypatch):
    return Cell(monkeypatch)


def test_a_time_out_stands_while_a_node_of_the_crew_is_slow(cell):
    cell.script = {2.0: lambda: cell.slow.update(capture=1.6), 12.0: cell.slow.clear}
    came, seconds = cell.waited(5.0)
    assert not came
    assert seconds == pytest.approx(15.0, abs=0.7)


def test_who_is_not_of_the_crew_may_be_slow(cell):
    cell.slow["operator_page"] = 9.0
    assert cell.waited(5.0)[1] == pytest.approx(5.0, abs=0.5)
    assert not cell.logged


def test_people_are_told_once_and_see_what_is_done_again_afterwards(cell):
    cell.script = {1.0: lambda: cell.slow.update(capture=1.6), 2.0: cell.slow.clear,
                   3.0: lambda: cell.slow.update(recorder=1.7), 4.0: cell.slow.clear}  # fmt: skip
    cell.waited(5.0)
    assert len(cell.logged) == 1
    assert "waiting for capture (1.6 s): slow, not lost; load " in cell.logged[0]
    words = [text.partition(" (")[0] for text in cell.shown]
    assert words == ["waiting for capture", "step 3", "waiting for recorder", "step 3"]


def test_the_next_order_waits_until_all_answer(cell):
    cell.slow["recorder"] = 2.0
    cell.script = {8.0: cell.slow.clear}
    asyncio.run(cell.watch.wait_for_slow_nodes())
    assert cell.now_s - 100.0 == pytest.approx(8.0, abs=0.5)


@pytest.mark.parametrize(("joined_s", "anew"), [(3.0, []), (60.0, [goal_watch.FOUND_S])])
def test_who_has_not_been_found_for_long_is_published_anew_once(cell, joined_s, anew):
    def missing():
        return [] if cell.now_s - 100.0 >= joined_s else ["node capture cannot be heard yet"]

    assert asyncio.run(cell.watch.wait_until_found(missing)) == (not anew)
    assert cell.published_anew == pytest.approx(anew, abs=2 * TURN_S)


def test_a_preflight_tells_what_it_lacks_as_soon_as_it_has_lasted(cell, monkeypatch):
    """On a machine that is ten times too busy, too; what comes in time is not told."""
    monkeypatch.setattr(goal_watch, "load_scaled_timeout", lambda seconds: 10.0 * seconds)
    two = "2 publishers on /cell/joint_states"

    def missing():
        late = ["node solver does not beat"] if cell.now_s < 102.0 else []
        return [*late, two] if cell.now_s < 112.0 else ["no message of C"]

    with pytest.raises(GoalError, match="no message of C"):
        asyncio.run(cell.watch.have(missing, Codes.TOPIC_MISSING))
    (first_s, first), (second_s, second) = cell.told
    assert first == f"the preflight waits up to 150 s: {two}"
    assert "no message of C" in second
    assert (first_s, second_s) == pytest.approx((3.0, 15.0), abs=2 * TURN_S)


def test_what_is_waited_for_in_vain_ends_the_goal_at_once_with_the_reason(cell):
    refused = []
    cell.script = {2.0: lambda: refused.append("node capture refuses the plan: no method")}
    with pytest.raises(GoalError, match=r"^node capture refuses the plan: no method$") as raised:
        asyncio.run(cell.watch.have(lambda: ["the plan"], Codes.NODE_LOST, lambda: refused))
    assert raised.value.code == Codes.NODE_LOST
    assert cell.now_s - 100.0 == pytest.approx(2.0, abs=0.5)


def test_what_is_missing_for_too_long_is_named(cell):
    with pytest.raises(GoalError, match=r"^the plan$"):
        asyncio.run(cell.watch.have(lambda: ["the plan"], Codes.NODE_LOST))
    assert cell.now_s - 100.0 == pytest.approx(cell.watch.patience_s, abs=1.0)


def test_who_publishes_is_known_when_nobody_new_has_been_found_for_a_while(cell):
    cell.script = {0.3: lambda: cell.publishers.append("second tracer")}
    asyncio.run(cell.watch.wait_until_stable(lambda: [*cell.publishers]))
    assert cell.now_s - 100.0 == pytest.approx(0.3 + goal_watch.SETTLED_S, abs=3 * TURN_S)


def test_a_graph_that_never_stands_still_holds_no_goal_up_for_ever(cell):
    asyncio.run(cell.watch.wait_until_stable(lambda: cell.now_s))
    assert cell.now_s - 100.0 == pytest.approx(cell.watch.patience_s, abs=1.0)


def test_an_instrument_that_is_silent_and_there_is_waited_for(cell):
    cell.values = {f"{SILENT}tracer_length": "2.50"}
    cell.script = {6.0: cell.values.clear}
    assert cell.waited(3.0)[1] == pytest.approx(9.0, abs=0.7)
    assert f"waiting for {LENGTHS} (2.5 s)" in cell.logged[0]


@pytest.mark.parametrize(("publishers", "silent_s"), [([], "2.50"), (["tracer"], "30.50")])
def test_one_that_nobody_publishes_or_that_was_silent_for_too_long_is_lost(
    cell, publishers, silent_s
):
    cell.publishers, cell.values = publishers, {f"{SILENT}tracer_length": silent_s}
    with pytest.raises(GoalError, match=f"{LENGTHS} .* has been silent for") as raised:
        cell.waited(math.inf)
    assert raised.value.code == Codes.NODE_LOST


def test_what_looks_hopeless_for_a_moment_ends_nothing(cell):
    cell.script = {1.0: lambda: cell.values.update({HOPELESS: "no velocity"}),
                   1.3: cell.values.clear}  # fmt: skip
    assert cell.waited(5.0)[1] == pytest.approx(5.0, abs=0.5)
    cell.values[HOPELESS] = "no velocity"
    with pytest.raises(GoalError, match="nothing can be measured: no velocity"):
        cell.waited(math.inf)


def test_the_graph_is_looked_at_ten_times_a_second_however_many_turns_there_are(monkeypatch):
    now_s, looks = 100.0, []
    monkeypatch.setattr(goal_watch, "time", SimpleNamespace(monotonic=lambda: now_s))
    found = goal_watch._rarely(lambda: bool(looks.append(now_s) or now_s > 100.25))
    answers = []
    for turn in range(16):
        now_s = 100.0 + 0.03 * turn
        answers.append(found())
    assert looks == pytest.approx([100.0, 100.12, 100.24, 100.36])
    assert answers == [False] * 12 + [True] * 4
