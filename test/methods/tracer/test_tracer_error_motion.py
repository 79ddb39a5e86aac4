"""Error motion that is not stated: the circle of the stations shows how much there is."""

import numpy as np
import pytest
from chances import LONG

from rotcal_ros.methods.tracer.solver import TracerProblem, solve
from rotcal_ros.methods.tracer.solver.circle import bearing_slopes, table_motion
from rotcal_ros.methods.tracer.solver.error_motion import error_motion_of, error_motion_spread

ARCSEC = np.pi / 648000
RADIUS, HEIGHT = 0.1, 0.25


def tilted(seed, tilt, m=12, n=16, **options):
    """Return a problem with its true deviations; ``tilt``: EAC and EBC scatter so much, rad."""
    rng = np.random.default_rng(seed)
    commanded = 2 * np.pi * np.arange(m) / m
    deviation = 3 * ARCSEC * np.sin(commanded)
    actual = commanded + deviation
    stations = np.stack(
        [RADIUS * np.cos(actual), RADIUS * np.sin(actual), np.full(m, HEIGHT)], axis=1
    )
    about = tilt * rng.standard_normal((m, 2))
    stations[:, 0] += about[:, 1] * HEIGHT
    stations[:, 1] -= about[:, 0] * HEIGHT
    stations[:, 2] += about[:, 0] * stations[:, 1] - about[:, 1] * stations[:, 0]
    around = 2 * np.pi * np.arange(n) / n
    targets = np.stack(
        [0.5 * np.cos(around), 0.5 * np.sin(around), 0.1 + 0.6 * (np.arange(n) % 3)], axis=1
    )
    length = np.sqrt(((stations[:, None] - targets) ** 2).sum(axis=2)) - 0.3
    length += 2e-7 * rng.standard_normal((m, n))
    j, i = np.divmod(np.arange(m * n), n)
    return TracerProblem(
        position=j, target=i, length=length.ravel(), length_std=2e-7, targets=targets,
        target_std=0.0, table_angles=commanded, variant="station", **options,
    ), deviation  # fmt: skip


def expected(tilt):
    """What a tilt does to a deviation that counts from the first, rad (k = 1)."""
    return np.sqrt(2.0) * tilt * HEIGHT / RADIUS


@pytest.mark.parametrize("stated", [None, 0.0, 1e-7])
def test_an_unstated_tilt_is_in_the_uncertainty(stated):
    problem, deviation = tilted(1, 3 * ARCSEC, error_motion_std=stated)
    result = solve(problem)
    assert result.verdict == ("ok" if stated is None else "suspect")
    assert np.mean(result.std["ECC"][1:]) == pytest.approx(expected(3 * ARCSEC), rel=0.5)
    error = np.abs(result.deviations["ECC"] - deviation)[1:]
    assert np.sqrt(np.mean(error**2)) > 3 * ARCSEC  # it is as bad as that
    assert np.mean(error <= 1.96 * result.std["ECC"][1:]) >= 0.8
    motion = result.error_motion
    assert motion.stated == stated
    assert motion.used == motion.allowed > motion.likely > 2e-6
    if stated is not None:
        assert any("larger than the stated" in text for text in result.warnings)


def test_a_statement_that_fits_stays_to_the_last_bit():
    problem, _ = tilted(2, 0.4e-6 / HEIGHT, error_motion_std=4e-7)
    motion = solve(problem).error_motion
    assert motion.used == motion.stated == 4e-7
    assert motion.dof == 9


def test_a_zero_that_was_stated_is_believed_until_the_circle_speaks():
    problem, _ = tilted(3, 0.0, error_motion_std=0.0)
    result = solve(problem)
    assert result.error_motion.used == 0.0
    left_open = solve(tilted(3, 0.0)[0])
    assert left_open.error_motion.used > 0.0
    assert (left_open.std["ECC"][1:] > result.std["ECC"][1:]).all()
    assert left_open.verdict == "ok"


def independent(noise, m):
    """Covariance of stations with the same noise each, and no error of the targets."""
    return noise**2 * np.eye(3 * m)


NOISE = 2e-7


def moves(rng, m, orders):
    """Return an error motion (m, 2) of size 1: white, or of orders alike."""
    if not orders:
        return rng.standard_normal((m, 2))
    phase = np.outer(2 * np.pi * np.arange(m) / m, orders)
    waves = np.concatenate([np.cos(phase), np.sin(phase)], axis=1)
    return waves @ rng.standard_normal((2 * len(orders), 2)) / np.sqrt(len(orders))


