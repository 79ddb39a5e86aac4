"""The bridge over DDS before a controller over OPC UA: a real server, killed while it writes."""

import json

import pytest
from test_bridge import Bench, table

pytest.importorskip("asyncua")
import opcua_bench

pytestmark = pytest.mark.ros

CSV = "c_csv.csv"


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    with opcua_bench.serving(tmp_path_factory.mktemp("opcua")) as server:
        yield server


@pytest.fixture
def bench(cell, tmp_path):
    made = Bench(cell, tmp_path)
    yield made
    made.end()


def written(bench, made):
    """Publish a table and return the file that the bridge writes for it."""
    bench.publish(made)
    bench.wait(lambda: bench.status.get("table_hash") == made.table_hash, "the table")
    bench.wait(lambda: "confirmation" in bench.status, "its files")
    folder = bench.controller.parent / "output" / f"c-{bench.status['confirmation']}"
    return (folder / CSV).read_text()


def actions(bench):
    lines = (bench.controller / ".rotcal" / "journal.jsonl").read_text().splitlines()
    return [json.loads(line)["action"] for line in lines]


@pytest.mark.slow
def test_a_table_goes_over_comes_back_and_is_never_half(bench, server):
    from rotcal_msgs.msg import TableInForce

    from rotcal_ros.nodes.runtime.qos import LATCHED

    heard = []
    bench.node.create_subscription(
        TableInForce, "table_in_force", lambda m: heard.append(m.in_force), LATCHED
    )
    bench.start(
        controller="csv", transport="opcua", opcua=server.settings(), answer_timeout_s=20.0
    )
    first = written(bench, table())
    assert server.files() == {}
    answer = bench.apply()
    assert answer.success, answer.message
    assert server.files() == {CSV: first}
    assert answer.files[0].endswith(f"2:Machine/FileSystem/{CSV}")
    assert bench.restore().success
    assert server.files() == {}

    old = written(bench, table(0.5))
    assert bench.apply().success
    bench.wait(lambda: len((heard or [""])[-1]) == 64, "a hash in force")

    new = written(bench, table(1.5))
    server.fail(0, "kill", "before", "Write")
    answer = bench.apply()
    assert not answer.success
    assert "it is not known what the controller holds" in answer.message
    held = server.files()
    assert held.get(CSV) in (None, old, new)  # what a controller would load
    assert sorted(held) != [CSV]  # the half that was written is under another name
    assert actions(bench)[-1] == "applying"
    bench.wait(lambda: heard[-1] == "unknown", "that it is not known")

    server.start()
    refused = bench.apply()
    assert not refused.success
    assert "was never finished" in refused.message
    bench.wait(lambda: "was never finished" in bench.status.get("unfinished", ""), "a warning")
    answer = bench.restore()
    assert answer.success, answer.message
    assert server.files()[CSV] == old
    assert actions(bench) == [
        "applying", "applied", "restoring", "restored", "applying", "applied",
        "applying", "restoring", "restored",
    ]  # fmt: skip
    bench.wait(lambda: "unfinished" not in bench.status, "no warning any more")
