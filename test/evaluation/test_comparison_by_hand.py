"""A comparison against independent formulas: E_n, chi-square, verdict, words, ends of arcs."""

import math

import numpy as np
import pytest
from scipy import linalg, stats

from rotcal_ros.evaluation.compare import TOO_ALIKE, Comparison, compare, compare_all
from rotcal_ros.foundation.curves.measured import MeasuredCurve
from rotcal_ros.foundation.errors import DataError
from rotcal_ros.foundation.units import ARCSEC, MICROMETRE

TAU = 2.0 * np.pi


def circle(deviation, covariance):
    n = len(deviation)
    return MeasuredCurve(np.arange(n) * TAU / n, np.asarray(deviation), covariance, TAU)


def covariances(n, rng):
    root = rng.normal(size=(n, n))
    return root @ root.T / n


def by_definition(d, c, order):
    """Aligned differences, their uncertainties, chi-square by the normal equations, the offset."""
    n = len(d)
    t = np.arange(n) * TAU / n
    basis = np.column_stack([f(k * t) for k in range(order + 1) for f in (np.cos, np.sin)])
    basis = np.delete(basis, 1, axis=1)  # the sine of order 0
    hat = basis @ np.linalg.pinv(basis)
    spread = (np.eye(n) - hat) @ c @ (np.eye(n) - hat).T
    inverse = linalg.inv(c)
    unknowns = linalg.solve(basis.T @ inverse @ basis, basis.T @ inverse @ d)
    left = d - basis @ unknowns
    aligned = d - hat @ d
    return aligned, np.sqrt(np.diag(spread)), left @ inverse @ left, d.mean()


def binomial_limit(n):
    """The smallest number that 99 % of n honest |E_n| above 1 do not exceed."""
    p, total = math.erfc(2.0 / math.sqrt(2.0)), 0.0
    for k in range(n + 1):
        total += math.comb(n, k) * p**k * (1.0 - p) ** (n - k)
        if total >= 0.99:
            return k
    raise AssertionError


@pytest.mark.parametrize("order", [0, 1])
def test_every_figure_is_that_of_its_definition(order):
    """Correlated curves of every quality, so that each reason for a verdict occurs."""
    rng = np.random.default_rng(3)
    seen = set()
    for scale in np.repeat([0.5, 1.0, 1.3, 1.6, 2.5], 16):
        n = 9
        c1, c2 = covariances(n, rng), covariances(n, rng)
        noise = rng.multivariate_normal(np.zeros(n), c1 + c2) * scale
        found = compare(circle(noise + 3.0, c1), circle(np.zeros(n), c2), align_order=order)
        aligned, std, chi2, offset = by_definition(noise + 3.0, c1 + c2, order)
        np.testing.assert_allclose(found.difference, aligned, atol=1e-12)
        np.testing.assert_allclose(found.std, std, rtol=1e-8)
        np.testing.assert_allclose(found.normalised_error, aligned / (2.0 * std), rtol=1e-7)
        assert found.chi2 == pytest.approx(chi2, rel=1e-6)
        assert found.offset == pytest.approx(offset, rel=1e-9)
        assert found.dof == n - 1 - 2 * order
        assert found.rms == pytest.approx(math.sqrt(sum(aligned**2) / n))
        assert found.largest == pytest.approx(max(abs(aligned / (2.0 * std))))
        p_value = 1.0 - stats.chi2.cdf(chi2, n - 1 - 2 * order)
        assert found.p_value == pytest.approx(p_value, abs=1e-9)
        above = sum(abs(aligned) > 2.0 * std)
        usual, likely = above <= binomial_limit(n), p_value >= 0.01
        assert found.agree == (above == 0 or (usual and likely))
        seen.add((min(above, 1), above == binomial_limit(n), usual, likely))
    assert {(1, False, True, True), (1, True, True, True), (1, False, True, False)} <= seen
    assert {(1, False, False, True), (1, False, False, False), (0, False, True, True)} <= seen


