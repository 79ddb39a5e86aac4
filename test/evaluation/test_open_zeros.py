"""Zeros that nothing joins: compared without them, joined by a second result, never ignored."""

from dataclasses import replace

import numpy as np
import pytest
from two_groups import ALTERNATING, ANGLES, ARCSEC, GRID, plate_problem

from rotcal_ros.evaluation.combination import CombinationInput
from rotcal_ros.evaluation.compare import compare
from rotcal_ros.evaluation.harmonics import harmonic_content
from rotcal_ros.evaluation.iso230 import runs_of
from rotcal_ros.evaluation.joint import combine
from rotcal_ros.evaluation.marks import conformities
from rotcal_ros.evaluation.quick_check import quick_check
from rotcal_ros.foundation.curves.measured import MeasuredCurve, measured_curve
from rotcal_ros.foundation.errors import DataError
from rotcal_ros.foundation.identity import Identity
from rotcal_ros.foundation.results import RepeatedRuns
from rotcal_ros.methods import find_method
from rotcal_ros.methods.ball_plate.solver import solve
from rotcal_ros.planning.check_rule import CheckRule

NOISE = 0.05 * ARCSEC
SIX = solve(plate_problem())
TWELVE = solve(plate_problem(range(GRID), seed=1))


def autocollimator(angles=ANGLES, seed=0, noise=NOISE):
    """Readings of the alternating table with a zero of their own."""
    rng = np.random.default_rng(seed)
    index = np.round(angles / ANGLES[1]).astype(int)
    values = ALTERNATING[index] + 3.0 * ARCSEC + rng.normal(0.0, noise, len(angles))
    return MeasuredCurve(angles, values, noise**2 * np.eye(len(angles)), 2.0 * np.pi)


def combined(*sources, names=("six", "other")):
    return combine([CombinationInput.of(n, s) for n, s in zip(names, sources, strict=True)]).result


@pytest.mark.parametrize("component", ["EXC", "EYC", "EZC", "EAC", "EBC", "ECC"])
def test_six_balls_agree_with_twelve_but_for_what_they_leave_open(component):
    curves = [measured_curve(r, component) for r in (SIX, TWELVE)]
    found = compare(*curves, names=("six", "twelve"))
    assert found.agree
    # twelve differences less two zeros; in a pair also less what turns with the second group
    assert found.dof == (GRID - 2 if component in ("EZC", "ECC") else GRID - 4)
    assert "such offsets are removed" in found.notes[0]
    backward = compare(*curves[::-1])
    np.testing.assert_allclose(backward.difference, -found.difference, atol=1e-18)


def test_what_is_wrong_within_a_group_is_seen():
    wrong = SIX.deviations["ECC"] + 1.0 * ARCSEC * (np.arange(GRID) == 4)
    off = replace(SIX, deviations={**SIX.deviations, "ECC": wrong})
    assert not compare(measured_curve(off), measured_curve(TWELVE)).agree


@pytest.mark.parametrize("other", ["autocollimator", "twelve balls"])
def test_a_second_result_tells_the_offset(other):
    """It was the good one that became suspect."""
    source = autocollimator() if other == "autocollimator" else TWELVE
    found = combined(SIX, source)
    assert found.verdict == "ok"
    assert found.zeros.free == ()
    assert found.zeros.counts_from == "mean"
    error = found.deviations["ECC"] - ALTERNATING
    assert np.abs(error).max() < 4.0 * found.std["ECC"].max()
    link = next(link for link in found.details["links"] if link["component"] == "ECC")
    # by hand: the mean of six differences less that of the other six
    assert link["offset"] == pytest.approx(4.0 * ARCSEC, abs=4.0 * link["std"])
    if other == "autocollimator":
        assert link["std"] == pytest.approx(NOISE * np.sqrt(2.0 / 6.0), rel=0.02)
        assert found.components == ("ECC",)
        assert any("EBC left out: no input measured the offset" in w for w in found.warnings)
    else:
        assert found.components == SIX.components
    sentence = next(w for w in found.warnings if w.startswith("ECC of six"))
    assert "comes from other alone: nothing checks that, its stated uncertainty rules" in sentence
    assert f"it adds up to {2 * link['share'] / ARCSEC:.2g} arcsec" in sentence
    # what is added: half the offset, to every value
    assert link["share"] == pytest.approx(link["std"] / 2.0)


def test_of_three_groups_each_link_says_which_one_it_is_of():
    """Every third position belongs together; group 1 is 3 arcsec off, group 2 is not."""
    ecc = 3.0 * ARCSEC * (np.arange(GRID) % 3 == 1)
    three = solve(plate_problem(range(0, GRID, 3), ecc=ecc, separate_groups=True))
    found = combined(three, solve(plate_problem(range(GRID), ecc=ecc, seed=2)))
    links = [link for link in found.details["links"] if link["component"] == "ECC"]
    # against the mean of the eight others, what is to be added: -3, and the 12 of four by eight
    for link, angle, offset in zip(links, (30, 60), (-3.0, 1.5), strict=True):
        assert f"that with {angle} deg against the others" in link["name"]
        assert link["offset"] == pytest.approx(offset * ARCSEC, abs=5.0 * link["std"])


