"""A reversal that was measured gets to the controller, whatever the angles are.

Curves of either direction are drawn at random, measured with noise, and the file is applied by a
model of each control that knows nothing but the text.
"""

import re
from dataclasses import replace
from datetime import datetime, timezone

import numpy as np
import pytest
from compensation_examples import TAU, even, result_of, wavy
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from independent_controls import CONTROLS

from rotcal_ros.compensation.export import prepare_export
from rotcal_ros.compensation.table import table_from_result
from rotcal_ros.compensation.volumetric import volumetric_files
from rotcal_ros.foundation.errors import ConfigurationError, DataError
from rotcal_ros.foundation.results import RepeatedRuns, Result
from rotcal_ros.foundation.units import ARCSEC, DEGREE
from rotcal_ros.methods.arrivals import Arrivals, mean_of_runs

NOW = datetime(2026, 1, 2, 3, 4, 5, tzinfo=timezone.utc)
SPACING = 5.0 * DEGREE
COMMANDS = np.linspace(0.0, 360.0, 1441)


def both_ways(angles, up, down, std=1e-4 * ARCSEC, seed=0, runs=1):
    """The result of runs to and fro over ``angles``, each arrival with noise of its own."""
    n = len(angles)
    target = np.tile(np.concatenate([np.arange(n), np.arange(n)[::-1]]), runs)
    upward = np.tile(np.repeat([True, False], n), runs)
    arrivals = Arrivals(angles, target, np.repeat(np.arange(runs), 2 * n), upward)
    at = angles[target]
    ecc = np.where(upward, up(at), down(at))
    ecc = ecc + std * np.random.default_rng(seed).standard_normal(len(at))
    covariance = std**2 * np.eye(len(at))
    measured = Result(
        method="simulated",
        angles=at,
        deviations={"ECC": ecc},
        std={"ECC": np.full(len(at), std)},
        covariance={"ECC": covariance},
        sigma0=1.0,
        dof=10,
        n_observations=100,
    )
    return mean_of_runs(measured, arrivals)


CSV = CONTROLS["csv"]


def export(table, control, **more):
    return prepare_export(
        table, control.kind, now=NOW, settings=control.settings, accept_unverified=True, **more
    )


def attempt(table, control):
    """The export, or None where the control's numbers are too coarse for the curve."""
    try:
        return export(table, control, spacing=SPACING)
    except DataError as error:
        assert re.search("too coarse", str(error)), error  # noqa: PT017
    return None


def left(made, control, up, down, commands_deg=COMMANDS):
    """What stays of both curves, counted from the forward one at the reference (rad)."""
    correction = control.correction(made.files)
    zero = up(made.table.reference_angle)
    worst = 0.0
    for rising, curve in ((True, up), (False, down)):
        moved = (commands_deg + correction(commands_deg, rising)) * DEGREE
        missed = moved + curve(moved) - zero - commands_deg * DEGREE
        worst = max(worst, np.max(np.abs(missed)))
    return worst


def play(t):
    return wavy(t) + 6.0 * ARCSEC


def remove_play(control, most_arcsec=0.7):
    """Six arcsec of play are removed up to ``most_arcsec``; None: the file has no room for it.

    Once the mean of both directions stood in both columns: 6.6 arcsec left, 0.18 stated.
    """
    result = both_ways(even(36), wavy, play, 0.05 * ARCSEC)
    made = export(table_from_result(result), control, spacing=SPACING)
    residual = made.residual
    found = left(made, control, wavy, play)
    assert found <= residual.stated + 4 * residual.std
    one_column = most_arcsec is None
    assert (residual.direction > 5.9 * ARCSEC) == one_column
    assert any("of reversal remain" in text for text in made.warnings) == one_column
    assert one_column or found < most_arcsec * ARCSEC


@pytest.mark.parametrize("control", CONTROLS.values(), ids=CONTROLS)
def test_six_arcsec_of_play_are_removed(control):
    remove_play(control)


curves = st.lists(
    st.tuples(st.integers(1, 6), st.floats(0.3, 20.0), st.floats(0.0, 6.28)),
    min_size=1,
    max_size=5,
)


RANDOM = {
    "terms": curves,
    "reversal": st.tuples(st.floats(-20.0, 20.0), curves),
    "angles": st.sampled_from([24, 36, 48]),
    "uneven": st.floats(0.0, 0.4),
    "noise": st.floats(0.001, 0.5),
    "seed": st.integers(0, 2**32 - 1),
}
"""Curves of both directions, and how they are measured."""


def remove_curves(control, terms, reversal, angles, uneven, noise, seed):
    """The angles miss even ones by up to 0.4 of their distance."""

    def down(t):
        return wavy(t, terms) + reversal[0] * ARCSEC + 0.3 * wavy(t, reversal[1])

    def up(t):
        return wavy(t, terms)

    shift = uneven * np.random.default_rng(seed).uniform(-1.0, 1.0, angles)
    shift[0] = 0.0
    at = (np.arange(angles) + shift) * TAU / angles
    result = both_ways(at, up, down, noise * ARCSEC, seed)
    try:
        table = table_from_result(result)
    except DataError as error:  # a flat curve in much noise: it may differ in a gap by its range
        assert re.search("nothing was measured between", str(error)), error  # noqa: PT017
        return
    assert table.closed
    made = attempt(table, control)
    assume(made is not None)
    assert left(made, control, up, down) <= made.residual.stated + 4 * made.residual.std


