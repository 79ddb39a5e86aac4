"""Combined results: their angles, what is refused or named, and that they are results."""

import json
from dataclasses import replace

import numpy as np
import pytest
from campaigns import TAU, about_mean, campaign, combined, result_of, three, truth
from click.testing import CliRunner
from coded import coded
from scipy import stats

from rotcal_ros.cli.main import rotcal
from rotcal_ros.compensation.table import check_verdict, table_from_result
from rotcal_ros.compensation.volumetric import volumetric_files
from rotcal_ros.evaluation.combination import UNCHECKED, CombinationInput
from rotcal_ros.evaluation.component_groups import FARTHEST
from rotcal_ros.evaluation.joint import combine
from rotcal_ros.foundation.circumstances import Circumstances
from rotcal_ros.foundation.curves.measured import MeasuredCurve, measured_curve
from rotcal_ros.foundation.errors import ConfigurationError, DataError
from rotcal_ros.foundation.identity import Identity
from rotcal_ros.foundation.protection import EFFECTS, Protection
from rotcal_ros.foundation.results import Result
from rotcal_ros.foundation.units import ARCSEC

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


HASH, OTHER = "a" * 64, "b" * 64


@pytest.mark.parametrize(
    ("ours", "theirs", "words"),
    [
        ({"serial": "4711"}, {"serial": "9999"}, "serial number 4711 (r0), 9999 (r1)"),
        ({"axis": "B"}, {"axis": "C"}, "axis B (r0), C (r1)"),
        ({"on": HASH}, {"on": "none"}, "compensation in force aaaaaaaaaaaa (r0), none (r1)"),
        ({"on": HASH}, {"on": OTHER}, "in force aaaaaaaaaaaa (r0), bbbbbbbbbbbb (r1)"),
    ],
)
def test_what_was_measured_of_two_tables_is_not_combined(ours, theirs, words):
    rng = np.random.default_rng(31)
    grid = np.arange(12) * TAU / 12
    both = [measured_of(campaign(grid, 0.2 * ARCSEC, rng)[2], **said) for said in (ours, theirs)]
    with pytest.raises(DataError) as refused:
        combined(*both)
    assert words in str(refused.value)
    assert combined(both[0], campaign(grid, 0.2 * ARCSEC, rng)[2]).verdict == "ok"


@pytest.mark.parametrize(
    ("ours", "theirs", "words"),
    [
        ({"serial": "4711"}, {"serial": "9999"}, "serial number 4711 ({0}), 9999 ({1})"),
        ({"axis": "B"}, {"axis": "C"}, "axis B ({0}), C ({1})"),
    ],
)
def test_nor_is_it_compared_or_checked(ours, theirs, words, tmp_path):
    """The numbers agree: only what the results say of themselves can show it."""
    rng = np.random.default_rng(33)
    grid = np.arange(12) * TAU / 12
    first, second, bare = (campaign(grid, 0.2 * ARCSEC, rng)[2] for _ in range(3))
    paths = []
    for name, result in (
        ("a", measured_of(first, **ours)), ("b", measured_of(second, **theirs)), ("c", bare),
    ):  # fmt: skip
        paths.append(tmp_path / f"{name}.json")
        paths[-1].write_text(result.to_json())
    a, b, c = map(str, paths)
    verbs = {("compare",): (a, b), ("check", "--within", "3"): _ROLES}
    for (verb, *options), names in verbs.items():
        ran = CliRunner().invoke(rotcal, [verb, a, b, *options])
        assert ran.exit_code == 3, ran.output
        assert words.format(*names) in ran.stderr
        for other in (a, b):
            assert CliRunner().invoke(rotcal, [verb, other, c, *options]).exit_code == 0


_ROLES = ("the earlier result", "the new measurement")


def measured_of(result, serial="", axis="", on="unknown", begun_ns=None, place=""):
    identity = Identity(item="table", serial=serial, place=place)
    around = Circumstances(axis=axis, identity=identity, begun_ns=begun_ns, ended_ns=begun_ns)
    return replace(result, circumstances=around, measured_on=on)


def test_a_combination_is_of_its_item_axis_and_table_and_as_old_as_its_first_measurement():
    rng = np.random.default_rng(32)
    grid = np.arange(12) * TAU / 12
    first, second, bare = (campaign(grid, 0.2 * ARCSEC, rng)[2] for _ in range(3))
    known = measured_of(first, "4711", "B", HASH, 10**18, place="hall 1")
    later = measured_of(second, "4711", "B", HASH, 2 * 10**18, place="hall 2")
    found = combined(known, later, bare)
    around = found.circumstances
    assert (around.identity.serial, around.identity.place, around.axis) == ("4711", "", "B")
    assert (around.begun_ns, around.ended_ns) == (10**18, None)  # nobody knows when bare ended
    assert combined(known, later).circumstances.ended_ns == 2 * 10**18
    assert found.measured_on == HASH
    table = table_from_result(found, axis="B")
    assert (table.serial, table.measured_from_ns) == ("4711", 10**18)


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
    usual = np.sqrt(2.0) * std * (-1.0) ** np.arange(12)
    both = combined(
        *(
            result_of(grid, {"EZC": ezc, "ECC": ecc}, {"EZC": cov, "ECC": cov})
            for ecc, ezc in ((one, 0.0 * wave), (two, usual))
        )
    )
    assert both.verdict == "ok"


def test_a_combination_says_what_was_measured_and_whether_anything_was():
    rng = np.random.default_rng(21)
    grid = np.arange(12) * TAU / 12
    table, other = Identity(item="table", serial="1"), Identity(item="turntable")

    def made(**known):
        found = campaign(grid, 0.2 * ARCSEC, rng)[2]
        return replace(found, circumstances=Circumstances(axis="C", **known))

    both = combined(made(identity=table, simulated=True), made(identity=table))
    assert (both.simulated, both.circumstances.identity, both.circumstances.axis) == (
        True, table, "C",
    )  # fmt: skip
    two = combined(made(identity=table), made(identity=other))
    assert (two.simulated, two.circumstances.identity) == (False, Identity(serial="1"))
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
    assert coded(combined(good[0], odd, good[1]).warnings[0])[FARTHEST] == [("r1",)]
    assert FARTHEST not in coded(combined(good[0], odd).warnings[0])


def test_an_effect_is_protected_only_where_every_input_is():
    rng = np.random.default_rng(16)
    grid = np.arange(12) * TAU / 12
    drifting, steady, silent = (campaign(grid, 0.2 * ARCSEC, rng)[2] for _ in range(3))
    drifting = with_protection(drifting, drift=Protection("drift", "not protected", "one round"))
    steady = with_protection(steady, drift=Protection("drift", "tested", "closure", 1.0))
    found = combined(drifting, steady)
    assert found.unprotected == ("drift",)
    assert found.protections[0].why == "r0: one round"
    assert found.verdict_line == "ok. Not tested for: drift"
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


def test_of_values_that_nobody_measured_again_it_is_said_that_nothing_checked_them():
    grid = np.arange(12) * TAU / 12
    rng = np.random.default_rng(4)
    values = (rng.standard_normal((2, 12)) + 4.0 * np.sin(grid)) * ARCSEC
    once, again = (MeasuredCurve(grid, value, ARCSEC**2 * np.eye(12), TAU) for value in values)
    alone = combined(once)
    assert alone.verdict == "ok"
    assert set(alone.unprotected) == {*EFFECTS, "single readings"}
    assert UNCHECKED in coded(*alone.warnings)
    twice = combined(once, again)
    assert "single readings" not in twice.unprotected
    assert UNCHECKED not in coded(*twice.warnings)