def test_the_uncertainty_with_a_link_holds_the_truth():
    """95 % of 12 values in 200 worlds, the offset between the groups drawn anew each time."""
    inside, offsets, sound = 0, 0, 0
    for seed in range(200):
        rng = np.random.default_rng(1000 + seed)
        noise = 0.1 * ARCSEC * rng.standard_normal(GRID)
        own = 0.03 * ARCSEC * rng.standard_normal(GRID)
        groups = np.arange(GRID) % 2
        offset = 5.0 * ARCSEC * rng.standard_normal()
        covariance = (0.03 * ARCSEC) ** 2 * np.eye(GRID)
        six = replace(
            SIX,
            deviations={"ECC": ALTERNATING + own + offset * groups},
            std={"ECC": np.sqrt(np.diag(covariance))},
            covariance={"ECC": covariance},
            zeros=replace(SIX.zeros, free=SIX.zeros.free[5:6]),
        )
        other = MeasuredCurve(
            ANGLES, ALTERNATING + noise, (0.1 * ARCSEC) ** 2 * np.eye(GRID), 2 * np.pi
        )
        found = combined(six, other)
        sound += found.verdict == "ok"
        inside += np.sum(np.abs(found.deviations["ECC"] - ALTERNATING) < 1.96 * found.std["ECC"])
        link = found.details["links"][0]
        offsets += abs(link["offset"] - offset) < 1.96 * link["std"]
    assert 0.93 < inside / (200 * GRID) < 0.97
    assert 180 <= offsets <= 199
    assert sound >= 190


def test_what_sees_one_group_only_joins_nothing():
    found = combined(SIX, autocollimator(ANGLES[::2]))
    assert found.verdict == "suspect"
    assert "the odd and even table positions is not measured" in found.verdict_line
    assert found.zeros.of("ECC", GRID).any()


def test_a_line_between_other_angles_joins_nothing():
    """Read off between its angles, a curve of two zeros would follow them up and down."""
    between = np.linspace(0.0, 2.0 * np.pi, 8)[1:] - 0.1
    values = MeasuredCurve(between, np.zeros(7), NOISE**2 * np.eye(7), 2.0 * np.pi)
    found = combined(SIX, values)
    assert found.verdict == "suspect"
    assert found.zeros.of("ECC", len(found.angles)).any()


def test_two_results_with_the_same_groups_stay_two_groups():
    again = solve(plate_problem(seed=5))
    found = combined(SIX, again)
    assert found.verdict == "suspect"
    assert found.components == SIX.components
    assert len(found.zeros.free) == 10
    assert found.std["ECC"].max() < 0.8 * SIX.std["ECC"].max()


def test_a_doubtful_input_stays_doubtful_however_it_is_joined():
    assert combined(SIX.as_suspect(), TWELVE).verdict == "suspect"


def test_a_link_that_one_input_alone_determines_is_named():
    """What the link errs by goes into the result, and nothing contradicts it."""
    alternating = ALTERNATING + 0.3 * ARCSEC * (-1.0) ** np.arange(GRID)
    wrong = solve(plate_problem(range(GRID), ecc=alternating, seed=8))
    found = combined(SIX, wrong)
    off = np.abs(found.deviations["ECC"] - ALTERNATING) / found.std["ECC"]
    assert off.max() > 10.0
    assert "gauge" in found.unprotected
    gauge = next(p for p in found.protections if p.effect == "gauge")
    assert "comes from other alone, whose error nothing checks" in gauge.why


def test_of_two_inputs_that_determine_a_link_each_checks_the_other():
    names = ("six", "twelve", "reading")
    sources = (SIX, TWELVE, autocollimator())
    found = combine([CombinationInput.of(*each) for each in zip(names, sources, strict=True)])
    link = next(k for k in found.result.details["links"] if k["component"] == "ECC")
    assert link["others"] == ("twelve", "reading")
    assert "comes from twelve, reading; it adds" in " ".join(found.result.warnings)
    again = solve(plate_problem(seed=5))
    found = combine([
        CombinationInput.of(*each) for each in zip(names, (SIX, TWELVE, again), strict=True)
    ])  # fmt: skip
    of_six = [k for k in found.result.details["links"] if k["input"] == "six"]
    assert {k["others"] for k in of_six} == {("twelve",)}  # six other balls leave it open, too


def test_no_tolerance_is_met_with_an_offset_open():
    identity = Identity(tolerance_arcsec=1.0)
    (found,) = (c for c in conformities(SIX, identity) if c.component == "ECC")
    assert found.decision == "undecided"
    assert "the offset between the odd and even" in found.describe(SIX)
    assert {c.decision for c in conformities(TWELVE, identity) if c.component == "ECC"} == {
        "beyond"
    }


def test_ranges_over_both_groups_are_not_evaluated():
    table = np.zeros((GRID, 2))
    with pytest.raises(DataError, match="figures of ISO 230-2"):
        runs_of(replace(SIX, runs=RepeatedRuns(ANGLES, table, table)))
    assert runs_of(replace(TWELVE, runs=RepeatedRuns(ANGLES, table, table))) is not None


def test_no_harmonics_of_a_curve_of_parts():
    with pytest.raises(DataError, match="look like harmonics"):
        harmonic_content(measured_curve(SIX))


def test_a_quick_check_against_parts_is_undecided():
    rule = CheckRule(3.0 * ARCSEC, 0.05, 0.05, 0.0)
    for earlier, new in ((SIX, TWELVE), (TWELVE, SIX)):
        found = quick_check(measured_curve(earlier), measured_curve(new), rule)
        assert found.verdict == "undecided"
    assert quick_check(measured_curve(TWELVE), autocollimator(), rule).verdict == "still valid"


def test_people_read_what_the_curves_count_from():
    """Of two groups the page said 'zero mean over the measured angles', above a range of both."""
    words = find_method("ball_plate").zero
    assert "over the measured angles (zero-mean gauge)." in words(TWELVE)[0]
    assert "of each group (zero-mean gauge): steps from group to group" in words(SIX)[0]
    bounded = solve(plate_problem(group_allowance=1e-6))
    assert words(bounded)[0].endswith("of each group (zero-mean gauge).")
