"""Dataclass to message and back, the message having gone over the wire."""

import math
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

rclpy = pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")

from rclpy.serialization import deserialize_message, serialize_message  # noqa: E402
from two_groups import ARCSEC, GRID, plate_problem  # noqa: E402

import rotcal_ros as rc  # noqa: E402
from rotcal_ros.capture import messages  # noqa: E402
from rotcal_ros.compensation.table import check_verdict, table_from_result  # noqa: E402
from rotcal_ros.foundation.errors import DataError  # noqa: E402
from rotcal_ros.foundation.language import phrase  # noqa: E402
from rotcal_ros.foundation.observations import (  # noqa: E402
    Approach,
    Command,
    LengthStatus,
    Observation,
    PointKind,
    ProbeSample,
    TableSample,
    TemperatureSample,
    TracerSample,
    Turn,
)
from rotcal_ros.foundation.results import Directions, Result, Zeros  # noqa: E402
from rotcal_ros.methods.ball_plate.solver import solve  # noqa: E402
from rotcal_ros.nodes.runtime import conversions  # noqa: E402
from rotcal_ros.planning.plan import Step  # noqa: E402

NOTHING = Step(0, 0, 0.0, Approach.UNKNOWN, PointKind.SURFACE, 0, (0.0, 0.0, 0.0)).observed((0.0,))
GOLDEN = Path(__file__).parents[2] / "golden"

stamps = st.integers(0, 2**31 * 10**9 - 1)
counts = st.integers(0, 2**32 - 1)
reals = st.floats(allow_nan=False)
points = st.tuples(reals, reals, reals)
lists = st.lists(reals, max_size=3).map(tuple)

tracer_samples = st.builds(
    TracerSample, stamps, counts, reals, reals, st.sampled_from(LengthStatus)
)
table_samples = st.builds(TableSample, stamps, reals, reals)
temperature_samples = st.builds(TemperatureSample, stamps, st.text("abc_", max_size=9), reals)
probe_samples = st.builds(
    ProbeSample, stamps, counts, counts, counts, st.sampled_from(PointKind), counts, counts,
    counts, points, points, reals,
)  # fmt: skip
turns = st.none() | st.builds(Turn, reals, reals, reals.filter(bool))
commands = st.builds(
    Command, counts, counts, reals, st.sampled_from(Approach), st.sampled_from(PointKind), counts,
    points, counts, turns,
)  # fmt: skip
reasons = st.text("abc ", max_size=20).map(phrase) | st.builds(
    partial(phrase, "{0} of {1:.3g}: {2}"),
    counts,
    reals,
    st.builds(phrase, st.just("only {0}"), counts),
)
observations = st.builds(
    Observation, counts, counts, counts, reals, counts, counts, st.sampled_from(PointKind), lists,
    lists, lists, points, counts, counts, st.booleans(), reasons, reals,
    st.none() | reals, stamps, stamps,
)  # fmt: skip


def sent(message):
    return deserialize_message(serialize_message(message), type(message))


@given(tracer_samples)
def test_tracer_sample(sample):
    assert messages.tracer_sample(sent(conversions.tracer_message(sample))) == sample


@given(table_samples)
def test_table_sample(sample):
    message = sent(conversions.table_message(sample, "table"))
    assert messages.table_sample(message, "table") == sample
    assert messages.table_sample(message, "other") is None


@given(probe_samples)
def test_probe_sample(sample):
    assert messages.probe_sample(sent(conversions.probe_message(sample, "f"))) == sample


@given(temperature_samples)
def test_temperature_sample(sample):
    assert messages.temperature_sample(sent(conversions.temperature_message(sample))) == sample


@given(commands, stamps)
def test_command(command, now_ns):
    table, probe = conversions.command_messages(command, now_ns)
    assert messages.command(sent(table), sent(probe)) == command
    assert table.turn_anew == (command.turn is not None)
    assert (table.header.frame_id, probe.header.frame_id) == ("table_base", "machine")


@given(observations)
def test_observation(observation):
    message = sent(conversions.observation_message(observation))
    assert messages.observation(message) == observation


@given(reasons)
def test_a_reason_keeps_code_and_arguments_on_its_way(reason):
    message = sent(conversions.observation_message(replace(NOTHING, reason=reason)))
    read = messages.observation(message).reason
    assert (read, read.template, read.parts) == (reason, reason.template, reason.parts)
    assert message.reason_code.code == reason.template


