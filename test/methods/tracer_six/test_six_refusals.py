"""What cannot be determined is refused, and the lost direction named."""

import numpy as np
import pytest
from chances import LONG
from six_scene import good_targets, scene

from rotcal_ros.foundation.components import COMPONENTS
from rotcal_ros.foundation.errors import ConfigurationError, DataError, ObservabilityError
from rotcal_ros.methods.tracer_six.solver import SixProblem, solve

COLUMNS = ("position", "place", "target", "length", "arrival")


def some(rows, keep):
    return {**rows, **{name: rows[name][keep] for name in COLUMNS}}


def test_two_places_name_the_line_through_them():
    rows = scene(np.random.default_rng(1), good_targets()[:10], m=4).rows
    two = some(rows, rows["place"] != 2)
    with pytest.raises(ObservabilityError, match=r"two places .* \(0\.87, -0\.50, -?0\.00\)"):
        solve(SixProblem(**two))


def test_three_places_in_a_line_are_no_more_than_two():
    line = np.array([[-0.15, 0.0, 0.0], [0.02, 0.0, 0.0], [0.15, 0.0, 0.0]])
    rows = scene(np.random.default_rng(2), good_targets()[:10], line, m=4).rows
    with pytest.raises(ObservabilityError, match=r"3 places in a line .* \(1\.00, 0\.00, 0\.00\)"):
        solve(SixProblem(**rows))


def test_a_prior_on_the_tilts_carries_two_places_and_stands_in_the_budget():
    tilts = []
    for tilt in (5e-6, 1e-5):
        rows = scene(np.random.default_rng(3), curves=(1e-6, tilt)).rows
        two = some(rows, rows["place"] != 2)
        result = solve(SixProblem(**two, tilt_std=tilt, scatter_translation_std=0.0,
                                  scatter_rotation_std=0.0))  # fmt: skip
        tilts.append(np.concatenate([result.std["EAC"], result.std["EBC"]]).mean())
        assert {p.effect: p.treatment for p in result.protections}["tilt"] == "bounded"
    # half of the tilt's variance, across the line, is as well known as the prior has it
    assert tilts[1] == pytest.approx(2.0 * tilts[0], rel=0.05)
    assert 0.5e-5 < tilts[1] < 1e-5


@pytest.mark.slow
def test_prior_on_the_tilts_covers():
    rng, inside = np.random.default_rng(4), []
    for _ in range(25 if LONG else 8):
        truth = scene(rng, curves=(1e-6, 1e-5))
        two = some(truth.rows, truth.rows["place"] != 2)
        result = solve(SixProblem(**two, tilt_std=1e-5))
        error = np.array([result.deviations[n] for n in COMPONENTS]) - truth.truth
        std = np.array([result.std[n] for n in COMPONENTS])
        inside.append((np.abs(error) < 1.96 * std).mean(axis=1))
    assert (np.mean(inside, axis=0) > (0.89 if LONG else 0.84)).all()


def test_a_clockwise_table_is_named():
    rows = scene(np.random.default_rng(5), good_targets()[:10], m=6).rows
    with pytest.raises(DataError, match="sense of the table angles"):
        solve(SixProblem(**{**rows, "table_angles": -rows["table_angles"]}))


def test_millimetres_are_named():
    rows = scene(np.random.default_rng(6), good_targets()[:10], m=4).rows
    with pytest.raises(DataError, match="millimetres"):
        solve(SixProblem(**{**rows, "length": 1e3 * rows["length"]}))


def test_a_different_repetition_is_refused_by_place_and_position():
    rows = scene(np.random.default_rng(7), good_targets()[:10], m=4).rows
    again = some(rows, np.append(np.arange(len(rows["length"])), 57))
    result = solve(SixProblem(**again))
    assert "repeats row 57 (place 1, position 1, target 7)" in result.rejected[0].why
    again["length"][-1] += 1e-6
    with pytest.raises(DataError, match="rows 57 and 120 both give a length for place 1"):
        solve(SixProblem(**again))


@pytest.mark.parametrize(
    ("change", "error", "text"),
    [
        ({"datum": "fixed"}, ConfigurationError, "datum 'fixed' is unknown"),
        ({"zero": "per_segment"}, DataError, "segment is missing"),
        ({"segment": np.zeros(120, dtype=int)}, DataError, "segment is given"),
        ({"tilt_std": 0.0}, ConfigurationError, "tilt_std is 0"),
        ({"scatter_rotation_std": -1.0}, ConfigurationError, "scatter_rotation_std is -1"),
        ({"target_std": 0.0}, DataError, "target_std in row"),
        ({"place": np.full(120, 3)}, DataError, "place index in row 0 is 3"),
    ],
)
def test_wrong_input_is_named(change, error, text):
    rows = scene(np.random.default_rng(8), good_targets()[:10], m=4).rows
    with pytest.raises(error, match=text):
        SixProblem(**{**rows, **change})


def test_targets_on_the_axis_cannot_tell_the_angle():
    rng = np.random.default_rng(9)
    column = np.column_stack([np.zeros(8), np.zeros(8), np.linspace(0.3, 1.0, 8)])
    column += 1e-5 * rng.normal(size=column.shape)
    rows = scene(rng, column, m=4, zero="per_station").rows
    with pytest.raises((ObservabilityError, DataError)):
        solve(SixProblem(**rows))
