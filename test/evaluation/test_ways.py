"""The same data evaluated in several ways: which there are, and how far apart they are."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rotcal_ros.evaluation.ways import (
    Evaluation,
    describe_evaluations,
    evaluate,
    largest_differences,
    setting_combinations,
)
from rotcal_ros.foundation.components import COMPONENTS
from rotcal_ros.foundation.protection import Protection
from rotcal_ros.foundation.results import Result
from rotcal_ros.foundation.units import ARCSEC, DEGREE
from rotcal_ros.methods import changed, find_method, prepare
from rotcal_ros.methods.configuration import read_configuration

DEMO = Path(__file__).parents[2] / "config" / "ball_plate_demo.yaml"
STEPS = (0, 2, 4, 6, 8, 10, 1)
"""Balls on a 30 degree grid; a grid of 60 degrees has those with even numbers."""


@pytest.mark.parametrize(
    ("balls", "coarser", "expected"),
    [
        ([], [], [()]),
        (["all"], [1], [()]),
        ([], [2], [("solver.coarser=2",)]),
        (["0,12"], [], [("solver.balls=[0,12]",)]),
        (
            ["all", "0,12"],
            [1, 3],
            [
                (),
                ("solver.coarser=3",),
                ("solver.balls=[0,12]",),
                ("solver.balls=[0,12]", "solver.coarser=3"),
            ],
        ),
    ],
)
def test_every_combination_is_a_way(balls, coarser, expected):
    assert setting_combinations(balls, coarser) == tuple(expected)


def result(degrees, verdict="ok", **deviations):
    """A result with the standard uncertainties 1, 2, ... units of 1e-9 of each component."""
    n = len(degrees)
    return Result(
        method="tracer_multistation",
        angles=np.asarray(degrees) * DEGREE,
        deviations={name: np.asarray(values, float) for name, values in deviations.items()},
        std={name: 1e-9 * np.arange(1.0, n + 1.0) for name in deviations},
        covariance={},
        sigma0=1.0,
        dof=7,
        n_observations=70,
        verdict=verdict,
    )


def test_the_largest_distance_is_that_at_the_common_angles():
    """ECC counts from its value at the first common angle: 3, 8 is 0, 5 and 20, 40 is 0, 20."""
    first = result([0, 90, 180, 270], ECC=[1.0, 3.0, 99.0, 8.0], EXC=[0.0, 1.0, 99.0, 2.0])
    second = result([45, 90, 200, 270], ECC=[50.0, 20.0, 70.0, 40.0], EXC=[5.0, 1.5, 60.0, -7.0],
                    EZC=[1.0, 2.0, 3.0, 4.0])  # fmt: skip
    tracer = find_method("tracer_multistation")
    assert largest_differences(tracer, first, second) == {"ECC": 15.0, "EXC": 9.0}
    assert largest_differences(tracer, second, first) == {"ECC": 15.0, "EXC": 9.0}


@pytest.mark.parametrize(("away", "found"), [(0.5e-9, {"EXC": 3.0}), (2e-9, {})])
def test_angles_are_common_within_a_nanoradian(away, found):
    first, second = result([10.0], EXC=[5.0]), result([10.0], EXC=[2.0])
    moved = replace(second, angles=second.angles + away)
    assert largest_differences(find_method("tracer_multistation"), first, moved) == found


def test_plain_form_and_name():
    given = result([0, 90], ECC=[0.0, 1.0])
    evaluation = Evaluation(("solver.balls=[0,2]", "solver.coarser=2"), given, {"ECC": 0.5})
    assert evaluation.name == "balls=[0,2], coarser=2"
    assert replace(evaluation, changes=()).name == "all data"
    assert evaluation.to_dict() == {
        "changes": ["solver.balls=[0,2]", "solver.coarser=2"],
        "largest_differences": {"ECC": 0.5},
        "result": given.to_dict(),
    }


def test_words_hold_expanded_uncertainties_and_distances_in_their_units():
    """The largest of three standard uncertainties is 3e-9; U = 2 u."""
    given = result([0, 90, 180], "ok", ECC=np.zeros(3), EXC=np.zeros(3))
    given = replace(given, protections=(Protection("drift", "not protected", ""),))
    doubted = replace(given, verdict="suspect")
    other = Evaluation(("solver.coarser=2",), doubted, {"ECC": 5.0 * ARCSEC, "EXC": 1.25e-6})
    assert describe_evaluations([Evaluation((), given, {}), other]) == [
        "all data: 70 observations, 7 degrees of freedom, verdict ok. Not tested for: drift",
        "  EXC  U (k = 2) 0.006 µm",
        "  ECC  U (k = 2) 0.001 arcsec",
        "coarser=2: 70 observations, 7 degrees of freedom, verdict suspect. Not tested for: drift",
        "  EXC  U (k = 2) not stated, at most 1.250 µm from the first",
        "  ECC  U (k = 2) not stated, at most 5.000 arcsec from the first",
    ]


@pytest.fixture(scope="module")
def plate():
    """Calibration and observations of a plate: nominal places and 0.1 um of noise."""
    names = ("plan.plate.grid=12", f"plan.plate.ball_steps={list(STEPS)}", "plan.rounds=1")
    calibration = prepare(changed(read_configuration(DEMO), names))
    rng = np.random.default_rng(1)
    observations = tuple(
        replace(o, mean=tuple(np.array(o.mean) + 1e-7 * rng.normal(size=3)))
        for o in calibration.nominal_observations()
    )
    return calibration, observations


def seen(angles, deviations):
    """Take off by least squares what a plate shifted, tilted or turned by any amount would do."""
    n, out = len(angles), {}
    one, none, cosine, sine = np.ones(n), np.zeros(n), np.cos(angles), np.sin(angles)
    for names in (("EXC", "EYC"), ("EAC", "EBC")):
        columns = [(one, none), (none, one), (cosine, sine), (-sine, cosine)]
        design = np.array([np.concatenate(pair) for pair in columns]).T
        both = np.concatenate([deviations[name] for name in names])
        rest = both - design @ np.linalg.lstsq(design, both, rcond=None)[0]
        out |= dict(zip(names, np.split(rest, 2), strict=True))
    return out | {name: deviations[name] - deviations[name].mean() for name in ("EZC", "ECC")}


def test_every_way_is_compared_with_the_first(plate):
    calibration, observations = plate
    wanted = setting_combinations(["all", "0,1,2,4,8"], [1, 2])
    found = evaluate(calibration, observations, wanted)
    assert tuple(evaluation.changes for evaluation in found) == wanted
    first = found[0]
    assert first.differences == {}
    counts = [evaluation.result.n_observations for evaluation in found]
    assert counts == [7 * 13, 6 * 7, 5 * 13, 4 * 7]  # the first position is measured again
    for evaluation, every in zip(found[1:], (2, 1, 2), strict=True):
        angles = first.result.angles[::every]
        np.testing.assert_allclose(evaluation.result.angles, angles, atol=1e-12)
        here = {name: values[::every] for name, values in first.result.deviations.items()}
        left, right = seen(angles, here), seen(angles, evaluation.result.deviations)
        assert set(evaluation.differences) == set(COMPONENTS)
        for name, distance in evaluation.differences.items():
            assert distance == pytest.approx(np.abs(left[name] - right[name]).max(), rel=1e-6)
            assert distance > 1e-9
