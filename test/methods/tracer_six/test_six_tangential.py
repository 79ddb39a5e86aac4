"""A tracer that mount or cable shift along its circle: what no length of any place can show."""

import numpy as np
import pytest
from chances import LONG
from coded import coded

from rotcal_ros.methods.tracer.solver.reporting import NO_ANGLE_AGAIN
from rotcal_ros.methods.tracer_six.solver import SixProblem, solve

RADIUS, ANGLES, TARGETS = 0.13, 12, 16


def measured(seed, wave, again=()):
    """A perfect table; every place is shifted along its circle by ``wave(angle, share of run)``.

    Positions ``again`` are measured once more at the end of each run.
    """
    rng = np.random.default_rng(seed)
    around = 2 * np.pi * np.arange(3) / 3
    places = np.column_stack([RADIUS * np.cos(around), RADIUS * np.sin(around), np.full(3, 0.1)])
    far, turn = rng.uniform(0.35, 0.8, TARGETS), rng.uniform(0, 2 * np.pi, TARGETS)
    said = np.column_stack([far * np.cos(turn), far * np.sin(turn), rng.uniform(0.2, 1, TARGETS)])
    true = said + 1e-6 * rng.standard_normal(said.shape)
    angles = 2 * np.pi * np.arange(ANGLES) / ANGLES
    visited = [*range(ANGLES), *again]
    rows = []
    for place, azimuth in enumerate(around):
        for visit, position in enumerate(visited):
            shift = wave(angles[position], visit / (len(visited) - 1)) / RADIUS
            stands = azimuth + angles[position] + shift
            tracer = [RADIUS * np.cos(stands), RADIUS * np.sin(stands), 0.1]
            length = np.linalg.norm(true - tracer, axis=1) - 0.4
            length += 2e-7 * rng.standard_normal(TARGETS)
            rows += [(place, position, visit >= ANGLES, i, x) for i, x in enumerate(length)]
    place, position, arrival, target, length = np.array(rows).T
    place, position, arrival, target = (x.astype(int) for x in (place, position, arrival, target))
    return solve(
        SixProblem(
            position=position, place=place, target=target, length=length, length_std=2e-7,
            targets=said, target_std=1e-6, table_angles=angles, places=places, arrival=arrival,
            order=np.arange(len(length)),
        )
    )  # fmt: skip


def statement(result):
    return next(p for p in result.protections if p.effect == "tangential motion")


@pytest.mark.parametrize("order", [1, 2, 3])
def test_it_is_named_as_no_length_sees_it(order):
    """0.6 um times cos: the closed form of its error is shift / radius, less its mean."""
    quiet = measured(1, lambda angle, share: 0.0)
    result = measured(1, lambda angle, share: 6e-7 * np.cos(order * angle))
    assert quiet.verdict == result.verdict == "ok"
    moved = result.deviations["ECC"] - quiet.deviations["ECC"]
    expected = 6e-7 * np.cos(order * result.angles) / RADIUS
    assert moved == pytest.approx(expected, abs=1e-9)
    assert np.abs(moved / result.std["ECC"]).max() > 4.0
    for found in (quiet, result):
        assert "tangential motion" in found.verdict_line
        assert f"1 um of it is {1e-6 / RADIUS * 206264.806:.2f} arcsec" in statement(found).why
        assert NO_ANGLE_AGAIN in coded(statement(found).why)


@pytest.mark.parametrize("crept", [0.0, 8e-7])
def test_an_angle_measured_again_bounds_what_of_it_does_not_come_back(crept):
    within = []
    for seed in range(8 if LONG else 4):
        why = statement(measured(seed, lambda angle, share: crept * share, again=[0])).why
        within.append(float(why.split(" is less than ")[1].split(" um")[0]) * 1e-6)
    assert np.mean(np.array(within) >= crept) >= 0.75
    assert np.median(within) < crept + 5e-7  # a bound that says something
