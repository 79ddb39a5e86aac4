"""A stranger's plan in a bag says nothing about its measurement."""

from pathlib import Path

import pytest
from bag_samples import CONFIGURATION, START_NS, STORE, encode, open_writer, serialised
from coded import coded

from rotcal_ros.bags import names
from rotcal_ros.capture.publishers import RUN
from rotcal_ros.foundation.errors import BagError
from rotcal_ros.nodes.player.replayed_bag import ReplayedBag
from rotcal_ros.recordings.replay import STRANGERS_PLANS, read_recording

OTHER = CONFIGURATION.replace("window_samples: 30", "window_samples: 20")
OURS, THEIRS = f"ours@{START_NS + 1}", f"theirs@{START_NS + 2}"
BEATS = {"before": "diagnostic_msgs/msg/DiagnosticStatus", "now": "rotcal_msgs/msg/NodeState"}


def plan(name, configuration, stamp_ns):
    return serialised(
        "rotcal_msgs/msg/CalibrationPlan", stamp_ns=stamp_ns, plan_id=name, method="",
        configuration=configuration, total_steps=32, start_index=0, run=0,
    )  # fmt: skip


def beat(node, run, form):
    values = [STORE.types["diagnostic_msgs/msg/KeyValue"](RUN, run)]
    if form == "before":
        return serialised(
            BEATS[form], level=0, name=node, message="", hardware_id="", values=values
        )
    return serialised(
        BEATS[form], stamp_ns=START_NS, node=node, session="", process="", age=0, host="", pid=1,
        start=0, busy=0.0, state=8, level=0, step=0, total=0, reasons=[], page="", values=values,
    )  # fmt: skip


def write(folder, run, *, first, attachment=CONFIGURATION, beats=(("planner", OURS),), form="now"):
    """Write a bag with our plan and a stranger's, which comes ``first`` or last."""
    writer, channels = open_writer(folder, configuration=attachment)
    with writer:
        kind = BEATS[form]
        beating = writer.channel("/cell/heartbeat", kind, STORE.generate_msgdef(kind)[0])
        plans = [plan("ours", CONFIGURATION, START_NS + 1), plan("theirs", OTHER, START_NS + 2)]
        for data in reversed(plans) if first else plans:
            writer.write(channels[names.PLAN], data, START_NS, START_NS)
        for said in beats:
            writer.write(beating, beat(*said, form), START_NS, START_NS)
        for number, record in enumerate(run.records):
            for role, data in encode(record):
                writer.write(channels[role], data, START_NS + number * 1_000_000, START_NS)
    if attachment != CONFIGURATION:  # recorded by others, without it
        file = folder / "bag_0.mcap"
        file.write_bytes(file.read_bytes().replace(b"configuration.yaml", b"configuration.yamX"))
    return folder


@pytest.mark.parametrize("form", BEATS)
@pytest.mark.parametrize("first", [True, False], ids=["stray first", "stray last"])
@pytest.mark.parametrize("attachment", [CONFIGURATION, "x: 1"], ids=["attached", "only plans"])
def test_the_runs_own_plan_counts_by_its_identity(
    simulated_run, run_bag, tmp_path, form, first, attachment
):
    bag = write(tmp_path / "bag", simulated_run, first=first, attachment=attachment, form=form)
    file = bag / "bag_0.mcap"
    recording = read_recording(file)
    assert recording.configuration.text == CONFIGURATION
    assert recording.observations == read_recording(run_bag).observations
    assert recording.foreign_plans == 1
    assert coded(*recording.warnings())[STRANGERS_PLANS] == [(1, "plan")]
    replayed = ReplayedBag.read(file)
    assert (replayed.plan_id, replayed.configuration) == ("ours", CONFIGURATION)
    assert replayed.strangers == {THEIRS}


def test_without_beats_the_plan_that_the_recorder_was_given_counts(simulated_run, tmp_path):
    recording = read_recording(write(tmp_path / "bag", simulated_run, first=True, beats=()))
    assert (recording.configuration.text, recording.foreign_plans) == (CONFIGURATION, 1)


@pytest.mark.parametrize(
    "beats", [(), (("capture", THEIRS),), (("planner", OURS), ("planner", THEIRS))]
)
def test_what_no_planner_decides_is_asked(simulated_run, tmp_path, beats):
    bag = write(tmp_path / "bag", simulated_run, first=False, attachment="x: 1", beats=beats)
    with pytest.raises(BagError, match="holds 2 configurations that differ"):
        read_recording(bag / "bag_0.mcap")


def test_both_runs_of_an_interrupted_plan_are_the_planners():
    bag = ReplayedBag.read(Path(__file__).parents[1] / "golden" / "tracer" / "bag")
    assert bag.strangers == frozenset()
    assert bag.plan_id.startswith("d1aad1db")
