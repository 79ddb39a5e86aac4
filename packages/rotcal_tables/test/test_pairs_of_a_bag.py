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


def joints_bag(path, states, hertz=20):
    """A JSON bag: rests of 2 s at 0 and 90 degrees; ``states(k, angle)`` yields what is sent."""
    rows = []
    for k in range(4 * hertz):
        angle = 0.0 if k < 2 * hertz else 90.0
        at = START_NS + k * 1_000_000_000 // hertz
        rows.append(("/drive", {"reference": angle}, at))
        rows += [("/joints", state, at + 1 + n) for n, state in enumerate(states(k, angle))]
    write_messages(path, "json", rows)
    return path


def of_joints(bag, out, field="position", *more):
    return CliRunner().invoke(command, [
        str(bag), "--commanded", "/drive:reference", "--actual", f"/joints:{field}",
        "--commanded-unit", "deg", "--actual-unit", "deg", "-o", str(out), *more,
    ])  # fmt: skip


def actual(out):
    return np.loadtxt(out, delimiter=",", skiprows=1)[:, 1]


def in_turn(_, angle):
    """Two drivers, a joint each, on one topic."""
    yield {"name": ["tilt"], "position": [5.0 + angle]}
    yield {"name": ["table"], "position": [angle + 0.01]}


def in_changing_order(k, angle):
    yield {
        "name": ["tilt", "table"][:: 1 - 2 * (k % 2)],
        "position": [5.0, angle + 0.01][:: 1 - 2 * (k % 2)],
    }


@pytest.mark.parametrize("states", [in_turn, in_changing_order])
def test_a_joint_is_found_by_its_name_alone(states, tmp_path):
    bag, out = joints_bag(tmp_path / "b.mcap", states), tmp_path / "pairs.csv"
    for stated in ((), ("--joint", "tabel")):
        asked = of_joints(bag, out, "position", *stated)
        assert "say which by --joint" in str(asked.exception)
        assert "table" in str(asked.exception)
    assert of_joints(bag, out, "position", "--joint", "table").exception is None
    assert actual(out) == pytest.approx([0.01, 90.01])
    by_place = of_joints(bag, tmp_path / "other.csv", "position.0")
    assert "changing order" in str(by_place.exception) or "by --joint" in str(by_place.exception)


def test_a_number_without_a_name_is_found_by_its_place(tmp_path):
    bag = joints_bag(tmp_path / "b.mcap", lambda _, angle: [{"position": [5.0, angle + 0.01]}])
    out = tmp_path / "pairs.csv"
    assert "say which, as /joints:position.0" in str(of_joints(bag, out).exception)
    assert of_joints(bag, out, "position.1").exception is None
    assert actual(out) == pytest.approx([0.01, 90.01])


@pytest.mark.parametrize(
    ("state", "why"),
    [
        ({"name": ["table"], "position": [None]}, "position is no number in 80 messages"),
        ({"name": ["table"], "position": []}, "no position of table in 80 messages"),
        ({"name": ["table"], "position": ["far"]}, "position cannot be read as a number"),
        ({"name": ["table"], "velocity": [0.1]}, "has no field position; it has name, velocity"),
    ],
)
def test_why_no_message_gives_a_number_is_said(state, why, tmp_path):
    bag = joints_bag(tmp_path / "b.mcap", lambda *_: [state])
    done = of_joints(bag, tmp_path / "pairs.csv", "position", "--joint", "table")
    assert why in str(done.exception)


def test_messages_that_give_no_number_are_counted_beside_those_that_do(tmp_path):
    def states(k, angle):
        yield {"position": [angle + 0.01] if k % 4 else ["far"]}

    bag, out = joints_bag(tmp_path / "b.mcap", states), tmp_path / "pairs.csv"
    assert "cannot be read as a number in 20 messages" in of_joints(bag, out).output
    assert actual(out) == pytest.approx([0.01, 90.01])


def test_a_rest_in_two_places_is_none(tmp_path):
    """Two trackers on one topic, without names."""
    rng = np.random.default_rng(3)

    def states(_, angle):
        yield {"position": angle + rng.normal(0.0, 1e-5)}
        yield {"position": angle + 0.5 + rng.normal(0.0, 1e-5)}

    done = of_joints(joints_bag(tmp_path / "b.mcap", states), tmp_path / "pairs.csv")
    assert "commanded 90, 1.95 s: it is in two places, 0.4999" in done.output
    assert "with the table at rest: see what was left out" in str(done.exception)


def test_a_count_that_flickers_at_a_rest_is_no_wrap(tmp_path):
    def states(k, angle):
        yield {"position": round(angle * 100) + (k % 7 == 0)}

    out = tmp_path / "pairs.csv"
    bag = joints_bag(tmp_path / "b.mcap", states)
    done = of_joints(bag, out, "position", "--actual-unit", "counts")
    assert done.exception is None, done.exception
    assert actual(out) == pytest.approx([1 / 7, 9000 + 1 / 7], abs=0.1)