@pytest.mark.slow
@pytest.mark.parametrize("control", CONTROLS.values(), ids=CONTROLS)
@settings(max_examples=6, deadline=None)
@given(**RANDOM)
def test_random_curves_and_uneven_angles(control, **drawn):
    remove_curves(control, **drawn)


@settings(max_examples=20, deadline=None)
@given(
    terms=curves,
    angles=st.lists(st.integers(0, 359), min_size=16, max_size=40, unique=True),
    noise=st.floats(0.001, 0.3),
    seed=st.integers(0, 2**32 - 1),
)
@example([(1, 10.0, 0.3), (2, 8.0, 1.0), (3, 5.0, 2.0)], [*range(0, 181, 10), 290], 0.05, 1)
@example([(1, 10.0, 0.3)], [*range(0, 181, 10), 290], 0.01, 1)
def test_angles_anywhere_are_refused_an_arc_or_true(terms, angles, noise, seed):
    def up(t):
        return wavy(t, terms)

    at = np.sort(angles) * DEGREE
    result = both_ways(at, up, up, noise * ARCSEC, seed)
    assert true_where_it_holds(result, up) in ("refused", "arc", "circle")


def true_where_it_holds(result, curve):
    """What becomes of a result: no table, or one that leaves no more than it says, where it is."""
    try:
        table = table_from_result(result)
    except DataError as error:
        assert re.search("nothing was measured between", str(error)), error  # noqa: PT017
        return "refused"
    made = attempt(table, CSV)
    if made is not None:
        first, last = (0.0, 360.0) if table.closed else np.rad2deg(table.angles[[0, -1]])
        inside = np.linspace(first, last, 1441)
        found = left(made, CSV, curve, curve, inside)
        assert found <= made.residual.stated + 4 * made.residual.std
    return "circle" if table.closed else "arc"


LONELY = np.append(np.arange(0.0, 181.0, 10.0), 290.0) * DEGREE


@pytest.mark.parametrize("turn", [0.0, 70.0, -70.0, 115.0])
def test_half_a_circle_and_a_lonely_angle_are_no_circle(turn):
    """17.5 arcsec were left where 0.13 were stated."""
    angles = np.sort(np.mod(LONELY + turn * DEGREE, TAU))

    def curve(t):
        return wavy(t, [(1, 10, 0.3), (2, 8, 1), (3, 5, 2)])

    assert true_where_it_holds(result_of(angles, curve(angles)), curve) in ("refused", "arc")
    if turn == 0.0:
        with pytest.raises(
            DataError, match=r"between 180 and 290 deg.* so that the rest is an arc"
        ):
            table_from_result(result_of(angles, curve(angles)))


def test_the_harmonics_that_gaps_hide_are_stated():
    """A circle in steps of 10 deg without 100 to 120: order 8 is seen, and known worse there."""

    def curve(t):
        return wavy(t, [(1, 10.0, 0.3), (8, 1.0, 1.0)])

    whole, angles = even(36), np.delete(even(36), [10, 11, 12])
    full, gappy = (
        export(table_from_result(result_of(at, curve(at), 0.01 * ARCSEC)), CSV, spacing=SPACING)
        for at in (whole, angles)
    )
    assert gappy.residual.sampling > 5 * full.residual.sampling
    assert '"what repeats more than 18 times in a turn' in full.files["c_csv.provenance.json"]
    assert '"what repeats more than 4 times in a turn' in gappy.files["c_csv.provenance.json"]
    for made in (full, gappy):
        assert left(made, CSV, curve, curve) <= made.residual.stated + 4 * made.residual.std


def test_each_column_has_its_own_uncertainty():
    """Five arrivals up and down, all independent: s^2 / 5 of each mean, up to its zero."""
    s, angles = 0.3 * ARCSEC, even(12)
    result = both_ways(angles, wavy, play, s, runs=5)
    scatter = result.runs.repeatability_std
    one = np.sqrt((s**2 + scatter**2) / 5)
    table = table_from_result(result)
    np.testing.assert_allclose(table.std, np.append(0.0, np.full(11, np.sqrt(2) * one)), rtol=1e-9)
    np.testing.assert_allclose(table.std_reverse, np.sqrt(2) * one, rtol=1e-9)
    reversal = result.directions["ECC"]
    np.testing.assert_allclose(reversal.reversal_std, np.sqrt(2) * one, rtol=1e-9)
    assert np.all(np.abs(reversal.reversal + 6.0 * ARCSEC) < 4 * reversal.reversal_std)
    text = export(table, CSV).files["c_csv.csv"]
    assert text.splitlines()[0].endswith(",std_arcsec,std_reverse_arcsec")


