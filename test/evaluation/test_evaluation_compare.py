import json
import re
from dataclasses import replace

import numpy as np
import pytest
from chances import LONG
from text_tables import table_in

from rotcal_ros.evaluation.compare import compare, compare_all
from rotcal_ros.evaluation.reference import read_reference, subtract_polygon
from rotcal_ros.foundation.curves.measured import MeasuredCurve
from rotcal_ros.foundation.errors import BagError, DataError
from rotcal_ros.foundation.units import ARCSEC

TAU = 2.0 * np.pi


def truth(t):
    return (8.0 * np.sin(t + 0.4) + 2.0 * np.cos(3 * t + 0.5)) * ARCSEC


def curve(n, std=0.2 * ARCSEC, rng=None, offset=0.0, to_first=False, angles=None, shape=truth):
    angles = np.arange(n) * TAU / n if angles is None else angles
    n = len(angles)
    noise = np.zeros(n) if rng is None else rng.normal(0.0, std, n)
    turn = np.eye(n)
    if to_first:
        turn[:, 0] -= 1.0
    return MeasuredCurve(
        angles, turn @ (shape(angles) + noise + offset), std**2 * turn @ turn.T, TAU
    )


def test_offset_is_taken_off_and_reported():
    result = compare(curve(24), curve(24, offset=-3.0 * ARCSEC))
    assert result.offset / ARCSEC == pytest.approx(3.0, abs=1e-9)
    np.testing.assert_allclose(result.difference, 0.0, atol=1e-17)
    assert result.agree
    assert not np.any(result.interpolated)


@pytest.mark.parametrize("to_first", [False, True])
def test_normalised_errors_and_chi_square_follow_their_distributions(to_first):
    """95.45 % within one, chi-square/dof one, whatever the zero they count from."""
    rng = np.random.default_rng(11)
    errors, ratios, agreed = [], [], 0
    runs = 600 if LONG else 200
    for _ in range(runs):
        result = compare(
            curve(12, 0.3 * ARCSEC, rng, to_first=to_first),
            curve(12, 0.1 * ARCSEC, rng, offset=1.0, to_first=to_first),
        )
        errors.append(result.normalised_error)
        ratios.append(result.chi2 / result.dof)
        agreed += result.agree
    assert np.mean(np.abs(errors) <= 1.0) == pytest.approx(0.9545, abs=0.01 if LONG else 0.018)
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.07 if LONG else 0.12)
    assert agreed / runs > 0.96


def test_zero_of_a_curve_does_not_matter():
    """The same two measurements, counted from nowhere or from their first angles."""
    free, tied = (
        compare(
            curve(12, 0.3 * ARCSEC, np.random.default_rng(1), to_first=to_first),
            curve(24, 0.2 * ARCSEC, np.random.default_rng(2), to_first=to_first),
        )
        for to_first in (False, True)
    )
    np.testing.assert_allclose(tied.difference, free.difference, atol=1e-12 * ARCSEC)
    np.testing.assert_allclose(tied.normalised_error, free.normalised_error, atol=1e-9)
    assert tied.chi2 == pytest.approx(free.chi2, rel=1e-6)


def test_uncertainty_after_alignment_in_closed_form():
    """Equal independent values: the mean takes off one n-th of the variance."""
    result = compare(curve(12, 0.3 * ARCSEC), curve(12, 0.4 * ARCSEC))
    np.testing.assert_allclose(result.std, 0.5 * ARCSEC * np.sqrt(11 / 12), rtol=1e-9)
    assert (result.dof, result.interpolated.any()) == (11, False)


def test_a_real_difference_is_found():
    result = compare(curve(24), curve(24, shape=lambda t: truth(t) + 2 * ARCSEC * np.cos(2 * t)))
    assert not result.agree
    assert result.rms / ARCSEC == pytest.approx(np.sqrt(2.0), rel=1e-9)
    assert result.describe().startswith("DISAGREE: rms 1.41 arcsec, largest |E_n| 3.")


