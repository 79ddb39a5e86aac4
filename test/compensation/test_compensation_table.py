from dataclasses import replace

import numpy as np
import pytest
from compensation_examples import TAU, even, result_of, wavy
from scipy.interpolate import CubicSpline

from rotcal_ros.compensation.table import (
    CompensationTable,
    Correction,
    average_directions,
    resample,
    table_from_result,
)
from rotcal_ros.foundation.circumstances import Circumstances
from rotcal_ros.foundation.curves.interpolation import harmonic_estimator, interpolation_matrix
from rotcal_ros.foundation.errors import ConfigurationError, DataError
from rotcal_ros.foundation.identity import Identity
from rotcal_ros.foundation.observations import Approach
from rotcal_ros.foundation.units import ARCSEC


def test_correction_is_minus_the_deviation_and_zero_at_the_first_angle():
    angles = even(12)
    table = table_from_result(result_of(angles, wavy(angles)))
    np.testing.assert_allclose(
        table.correction_forward, wavy(0.0) - wavy(angles), rtol=0, atol=1e-18
    )
    assert table.correction_forward[0] == 0.0
    assert table.std[0] == 0.0
    assert table.period == TAU
    assert table.closed
    assert not table.directional
    assert table.verdict == "ok"


def test_spline_between_the_angles_is_scipys_periodic_spline():
    angles = even(24)
    table = table_from_result(result_of(angles, wavy(angles)), spacing=TAU / 100)
    knots = np.append(angles, TAU)
    spline = CubicSpline(knots, wavy(knots) - wavy(0.0), bc_type="periodic")
    np.testing.assert_allclose(table.correction_forward, -spline(table.angles), atol=1e-17)


def test_covariance_is_carried_through_the_interpolation():
    """Against simulated results: 4000 noisy curves, interpolated one by one."""
    rng = np.random.default_rng(4)
    angles, std = even(12), 0.5 * ARCSEC
    noise = rng.normal(0.0, std, (12, 4000))
    knots = np.append(angles, TAU)
    rows = np.arange(30) * TAU / 30
    spread = CubicSpline(knots, np.vstack([noise, noise[:1]]), bc_type="periodic")
    simulated = np.std(spread(rows) - spread(1.0), axis=1)
    table = table_from_result(
        result_of(angles, np.zeros(12), std), spacing=TAU / 30, reference_angle=1.0
    )
    np.testing.assert_allclose(table.std, simulated, rtol=0.06)


@pytest.mark.parametrize("reference", [0.0, 0.7, 4.0, 7.0, -1.0])
def test_zero_moves_to_the_reference_angle(reference):
    angles = even(36)
    table = table_from_result(result_of(angles, wavy(angles)), reference_angle=reference)
    assert table.reference_angle == pytest.approx(reference % TAU)
    at_reference = Correction(table)(reference, Approach.POSITIVE)
    np.testing.assert_allclose(at_reference, 0.0, atol=1e-17)
    expected = wavy(reference) - wavy(angles)
    np.testing.assert_allclose(table.correction_forward, expected, atol=5e-3 * ARCSEC)


def test_harmonic_fit_recovers_the_harmonics_and_says_what_it_left():
    angles = even(36)
    exact = table_from_result(result_of(angles, wavy(angles)), harmonics=5, spacing=TAU / 90)
    expected = wavy(0.0) - wavy(exact.angles)
    np.testing.assert_allclose(exact.correction_forward, expected, atol=1e-15)
    short = table_from_result(result_of(angles, wavy(angles)), harmonics=2)
    assert any("leave out 0.707 arcsec rms" in text for text in short.warnings)
    # What stays of independent noise after fitting p of n parameters: sqrt(p / n).
    np.testing.assert_allclose(np.mean(exact.std**2), 22 / 36 * (0.1 * ARCSEC) ** 2, rtol=0.1)