def test_a_reason_without_a_code_of_its_words_is_its_words_alone():
    message = conversions.observation_message(replace(NOTHING, reason=phrase("{0} lost", 3)))
    message.reason = "4 lost"
    assert messages.observation(message).reason.template == "4 lost"
    message.reason_code.arguments = ["["]
    assert messages.observation(message).reason == "4 lost"


def test_warnings_carry_their_codes():
    warnings = (phrase("{0} of {1} lengths", 3, 9), phrase("all drift"))
    result = replace(solve(plate_problem()), warnings=warnings)
    found = sent(conversions.deviations_message(result, "", 0, final=True))
    assert [*found.warnings] == [*warnings]
    codes = [(code.code, [*code.arguments]) for code in found.warning_codes]
    assert codes == [("{0} of {1} lengths", ["3", "9"]), ("all drift", [])]


def test_absent_components_of_a_result_are_absent():
    result = Result(
        method="m",
        angles=np.array([0.0, 1.0]),
        deviations={"ECC": np.array([0.0, 1e-6])},
        std={"ECC": np.array([0.0, 2e-7])},
        covariance={},
        sigma0=1.1,
        dof=7,
        n_observations=9,
    )
    message = sent(conversions.deviations_message(result, "p", 5, final=True))
    assert message.ecc.tolist() == [0.0, 1e-6]
    assert message.ecc_std.tolist() == [0.0, 2e-7]
    assert len(message.exc) == len(message.eac_std) == 0
    assert (message.final, message.dof, message.n_observations) == (True, 7, 9)
    assert (message.plan_id, message.method, message.verdict) == ("p", "m", "ok")
    assert (message.angles.tolist(), message.sigma0) == ([0.0, 1.0], 1.1)


def test_no_temperature_is_not_a_number_in_the_message():
    observation = Observation(
        0, 0, 0, 0.0, 0, 0, PointKind.REFLECTOR, (), (), (), (0.0, 0.0, 0.0), 0, 0, False, "why",
        0.0, None, 0, 0,
    )  # fmt: skip
    assert math.isnan(conversions.observation_message(observation).temperature)


def six_balls(**more):
    return solve(plate_problem(**more))


def test_deviations_say_what_they_count_from():
    """reference_index was 0 with ecc[0] = 1.9 arcsec: the values count from their mean."""
    whole = six_balls(balls=range(GRID))
    message = sent(conversions.deviations_message(whole, "p", 0, final=True))
    assert message.counts_from == message.MEAN
    assert abs(message.ecc[0]) > 1.9 * ARCSEC
    assert np.mean(message.ecc) == pytest.approx(0.0, abs=1e-15)
    assert list(message.free_directions) == []
    parts = sent(conversions.deviations_message(six_balls(), "p", 0, final=True))
    assert parts.counts_from == parts.MEAN_OF_EACH_GROUP
    for first in (0, 1):
        assert np.mean(parts.ecc[first::2]) == pytest.approx(0.0, abs=1e-15)


@pytest.mark.parametrize("name", ["tracer", "ball_plate", "plane_mirror", "tracer_six"])
def test_what_a_method_counts_from_is_true_of_what_it_measured(name):
    """Of the recorded calibrations: zero at the first angle, or zero on average."""
    result = rc.read_bag(GOLDEN / name / "bag").solve()
    message = sent(conversions.deviations_message(result, "p", 0, final=False))
    values = {c: np.array(getattr(message, c.lower())) for c in result.components}
    if name in ("tracer", "plane_mirror"):
        assert message.counts_from == message.FIRST_ANGLE
        assert list(values) == ["ECC"]
        assert values["ECC"][0] == message.ecc_std[0] == 0.0
    else:
        assert message.counts_from == message.MEAN
        for curve in values.values():
            assert abs(curve.mean()) < 1e-3 * np.ptp(curve)


def test_open_zeros_travel_with_their_columns():
    result = six_balls()
    message = sent(conversions.deviations_message(result, "p", 0, final=True))
    assert message.verdict == "suspect"
    assert message.verdict_line == result.verdict_line
    assert list(message.not_protected) == list(result.unprotected)
    assert list(message.warnings) == list(result.warnings)
    for sent_one, own in zip(message.free_directions, result.zeros.free, strict=True):
        assert sent_one.name == "the odd and even table positions"
        assert sent_one.components == list(own.columns)
        columns = np.reshape(sent_one.columns, (-1, GRID))
        np.testing.assert_array_equal(columns, [*own.columns.values()])


