"""Which topics play which role: names that the nodes report and the recorder notes."""

from rotcal_ros.bags import names
from rotcal_ros.bags.topic_roles import TopicRoleFinder


def test_roles_of_topics_follow_what_the_nodes_tell():
    called = TopicRoleFinder("/cell")
    told = {"capture": {"topic.tracer_length": "/leica/length", "run": ""}, "planner": {"run": ""}}
    called.poll(lambda node: told.get(node, {}))
    assert called.role("/leica/length") == names.TRACER_LENGTH
    assert called.role("/cell/tracer_length") == ""
    assert called.role("/cell/joint_states") == called.role("/x/joint_states") == "joint_states"
    assert called.lost({"lost /leica/length": 3, "queue /cell/tracer_length": 5}) == 3
    called.poll(lambda _: {})  # the nodes left: what they said stays
    assert called.topic(names.TRACER_LENGTH) == "/leica/length"
    called.poll(lambda node: {"run": ""})
    assert called.topic(names.TRACER_LENGTH) == "/cell/tracer_length"