def test_weighted_harmonics_are_generalised_least_squares():
    """Against the normal equations with a regular covariance."""
    rng = np.random.default_rng(1)
    angles = even(15)
    square = rng.normal(size=(15, 15))
    covariance = square @ square.T + np.eye(15)
    basis = np.column_stack(
        [np.ones(15), np.cos(angles), np.sin(angles), np.cos(2 * angles), np.sin(2 * angles)]
    )
    inverse = np.linalg.inv(covariance)
    expected = np.linalg.solve(basis.T @ inverse @ basis, basis.T @ inverse)
    estimator = harmonic_estimator(angles, 2, covariance)
    np.testing.assert_allclose(estimator[1:], expected[1:], atol=1e-9)


@pytest.mark.parametrize("order", [-1, 6])
def test_too_many_harmonics_are_refused_with_the_number(order):
    angles = even(12)
    with pytest.raises(DataError, match="at most 5"):
        table_from_result(result_of(angles, wavy(angles)), harmonics=order)


def test_both_directions_are_of_one_item():
    angles = even(12)

    def of(item, serial):
        identity = Identity(item=item, serial=serial)
        return replace(result_of(angles, wavy(angles)), circumstances=Circumstances(
            identity=identity,
        ))  # fmt: skip

    known, unknown = of("table", "1"), of("", "")
    assert table_from_result(known, reverse=known).item == "table no. 1"
    assert table_from_result(unknown, reverse=known).item == "table no. 1"
    assert table_from_result(unknown).item == ""
    with pytest.raises(DataError, match=r"different items, no\. 1 and no\. 2"):
        table_from_result(known, reverse=of("table", "2"))


def test_both_directions_keep_the_reversal():
    angles = even(18)
    up, down = wavy(angles), wavy(angles) - 4.0 * ARCSEC
    table = table_from_result(result_of(angles, up), reverse=result_of(angles, down))
    np.testing.assert_allclose(
        table.correction_reverse - table.correction_forward, 4.0 * ARCSEC, atol=1e-18
    )
    assert not table.warnings
    mean = average_directions(table)
    np.testing.assert_allclose(mean.correction_forward, table.correction_forward, atol=1e-18)
    assert "4 arcsec of reversal remain" in mean.warnings[-1]


def test_reverse_uncertainty_holds_the_forward_zero_too():
    """Independent runs, value s at every angle after the first: 2 s^2 there, 2 s^2 at the zero."""
    angles, s = even(18), 0.3 * ARCSEC
    run = result_of(angles, np.zeros(18), s)
    table = table_from_result(run, reverse=run, reference_angle=angles[4])
    np.testing.assert_allclose(table.std_reverse[[2, 9]], 2.0 * s, rtol=1e-12)
    np.testing.assert_allclose(table.std[[2, 9]], np.sqrt(2.0) * s, rtol=1e-12)
    alone = table_from_result(run, reference_angle=angles[4])
    np.testing.assert_allclose(alone.std[[2, 4, 9]], [np.sqrt(2.0) * s, 0.0, np.sqrt(2.0) * s])


def test_runs_with_a_zero_each_have_lost_the_reversal_and_say_so():
    angles = even(18)
    values = wavy(angles) - wavy(0.0)
    table = table_from_result(result_of(angles, values), reverse=result_of(angles, values * 1.1))
    assert any("reversal at the reference angle is not in the table" in w for w in table.warnings)


def test_reverse_run_at_other_angles_is_refused():
    with pytest.raises(DataError, match="same angles"):
        table_from_result(
            result_of(even(12), np.zeros(12)), reverse=result_of(even(9), np.zeros(9))
        )


def test_worse_verdict_of_both_runs_counts():
    angles = even(12)
    suspect = result_of(angles, np.zeros(12), verdict="suspect")
    table = table_from_result(result_of(angles, np.zeros(12)), reverse=suspect)
    assert table.verdict == "suspect"


