"""From observations of several places to the problem, and to a person's work."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rotcal_ros.methods import changed, prepare, read_configuration
from rotcal_ros.methods.tracer_six.method import problem

DEMO = Path(__file__).parents[2] / "config" / "tracer_six_demo.yaml"
SMALL = ("plan.table_positions=4", "plan.table_step_deg=90.0", "plan.box_points=[2, 2, 2]")
PER_PLACE = 32


def small(*changes):
    return prepare(changed(read_configuration(DEMO), (*SMALL, *changes)))


def posed(calibration, observations):
    return problem(calibration.configuration, calibration.plan, observations)


@pytest.mark.parametrize("order", ["targets_per_station", "stations_per_target"])
def test_a_tracer_far_from_its_place_is_found_from_the_first_lengths(order):
    calibration = small(f"plan.order={order}")
    moved = small(f"plan.order={order}", "plan.place_radius_m=0.17")
    seen = moved.nominal_observations()  # 20 mm too far out
    for pause in calibration.plan.pauses:
        here = seen[: pause.last + 1]
        (text,) = calibration.check(here)
        assert text.startswith(f"place {here[-1].station + 1}: the tracer stands 20.0 mm from its")
        assert "170 mm from the table axis" in text
        assert "planned 150 mm" in text
        assert moved.check(here) == ()
    assert calibration.check(()) == ()


def test_a_place_is_right_within_its_tolerance():
    seen = small("plan.place_height_m=0.129").nominal_observations()[:8]
    assert small().check(seen) == ()
    assert (
        "9.0 mm from its place, allowed 8" in small("plan.place_tolerance_m=0.008").check(seen)[0]
    )


def test_each_length_has_its_place_position_target_and_arrival():
    calibration = small("plan.arrivals=2", "solver.length_std_relative=1e-6")
    observations = calibration.nominal_observations()
    shuffled = [observations[i] for i in np.random.default_rng(0).permutation(len(observations))]
    for rows in (observations, shuffled):
        made = posed(calibration, rows)
        step = np.array([o.step for o in rows])
        np.testing.assert_array_equal(made.place, step // (2 * PER_PLACE))
        np.testing.assert_array_equal(made.position, step // 8 % 4)
        np.testing.assert_array_equal(made.target, step % 8)
        np.testing.assert_array_equal(made.arrival, step // PER_PLACE % 2)
        np.testing.assert_array_equal(np.argsort(made.order), np.argsort(step))
        distance = np.linalg.norm(np.array(calibration.plan.targets), axis=1)[made.target]
        np.testing.assert_allclose(made.length_std, np.hypot(1.05e-7, 1e-6 * distance))
        assert made.zero == "per_segment"
        np.testing.assert_array_equal(made.segment, made.place)
    np.testing.assert_allclose(np.hypot(*made.places[:, :2].T), 0.15)


@pytest.mark.parametrize(("zero", "segments"), [("per_run", 4), ("per_station", 13)])
def test_a_place_that_was_interrupted_counts_from_another_zero_afterwards(zero, segments):
    calibration = small(f"solver.zero={zero}")
    observations = [
        replace(o, run=int(o.step >= PER_PLACE + 12)) for o in calibration.nominal_observations()
    ]
    made = posed(calibration, observations)
    assert made.zero == "per_segment"
    assert len(np.unique(made.segment)) == segments  # place 1 has two, its second angle has two
    at = [made.segment[row] for row in (PER_PLACE + 11, PER_PLACE + 12)]
    assert at[0] != at[1]
    assert made.arrival[PER_PLACE + 11] != made.arrival[PER_PLACE + 12]


@pytest.mark.parametrize(
    ("zero", "expected"),
    [
        ("auto", "per_segment"), ("per_segment", "per_segment"), ("per_run", "per_run"),
        ("per_station", "per_station"),
    ],
)  # fmt: skip
def test_a_broken_beam_begins_a_zero_where_the_measurement_tells_it(zero, expected):
    """The beam breaks once at place 1, after its second angle; a new place has a new zero."""
    calibration = small(f"solver.zero={zero}")
    observations = [
        replace(o, segment=int(o.step >= PER_PLACE + 16))
        for o in calibration.nominal_observations()
    ]
    made = posed(calibration, observations)
    assert made.zero == expected
    assert (made.segment is None) == (expected != "per_segment")
    if made.segment is not None:
        at = np.split(made.segment, [PER_PLACE, PER_PLACE + 16, 2 * PER_PLACE])
        assert [np.unique(part).tolist() for part in at] == [[0], [1], [2], [3]]


def test_where_every_length_has_an_arrival_of_its_own_the_scatter_joins_it():
    stated = ("solver.scatter_translation_std_m=3e-7", "solver.scatter_rotation_std_rad=2e-6")
    by_station, by_target = (
        small(*stated, f"plan.order={order}")
        for order in ("targets_per_station", "stations_per_target")
    )
    made = posed(by_station, by_station.nominal_observations())
    assert (made.scatter_translation_std, made.scatter_rotation_std) == (3e-7, 2e-6)
    np.testing.assert_allclose(made.length_std, 1.05e-7)
    made = posed(by_target, by_target.nominal_observations())
    assert (made.scatter_translation_std, made.scatter_rotation_std) == (0.0, 0.0)
    arm = np.hypot(0.15, 0.12)
    np.testing.assert_allclose(made.length_std**2, 1.05e-7**2 + 3e-7**2 + (arm * 2e-6) ** 2)


def distances(made, places_of_targets):
    """Return distances (k,) from the tracer of each row to a place (k, 3), the table perfect."""
    angle = made.table_angles[made.position]
    x, y, z = made.places[made.place].T
    turned = [np.cos(angle) * x - np.sin(angle) * y, np.sin(angle) * x + np.cos(angle) * y, z]
    return np.linalg.norm(places_of_targets - np.transpose(turned), axis=1)


@pytest.mark.parametrize(("noise", "weight"), [(0.0, 1.0), (1e-6, 0.0)])
def test_what_the_machine_reports_beside_the_mean_counts_as_far_as_the_lengths_follow(
    noise, weight
):
    """A machine that misses by 0.3 um and says so; and one that stands and reports noise."""
    calibration = small("plan.table_positions=6", "plan.table_step_deg=60.0")
    nominal = calibration.nominal_observations()
    exact = posed(calibration, nominal)
    mean = exact.targets[exact.target]
    rng = np.random.default_rng(4)
    place = mean + 3e-7 * weight * rng.standard_normal(mean.shape)
    read = distances(exact, place) - 0.4 + 1e-7 * rng.standard_normal(len(mean))
    reported = place + noise * rng.standard_normal(mean.shape)

    def found(positions, lengths):
        rows = zip(nominal, lengths.tolist(), positions.tolist(), strict=True)
        seen = [replace(o, mean=(v,), probe_position=tuple(at)) for o, v, at in rows]
        return calibration.solve(seen)

    result = found(reported, read)
    still = found(mean, read - distances(exact, place) + distances(exact, mean))
    assert result.details["reported_places"]["weight"] == weight
    assert result.verdict == still.verdict == "ok"
    assert any("reported places" in text for text in result.warnings) == (weight == 0.0)
    for name, values in still.deviations.items():
        assert np.abs(result.deviations[name] - values).max() < still.std[name].max(), name
    np.testing.assert_allclose(result.std["ECC"], still.std["ECC"], rtol=0.2)
