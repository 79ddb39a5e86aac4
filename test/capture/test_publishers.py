"""Who is heard, on a clock of the test: (topic, publisher, number) in, counted or left alone."""

import pytest

from rotcal_ros.capture.publishers import (
    MOST_MISSED,
    PATIENCE_S,
    HeardPublishers,
    Intruder,
    MessageOrigin,
    PendingPlans,
    PlanOwner,
    PublisherFilter,
    PublisherList,
    publisher_of,
    restarted_nodes,
)

POINTS, LENGTHS = "/cell/probe_point", "/cell/tracer_length"
OURS, STRAY, THIRD = "0a" * 16, "0b" * 16, "0c" * 16


def judge(**publishers):
    heard = PublisherFilter()
    topics = {"points": POINTS, "lengths": LENGTHS}
    heard.accept(PublisherList({topics[name]: gids for name, gids in publishers.items()}))
    return heard


@pytest.mark.parametrize(
    ("accepted", "events", "expected"),
    [
        # a second probe joins in the middle, between the points of the first one
        ((OURS,), [(OURS, 5), (STRAY, 1), (OURS, 6), (STRAY, 2)], [True, False, True, False]),
        # it is alone: still not the one with whom the run began
        ((OURS,), [(STRAY, 1), (STRAY, 2)], [False, False]),
        # several sensors were there from the beginning
        ((OURS, THIRD), [(OURS, 1), (THIRD, 1), (STRAY, 1)], [True, True, False]),
        # nobody was there: whoever comes is welcome
        ((), [(STRAY, 1)], [True]),
        # no identities: who began later counts from 1 anew
        ((OURS,), [("", 90), ("", 91), ("", 1), ("", 93)], [True, True, False, True]),
        # nor does anybody count as far ahead
        ((OURS,), [("", 90), ("", 91 + MOST_MISSED), ("", 91)], [True, False, True]),
        # a middleware that says nothing at all hides everybody
        ((OURS,), [("", None), ("", None)], [True, True]),
    ],
)  # fmt: skip
def test_a_run_hears_those_with_whom_it_began(accepted, events, expected):
    heard = judge(points=accepted)
    assert [heard.accepts(POINTS, MessageOrigin(*event)) for event in events] == expected
    assert bool(heard.intruders) == (False in expected)


@pytest.mark.parametrize(
    ("origins", "count"),
    [
        ([(OURS, 1), (STRAY, 1), (OURS, 2)], 2),
        ([("", 90), ("", 91), ("", 95)], 1),  # some are lost
        ([("", 90), ("", 3), ("", 91), ("", 4)], 2),
        ([("", 5), ("", 5), ("", 6), ("", 6)], 2),  # started together
        ([("", 90), ("", 3), ("", 50), ("", 91), ("", 4), ("", 51)], 3),
        ([("", 1), ("", 2 + MOST_MISSED)], 2),
        ([("", None), ("", None)], 1),  # nothing tells them apart
        ([], 0),
    ],
)
def test_publishers_are_counted_with_identities_and_without(origins, count):
    heard = HeardPublishers()
    for origin in origins:
        heard.receive(MessageOrigin(*origin))
    assert len(heard) == count


def test_topics_are_judged_each_for_itself():
    heard = judge(points=(OURS,), lengths=(THIRD,))
    assert not heard.accepts(LENGTHS, MessageOrigin(OURS, 1))
    assert heard.accepts(POINTS, MessageOrigin(OURS, 1))
    assert heard.accepts("/cell/heartbeat", MessageOrigin(STRAY, 1))


def test_an_intruder_is_named_with_its_topic_and_what_to_do():
    heard = judge(points=(OURS,))
    for publisher in (THIRD, STRAY, THIRD):
        heard.accepts(POINTS, MessageOrigin(publisher, 1))
    first, second = heard.intruders
    assert (first.publisher, second) == (THIRD, Intruder(POINTS, STRAY))
    text = second.describe("second_probe")
    assert "/cell/probe_point: node second_probe publishes there too" in text
    assert "are ignored" in text
    assert "a node that is gone" in second.describe(None)


def test_an_instrument_that_was_started_anew_is_not_told_to_go_away():
    text = Intruder(POINTS, STRAY).describe("probe", anew=True)
    assert "/cell/probe_point: node probe was restarted" in text
    assert "ignored until another run begins" in text
    assert "end that node" not in text


@pytest.mark.parametrize(
    ("now", "anew"),
    [
        ({OURS: "/cell/probe"}, {}),
        ({}, {}),  # gone, and not back
        ({OURS: "/cell/probe", STRAY: "/cell/probe"}, {}),  # nobody knows yet that it is gone
        ({STRAY: "/cell/probe"}, {"/cell/probe": [POINTS]}),
        ({STRAY: "/cell/probe", THIRD: "/x"}, {"/cell/probe": [POINTS]}),
        ({STRAY: "/other/probe"}, {}),
    ],
)
def test_who_was_started_anew_during_a_run(now, anew):
    assert restarted_nodes({POINTS: {OURS: "/cell/probe"}}, {POINTS: now}) == anew


def test_a_topic_that_nobody_publishes_any_more_has_nobody_who_was_started_anew():
    assert restarted_nodes({POINTS: {OURS: "/cell/probe"}, LENGTHS: {THIRD: "/x"}}, {}) == {}


