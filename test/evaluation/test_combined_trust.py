"""Combined results: their angles, what is refused or named, and that they are results."""

import json
from dataclasses import replace

import numpy as np
import pytest
from campaigns import TAU, about_mean, campaign, combined, result_of, three, truth
from scipy import stats

from rotcal_ros.circumstances import Circumstances
from rotcal_ros.compensation.table import check_verdict, table_from_result
from rotcal_ros.compensation.volumetric import volumetric_files
from rotcal_ros.curves.measured import MeasuredCurve, measured_curve
from rotcal_ros.errors import ConfigurationError, DataError
from rotcal_ros.evaluation.combination import CombinationInput, combine
from rotcal_ros.identity import Identity
from rotcal_ros.protection import EFFECTS, Protection
from rotcal_ros.results import Result
from rotcal_ros.units import ARCSEC

# Angles.


@pytest.mark.parametrize(("count", "start"), [(10, 0.05), (7, 0.0)])
def test_inputs_without_two_common_angles_are_joined_by_interpolation(count, start):
    rng = np.random.default_rng(11)
    fine, between = np.arange(36) * TAU / 36, np.arange(count) * TAU / count + start
    results = [campaign(fine, 0.1 * ARCSEC, rng)[2], campaign(between, 0.1 * ARCSEC, rng)[2]]
    found = combined(*results)
    np.testing.assert_allclose(found.angles, fine, atol=1e-12)
    assert "r1 shares fewer than two angles with the others" in found.warnings[0]
    assert found.dof == count - 1
    assert found.verdict == "ok"
    assert np.mean(found.std["ECC"]) < np.mean(combined(results[0]).std["ECC"])


def test_angles_are_joined_across_the_turn():
    rng = np.random.default_rng(12)
    grid = np.arange(12) * TAU / 12
    turned = np.append(grid[6:] - TAU, grid[:6])
    _, cov, first = campaign(grid, 0.2 * ARCSEC, rng)
    second = campaign(turned, 0.2 * ARCSEC, rng)[2]
    found = combined(first, second)
    np.testing.assert_allclose(found.angles, grid, atol=1e-9)
    assert np.max(np.abs(found.deviations["ECC"] - about_mean(truth(grid), cov)[0])) < ARCSEC


def test_arcs_that_overlap_become_one():
    rng = np.random.default_rng(13)
    degrees = np.deg2rad(np.arange(-90.0, 91.0, 15.0))
    left, right = (campaign(a, 0.1 * ARCSEC, rng)[2] for a in (degrees[:8], degrees[5:]))
    found = combined(left, right)
    np.testing.assert_allclose(found.angles, degrees, atol=1e-12)
    assert found.dof == 2
    far = campaign(degrees[:4] - 10.0, 0.1 * ARCSEC, rng)[2]
    with pytest.raises(DataError, match="share 0 angles"):
        combined(left, far)


# Trust.


def with_protection(result, **stated):
    return replace(
        result,
        protections=tuple(
            stated.get(e.replace(" ", "_"), Protection(e, "harmless", "none")) for e in EFFECTS
        ),
    )


def test_a_failed_input_is_refused_and_a_suspect_one_named():
    rng = np.random.default_rng(14)
    grid = np.arange(12) * TAU / 12
    good = campaign(grid, 0.2 * ARCSEC, rng)[2]
    odd = replace(campaign(grid, 0.2 * ARCSEC, rng)[2], verdict="suspect", warnings=("it moved",))
    found = combined(good, odd)
    assert (found.verdict, found.warnings[0]) == ("suspect", "r1 is suspect (it moved)")
    with pytest.raises(DataError, match=r"r1: the verdict is failed \(it moved\)"):
        combined(good, replace(odd, verdict="failed"))
    with pytest.raises(DataError, match="r1: ECC without uncertainty"):
        combined(good, MeasuredCurve(grid, truth(grid), np.zeros((12, 12)), TAU))
    with pytest.raises(DataError, match="each only once"):
        combine([CombinationInput.of("a", good), CombinationInput.of("a", good)])
    with pytest.raises(DataError, match="inputs none"):
        combine([])
    with pytest.raises(ConfigurationError, match="enlargement 'more'"):
        combined(good, enlarge="more")


def test_false_alarms_are_one_percent_over_all_groups():
    """A contradiction of p = 0.7 % counts alone, but not as the odd one of two groups."""
    grid, std = np.arange(12) * TAU / 12, 0.2 * ARCSEC
    wave = np.cos(2 * grid)
    size = np.sqrt(stats.chi2.isf(0.007, 11) * 2.0) * std / np.linalg.norm(wave)
    cov = std**2 * np.eye(12)
    one, two = truth(grid), truth(grid) + size * wave
    alone = combined(result_of(grid, one, cov), result_of(grid, two, cov))
    assert alone.details["consistency"]["ECC"]["p_value"] == pytest.approx(0.007, rel=1e-6)
    assert alone.verdict == "suspect"
    both = combined(
        *(
            result_of(grid, {"EZC": ezc, "ECC": ecc}, {"EZC": cov, "ECC": cov})
            for ecc, ezc in ((one, wave * 1e-9), (two, wave * 2e-9))
        )
    )
    assert both.verdict == "ok"


