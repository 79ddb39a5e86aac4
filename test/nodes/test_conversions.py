"""Dataclass to message and back, the message having gone over the wire."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

rclpy = pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")

from rclpy.serialization import deserialize_message, serialize_message  # noqa: E402

from rotcal_ros import messages  # noqa: E402
from rotcal_ros.nodes import conversions  # noqa: E402
from rotcal_ros.observations import (  # noqa: E402
    Approach,
    Command,
    LengthStatus,
    Observation,
    PointKind,
    ProbeSample,
    TableSample,
    TemperatureSample,
    TracerSample,
)
from rotcal_ros.results import Result  # noqa: E402

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
commands = st.builds(
    Command, counts, counts, reals, st.sampled_from(Approach), st.sampled_from(PointKind), counts,
    points,
)  # fmt: skip
observations = st.builds(
    Observation, counts, counts, counts, reals, counts, counts, st.sampled_from(PointKind), lists,
    lists, lists, points, counts, counts, st.booleans(), st.text("abc ", max_size=20), reals,
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
    assert (table.header.frame_id, probe.header.frame_id) == ("table_base", "machine")


@given(observations)
def test_observation(observation):
    message = sent(conversions.observation_message(observation))
    assert messages.observation(message) == observation


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


def test_no_temperature_is_not_a_number_in_the_message():
    observation = Observation(
        0, 0, 0, 0.0, 0, 0, PointKind.REFLECTOR, (), (), (), (0.0, 0.0, 0.0), 0, 0, False, "why",
        0.0, None, 0, 0,
    )  # fmt: skip
    assert math.isnan(conversions.observation_message(observation).temperature)
