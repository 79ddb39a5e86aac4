"""What a required uncertainty takes: against dense least squares, plans and figures."""

from dataclasses import replace

import numpy as np
import pytest

from rotcal_design.ball_plate.ball_layout import plate_trade, unit_std, variance_bound
from rotcal_design.settings import TracerDesignSettings
from rotcal_design.tracer.trade import tracer_trade
from rotcal_ros.foundation.errors import ObservabilityError
from rotcal_ros.foundation.units import ARCSEC
from rotcal_ros.planning.sequence_time import constant_time_model

M = 11
PAPERS_TIME = constant_time_model(10.0, 5.0)
GOAL = 1.202 * ARCSEC
COARSE = TracerDesignSettings(
    need_arcsec=1.202, table_start_deg=-145.0, table_step_deg=30.0, table_positions=M,
    spacing_m=0.28, zero="one",
)  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize(("zero", "known"), [("one", 25.8), ("per_station", 25.9)])
def test_the_bound_is_the_known_one(zero, known):
    """25.8 and 25.9 lengths in this volume, by a multiplicative algorithm on another grid."""
    settings = replace(COARSE, zero=zero, spacing_m=0.17)
    (row,) = tracer_trade(settings, (0.06517,), (2e-7,), time=PAPERS_TIME)
    assert row.bound == pytest.approx(known, rel=0.04)


@pytest.mark.slow
def test_more_noise_takes_more_lengths_and_a_larger_circle_fewer():
    radii, sigmas = (0.065, 0.13), (2e-7, 4e-7)
    rows = tracer_trade(COARSE, radii, sigmas, time=PAPERS_TIME)
    quiet, loud, wide, both = rows
    assert quiet.lengths < loud.lengths
    assert wide.lengths <= quiet.lengths
    assert both.lengths < loud.lengths
    for row in rows:
        assert row.lengths == M * row.targets
        assert row.bound <= row.lengths
        assert row.redundancy >= 0.25
        assert row.expanded <= GOAL
        assert row.seconds == pytest.approx(5.0 * row.lengths + 10.0 * M, abs=0.01)
    # information grows with (R / sigma)^2 wherever the targets are: so does the bound fall
    assert both.bound == pytest.approx(quiet.bound, rel=0.02)
    assert loud.bound == pytest.approx(4.0 * quiet.bound, rel=0.02)


@pytest.mark.slow
def test_all_scaled_alike_takes_the_same():
    once, half = (
        tracer_trade(
            replace(
                COARSE, need_arcsec=s * 1.202, target_std_m=(s * 1e-6,) * 3,
                error_motion_std_m=s * 2e-9,
            ),
            (0.065,),
            (s * 2e-7,),
            time=PAPERS_TIME,
        )[0]
        for s in (1.0, 0.5)
    )  # fmt: skip
    assert half.lengths == once.lengths
    assert half.expanded == pytest.approx(0.5 * once.expanded, rel=1e-6)


def test_what_no_plan_reaches_is_said():
    (row,) = tracer_trade(replace(COARSE, need_arcsec=0.02), (0.065,), (4e-7,), time=PAPERS_TIME)
    assert row.lengths is None
    assert row.expanded > 0.02 * ARCSEC


def test_no_pattern_of_a_plate_beats_its_bound():
    rng, grid = np.random.default_rng(0), 12
    tried = 0
    for _ in range(30):
        balls = rng.choice(grid, rng.integers(5, 10), replace=False)
        positions = rng.choice(grid, rng.integers(6, 13), replace=False)
        try:
            std = unit_std(grid, np.sort(balls), np.sort(positions), 1.0)["ECC"]
        except ObservabilityError:
            continue
        tried += 1
        assert (std**2).mean() >= (1.0 - 1e-9) * variance_bound(grid, len(balls) * len(positions))
    assert tried > 15
    every = np.arange(grid)
    full = unit_std(grid, every, every, 1.0)["ECC"]
    assert (full**2).mean() == pytest.approx(variance_bound(grid, grid**2), rel=1e-9)


def test_a_plate_of_that_radius_or_noise_reaches_the_goal():
    goal = 0.05 * ARCSEC
    for row in plate_trade(12, (6, 8), goal, radius=0.185, sigma=5e-8, centre_s=30.0):
        unit = unit_std(12, np.array(row.ball_steps), np.arange(12), 1.0)["ECC"]
        rms = 2.0 * np.sqrt((unit**2).mean())
        assert row.expanded == pytest.approx(rms * 5e-8 / 0.185, rel=1e-9)
        assert rms * 5e-8 / row.radius == pytest.approx(goal, rel=1e-9)
        assert rms * row.sigma / 0.185 == pytest.approx(goal, rel=1e-9)
        assert row.seconds == 12 * row.balls * 30.0
        assert 0.0 < row.saving < 0.15
