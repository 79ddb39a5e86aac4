"""Our bags as Foxglove reads them: @mcap/core and @foxglove/rosmsg2-serialization."""

import pytest
from bag_readers import on_node_js
from bag_samples import simulate, write_run, writer_settings

from rotcal_ros.bags.interrupted_files import find_unclosed_end
from rotcal_ros.bags.reader import check_files
from rotcal_ros.foundation.observations import ProbeSample, TableSample, TracerSample


def stamp_ns(value):
    stamp = value["header"]["stamp"]
    return stamp["sec"] * 10**9 + stamp["nanosec"]


@pytest.mark.slow
def test_every_message_is_read_with_the_same_values(tmp_path):
    run = simulate()
    counts = write_run(tmp_path / "bag", run, writer_settings(chunk_bytes=20_000))
    found = on_node_js(tmp_path / "bag" / "bag_0.mcap")
    assert {topic: len(values) for topic, values in found.items()} == {
        topic: count for topic, count in counts.items() if count
    }
    tracer = [r for r in run.records if isinstance(r, TracerSample)]
    assert [(stamp_ns(v), v["sequence"], v["length"]) for v in found["/cell/tracer_length"]] == [
        (r.stamp_ns, r.sequence, r.length) for r in tracer
    ]
    table = [r for r in run.records if isinstance(r, TableSample)]
    assert [(v["name"], v["position"]) for v in found["/cell/joint_states"]] == [
        (["table"], [r.angle]) for r in table
    ]
    probe = [r for r in run.records if isinstance(r, ProbeSample)]
    assert [(v["step"], v["position"]) for v in found["/cell/probe_point"]] == [
        (r.step, list(r.position)) for r in probe
    ]
    assert [(v["step"], v["mean"], v["accepted"]) for v in found["/cell/observation"]] == [
        (o.step, list(o.mean), o.accepted) for o in run.observations
    ]


@pytest.mark.slow
def test_a_file_closed_after_an_interruption_is_read_like_any(run_bag, tmp_path):
    data = (run_bag / "run_0.mcap").read_bytes()
    path = tmp_path / "killed_0.mcap"
    path.write_bytes(data[: len(data) // 2])
    (verdict,) = check_files((path,))
    end = find_unclosed_end(verdict)
    end.close("killed_1.mcap")
    found = on_node_js(path)
    assert {topic: len(values) for topic, values in found.items()} == {
        name: topic.messages for name, topic in verdict.topics.items() if topic.messages
    }