def test_covariances_are_in_final_messages_row_by_row():
    result = six_balls(balls=range(GRID))
    message = sent(conversions.deviations_message(result, "p", 0, final=True))
    found = np.reshape(message.eac_covariance, (GRID, GRID))
    np.testing.assert_array_equal(found, result.covariance["EAC"])
    preliminary = sent(conversions.deviations_message(result, "p", 0, final=False))
    assert len(preliminary.eac_covariance) == 0


def with_directions():
    angles = np.array([0.0, 1.0, 2.0])
    ecc = np.array([0.0, 2e-6, 1e-6])
    both = Directions(angles, ecc + 1e-7, ecc - 1e-7, 1e-14 * np.eye(6))
    return Result(
        method="tracer", angles=angles, deviations={"ECC": ecc}, std={"ECC": 1e-7 * angles},
        covariance={"ECC": 1e-14 * np.diag(angles**2)}, sigma0=1.0, dof=3, n_observations=9,
        adjacent_deviations=np.diff(ecc), adjacent_std=np.array([1e-7, 1e-7]),
        directions={"ECC": both}, measured_on="none", zeros=Zeros("first angle"),
    )  # fmt: skip


def test_both_directions_and_the_steps_are_in_the_message():
    message = sent(conversions.deviations_message(with_directions(), "p", 0, final=True))
    np.testing.assert_array_equal(message.adjacent_deviations, [2e-6, 1e-6 - 2e-6])
    np.testing.assert_array_equal(message.adjacent_std, [1e-7, 1e-7])
    (both,) = message.directions
    assert both.component == "ECC"
    np.testing.assert_allclose(np.subtract(both.forward, both.reverse), 2e-7)
    assert len(both.covariance) == 36
    assert len(message.exc) == len(message.exc_covariance) == 0  # absent, never zero


def test_the_correction_of_all_components_is_minus_the_deviation():
    message = sent(conversions.correction_message(with_directions(), "C", "p", 5))
    assert (message.axis, message.plan_id, message.measured_on) == ("C", "p", "none")
    np.testing.assert_array_equal(message.ecc, [0.0, -2e-6, -1e-6])
    np.testing.assert_array_equal(message.directions[0].forward, [-1e-7, -2.1e-6, -1.1e-6])
    assert len(message.exc) == len(message.eac_std) == 0
    six = six_balls(balls=range(GRID))
    message = sent(conversions.correction_message(six, "C", "p", 5))
    for name in six.components:
        np.testing.assert_array_equal(getattr(message, name.lower()), -six.deviations[name])
    assert (message.verdict, message.open_zeros, message.measured_on) == ("ok", "", "")
    open_one = sent(conversions.correction_message(six_balls(), "C", "p", 5))
    assert open_one.verdict == "suspect"
    assert "the offset between the odd and even table positions" in open_one.open_zeros


def test_a_table_of_parts_arrives_as_one_and_is_refused_by_the_bridge():
    table = table_from_result(six_balls())
    arrived = conversions.compensation_table(sent(conversions.compensation_message(table, "p", 0)))
    assert arrived.open_zeros == table.open_zeros
    assert arrived.table_hash == table.table_hash
    with pytest.raises(DataError, match=r"odd and even.*rotcal combine"):
        check_verdict(arrived)


def test_a_result_stands_in_the_diagnostics_in_words():
    deviations = {"EXC": np.array([0.0, 2e-6, -1e-6]), "ECC": np.array([0.0, 3.0, 1.0]) * ARCSEC}
    std = {"EXC": np.full(3, 0.25e-6), "ECC": np.array([0.0, 0.1, 0.05]) * ARCSEC}
    result = SimpleNamespace(verdict_line="ok (SIMULATED)", deviations=deviations, std=std)
    assert conversions.result_values(result) == {
        "verdict": "ok (SIMULATED)",
        "EXC": "range 3 µm, U (k = 2) 0.5 µm",
        "ECC": "range 3 arcsec, U (k = 2) 0.2 arcsec",
    }
