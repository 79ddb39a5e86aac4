"""Commanded and actual angles of a bag at rest become a table, and that becomes deviations."""

import sys
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

sys.path.append(str(Path(__file__).parents[3] / "test" / "bags"))
from bag_samples import START_NS, STORE, serialised
from other_messages import write_messages

from rotcal_ros.bags.settings import WriterSettings
from rotcal_ros.bags.writer import BagWriter
from rotcal_ros.foundation.units import ARCSEC, DEGREE
from rotcal_ros.recordings.inputs import MeasurementInput
from rotcal_tables.pair_verb import command

N = 4096
COMMANDED = np.arange(0.0, 360.0, 30.0)
TRUTH = 300.0 * np.sin(np.deg2rad(COMMANDED) + 1.0) - 400.0
"""Deviations, arcsec: at 0 the encoder has not come to its zero, and there it wraps."""
RATE, STANDS_S, MOVES_S = 100, 2.0, 0.5
NOISE = 80.0
"""arcsec, about a quarter of a count: at some rests two counts are seen."""


def motion():
    """Yield time (s), commanded angle (deg), and the actual one in counts, as it wraps."""
    rng, t = np.random.default_rng(7), 0.0
    for k, angle in enumerate(COMMANDED):
        for n in range(int(RATE * (MOVES_S + STANDS_S))):
            share = min(n / RATE / MOVES_S, 1.0) if k else 1.0
            ordered = angle - 30.0 * (1.0 - share)
            actual = ordered + (TRUTH[k] + rng.normal(0.0, NOISE)) / 3600.0
            yield t, ordered, int(np.rint(actual / 360.0 * N)) % N
            t += 1.0 / RATE


def ros_bag(folder):
    kinds = {
        "/drive/reference": "std_msgs/msg/Float64",
        "/joint_states": "sensor_msgs/msg/JointState",
    }
    with BagWriter(folder, WriterSettings(min_free_bytes=0)) as writer:
        channels = {
            topic: writer.channel(topic, kind, STORE.generate_msgdef(kind, ros_version=2)[0])
            for topic, kind in kinds.items()
        }
        for t, ordered, counts in motion():
            at, none = START_NS + round(t * 1e9), np.zeros(0)
            data = serialised(kinds["/drive/reference"], data=ordered)
            writer.write(channels["/drive/reference"], data, at, at)
            places = np.array([0.5, float(counts)])
            data = serialised(
                kinds["/joint_states"], stamp_ns=at, name=["tilt", "table"], position=places,
                velocity=none, effort=none,
            )  # fmt: skip
            writer.write(channels["/joint_states"], data, at, at)
    return folder


def json_bag(path):
    rows = (
        (
            "/drive",
            {"reference": ordered, "encoder": {"counts": counts}},
            START_NS + round(t * 1e9),
        )
        for t, ordered, counts in motion()
    )
    write_messages(path, "json", rows)
    return path


def taken(bag, out, *more):
    fields = (
        ("/drive:reference", "/drive:encoder.counts")
        if bag.suffix == ".mcap" else ("/drive/reference:data", "/joint_states:position")
    )  # fmt: skip
    return CliRunner().invoke(command, [
        str(bag), "--commanded", fields[0], "--actual", fields[1], "--commanded-unit", "deg",
        "--actual-unit", "counts", "-o", str(out), *more,
    ])  # fmt: skip


@pytest.fixture(scope="module", params=["ros2", "json"])
def bag(request, tmp_path_factory):
    folder = tmp_path_factory.mktemp("pairs")
    return ros_bag(folder / "bag") if request.param == "ros2" else json_bag(folder / "b.mcap")


def test_rests_of_counts_that_wrap_are_deviations_with_their_noise(bag, tmp_path):
    out, joint = tmp_path / "pairs.csv", ("--joint", "table")
    done = taken(bag, out, *joint, "--period", str(N))
    assert done.exception is None, done.exception
    assert "12 rests" in done.output
    result = MeasurementInput(out, changes=(f"sheet.counts_per_turn={N}",)).read().solve()
    assert result.angles / DEGREE == pytest.approx(COMMANDED)
    count = 1_296_000 / N
    assert np.abs(result.deviations["ECC"] / ARCSEC - TRUTH).max() <= count / 2.0
    off = result.deviations["ECC"] / ARCSEC - TRUTH
    u = result.std["ECC"] / ARCSEC
    assert np.sqrt(np.mean((off / u) ** 2)) < 1.0  # half a count is in u, twice
    assert u.min() >= count / np.sqrt(12.0)
    assert u.max() > 1.2 * u.min()  # where two counts were seen


def test_what_a_bag_does_not_say_is_asked(bag, tmp_path):
    out, joint = tmp_path / "pairs.csv", ("--joint", "table")
    jump = taken(bag, out, *joint)
    assert "say by how much it jumps where it wraps: --period" in str(jump.exception)
    if bag.suffix != ".mcap":
        which = taken(bag, out, "--period", str(N))
        assert "has tilt, table in position: say which by --joint" in str(which.exception)
    never = taken(bag, out, *joint, "--period", str(N), "--rest", "5")
    assert "never stood for 5 s" in str(never.exception)
    assert not out.exists()