def test_every_second_angle_of_a_finer_reference_is_not_interpolated():
    result = compare(curve(24), curve(12))
    assert len(result.angles) == 12
    assert not np.any(result.interpolated)
    assert [note[:11] for note in result.notes] == ["they agree "]  # better than chance
    np.testing.assert_allclose(result.difference, 0.0, atol=1e-17)
    swapped = compare(curve(12), curve(24, offset=1e-6))
    assert swapped.offset == pytest.approx(-1e-6, abs=1e-15)


def test_interpolation_is_marked_and_said():
    angles = np.arange(10) * TAU / 10
    result = compare(curve(10, angles=angles), curve(36))
    assert np.sum(result.interpolated) == 8
    assert "8 of 10 angles were not measured by both" in result.notes[0]
    assert np.max(np.abs(result.difference)) < 0.02 * ARCSEC


def test_an_arc_is_compared_where_both_were():
    angles = np.deg2rad(np.arange(-60.0, 61.0, 5.0))
    arc = MeasuredCurve(angles, truth(angles), np.eye(25) * (0.1 * ARCSEC) ** 2, 0.0)
    result = compare(curve(24), arc)
    assert len(result.angles) == 9
    assert "15 angles lie outside" in " ".join(result.notes)
    np.testing.assert_allclose(result.difference, 0.0, atol=1e-16)
    with pytest.raises(DataError, match="9 common angles: more than 9 are needed"):
        compare(curve(24), arc, align_order=4)
    tiny = MeasuredCurve(angles[:26] / 1e3 + 0.1, truth(angles), np.eye(25), 0.0)
    with pytest.raises(DataError, match="the curves share 0 angles"):
        compare(curve(24), tiny)


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (lambda t: -truth(t), "its sign is reversed"),
        (lambda t: truth(t) / ARCSEC, "radians taken for arcseconds"),
        (lambda t: truth(t) / 3600.0, "degrees taken for arcseconds"),
        (lambda t: -truth(t) * 4.848, "sign is reversed .*; microradians and arcseconds"),
        (lambda t: -truth(-t), "counted clockwise"),
    ],
)
def test_wrong_unit_or_sense_is_named(change, text):
    result = compare(curve(24), curve(24, shape=change))
    assert not result.agree
    assert re.search(text, " ".join(result.notes))


def test_without_uncertainties_nothing_is_claimed():
    result = compare(curve(12, 0.0), curve(12, 0.0, offset=1.0))
    assert "E_n is meaningless" in result.notes[0]
    assert result.agree
    assert not compare(curve(12, 0.0), curve(12, 0.0, shape=lambda t: 2 * truth(t))).agree


def test_origin_of_radial_deviations_can_be_aligned():
    moved = curve(24, shape=lambda t: truth(t) + 5 * ARCSEC * np.cos(t))
    assert not compare(curve(24), moved).agree
    aligned = compare(curve(24), moved, align_order=1)
    assert aligned.agree
    assert aligned.dof == 21


def test_all_pairs_and_json():
    curves = {"a": curve(12), "b": curve(24), "c": curve(12, offset=1e-6)}
    pairs = compare_all(curves)
    assert set(pairs) == {("a", "b"), ("a", "c"), ("b", "c")}
    data = json.loads(json.dumps(pairs["a", "c"].to_dict(), allow_nan=False))
    assert data["agree"] is True
    assert len(data["normalised_error"]) == 12


# References and polygons.