def steps_bag(path, early_s, stands_s=2.0, hertz=50, moves_s=0.4):
    """Commands that jump by 30 degrees; the actual angle, off by 0.01, goes there ``early_s``."""
    rng, rows = np.random.default_rng(11), []
    for n in range(int(6 * stands_s * hertz)):
        t = n / hertz
        ordered = 30.0 * int(t / stands_s)
        since = (t + early_s) % stands_s
        share = min(since / moves_s, 1.0) if t + early_s >= stands_s else 1.0
        actual = 30.0 * (int((t + early_s) / stands_s) - (1.0 - share)) + 0.01
        at = START_NS + round(t * 1e9)
        message = {"reference": ordered, "actual": actual + rng.normal(0.0, 1e-4)}
        rows.append(("/drive", message, at))
    write_messages(path, "json", rows)
    return path


def of_drive(bag, out, *more, commanded="reference", actual="actual", unit="deg"):
    return CliRunner().invoke(command, [
        str(bag), "--commanded", f"/drive:{commanded}", "--actual", f"/drive:{actual}",
        "--commanded-unit", unit, "--actual-unit", unit, "-o", str(out), *more,
    ])  # fmt: skip


@pytest.mark.parametrize("early_s", [0.0, 0.14, 0.3, 0.5])
def test_a_feedback_that_is_early_spoils_no_rest(early_s, tmp_path):
    out = tmp_path / "pairs.csv"
    done = of_drive(steps_bag(tmp_path / "b.mcap", early_s), out)
    assert done.exception is None, done.exception
    found = np.loadtxt(out, delimiter=",", skiprows=1)
    assert found[:, 0].tolist() == [0.0, 30.0, 60.0, 90.0, 120.0, 150.0]
    assert found[:, 1] - found[:, 0] == pytest.approx(0.01, abs=2e-4)
    assert found[:, 2].max() < 3e-4
    assert ("before the command" in done.output) == (early_s > 0.1)


def test_a_rest_without_a_part_at_rest_is_none(tmp_path):
    bag = steps_bag(tmp_path / "b.mcap", 0.3)
    done = of_drive(bag, tmp_path / "pairs.csv", "--rest", "2")
    assert "commanded 30, 2 s: it creeps by" in done.output
    assert "see what was left out" in str(done.exception)


def coarse_bag(path, unit=1.0, angles=COMMANDED, counts=4096):
    """Commands that the table follows 60 ms later, in steps of a coarse encoder."""
    rows, hertz = [], 50
    size = 360.0 / counts
    for k, angle in enumerate(angles):
        for n in range(2 * hertz):
            late = angles[k - 1] if k and n < 3 else angle
            moved = round((late + 0.2 * np.sin(np.deg2rad(late))) / size) * size
            at = START_NS + (2 * hertz * k + n) * 1_000_000_000 // hertz
            rows.append(("/drive", {"reference": angle * unit, "actual": moved * unit}, at))
    write_messages(path, "json", rows)
    return path


TARGETS_OF_ISO = [3.17, 34.81, 61.44, 97.02, 121.68, 155.35, 181.9, 214.26, 243.71, 276.08]


@pytest.mark.parametrize(("unit", "size"), [("deg", 1.0), ("rad", np.pi / 180.0)])
@pytest.mark.parametrize("angles", [30.0 * np.arange(12), np.array(TARGETS_OF_ISO)])
def test_commanded_and_actual_that_are_exchanged_are_noticed(unit, size, angles, tmp_path):
    bag, out = coarse_bag(tmp_path / "b.mcap", size, angles), tmp_path / "pairs.csv"
    asked = of_drive(bag, out, commanded="actual", actual="reference", unit=unit)
    assert "are they exchanged?" in str(asked.exception)
    assert "--as-stated" in str(asked.exception)
    assert not out.exists()
    assert of_drive(bag, out, unit=unit).exception is None
    off = np.diff(np.loadtxt(out, delimiter=",", skiprows=1)[:, :2])[:, 0] / size
    assert off == pytest.approx(0.2 * np.sin(np.deg2rad(angles)), abs=180.0 / 4096)


def test_a_person_may_know_that_commands_follow(tmp_path):
    bag, out = coarse_bag(tmp_path / "b.mcap"), tmp_path / "pairs.csv"
    done = of_drive(bag, out, "--as-stated", commanded="actual", actual="reference")
    assert done.exception is None, done.exception


def test_nothing_is_overwritten(tmp_path):
    bag, out = coarse_bag(tmp_path / "b.mcap"), tmp_path / "pairs.csv"
    out.write_text("kept")
    done = of_drive(bag, out)
    assert f"{out} exists and is not overwritten; name another file with -o" in str(done.exception)
    assert out.read_text() == "kept"