def test_a_combination_says_what_was_measured_and_whether_anything_was():
    rng = np.random.default_rng(21)
    grid = np.arange(12) * TAU / 12
    table, other = Identity(item="table", serial="1"), Identity(item="table", serial="2")

    def made(**known):
        found = campaign(grid, 0.2 * ARCSEC, rng)[2]
        return replace(found, circumstances=Circumstances(axis="C", **known))

    both = combined(made(identity=table, simulated=True), made(identity=table))
    assert (both.simulated, both.circumstances.identity, both.circumstances.axis) == (
        True, table, "C",
    )  # fmt: skip
    two = combined(made(identity=table), made(identity=other))
    assert (two.simulated, two.circumstances.identity) == (False, Identity())
    curve = measured_curve(made(simulated=True))
    assert combined(made(), curve).simulated
    assert not combined(made(), replace(curve, simulated=False)).simulated
    assert json.loads(volumetric_files(both, "both")["both.json"])["simulated"] is True


def test_one_measurement_under_two_names_is_refused():
    rng = np.random.default_rng(18)
    grid = np.arange(12) * TAU / 12
    result = campaign(grid, 0.2 * ARCSEC, rng)[2]
    copy = Result.from_dict(result.to_dict())
    with pytest.raises(DataError, match="r0 and r2 hold the same ECC to the last bit"):
        combined(result, campaign(grid, 0.2 * ARCSEC, rng)[2], copy)


def test_the_input_that_is_off_is_named():
    rng = np.random.default_rng(15)
    grid = np.arange(12) * TAU / 12
    good = [campaign(grid, 0.2 * ARCSEC, rng)[2] for _ in range(2)]
    odd = campaign(grid, 0.2 * ARCSEC, rng, extra=3.0 * ARCSEC)[2]
    assert "r1 is farthest off" in combined(good[0], odd, good[1]).warnings[0]
    assert "farthest" not in combined(good[0], odd).warnings[0]


def test_an_effect_is_protected_only_where_every_input_is():
    rng = np.random.default_rng(16)
    grid = np.arange(12) * TAU / 12
    drifting, steady, silent = (campaign(grid, 0.2 * ARCSEC, rng)[2] for _ in range(3))
    drifting = with_protection(drifting, drift=Protection("drift", "not protected", "one round"))
    steady = with_protection(steady, drift=Protection("drift", "tested", "closure", 1.0))
    found = combined(drifting, steady)
    assert found.unprotected == ("drift",)
    assert found.protections[0].why == "r0: one round"
    assert found.verdict_line == "ok, not protected against drift"
    assert set(combined(steady, silent).unprotected) == set(EFFECTS)
    assert combined(silent).protections == ()


def test_a_particular_effect_concerns_only_inputs_that_speak_of_it():
    rng = np.random.default_rng(16)
    grid = np.arange(12) * TAU / 12
    first, second = (with_protection(campaign(grid, 0.2 * ARCSEC, rng)[2]) for _ in range(2))
    assert "slip" not in {p.effect for p in combined(first, second).protections}
    slip = Protection("slip", "bounded", "one fringe", 1.0)
    first = replace(first, protections=(*first.protections, slip))
    joined = combined(first, second).protections[-1]
    assert (joined.effect, joined.treatment, joined.why) == ("slip", "bounded", "r0: one fringe")
    assert 0.3 < joined.error < 1.0  # its share of the combination


def test_unseen_errors_of_equal_inputs_add_as_their_kind_does():
    """Four equal inputs: each has half of the standard uncertainty's share."""
    grid = np.arange(12) * TAU / 12
    spread = (0.2 * ARCSEC) ** 2 * np.eye(12)
    stated = {
        "drift": Protection("drift", "tested", "closure", 1.5),
        "scale": Protection("scale", "tested", "bar", 1.5),
    }
    found = combined(
        *(
            with_protection(result_of(grid, truth(grid + 1e-6 * k), spread), **stated)
            for k in range(4)
        )
    )
    error = {p.effect: p.error for p in found.protections}
    assert error["drift"] == pytest.approx(1.5, rel=1e-6)
    assert error["scale"] == pytest.approx(3.0, rel=1e-6)
    assert found.unprotected == ("scale",)


def test_weights_follow_the_variances():
    grid = np.arange(12) * TAU / 12
    one, two = (result_of(grid, truth(grid + s), s**2 * np.eye(12)) for s in (1e-6, 2e-6))
    assert combined(one, two).details["weights"]["ECC"] == pytest.approx({"r0": 0.8, "r1": 0.2})


# What comes out is a result like any other.


def test_it_can_be_stored_combined_again_and_fed():
    results = [c[2] for c in three(np.random.default_rng(17))]
    found = combined(*results[:2])
    back = Result.from_dict(found.to_dict())
    np.testing.assert_array_equal(back.covariance["ECC"], found.covariance["ECC"])
    check_verdict(back)
    table = table_from_result(back)
    assert table.period == pytest.approx(TAU)
    np.testing.assert_allclose(
        table.correction_forward, back.deviations["ECC"][0] - back.deviations["ECC"], atol=1e-15
    )
    again = combined(back, results[2])
    np.testing.assert_allclose(
        again.deviations["ECC"], combined(*results).deviations["ECC"], atol=1e-7 * ARCSEC
    )
    np.testing.assert_allclose(again.std["ECC"], combined(*results).std["ECC"], rtol=1e-6)