def measured(rng, m, motion_std, runs, orders=()):
    """Yield motion, bearings and covariance of so many circles with an error motion."""
    angles = 2 * np.pi * np.arange(m) / m
    true = np.stack([RADIUS * np.cos(angles), RADIUS * np.sin(angles), np.full(m, 0.2)], axis=1)
    known = independent(NOISE, m)
    for _ in range(runs):
        stations = true + NOISE * rng.standard_normal((m, 3))
        stations[:, :2] += motion_std * moves(rng, m, orders)
        found = table_motion(stations, angles)
        estimate, spectrum = error_motion_of(stations, found, known)
        motion = error_motion_spread(found, estimate.used, spectrum)
        total = known + motion.dense()
        yield found, bearing_slopes(stations, found).dense(), total


@pytest.mark.parametrize("m", [5, 12])
@pytest.mark.parametrize("motion_std", [3e-7, 3e-6])
def test_95_percent_of_the_deviations_lie_inside(m, motion_std):
    """Only stations and their noise: many circles, as many estimates of their error motion."""
    rng, runs, hits = np.random.default_rng(m), 400 if LONG else 100, []
    for found, bearing, total in measured(rng, m, motion_std, runs):
        seen = bearing - bearing[0]
        std = np.sqrt(np.einsum("ia,ia->i", seen @ total, seen))[1:]
        hits.append(np.abs(found.cumulative[1:]) <= 1.96 * std)
    assert np.mean(hits) >= (0.92 if LONG else 0.9)
    if m > 5 or motion_std > 5 * NOISE:  # two residuals cannot tell so little from more
        assert np.mean(hits) <= (0.98 if LONG else 0.99)


@pytest.mark.parametrize("m", [11, 12])
@pytest.mark.parametrize("motion_std", [0.0, 1e-7, 2e-7, 3e-7, 3e-6])
def test_intervals_hold_neither_more_nor_less_than_95_percent(m, motion_std):
    """All sizes of error motion beside a noise of 0.2 um, and none at all: 93 to 97 % (+- 1)."""
    rng, runs, hits = np.random.default_rng(100 + m), 300 if LONG else 100, []
    turn = np.eye(m) - 1.0 / m
    for found, bearing, total in measured(rng, m, motion_std, runs):
        seen = turn @ bearing
        std = np.sqrt(np.einsum("ia,ia->i", seen @ total, seen))
        hits.append(np.abs(turn @ found.cumulative) <= 1.96 * std)
    assert (0.925 if LONG else 0.915) <= np.mean(hits) <= (0.98 if LONG else 0.985)


@pytest.mark.parametrize("orders", [(2, 3, 4), tuple(range(2, 11))])
@pytest.mark.parametrize(("m", "motion_std"), [(12, 3e-7), (12, 1e-6), (36, 1e-6)])
def test_intervals_hold_where_the_error_motion_has_low_orders(m, motion_std, orders):
    """Half of order 2 leaves no residual, and is felt twice."""
    rng, runs, hits, squares = np.random.default_rng(200 + m), 200 if LONG else 60, [], []
    for found, bearing, total in measured(rng, m, motion_std, runs, orders):
        seen = bearing - bearing[0]
        std = np.sqrt(np.einsum("ia,ia->i", seen @ total, seen))[1:]
        hits.append(np.abs(found.cumulative[1:]) <= 1.96 * std)
        squares.append((found.cumulative[1:] / std) ** 2)
    assert np.mean(hits) >= 0.925
    assert np.sqrt(np.mean(squares)) <= 1.08


def test_exact_stations_on_an_exact_circle_have_no_error_motion():
    angles = 2 * np.pi * np.arange(12) / 12
    stations = np.stack([RADIUS * np.cos(angles), RADIUS * np.sin(angles), 0 * angles], axis=1)
    none = independent(0.0, 12)
    found, _ = error_motion_of(stations, table_motion(stations, angles), none)
    assert found.likely == 0.0
    assert found.allowed < 1e-11


def test_without_any_error_motion_little_is_added():
    rng, m, noise = np.random.default_rng(3), 24, 2e-7
    angles = 2 * np.pi * np.arange(m) / m
    true = np.stack([RADIUS * np.cos(angles), RADIUS * np.sin(angles), np.full(m, 0.2)], axis=1)
    known = independent(noise, m)
    used = [
        error_motion_of(stations, table_motion(stations, angles), known)[0].used
        for stations in (true + noise * rng.standard_normal((m, 3)) for _ in range(100))
    ]
    assert np.median(used) < 0.2 * noise