def test_autocollimator_and_polygon():
    angles = np.arange(0, 361, 15)
    faces = np.sin(np.deg2rad(7.0 * angles))
    faces[-1] = faces[0]
    deviation = truth(np.deg2rad(angles)) / ARCSEC
    reading = "angle_deg,deviation_arcsec,u_arcsec\n" + "".join(
        f"{a},{d + f:.12f},0.3\n" for a, d, f in zip(angles, deviation, faces, strict=True)
    )
    polygon = "angle_deg,deviation_arcsec,u_arcsec\n" + "".join(
        f"{a},{f:.12f},0.4\n" for a, f in zip(angles[:-1], faces[:-1], strict=True)
    )
    table = subtract_polygon(read_reference(table_in(reading)), read_reference(table_in(polygon)))
    assert len(table.angles) == 24
    np.testing.assert_allclose(table.deviation, truth(table.angles), atol=1e-15)
    np.testing.assert_allclose(np.sqrt(np.diag(table.covariance)), 0.5 * ARCSEC)
    result = compare(curve(12), table)
    assert result.agree
    assert len(result.angles) == 12


def test_polygon_without_a_face_is_refused():
    reading = read_reference(
        table_in("angle_deg,deviation_arcsec,u_arcsec\n0,1,0\n120,2,0\n240,3,0\n")
    )
    polygon = read_reference(
        table_in("angle_deg,deviation_arcsec,u_arcsec\n0,1,0\n90,2,0\n180,3,0\n270,1,0\n")
    )
    with pytest.raises(DataError, match="no face for 120 deg"):
        subtract_polygon(reading, polygon)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("angle_deg,deviation_arcsec\n0,1\n90,1\n", "2 rows, expected at least 3"),
        ("angle_deg,deviation_arcsec\n0,1\n90\n180,1\n", "row 3: expected 2 values .*, found 1"),
        (
            "angle_deg,deviation_arcsec\n0,1\n90,one\n180,1\n",
            "row 3: deviation_arcsec must be .* found 'one'",
        ),
        ("angle_deg,deviation_arcsec\n0,1\n90,inf\n180,1\n", "row 3.*finite"),
        (
            "angle_deg,deviation_arcsec,u_arcsec\n0,1,1\n90,1,-1\n180,1,1\n",
            "row 3: the uncertainty is negative",
        ),
        ("angle_deg,deviation_arcsec\n0,1\n90,1\n90,2\n180,1\n", "90 deg occurs twice"),
        (
            "angle_deg,deviation_arcsec,u_arcsec\n0,1,0\n120,1,0\n240,1,0\n360,9,0\n",
            "differ by 8 arcsec",
        ),
        (
            "angle_deg,deviation_arcsec,u_arcsec\n0,1,0\n120,1,0\n240,1,0\n480,9,0\n",
            "more than one turn",
        ),
        ("angle_deg,deviation_arcsec\n0,1\n120,1\n240,1\n", "states no uncertainty"),
    ],
)
def test_bad_references_are_refused_with_the_place(text, expected):
    with pytest.raises(DataError, match=expected):
        read_reference(table_in(text, "ref.csv"))


@pytest.mark.parametrize(("text", "found"), [("", "''"), ("angle,dev\n", "'angle,dev'")])
def test_other_columns_are_no_reference(text, found):
    with pytest.raises(BagError, match=rf"ref\.csv: expected the header .*, found {found}"):
        read_reference(table_in(text, "ref.csv"))


def test_an_input_that_is_suspect_or_not_protected_is_named_even_where_curves_agree():
    bare = replace(curve(12), verdict_line="ok. Not tested for: drift")
    odd = replace(curve(24), verdict_line="suspect")
    fine = replace(curve(12), verdict_line="ok")
    pairs = compare_all({"a.json": bare, "b.json": odd, "c.csv": curve(12), "d.json": fine})
    assert pairs["a.json", "b.json"].agree
    assert pairs["a.json", "b.json"].notes[:2] == (
        "a.json: ok. Not tested for: drift", "b.json: suspect",
    )  # fmt: skip
    assert pairs["b.json", "c.csv"].notes[0] == "b.json: suspect"  # turned round inside
    assert not any("d.json" in note for note in pairs["c.csv", "d.json"].notes)
