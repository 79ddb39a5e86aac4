"""Baarda's reliability against tables, by simulation, and in plans."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from scipy import stats

from rotcal_ros.adjust.distributions import noncentrality
from rotcal_ros.cli.main import rotcal
from rotcal_ros.evaluation.reliability import effects_on_deviations, reliability
from rotcal_ros.foundation.errors import DataError
from rotcal_ros.foundation.results import Residuals
from rotcal_ros.methods import parse_configuration, prepare
from rotcal_ros.methods.configuration import dump_configuration


def residuals(redundancy, used=None, std=1e-6, coordinates=1):
    n = len(redundancy)
    return Residuals(
        table_position=np.arange(n), target=np.arange(n) % 3, residual=np.zeros(n),
        redundancy=np.array(redundancy), test_value=np.zeros(n),
        used=np.ones(n, dtype=bool) if used is None else np.array(used),
        std=None if std is None else np.full(n, std), coordinates=coordinates,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("alpha", "power", "dof", "lambda0"),
    [
        (0.001, 0.80, 1, 17.075),  # Baarda's alpha0 and power, delta0 = 4.13
        (0.05, 0.80, 1, 7.849),  # Haynam, Govindarajulu and Leone (1962), dof 1 to 3
        (0.05, 0.80, 2, 9.635),
        (0.05, 0.80, 3, 10.903),
        (0.01, 0.90, 1, 14.879),
    ],
)
def test_the_noncentrality_is_that_of_the_tables(alpha, power, dof, lambda0):
    found = noncentrality(alpha, power, dof)
    assert found == pytest.approx(lambda0, abs=6e-4)
    assert stats.ncx2.sf(stats.chi2.isf(alpha, dof), dof, found) == pytest.approx(power, abs=1e-9)


def test_a_length_that_the_others_check_by_half():
    found = reliability(residuals([0.5, 1.0, 0.0, 0.2], used=[True, True, True, False]))
    assert found.row.tolist() == [0, 1, 2]
    np.testing.assert_allclose(found.detectable[:2], [4.1321 * np.sqrt(2), 4.1321], rtol=1e-4)
    np.testing.assert_allclose(found.effect[:2], [4.1321, 0.0], rtol=1e-4)
    assert found.unchecked.tolist() == [False, False, True]
    assert found.worst(2).tolist() == [2, 0]
    np.testing.assert_allclose(found.detectable_error()[1], 4.1321e-6, rtol=1e-4)
    data = json.loads(json.dumps(found.to_dict(2), allow_nan=False))
    assert (data["n_observations"], data["n_unchecked"]) == (3, 1)
    assert [row["detectable_m"] for row in data["worst"]] == [
        None,
        pytest.approx(5.8437e-6, rel=1e-4),
    ]
    assert reliability(residuals([0.5], std=None)).detectable_error() is None


@pytest.mark.parametrize("coordinates", [1, 3])
def test_an_error_of_the_detectable_size_is_found_as_often_as_stated(coordinates):
    """n repetitions of one value, one of them wrong: redundancy 1 - 1/n, any direction."""
    rng, n, runs, alpha, power = np.random.default_rng(5), 4, 20_000, 0.01, 0.80
    share = 1.0 - 1.0 / n
    found = reliability(residuals([share] * n, std=1.0, coordinates=coordinates), alpha, power)
    way = rng.standard_normal((runs, coordinates))
    way /= np.linalg.norm(way, axis=1)[:, None]
    data = rng.standard_normal((runs, n, coordinates))
    data[:, 0] += found.detectable_error()[0] * way
    off = data[:, 0] - data.mean(axis=1)
    square = np.sum(off**2, axis=1) / share
    assert np.mean(square > stats.chi2.isf(alpha, coordinates)) == pytest.approx(power, abs=0.01)
    # The mean has the standard uncertainty 1/sqrt(n); the error moves it by its n-th part.
    moved = found.detectable_error()[0] / n * np.sqrt(n)
    assert moved == pytest.approx(found.effect[0], rel=1e-9)


TRACER = dump_configuration(
    "tracer_multistation",
    {
        "plan": {
            "table_start_deg": 0.0,
            "table_step_deg": 60.0,
            "table_positions": 6,
            "box_centre_m": [0.0, 0.0, 0.9],
            "box_points": [3, 3, 2],
        },
        "solver": {"length_std_m": 2.0e-7, "target_std_m": 1.0e-6},
    },
)


def test_the_effect_on_the_deviations_stays_below_its_bound_and_is_that_of_a_real_error():
    calibration = prepare(parse_configuration(TRACER))
    observations = calibration.measured(
        {}, seed=1
    ).observations  # exact ones have no noise to test
    result = calibration.solve(observations)
    found = reliability(result.residuals)
    which = found.worst(3)
    effects = effects_on_deviations(calibration, observations, result, found, which)
    assert np.all(effects < 1.01 * found.effect[which])
    assert np.all(effects > 0.01)
    # A length wrong by a fifth of that: no test reacts, the deviations move in proportion.
    row, error = int(found.row[which[0]]), 0.2 * found.detectable_error()[which[0]]
    wrong = list(observations)
    wrong[row] = replace(wrong[row], mean=(wrong[row].mean[0] + error,))
    moved = calibration.solve(wrong).deviations["ECC"] - result.deviations["ECC"]
    in_std = np.abs(moved[1:] / result.std["ECC"][1:]).max()
    assert in_std == pytest.approx(0.2 * effects[0], rel=1e-3)


def test_what_cannot_be_told_is_refused():
    calibration = prepare(parse_configuration(TRACER))
    observations = calibration.nominal_observations()
    result = calibration.solve(observations)
    found = reliability(result.residuals)
    with pytest.raises(DataError, match="one observation each"):
        effects_on_deviations(calibration, observations[1:], result, found, found.worst(1))
    silent = reliability(residuals([0.5] * len(observations), std=None))
    with pytest.raises(DataError, match="no standard deviation"):
        effects_on_deviations(calibration, observations, result, silent, silent.worst(1))


def test_the_plan_verb_tells_which_observations_could_hide_an_error(tmp_path):
    configuration = tmp_path / "tracer.yaml"
    configuration.write_text(TRACER)
    answer = CliRunner().invoke(
        rotcal, ["plan", "reliability", str(configuration), "--worst", "2", "--json"]
    )
    assert answer.exit_code == 0, answer.output
    data = json.loads(answer.stdout)
    assert data["lambda0"] == pytest.approx(17.075, abs=1e-3)
    assert data["n_observations"] == 6 * 18
    assert len(data["worst"]) == 2
    assert 0.0 < data["worst"][0]["effect_std"] <= 1.01 * data["worst"][0]["effect_bound_std"]
    # dof of the network: 108 lengths, 18 x 3 weighed coordinates; 6 x 4 + 54 unknowns
    assert data["mean_redundancy"] * 108 < 108 - 24
    words = CliRunner().invoke(rotcal, ["plan", "reliability", str(configuration)]).stderr
    assert "108 observations" in words


def test_a_ball_is_tested_as_a_point():
    stated = Path(__file__).parents[2] / "research" / "power_plans" / "ball_plate_stated.yaml"
    plan = ["plan", "reliability", str(stated), "--worst", "1"]
    data = json.loads(CliRunner().invoke(rotcal, [*plan, "--json"]).stdout)
    assert data["lambda0"] == pytest.approx(stats_lambda0(3), abs=1e-6)
    assert data["worst"][0]["detectable_m"] == pytest.approx(
        5e-8 * data["worst"][0]["detectable_std"]
    )
    easier = json.loads(CliRunner().invoke(rotcal, [*plan, "--json", "--power", "0.5"]).stdout)
    assert easier["worst"][0]["detectable_m"] < data["worst"][0]["detectable_m"]


def stats_lambda0(dof):
    """Return the noncentrality by bisection of scipy's distribution."""
    low, high = 1.0, 100.0
    while high - low > 1e-9:
        middle = 0.5 * (low + high)
        found = stats.ncx2.sf(stats.chi2.isf(0.001, dof), dof, middle)
        low, high = (middle, high) if found < 0.8 else (low, middle)
    return low
