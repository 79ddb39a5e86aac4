"""What clocks that may differ cost: held against drawn clocks and creeps, in every method."""

from pathlib import Path

import numpy as np
import pytest

import rotcal_ros as rc
from rotcal_ros.capture.settings import CaptureSettings
from rotcal_ros.evaluation.budget import contributions
from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.results import Directions, Result
from rotcal_ros.methods.added_errors import arrival_std, with_clock_errors
from rotcal_ros.methods.calibration import prepare, prepare_to_measure
from rotcal_ros.methods.configuration import changed, read_configuration

CONFIG = Path(__file__).parents[2] / "config"
DATA = Path(__file__).parents[2] / "examples" / "data"
BOUND_S, CREEP = 0.02, 0.02 * rc.ARCSEC * 3600.0
DRAWS = 200_000


def drawn(count, seed=1):
    """Return errors (draws, count) of angles: one clock for all, every angle with its creep."""
    rng = np.random.default_rng(seed)
    clock = rng.uniform(-BOUND_S, BOUND_S, (DRAWS, 1))
    return clock * rng.uniform(-CREEP, CREEP, (DRAWS, count))


def empty(count, **more):
    zero = np.zeros(count)
    return Result(
        "method", np.arange(count) * 1.0, {"ECC": zero, "EXC": zero}, {"ECC": zero, "EXC": zero},
        {"ECC": np.zeros((count, count)), "EXC": np.zeros((count, count))}, 1.0, 1, count, **more,
    )  # fmt: skip


def test_a_millisecond_at_the_largest_creep_is_24_thousandths_of_an_arcsecond():
    settings = CaptureSettings(velocity_tolerance_deg_s=0.02)
    assert arrival_std(1e-3, settings) == pytest.approx(0.024 * rc.ARCSEC)


def test_the_share_is_that_of_drawn_clocks_and_creeps():
    errors = drawn(4)
    cumulative = errors - errors[:, :1]
    std = arrival_std(BOUND_S, CaptureSettings(velocity_tolerance_deg_s=0.02))
    found = with_clock_errors(
        empty(4, adjacent_deviations=np.zeros(3), adjacent_std=np.zeros(3)), std
    )
    scale = std**2
    np.testing.assert_allclose(
        found.covariance["ECC"] / scale, np.cov(cumulative.T) / scale, atol=0.02
    )
    np.testing.assert_allclose(found.std["ECC"] ** 2, found.covariance["ECC"].diagonal())
    np.testing.assert_allclose(
        found.adjacent_std, np.diff(cumulative, axis=1).std(axis=0), rtol=0.01
    )
    assert not found.covariance["EXC"].any()


def test_an_ecc_that_has_an_error_at_the_first_angle_too_counts_from_none():
    before = empty(3)
    before.covariance["ECC"][:] = np.eye(3)
    share = with_clock_errors(before, 0.5).covariance["ECC"] - np.eye(3)
    np.testing.assert_allclose(share, 0.25 * np.eye(3))


def test_the_sides_of_a_reversal_have_errors_of_their_own():
    """Three angles counted from the first; the last one is reached from one side alone."""
    errors = drawn(5)
    forward, reverse, alone = errors[:, :2], errors[:, 2:4], errors[:, 4:]
    mean = np.hstack([0.5 * (forward + reverse), alone])
    sides = np.hstack([forward, reverse]) - mean[:, :1]
    zero = np.zeros(2)
    both = Directions(np.array([0.0, 1.0]), zero, zero, np.zeros((4, 4)))
    before = empty(3, directions={"ECC": both, "EXC": both})
    std = arrival_std(BOUND_S, CaptureSettings(velocity_tolerance_deg_s=0.02))
    found = with_clock_errors(before, std)
    np.testing.assert_allclose(
        found.covariance["ECC"] / std**2, np.cov((mean - mean[:, :1]).T) / std**2, atol=0.02
    )
    share = found.directions["ECC"].covariance / std**2
    np.testing.assert_allclose(share, np.cov(sides.T) / std**2, atol=0.02)
    np.testing.assert_allclose(
        found.directions["ECC"].reversal_std, (forward - reverse).std(axis=0), rtol=0.01
    )
    assert not found.directions["EXC"].covariance.any()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["tracer", "tracer_six", "ball_plate", "plane_mirror"])
def test_a_stated_bound_is_part_of_every_result(name):
    plain = read_configuration(DATA / f"{name}.yaml")
    stated = changed(plain, [f"topics.clock_bound_s={BOUND_S}"])
    observations = rc.simulate_observations(plain)
    without, found = (prepare(c).solve(observations) for c in (plain, stated))
    one = BOUND_S * plain.capture.velocity_tolerance_deg_s * 3600.0 * rc.ARCSEC / 3.0
    counted = without.std["ECC"][0] == 0.0  # from the first angle
    added = found.std["ECC"][1:] ** 2 - without.std["ECC"][1:] ** 2
    np.testing.assert_allclose(added, (2.0 if counted else 1.0) * one**2, rtol=1e-6)
    np.testing.assert_array_equal(found.deviations["ECC"], without.deviations["ECC"])
    for other in {*found.std} - {"ECC"}:
        np.testing.assert_array_equal(found.std[other], without.std[other])
    parts = contributions(found, "ECC")
    total = np.sum([part.std**2 for part in parts], axis=0)
    np.testing.assert_allclose(total, found.std["ECC"] ** 2, rtol=1e-6)
    named = [part.source for part in parts if part.source.startswith("Clocks that may differ")]
    assert len(named) == (bool(without.budget))


@pytest.mark.slow
def test_clocks_that_differ_by_more_than_settling_are_refused_before_and_after():
    plain = read_configuration(CONFIG / "tracer_paper.yaml")
    stated = changed(plain, ["topics.clock_bound_s=0.1"])
    for work in (prepare_to_measure, lambda c: prepare(c).solve(rc.simulate_observations(plain))):
        with pytest.raises(ConfigurationError, match=r"clock_bound_s = 0.1 is longer"):
            work(stated)


def test_a_method_that_does_not_wait_for_a_table_to_settle_may_state_any_bound():
    plate = read_configuration(CONFIG / "ball_plate_demo.yaml")
    stated = changed(plate, ["topics.clock_bound_s=1.0"])
    creep = plate.capture.velocity_tolerance_deg_s * 3600.0 * rc.ARCSEC
    assert prepare_to_measure(stated).arrival_std() == pytest.approx(creep / 3.0)
