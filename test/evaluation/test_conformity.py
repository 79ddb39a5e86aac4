"""Statements of conformity: the worked examples of JCGM 106:2012 and closed forms."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm

from rotcal_ros.evaluation.marks import conformities, decide_conformity
from rotcal_ros.foundation.identity import Identity
from rotcal_ros.foundation.results import Result
from rotcal_ros.foundation.units import ARCSEC, MICROMETRE


@pytest.mark.parametrize(
    ("value", "decision"),
    [(7.9, "within"), (-8.0, "within"), (8.1, "undecided"), (10.0, "undecided"),
     (11.9, "undecided"), (12.1, "beyond"), (-12.1, "beyond")],
)  # fmt: skip
def test_the_guard_band_is_u_on_either_side(value, decision):
    """Tolerance 10, u = 1, U = 2: accepted up to 8, rejected from 12 on."""
    assert decide_conformity(np.array([0.0, value]), np.array([0.0, 1.0]), 10.0) == decision


def result(covariance: np.ndarray, values: np.ndarray) -> Result:
    return Result(
        method="m", angles=np.deg2rad([0.0, 90.0]), deviations={"ECC": values * ARCSEC},
        std={"ECC": np.sqrt(np.diag(covariance)) * ARCSEC},
        covariance={"ECC": covariance * ARCSEC**2}, sigma0=1.0, dof=9, n_observations=20,
    )  # fmt: skip


def test_the_probability_of_a_whole_curve_knows_the_covariance():
    values, agreed = np.array([9.0, 9.0]), Identity(tolerance_arcsec=10.0)
    single = norm.cdf(1.0)  # 1 arcsec below the limit with u = 1; the other limit is far off
    (apart,) = conformities(result(np.eye(2), values), agreed)
    (together,) = conformities(result(np.ones((2, 2)), values), agreed)
    assert apart.probability == pytest.approx(single**2, abs=0.012)
    assert together.probability == pytest.approx(single, abs=0.012)
    assert apart.decision == together.decision == "undecided"


def test_words_name_the_tolerance_and_the_angle():
    agreed = Identity(tolerance_arcsec=10.0)
    for value, words in (
        (0.0, "ECC is within the tolerance ±10 arcsec; conformance probability above 99.9 %"),
        (9.0, "undecided against the tolerance ±10 arcsec: U goes beyond it at 90°"),
        (15.0, "ECC is beyond the tolerance ±10 arcsec, by more than U at 90°"),
    ):
        shown = result(np.eye(2), np.array([0.0, value]))
        (conformity,) = conformities(shown, agreed)
        assert words in conformity.describe(shown)


def test_every_component_has_the_tolerance_of_its_kind_or_none():
    both = replace(
        result(np.eye(2), np.zeros(2)),
        deviations={"EXC": np.full(2, 3.0) * MICROMETRE, "ECC": np.zeros(2)},
        std={"EXC": np.full(2, 0.1) * MICROMETRE, "ECC": np.zeros(2)},
    )
    agreed = Identity(tolerance_arcsec=1.0, tolerance_um=2.0)
    assert [c.decision for c in conformities(both, agreed)] == ["beyond", "within"]
    assert [c.component for c in conformities(both, Identity(tolerance_um=2.0))] == ["EXC"]
    assert conformities(both, Identity()) == ()
