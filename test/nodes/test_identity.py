"""A name can be taken twice: the first holder keeps it, and a stranger's farewell says nothing."""

import pytest

from rotcal_ros.nodes.identity import Identity, NameHolders, other_session, refusal

FIRST = Identity(100, "1", 101, "a")
SECOND = Identity(200, "2", 201, "b")


def held(*beats):
    """Return which of the beats (identity or text, s) are those of the node."""
    holders = NameHolders()
    return [holders.is_holder("capture", str(who), now_s) for who, now_s in beats]


def test_an_identity_goes_through_a_beat():
    assert Identity.read(str(FIRST)) == FIRST
    for text in ("", "1 2 3", "x 1 2 b", "1 2 y b"):
        assert Identity.read(text) is None


def test_processes_of_a_session_are_as_old_as_it_and_never_equal():
    session = {"ROTCAL_SESSION": "5-77"}
    one, other = Identity.own(session), Identity.own(session)
    assert one.session_ns == other.session_ns == 5
    assert one.session == other.session
    assert one != other
    assert one < Identity.own({})
    assert Identity.own({"ROTCAL_SESSION": "?"}).session_ns > 5


@pytest.mark.parametrize("first_heard", [FIRST, SECOND])
def test_the_older_one_is_the_node_whoever_is_heard_first(first_heard):
    beats = [(first_heard, 0.0), *((who, 0.1 + 0.1 * n) for n, who in
             zip(range(8), [FIRST, SECOND] * 4, strict=True))]  # fmt: skip
    assert held(*beats)[1:] == [True, False] * 4


def test_a_silent_holder_gives_its_name_to_the_one_that_beats():
    assert held((FIRST, 0.0), (SECOND, 0.6), (SECOND, 0.8), (SECOND, 1.0)) == [
        True, False, True, True,
    ]  # fmt: skip


def test_nodes_without_an_identity_are_known_by_their_name_alone():
    assert held(("", 0.0), ("", 0.2), (FIRST, 0.3), ("", 0.4)) == [True, True, True, False]


def test_only_the_farewell_of_the_holder_counts():
    holders = NameHolders()
    holders.is_holder("capture", str(FIRST), 0.0)
    assert not holders.leave("capture", str(SECOND))
    assert not holders.leave("capture", "")
    assert holders.leave("capture", str(FIRST))
    assert holders.is_holder("capture", str(SECOND), 0.1)
    assert holders.leave("never heard", str(SECOND))


def test_the_younger_of_two_ends_with_a_sentence():
    where = {"ROS_DOMAIN_ID": "7"}
    text = refusal("capture", "/cell", SECOND, str(FIRST), where)
    assert "node capture runs already in /cell of ROS domain 7" in text
    assert "another ROS_DOMAIN_ID" in text
    assert refusal("capture", "/cell", FIRST, str(SECOND), where) == ""
    assert refusal("capture", "/cell", FIRST, str(FIRST), where) == ""
    assert refusal("capture", "/cell", SECOND, "", where) == ""


class Heard:
    """Beats of the planner alone."""

    def __init__(self, identity):
        self._identity = identity

    def values(self, name):
        return {"identity": str(self._identity)} if name == "planner" else {}

    def state(self, _name):
        return "calibrating: step 3 of 60"


def test_a_session_hears_that_the_cell_is_of_another_one():
    mine = {"ROTCAL_SESSION": f"{SECOND.session_ns}-{SECOND.session}"}
    assert "planner: calibrating: step 3" in other_session(Heard(FIRST), mine)
    assert other_session(Heard(SECOND), mine) == ""
    assert other_session(Heard(FIRST), {}) == ""