def test_the_other_way_round_all_signs_turn():
    """Also where the curve with fewer angles is the second one, with its harmonics aligned."""
    rng = np.random.default_rng(4)
    fine, coarse = circle(rng.normal(size=12), np.eye(12)), circle(rng.normal(size=6), np.eye(6))
    one, other = compare(fine, coarse, 1), compare(coarse, fine, 1)
    for name in ("difference", "normalised_error", "offset"):
        np.testing.assert_array_equal(getattr(one, name), -getattr(other, name))
    for name in ("angles", "std", "interpolated", "chi2", "dof", "p_value", "agree", "notes"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    assert other.offset == pytest.approx((coarse.deviation - fine.deviation[::2]).mean())
    assert one.dof == 6 - 3


def test_equal_numbers_of_angles_keep_the_angles_of_the_first():
    turned = MeasuredCurve(np.arange(6) * TAU / 6 + 0.3, np.zeros(6), np.eye(6), TAU)
    np.testing.assert_array_equal(compare(turned, circle(np.zeros(6), np.eye(6))).angles,
                                  turned.angles)  # fmt: skip


def test_all_pairs_are_aligned_alike():
    curves = {name: circle(np.zeros(6), np.eye(6)) for name in "abc"}
    assert {pair.dof for pair in compare_all(curves, align_order=1).values()} == {3}
    assert {pair.dof for pair in compare_all(curves).values()} == {5}


def test_as_many_angles_as_unknowns_are_too_few():
    assert compare(circle(np.arange(4.0), np.eye(4)), circle(np.zeros(4), np.eye(4)), 1).dof == 1
    with pytest.raises(DataError, match="3 common angles: more than 3 are needed to compare"):
        compare(circle(np.arange(3.0), np.eye(3)), circle(np.zeros(3), np.eye(3)), 1)


def comparison(**changes):
    values = {
        "angles": np.array([0.0, TAU / 8, TAU / 4]),
        "difference": np.array([1.0, -2.5, 0.0]) * ARCSEC,
        "std": np.array([0.5, 1.0, 2.0]) * ARCSEC,
        "normalised_error": np.array([1.0, -1.25, 0.0]),
        "interpolated": np.array([False, True, False]),
        "offset": 3.0,
        "rms": 1.5 * ARCSEC,
        "chi2": 5.0,
        "dof": 2,
        "p_value": 0.25,
        "agree": True,
        "notes": ("a note",),
    }
    return Comparison(**{**values, **changes})


def test_words_and_rows_by_hand():
    """An E_n of exactly 1 is not above 1."""
    line = "rms 1.5 arcsec, largest |E_n| 1.25 at 45 deg, 1 of 3 above 1, chi2/dof 2.50"
    assert comparison().describe() == f"agree: {line}"
    assert comparison(agree=False).describe() == f"DISAGREE: {line}"
    metres = comparison(rms=0.25 * MICROMETRE)
    assert metres.describe(MICROMETRE, "um").startswith("agree: rms 0.25 um, largest")
    assert comparison().rows(ARCSEC) == [
        ("0.0000", "+1.0", "1.0", "+1.00"),
        ("45.0000", "-2.5", "2.0", "-1.25"),
        ("90.0000", "0.0", "4.0", "+0.00"),
    ]


def test_the_plain_form_holds_every_figure():
    found = comparison().to_dict()
    assert found["angles"] == [0.0, TAU / 8, TAU / 4]
    assert found["std"] == [0.5 * ARCSEC, ARCSEC, 2.0 * ARCSEC]
    assert found["interpolated"] == [False, True, False]
    assert found["notes"] == ["a note"]
    scalars = {"offset": 3.0, "chi2": 5.0, "dof": 2, "p_value": 0.25, "agree": True}
    assert {name: found[name] for name in scalars} == scalars
    assert set(found) == {*scalars, "angles", "std", "interpolated", "notes", "difference",
                          "normalised_error", "rms"}  # fmt: skip


def test_without_uncertainty_a_difference_is_too_large_by_any_measure():
    none = np.zeros((4, 4))
    found = compare(circle([3.0, -1.0, -1.0, -1.0], none), circle(np.zeros(4), none))
    np.testing.assert_array_equal(found.normalised_error, [1e6, -1e6, -1e6, -1e6])
    assert (found.chi2, found.p_value, found.agree) == (0.0, 0.0, False)
    same = compare(circle(np.ones(4), none), circle(np.zeros(4), none))
    np.testing.assert_array_equal(same.normalised_error, np.zeros(4))
    assert (same.chi2, same.p_value, same.agree) == (0.0, 1.0, True)


# Angles in common.


@pytest.mark.parametrize(
    ("away", "interpolated"), [(0.9e-6, False), (-0.9e-6, False), (1.1e-6, True), (-1.1e-6, True)]
)
def test_a_microradian_apart_is_measured_by_both(away, interpolated):
    """At angle 0, where the other curve's angle may lie just below the full turn."""
    moved = np.arange(8) * TAU / 8
    moved[0] += away
    second = MeasuredCurve(np.sort(np.mod(moved, TAU)), np.zeros(8), np.eye(8), TAU)
    found = compare(circle(np.zeros(8), np.eye(8)), second)
    assert found.interpolated.tolist() == [interpolated] + [False] * 7
    note = "1 of 8 angles were not measured by both: interpolated there"
    alike = f"{TOO_ALIKE} (chi2/dof 0.00)"  # they are equal
    assert found.notes == ((note,) if interpolated else ()) + (alike,)


def arc(degrees, deviation):
    n = len(degrees)
    return MeasuredCurve(np.deg2rad(degrees), np.asarray(deviation), np.eye(n), 0.0)


DEGREES = np.arange(0.0, 60.1, 2.5)
BENT = (DEGREES / 10.0) ** 2


@pytest.mark.parametrize(
    ("ends", "common"),
    [((0.0, 0.0), 5), ((2e-8, -2e-8), 5), ((2e-7, -2e-8), 4), ((2e-8, -2e-7), 4)],
)
def test_the_ends_of_an_arc_belong_to_it(ends, common):
    """A circle every 15 degrees and an arc 0 .. 60: a nanoradian (6e-8 deg) short is nothing."""
    degrees = DEGREES.copy()
    degrees[[0, -1]] += ends
    found = compare(circle(np.zeros(24), np.eye(24)), arc(degrees, BENT))
    assert len(found.angles) == common
    assert found.notes[0] == f"{24 - common} angles lie outside the other's arc: left out"
    first = 0 if common == 5 or ends[0] < 1e-7 else 1
    expected = -((np.arange(first, first + common) * 1.5) ** 2)
    np.testing.assert_allclose(found.difference, expected - expected.mean(), atol=1e-6)
    assert found.angles[0] >= np.deg2rad(degrees[0])
    assert found.angles[-1] <= np.deg2rad(degrees[-1])


def test_two_arcs_share_what_both_cover():
    """-30 .. 20 against 0 .. 60 degrees: an arc's angles are not wrapped."""
    left = arc(np.arange(-30.0, 20.1, 10.0), np.zeros(6))
    found = compare(left, arc(DEGREES, np.zeros(25)))
    np.testing.assert_allclose(np.rad2deg(found.angles), [0.0, 10.0, 20.0], atol=1e-12)
    full = arc(np.arange(330.0, 380.1, 10.0), np.zeros(6))
    with pytest.raises(DataError, match=r"share 0 angles: the second covers only -?\d.* \.\. 60 "):
        compare(full, arc(DEGREES, np.zeros(25)))


@pytest.mark.parametrize(("last", "common"), [(15.0, 2), (14.0, 1)])
def test_two_angles_in_common_are_enough_for_an_offset(last, common):
    degrees = np.linspace(0.0, last, 31)
    if common == 2:
        assert compare(circle(np.zeros(24), np.eye(24)), arc(degrees, degrees)).dof == 1
        return
    with pytest.raises(DataError, match=r"the curves share 1 angles: the second covers only"):
        compare(circle(np.zeros(24), np.eye(24)), arc(degrees, degrees))


def test_a_sense_of_rotation_is_sought_on_circles_only():
    """A curve at the negative angles, negative: what a clockwise scale gives."""
    rng = np.random.default_rng(1)
    shape = rng.normal(size=24)
    small = 1e-6 * np.eye(24)
    clockwise = -shape[(-np.arange(24)) % 24]
    notes = " ".join(compare(circle(shape, small), circle(clockwise, small)).notes)
    assert "counted clockwise?" in notes
    first, second = (
        MeasuredCurve(np.arange(24) * TAU / 48, d, small, 0.0) for d in (shape, clockwise)
    )
    assert compare(first, second).notes == ()


def test_curves_that_agree_are_under_no_suspicion():
    """One is the other with its sign turned, within the uncertainties or far beyond them."""
    t = np.arange(24) * TAU / 24
    for size in (1e-3, 1e3):
        found = compare(
            circle(size * np.sin(t), np.eye(24)), circle(-size * np.sin(t), np.eye(24))
        )
        assert found.agree == (size < 1.0)
        assert ("its sign is reversed" in " ".join(found.notes)) == (size > 1.0)
