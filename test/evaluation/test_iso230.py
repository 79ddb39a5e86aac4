from statistics import mean, stdev

import numpy as np
import pytest
from text_tables import table_in

from rotcal_ros.evaluation.iso230 import BidirectionalRuns, iso230, read_runs
from rotcal_ros.foundation.errors import BagError, DataError
from rotcal_ros.foundation.units import ARCSEC

SPREAD = np.array([-2.0, -1.0, 0.0, 1.0, 2.0])


def hand_checked_runs():
    """Eight targets, five runs, arcseconds: mean + g * (-2 .. 2), so that s = g * sqrt(2.5)."""
    mean_up = np.array([0.0, 3, 5, 2, -1, -4, -3, -1])
    mean_down = np.array([-2.0, 0, 2, 0, -4, -6, -6, -2])
    g_up = np.array([0.2, 0.2, 0.4, 0.2, 0.2, 0.3, 0.2, 0.2])
    g_down = np.array([0.2, 0.3, 0.2, 0.2, 0.5, 0.2, 0.2, 0.2])
    return BidirectionalRuns(
        targets=np.deg2rad(np.arange(8) * 45.0),
        forward=(mean_up[:, None] + g_up[:, None] * SPREAD) * ARCSEC,
        reverse=(mean_down[:, None] + g_down[:, None] * SPREAD) * ARCSEC,
    )


def test_rotary_example_to_all_digits():
    got = iso230(hand_checked_runs())
    root = np.sqrt(2.5)
    for value, expected in [
        (got.reversal, 3.0),
        (got.mean_reversal, 2.375),
        (got.repeatability_forward, 4 * 0.4 * root),  # 2.5298221
        (got.repeatability_reverse, 4 * 0.5 * root),  # 3.1622777
        (got.repeatability, 5.2135944),
        (got.systematic_forward, 9.0),
        (got.systematic_reverse, 8.0),
        (got.systematic, 11.0),
        (got.mean_range, 8.5),
        (got.accuracy_forward, 11.213594),
        (got.accuracy_reverse, 9.2649111),
        (got.accuracy, 12.897367),
    ]:
        assert value / ARCSEC == pytest.approx(expected, abs=6e-7)
    np.testing.assert_allclose(got.reversal_i / ARCSEC, [2, 3, 3, 2, 3, 2, 3, 1], atol=1e-9)
    np.testing.assert_allclose(
        got.repeatability_i / ARCSEC,
        [3.264911, 4.581139, 4.897367, 3.264911, 5.213594, 3.581139, 4.264911, 2.264911],
        atol=6e-7,
    )
    assert np.argmax(got.repeatability_i) == 4
    assert got.warnings == ()


@pytest.mark.parametrize("seed", range(5))
def test_definitions_in_plain_loops(seed):
    """The definitions once more, target by target, with the standard library."""
    rng = np.random.default_rng(seed)
    up, down = rng.normal(0.0, 3.0, (7, 1)) + rng.normal(0.0, 1.0, (2, 7, 4))
    got = iso230(BidirectionalRuns(np.arange(7.0), up, down))
    x_up, x_down = [mean(row) for row in up], [mean(row) for row in down]
    s_up, s_down = [stdev(row) for row in up], [stdev(row) for row in down]
    r_i = [
        max(2 * a + 2 * b + abs(u - d), 4 * a, 4 * b)
        for u, d, a, b in zip(x_up, x_down, s_up, s_down, strict=True)
    ]
    high = [m + 2 * s for m, s in zip(x_up + x_down, s_up + s_down, strict=True)]
    low = [m - 2 * s for m, s in zip(x_up + x_down, s_up + s_down, strict=True)]
    both = [(u + d) / 2 for u, d in zip(x_up, x_down, strict=True)]
    assert got.repeatability_i == pytest.approx(r_i)
    assert got.repeatability == pytest.approx(max(r_i))
    assert got.systematic == pytest.approx(max(x_up + x_down) - min(x_up + x_down))
    assert got.systematic_forward == pytest.approx(max(x_up) - min(x_up))
    assert got.mean_range == pytest.approx(max(both) - min(both))
    assert got.accuracy == pytest.approx(max(high) - min(low))
    assert got.accuracy_forward == pytest.approx(max(high[:7]) - min(low[:7]))
    assert got.accuracy_reverse == pytest.approx(max(high[7:]) - min(low[7:]))


def csv_of(runs):
    lines = ["angle_deg,run,direction,deviation_arcsec"]
    for name, values in (("up", runs.forward), ("down", runs.reverse)):
        for target, row in zip(runs.targets, values, strict=True):
            for run, value in enumerate(row, start=1):
                lines.append(f"{np.rad2deg(target)!r},{run},{name},{value / ARCSEC!r}")
    return "\n".join(line.replace("np.float64(", "").replace(")", "") for line in lines) + "\n"


def test_runs_come_from_a_table_in_any_order():
    runs = hand_checked_runs()
    head, *lines = csv_of(runs).splitlines()
    mixed = np.random.default_rng(2).permutation(lines).tolist()
    back = read_runs(table_in("\n".join([head, *mixed])))
    np.testing.assert_allclose(back.forward, runs.forward, atol=1e-18)
    np.testing.assert_allclose(back.reverse, runs.reverse, atol=1e-18)


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (lambda lines: lines[:5] + lines[6:], r"missing 0 deg in run 5 up"),
        (lambda lines: [*lines, lines[3]], r"row 82: 0 deg, run 3 up occurs twice"),
        (lambda lines: [*lines, "0,6,left,1"], "row 82: direction 'left'"),
        (lambda lines: [*lines, "0,6,up,x"], "must be a finite number, found 'x'"),
        (lambda lines: [*lines, "0,6,up,nan"], "must be a finite number, found 'nan'"),
        (lambda lines: [*lines, "0,6"], "row 82: expected 4 values .*, found 2"),
        (lambda lines: lines[:1], "has a header but no rows"),
    ],
)
def test_bad_tables_of_runs_are_refused_with_the_place(change, text):
    lines = change(csv_of(hand_checked_runs()).splitlines())
    with pytest.raises(DataError, match=text):
        read_runs(table_in("\n".join(lines)))


def test_other_columns_are_no_table_of_runs():
    with pytest.raises(BagError, match=r"expected the header line 'angle_deg,run,.*, found 'a,b'"):
        read_runs(table_in("a,b\n0,1\n"))


def test_runs_that_do_not_fit_are_refused():
    good = hand_checked_runs()
    broken = good.forward.copy()
    broken[2, 3] = np.nan
    with pytest.raises(DataError, match=r"forward run 4 has no deviation at target 3 \(90 deg\)"):
        BidirectionalRuns(good.targets, broken, good.reverse)
    with pytest.raises(DataError, match="one row per target"):
        BidirectionalRuns(good.targets, good.forward[:4], good.reverse)
    with pytest.raises(DataError, match="8 targets and 1 runs"):
        BidirectionalRuns(good.targets, good.forward[:, :1], good.reverse[:, :1])


def test_fewer_runs_or_targets_than_the_standard_asks_for_are_named():
    good = hand_checked_runs()
    got = iso230(BidirectionalRuns(good.targets[:4], good.forward[:4, :3], good.reverse[:4, :3]))
    assert got.warnings == (
        "3 runs in each direction, the standard requires 5",
        "4 targets over 135 deg, the standard requires 5",
    )