def test_closing_position_is_checked_and_averaged():
    angles = np.append(even(16), TAU)
    deviation = wavy(angles)
    deviation[-1] += 0.2 * ARCSEC
    table = table_from_result(result_of(angles, deviation), reference_angle=np.pi)
    assert len(table.angles) == 16
    expected = wavy(np.pi) - wavy(0.0) - 0.1 * ARCSEC
    np.testing.assert_allclose(table.correction_forward[0], expected, atol=1e-17)
    deviation[-1] += 5.0 * ARCSEC
    with pytest.raises(DataError, match=r"do not close: at 0 and 360 deg.* 5\.2 arcsec"):
        table_from_result(result_of(angles, deviation))


def test_closure_knows_correlations():
    """Errors common to both readings of one position do not excuse a gap between them."""
    angles = np.append(even(16), TAU)
    deviation = np.append(np.zeros(16), 3.0 * ARCSEC)
    free = result_of(angles, deviation, 2.0 * ARCSEC)
    loose = type(free)(**{**vars(free), "covariance": {"ECC": np.eye(17) * ARCSEC**2}})
    assert table_from_result(loose).closed
    common = (np.full((17, 17), 0.99) + 0.01 * np.eye(17)) * ARCSEC**2
    tight = type(free)(**{**vars(free), "covariance": {"ECC": common}})
    with pytest.raises(DataError, match=r"standard uncertainty of 0\.141 arcsec"):
        table_from_result(tight)


def test_an_arc_says_that_it_is_one():
    angles = np.deg2rad(np.arange(0, 151, 15))
    table = table_from_result(result_of(angles, wavy(angles)))
    assert table.period == 0.0
    assert any("only an arc (0 .. 150 deg)" in text for text in table.warnings)
    with pytest.raises(DataError, match=r"200 deg lies outside the measured arc 0 \.\. 150"):
        Correction(table)(np.deg2rad(200.0), Approach.POSITIVE)
    with pytest.raises(DataError, match="outside the measured arc"):
        table_from_result(result_of(angles, wavy(angles)), reference_angle=3.0)
    with pytest.raises(ConfigurationError, match="full circle"):
        table_from_result(result_of(angles, wavy(angles)), harmonics=1)


def test_an_arc_keeps_its_ends_when_resampled():
    angles = np.deg2rad([-33.0, -20.0, 0.0, 25.0, 41.0])
    rows = resample(table_from_result(result_of(angles, wavy(angles))), np.deg2rad(10.0)).angles
    np.testing.assert_allclose(np.rad2deg(rows), [-33, -30, -20, -10, 0, 10, 20, 30, 40, 41])


def test_angles_in_any_order_and_turn_give_the_same_table():
    angles = even(12)
    shuffled = np.random.default_rng(0).permutation(12)
    turned = np.where(np.arange(12) % 2, angles - TAU, angles)[shuffled]
    one = table_from_result(result_of(angles, wavy(angles)), reference_angle=0.0)
    other = table_from_result(result_of(turned, wavy(turned)), reference_angle=0.0)
    np.testing.assert_allclose(one.angles, other.angles, atol=1e-14)
    np.testing.assert_allclose(one.correction_forward, other.correction_forward, atol=1e-18)


def test_bad_results_are_refused_with_the_place():
    angles = even(12)
    broken = wavy(angles)
    broken[3] = np.nan
    with pytest.raises(DataError, match=r"ECC is nan at 90 deg"):
        table_from_result(result_of(angles, broken))
    other = result_of(angles, wavy(angles))
    lacking = type(other)(**{**vars(other), "deviations": {"EXC": np.zeros(12)}})
    with pytest.raises(DataError, match="holds no ECC, only EXC"):
        table_from_result(lacking)
    with pytest.raises(DataError, match="12 angles"):
        type(other)(**{**vars(other), "deviations": {"ECC": np.zeros(5)}})