def test_the_stated_interval_of_the_reversal_holds_the_truth():
    """What all arrivals at an angle share leaves the reversal: the joint covariance knows it."""
    angles, s, common = even(8), 0.2 * ARCSEC, 1.0 * ARCSEC
    rng, inside = np.random.default_rng(3), []
    for seed in range(100):
        shared = rng.normal(0.0, common, 8)
        target = np.concatenate([np.arange(8), np.arange(8)[::-1]])
        upward = np.repeat([True, False], 8)
        same = (target[:, None] == target).astype(float)
        noise = np.random.default_rng(seed).normal(0.0, s, 16)
        ecc = np.where(upward, 0.0, 6.0 * ARCSEC) + shared[target] + noise
        measured = Result(
            "m", angles[target], {"ECC": ecc}, {"ECC": np.full(16, np.hypot(s, common))},
            {"ECC": s**2 * np.eye(16) + common**2 * same}, 1.0, 10, 10,
        )  # fmt: skip
        arrivals = Arrivals(angles, target, np.zeros(16, dtype=int), upward)
        found = mean_of_runs(measured, arrivals).directions["ECC"]
        np.testing.assert_allclose(found.reversal_std, np.sqrt(2) * s, rtol=1e-6)
        inside.append(np.abs(found.reversal + 6.0 * ARCSEC) <= 1.96 * found.reversal_std)
    assert 0.93 <= np.mean(inside) <= 0.97


def test_an_angle_that_was_reached_from_one_side_only_is_left_out():
    angles = even(12)
    target = np.concatenate([np.arange(12), [11, 10, 9, 8, 7, 6, 4, 3, 2, 1, 0]])
    upward = np.arange(23) < 12
    ecc = np.where(upward, wavy(angles[target]), play(angles[target]))
    some = np.eye(23) * (0.1 * ARCSEC) ** 2
    measured = Result("m", angles[target], {"ECC": ecc}, {"ECC": np.full(23, 1e-7)},
                      {"ECC": some}, 1.0, 10, 10)  # fmt: skip
    arrivals = Arrivals(angles, target, np.zeros(23, dtype=int), upward)
    table = table_from_result(mean_of_runs(measured, arrivals))
    np.testing.assert_allclose(table.angles, np.delete(angles, 5))
    assert any("1 of 12 angles were reached only from one side" in w for w in table.warnings)
    np.testing.assert_allclose(
        table.correction_forward - table.correction_reverse, 6.0 * ARCSEC, atol=1e-15
    )


def test_both_directions_and_a_reverse_result_contradict():
    result = both_ways(even(12), wavy, play)
    with pytest.raises(ConfigurationError, match="already holds both directions"):
        table_from_result(result, reverse=result_of(even(12), np.zeros(12)))
    with pytest.raises(ConfigurationError, match="already holds both directions"):
        table_from_result(result_of(even(12), np.zeros(12)), reverse=result)


def test_both_directions_close_after_a_turn():
    angles = np.append(even(24), TAU)
    table = table_from_result(both_ways(angles, wavy, play))
    assert len(table.angles) == 24
    assert table.closed

    def open_down(t):
        return play(t) + 5.0 * ARCSEC * (t > 6.0)

    with pytest.raises(DataError, match=r"do not close: at 0 and 360 deg"):
        table_from_result(both_ways(angles, wavy, open_down))


def test_volumetric_tables_hold_both_directions():
    result = both_ways(even(12), wavy, play)
    text = volumetric_files(result, "x")["x.csv"]
    head, *rows = text.splitlines()
    names = head.split(",")
    data = np.array([row.split(",") for row in rows], dtype=float)
    for column in ("forward", "reverse"):
        found = data[:, names.index(f"ECC_{column}_rad")]
        np.testing.assert_array_equal(found, getattr(result.directions["ECC"], column))


@pytest.mark.parametrize("play", [4.0, 0.01])
def test_runs_from_both_sides_without_a_curve_of_each_are_refused(play):
    curve = wavy(even(12))
    up, down = (np.stack([curve + x * ARCSEC, curve + x * ARCSEC], axis=1) for x in (0.0, play))
    runs = RepeatedRuns(even(12), up, down)
    measured = replace(result_of(even(12), curve), runs=runs)
    with pytest.raises(DataError, match=f"runs from both sides, up to {play:g} arcsec apart"):
        table_from_result(measured)
    with pytest.raises(DataError, match="runs from both sides"):
        table_from_result(result_of(even(12), curve), reverse=measured)
    with pytest.raises(DataError, match=f"runs from both sides, up to {play:g} arcsec apart"):
        volumetric_files(measured, "vol")
    down[1:] = np.nan  # one angle that was reached from above, too, is no reversal
    assert not table_from_result(measured).directional
    assert volumetric_files(measured, "vol")
    one_side = replace(measured, runs=RepeatedRuns(even(12), up, None))
    assert not table_from_result(one_side).directional
    assert volumetric_files(one_side, "vol")
