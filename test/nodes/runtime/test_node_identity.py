"""A name can be taken twice: the first holder keeps it, and a stranger's farewell says nothing."""

from types import SimpleNamespace

import pytest

from rotcal_ros.nodes.runtime.liveness import (
    NameHolders,
    OtherSessionError,
    ProcessIdentity,
    SecondNodeError,
    require_own_session,
)

FIRST = ProcessIdentity("one", "a", -100.0)
SECOND = ProcessIdentity("two", "b", -50.0)


def held(*beats):
    """Return which of the beats (identity, s) are those of the node."""
    holders = NameHolders()
    return [holders.is_holder("capture", who, s) for who, s in beats]


def beat_of(identity, now_s):
    """Return who sent it, as a beat states it."""
    age_ns = identity.age_ns(now_s)
    return SimpleNamespace(session=identity.session, process=identity.process, age=age_ns)


def test_an_identity_goes_through_a_beat_by_its_age():
    heard = ProcessIdentity.of(beat_of(FIRST, 7.0), 1007.0)  # another machine's monotonic clock
    assert heard == ProcessIdentity("one", "a", pytest.approx(900.0))


def test_processes_of_a_session_are_as_old_as_it_and_never_equal():
    session = {"ROTCAL_SESSION": "5000000000-77"}
    one, other = (ProcessIdentity.own(session, 100.0) for _ in range(2))
    assert one.born_s == other.born_s == 5.0
    assert one.session == other.session
    assert one.is_older(other) != other.is_older(one)
    alone = ProcessIdentity.own({}, 100.0)
    assert one.is_older(alone)
    assert not alone.is_older(one)
    for strange in ("?", "1e9-3", f"{10**15}-3"):
        assert ProcessIdentity.own({"ROTCAL_SESSION": strange}, 100.0).born_s == 100.0


@pytest.mark.parametrize("first_heard", [FIRST, SECOND])
def test_the_older_one_is_the_node_whoever_is_heard_first(first_heard):
    beats = [(first_heard, 0.0)]
    beats += [((FIRST, SECOND)[n % 2], 0.1 + 0.1 * n) for n in range(8)]
    assert held(*beats)[1:] == [True, False] * 4


def test_a_silent_holder_gives_its_name_to_the_one_that_beats():
    beats = ((FIRST, 0.0), (SECOND, 0.6), (SECOND, 0.8), (SECOND, 1.0))
    assert held(*beats) == [True, False, True, True]


def test_only_the_farewell_of_the_holder_counts():
    holders = NameHolders()
    holders.is_holder("capture", FIRST, 0.0)
    assert not holders.leave("capture", SECOND)
    assert holders.leave("capture", FIRST)
    assert holders.is_holder("capture", SECOND, 0.2)
    assert holders.leave("never heard", SECOND)


def test_the_younger_of_two_ends_with_a_sentence():
    text = str(SecondNodeError("capture", "/cell", "7"))
    assert "node capture already runs in /cell of ROS domain 7" in text
    assert "another ROS_DOMAIN_ID" in text
    assert "ROS domain 0" in str(SecondNodeError("capture", "/cell", ""))


class Heard:
    """Beats of the planner alone."""

    def __init__(self, identity):
        self.others = {"planner": beat_of(identity, 0.0)}

    def describe(self, _name):
        return "calibrating: step 3 of 60"


def test_a_session_hears_that_the_cell_is_of_another_one():
    mine = {"ROTCAL_SESSION": "two"}
    with pytest.raises(OtherSessionError, match="planner: calibrating: step 3"):
        require_own_session(Heard(FIRST), mine)
    require_own_session(Heard(SECOND), mine)
    require_own_session(Heard(FIRST), {})