def table_with(**changes):
    fields = {
        "axis": "C",
        "method": "m",
        "angles": even(4),
        "correction_forward": np.zeros(4),
        "correction_reverse": np.zeros(4),
        "std": np.zeros(4),
        "period": TAU,
        "reference_angle": 0.0,
        "verdict": "ok",
    }
    return CompensationTable(**{**fields, **changes})


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"axis": "../C"}, "axis name"),
        ({"std": np.zeros(3)}, "std has shape"),
        ({"correction_reverse": np.array([0, np.inf, 0, 0])}, "row 1 is inf"),
        ({"angles": np.array([0.0, 1.0, 1.0, 2.0])}, "row 2 does not ascend"),
        ({"period": 360.0}, "period 360"),
        ({"angles": np.linspace(0.0, TAU, 4)}, "last row repeats the first"),
    ],
)
def test_a_table_that_does_not_hold_together_is_refused(changes, text):
    with pytest.raises((DataError, ConfigurationError), match=text):
        table_with(**changes)


def test_hash_feels_every_bit_and_survives_a_copy():
    one = table_with()
    assert one.table_hash == table_with().table_hash
    nudged = np.zeros(4)
    nudged[2] = np.nextafter(0.0, 1.0)
    for change in (
        {"std": nudged},
        {"correction_forward": nudged},
        {"axis": "A"},
        {"verdict": "suspect"},
        {"reference_angle": 1e-300},
    ):
        assert table_with(**change).table_hash != one.table_hash


def test_arrays_of_a_table_cannot_be_changed():
    with pytest.raises(ValueError, match="read-only"):
        table_with().angles[0] = 1.0


def test_interpolation_passes_through_the_rows_in_every_turn():
    angles = np.sort(np.random.default_rng(3).uniform(0.0, TAU, 9))
    values = wavy(angles)
    for turn in (-2, 0, 3):
        weights = interpolation_matrix(angles, angles + turn * TAU, TAU)
        np.testing.assert_allclose(weights @ values, values, atol=1e-18)


def test_two_rows_of_a_circle_are_joined_by_lines():
    angles = np.array([1.0, 4.0])
    at = np.linspace(-3.0, 9.0, 50)
    expected = np.interp(at, angles, wavy(angles), period=TAU)
    np.testing.assert_allclose(
        interpolation_matrix(angles, at, TAU) @ wavy(angles), expected, atol=1e-18
    )


def test_lookup_wraps_knows_directions_and_its_uncertainty():
    angles = even(36)
    table = table_from_result(
        result_of(angles, wavy(angles)), reverse=result_of(angles, wavy(angles) + 1e-5)
    )
    look = Correction(table)
    at = np.linspace(-10.0, 10.0, 101)
    expected = wavy(0.0) - wavy(at)
    np.testing.assert_allclose(look(at, Approach.POSITIVE), expected, atol=5e-3 * ARCSEC)
    np.testing.assert_allclose(look(at, Approach.NEGATIVE), expected - 1e-5, atol=5e-3 * ARCSEC)
    np.testing.assert_allclose(look.std(angles), table.std, atol=1e-18)
    with pytest.raises(ConfigurationError, match="the side from which"):
        look(0.0, Approach.UNKNOWN)


def test_resampled_uncertainty_is_never_below_the_exact_one():
    angles = even(12)
    result = result_of(angles, wavy(angles), 0.3 * ARCSEC)
    bound = resample(table_from_result(result), TAU / 50, reference_angle=2.0).std
    exact = table_from_result(result, spacing=TAU / 50, reference_angle=2.0).std
    assert np.all(bound >= exact - 1e-18)


@pytest.mark.parametrize("spacing", [0.0, -1.0, 4.0, np.nan, 1e-9])
def test_impossible_spacing_is_refused(spacing):
    with pytest.raises(ConfigurationError, match="spacing"):
        table_from_result(result_of(even(8), np.zeros(8)), spacing=spacing)
