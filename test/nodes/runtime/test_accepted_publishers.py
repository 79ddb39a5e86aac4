"""What a node makes of the planner's word on who is accepted; the middleware is made up."""

from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy")

from rclpy.impl.implementation_singleton import rclpy_implementation

from rotcal_ros.capture.publishers import PublisherList
from rotcal_ros.nodes.runtime.accepted_publishers import (
    ACCEPTED,
    APART,
    HEARS,
    AcceptedPublishers,
    accepted_publishers_hash,
    message_publisher,
)
from rotcal_ros.nodes.runtime.beat_values import INTRUDER

POINTS, SENT = "/cell/probe_point", "/cell/observation"
OURS, STRAY = bytes(range(16)), bytes(range(16, 32))
RUN = PublisherList({POINTS: (OURS.hex(),)})


class Node:
    """A node whose planner says what the test wants."""

    def __init__(self):
        self.said = []
        self.beat({})
        self.there = [("probe", OURS), ("second_probe", STRAY)]
        self.joined, self.given_up = 1, False
        self.subscriptions = [SimpleNamespace(topic_name=POINTS, get_publisher_count=self.count)]
        self.publishers = [
            SimpleNamespace(topic_name=SENT, get_subscription_count=lambda: 3 * self.joined)
        ]

    def count(self):
        if self.given_up:
            raise rclpy_implementation.InvalidHandle
        return self.joined

    def resolve_topic_name(self, name):
        return f"/cell/{name}"

    def beat(self, values):
        told = {"planner": object()}
        self.health = SimpleNamespace(
            others=told, values=lambda name: values, concerns={}, alarms={}
        )

    def get_logger(self):
        return SimpleNamespace(warning=self.said.append)

    def get_publishers_info_by_topic(self, _topic):
        return [SimpleNamespace(node_name=n, endpoint_gid=[*g]) for n, g in self.there]


def info(gid, number=1):
    return {"publisher_gid": {"data": gid}, "publication_sequence_number": number}


def during_a_run(**options):
    node = Node()
    node.beat({ACCEPTED: RUN.to_heartbeat()})
    return node, AcceptedPublishers(node, **options)


def test_messages_of_somebody_else_are_split_off_named_once_and_shown():
    node, accepted = during_a_run()
    batch = [("a", info(OURS)), ("b", info(STRAY)), ("c", info(OURS, 2)), ("d", info(STRAY, 2))]
    ours, others = accepted.split(POINTS, batch)
    assert [message for message, _ in ours] == ["a", "c"]
    assert [message for message, _ in others] == ["b", "d"]
    assert len(node.said) == 1
    assert f"{POINTS}: node second_probe publishes there too" in node.said[0]
    assert node.health.concerns[INTRUDER] == node.said[0]
    assert accepted.values() == {HEARS: accepted_publishers_hash(RUN)}


def test_who_is_known_and_not_joined_yet_is_told_until_he_can_be_heard():
    node, accepted = during_a_run()
    node.joined = 0
    assert accepted.values() == {APART: f"{SENT}, {POINTS}"}
    node.joined = 1
    assert accepted.values() == {HEARS: accepted_publishers_hash(RUN)}
    node.joined = 0  # who leaves later is lost, which others report
    assert accepted.values() == {HEARS: accepted_publishers_hash(RUN)}
    node.beat({ACCEPTED: PublisherList({POINTS: (STRAY.hex(),)}).to_heartbeat()})
    assert accepted.values() == {APART: f"{SENT}, {POINTS}"}


def test_a_subscription_that_is_given_up_meanwhile_proves_nothing():
    node, accepted = during_a_run()
    node.given_up = True
    assert accepted.values() == {APART: ""}
    node.given_up = False
    assert accepted.values() == {HEARS: accepted_publishers_hash(RUN)}


@pytest.mark.parametrize(
    ("there", "anew"),
    [
        ([("probe", OURS), ("second_probe", STRAY)], False),
        ([("probe", OURS), ("probe", STRAY)], True),  # the graph has not forgotten the first yet
        ([("probe", STRAY)], True),
        ([("stand_in", STRAY)], True),
    ],
)
def test_a_node_that_was_started_anew_is_named_as_that(there, anew):
    node, accepted = during_a_run()
    node.there = there
    assert not accepted.accepts(POINTS, info(STRAY))
    assert f"node {there[-1][0]} " in node.said[0]
    assert ("restarted" in node.said[0]) == anew
    assert ("end that node" in node.said[0]) != anew


def test_without_a_run_everybody_is_heard():
    node, accepted = during_a_run()
    assert not accepted.accepts(POINTS, info(STRAY))
    node.beat({})
    assert accepted.accepts(POINTS, info(STRAY))
    assert INTRUDER not in node.health.concerns
    assert accepted.values() == {}


def test_the_planner_decides_for_itself_and_ends_it():
    node = Node()
    node.health.others.clear()
    accepted = AcceptedPublishers(node)
    accepted.decide(RUN)
    assert not accepted.accepts(POINTS, info(STRAY))
    accepted.decide(PublisherList())
    assert accepted.accepts(POINTS, info(STRAY))


def test_a_node_that_keeps_quiet_leaves_alone_all_the_same():
    node, accepted = during_a_run(quiet=True)
    assert not accepted.accepts(POINTS, info(STRAY))
    assert node.said == []
    assert node.health.concerns == {}


def test_somebody_who_left_before_he_could_be_named():
    node, accepted = during_a_run()
    node.there = []
    accepted.accepts(POINTS, info(STRAY))
    assert "a node that is gone publishes there too" in node.said[0]


def test_a_middleware_without_identities_has_numbers_at_most():
    assert message_publisher({"publisher_gid": None}).publisher == ""
    assert message_publisher({"publication_sequence_number": 7}).number == 7
    assert message_publisher(info(OURS, 3)).publisher == OURS.hex()