def test_the_next_run_begins_without_intruders_and_the_same_words_change_nothing():
    heard = judge(points=(OURS,))
    heard.accepts(POINTS, MessageOrigin(STRAY, 1))
    heard.accept(PublisherList({POINTS: (OURS,)}))
    assert len(heard.intruders) == 1
    heard.accept(PublisherList({POINTS: (STRAY,)}))
    assert not heard.intruders
    assert heard.accepts(POINTS, MessageOrigin(STRAY, 2))
    heard.accept(PublisherList())
    assert heard.accepts(POINTS, MessageOrigin(OURS, 1))


def test_all_listeners_read_the_same_words():
    accepted = PublisherList({POINTS: (OURS, THIRD), LENGTHS: (STRAY,)})
    assert PublisherList.read(accepted.to_heartbeat()) == accepted
    turned = PublisherList({LENGTHS: (STRAY,), POINTS: (OURS, THIRD)})
    assert turned.to_heartbeat() == accepted.to_heartbeat()
    assert PublisherList().to_heartbeat() == ""
    for torn in ("", "{", "[]", "3", '{"a": 3}'):
        assert PublisherList.read(torn) == PublisherList()


def test_an_identity_is_the_same_in_the_graph_and_in_a_message():
    assert publisher_of(bytes(range(16))) == publisher_of([*range(16), *([0] * 8)])


BEATS = {0: None, 5: "", 20: "first", 30: "second", 40: "", 60: "third", 70: ""}
"""From which second on the planner's beat says which run; the goal of 20 s loses a node once.

A listener that starts knows no planner, from 5 s on a planner that prepares a goal.
"""
ENDS_S = 80
FREE, OURS_TOO, NOT_OURS = PlanOwner.NO_GOAL, PlanOwner.RUNNING_GOAL, PlanOwner.OTHER_PLANNER


def heard_in(offers, beats=BEATS, tick_s=0.2):
    """Return plan -> (whose it is, s that this took), by a clock of the test."""
    heard, found, offers = PendingPlans(), {}, dict(offers)
    goals_run, came = None, dict(offers)
    for tick in range(int(ENDS_S / tick_s)):
        now = tick * tick_s
        for at in [at for at in beats if at <= now]:
            goals_run = beats[at]
        for plan in [plan for plan, at in offers.items() if at <= now]:
            heard.offer(plan, plan, offers.pop(plan))
        for plan, whose in heard.with_known_owner(goals_run, now):
            assert plan not in found
            found[plan] = whose, round(now - came[plan], 1)
    return found


@pytest.mark.parametrize(
    ("at_s", "whose", "after_s"),
    [
        (0.0, FREE, PATIENCE_S),  # nobody knows a planner: perhaps there is none
        (4.0, FREE, 1.0),  # a planner without a goal is heard of
        (10.0, FREE, 0.0),  # it prepares a goal, which has no plan yet
        (19.0, FREE, 0.0),
        (20.0, NOT_OURS, PATIENCE_S),  # with the plan of the goal
        (25.0, NOT_OURS, PATIENCE_S),  # between two steps
        (29.0, NOT_OURS, PATIENCE_S),  # the goal goes on with another run meanwhile
        (35.0, NOT_OURS, PATIENCE_S),
        (39.0, NOT_OURS, PATIENCE_S),  # the goal ends while it waits
        (39.8, NOT_OURS, PATIENCE_S),
        (40.0, FREE, 0.0),  # behind the goal
        (59.0, FREE, 0.0),
        (65.0, NOT_OURS, PATIENCE_S),  # in the next goal
        (75.0, FREE, 0.0),
    ],
)
def test_what_a_stranger_announces_at_any_moment_of_a_goal(at_s, whose, after_s):
    ours = {"first": 20.0, "second": 30.0, "third": 60.0}
    found = heard_in({"stranger": at_s, **ours})
    judged, took_s = found.pop("stranger")
    assert judged is whose
    assert took_s == pytest.approx(after_s, abs=0.41)  # it is looked every 0.2 s
    assert found == dict.fromkeys(ours, (OURS_TOO, 0.0))


@pytest.mark.parametrize("late_s", [0.0, 0.6, 1.8])
def test_the_plan_of_another_run_may_come_before_the_beat_that_vouches_for_it(late_s):
    found = heard_in({"first": 20.0, "second": 30.0 - late_s, "third": 60.0})
    assert found["second"] == (OURS_TOO, pytest.approx(late_s))


def test_a_planner_that_is_gone_has_no_goal_any_more():
    beats = {0: "", 20: "first", 30: ""}  # its listener says so when it has lost it
    assert heard_in({"stranger": 31.0}, beats) == {"stranger": (FREE, 0.0)}
    assert heard_in({"stranger": 29.0}, beats)["stranger"][0] is NOT_OURS


def test_the_same_plan_again_is_judged_once_while_it_waits():
    heard = PendingPlans()
    for now in (0.0, 0.5, 1.0):
        heard.offer("stranger", "plan", now)
        assert list(heard.with_known_owner("ours", now)) == []
    assert list(heard.with_known_owner("ours", PATIENCE_S + 0.1)) == [("plan", NOT_OURS)]
    assert list(heard.with_known_owner("ours", 9.0)) == []
