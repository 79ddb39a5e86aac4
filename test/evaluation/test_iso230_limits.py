"""ISO 230-2: what the standard requires, what is refused, and the words and names of figures."""

import csv
import io
import json
from dataclasses import fields

import numpy as np
import pytest
from text_tables import table_in

from rotcal_ros.evaluation.iso230 import (
    BidirectionalRuns,
    Iso230,
    iso230,
    read_runs,
    require_runs,
    runs_of,
)
from rotcal_ros.foundation.errors import BagError, DataError
from rotcal_ros.foundation.results import RepeatedRuns, Result
from rotcal_ros.foundation.units import ARCSEC


def runs(targets, n=5):
    """Targets in degrees; every value is zero."""
    none = np.zeros((len(targets), n))
    return BidirectionalRuns(np.deg2rad(np.asarray(targets, float)), none, none)


@pytest.mark.parametrize(
    ("targets", "wanted"),
    [
        ([0, 45, 90], 3), ([0, 90], 3), ([10, 100], 3), ([0, 90.5], 5), ([-20, 0, 100], 5),
        ([0, 90, 180], 5), ([0, 90, 180.5], 8), ([0, 90, 180, 270], 8),
    ],
)  # fmt: skip
def test_targets_the_standard_asks_for_by_travel(targets, wanted):
    """docs/evaluation.md: 8 for a full turn, 5 up to 180 degrees, 3 up to 90."""
    travel = max(targets) - min(targets)
    found = iso230(runs(targets)).warnings
    if len(targets) >= wanted:
        assert found == ()
    else:
        words = f"{len(targets)} targets over {travel:g} deg, the standard requires {wanted}"
        assert found == (words,)


@pytest.mark.parametrize(("n", "few"), [(2, True), (4, True), (5, False), (6, False)])
def test_five_runs_are_enough(n, few):
    words = (f"{n} runs in each direction, the standard requires 5",)
    assert iso230(runs([0, 45, 90], n)).warnings == (words if few else ())


@pytest.mark.parametrize(
    ("targets", "forward", "reverse", "text"),
    [
        (2, (2, 2), (2, 3), r"runs forward \(2, 2\), reverse \(2, 3\), 2 targets: expected one"),
        (2, (2, 3), (3, 2), "one row per target"),
        (3, (2, 2), (2, 2), "3 targets: expected one row per target"),
        (2, (2,), (2,), "one row per target"),
        (2, (2, 2, 2), (2, 2, 2), "one row per target"),
        (1, (1, 2), (1, 2), "1 targets and 2 runs: a spread needs at least 2 of both"),
        (2, (2, 1), (2, 1), "2 targets and 1 runs: a spread needs at least 2 of both"),
        (2, (2, 2), (2, 2), None),
    ],
)
def test_shapes_that_do_not_fit_or_do_not_suffice(targets, forward, reverse, text):
    given = (np.arange(float(targets)), np.zeros(forward), np.zeros(reverse))
    if text is None:
        assert BidirectionalRuns(*given).forward.shape == (2, 2)
        return
    with pytest.raises(DataError, match=text):
        BidirectionalRuns(*given)


@pytest.mark.parametrize("direction", ["forward", "reverse"])
def test_the_missing_arrival_is_named(direction):
    values = {"forward": np.zeros((3, 2)), "reverse": np.zeros((3, 2))}
    values[direction][1, 0] = np.nan
    values[direction][2, 1] = np.inf
    words = rf"^{direction} run 1 has no deviation at target 2 \(30 deg\)"
    with pytest.raises(DataError, match=words):
        BidirectionalRuns(np.deg2rad([0.0, 30.0, 60.0]), **values)


def uneven():
    """Two targets, three runs; means up 1 and 4, down -2 and 3."""
    up = np.array([[0.0, 1.0, 2.0], [2.0, 4.0, 6.0]])
    down = np.array([[-2.5, -2.0, -1.5], [3.0, 3.0, 3.0]])
    return iso230(BidirectionalRuns(np.array([0.0, 1.0]), up, down))


def test_every_figure_per_target_by_hand():
    """s is 1, 2 up and 0.5, 0 down: R_1 = max(3 + 3, 4, 2), R_2 = max(4 + 1, 8, 0)."""
    found = uneven()
    expected = {
        "targets": [0.0, 1.0],
        "mean_forward": [1.0, 4.0],
        "mean_reverse": [-2.0, 3.0],
        "mean": [-0.5, 3.5],
        "s_forward": [1.0, 2.0],
        "s_reverse": [0.5, 0.0],
        "reversal_i": [3.0, 1.0],
        "repeatability_i": [6.0, 8.0],
        "reversal": 3.0,
        "mean_reversal": 2.0,
        "repeatability_forward": 8.0,
        "repeatability_reverse": 2.0,
        "repeatability": 8.0,
        "systematic_forward": 3.0,
        "systematic_reverse": 5.0,
        "systematic": 6.0,
        "mean_range": 4.0,
        "accuracy_forward": 8.0 - -1.0,
        "accuracy_reverse": 3.0 - -3.0,
        "accuracy": 8.0 - -3.0,
    }
    data = json.loads(json.dumps(found.to_dict(), allow_nan=False))
    assert data.pop("warnings") == list(found.warnings)
    assert data.pop("measurement_stated") is False
    assert set(data.pop("uncertainties")) <= set(expected)
    others = {"warnings", "measurement_stated", "uncertainties"}
    assert set(data) == set(expected) == {field.name for field in fields(Iso230)} - others
    for name, value in expected.items():
        assert data[name] == pytest.approx(value, abs=1e-14), name


def test_the_summary_names_each_figure():
    found = uneven()
    figures = [(name, values) for name, values, _ in found.summary()]
    assert [name for name, _ in figures] == [
        "Reversal B", "Mean reversal", "Repeatability R", "Systematic deviation E",
        "Range of the mean M", "Accuracy A",
    ]  # fmt: skip
    expected = [
        (3.0, None, None), (2.0, None, None), (8.0, 8.0, 2.0), (6.0, 3.0, 5.0),
        (4.0, None, None), (11.0, 9.0, 6.0),
    ]  # fmt: skip
    for (name, values), wanted in zip(figures, expected, strict=True):
        assert values == pytest.approx(wanted, abs=1e-12), name
    stated = [expanded for *_, expanded in found.summary()]
    assert stated[0] == found.uncertainties["reversal"].expanded
    assert stated[-1] == found.uncertainties["accuracy"].expanded


# Tables and results that hold runs.

HEAD = ["angle_deg", "run", "direction", "deviation_arcsec"]


def text_of(rows):
    out = io.StringIO()
    csv.writer(out, lineterminator="\n").writerows([HEAD, *rows])
    return out.getvalue()


ROWS = [
    [angle, run, direction, 10 * k + 3 * run + (direction == "up")]
    for k, angle in enumerate((0, 30, 60))
    for run in (1, 2)
    for direction in ("up", "down")
]


def test_a_table_of_runs_is_read_in_degrees_and_arcseconds():
    """The value is 10 target + 3 run + 1 on the way up; spaces and blank lines do not matter."""
    text = text_of(ROWS).replace(",up,", " , up ,").replace("\n30,", "\n\n30,")
    found = read_runs(table_in(text))
    np.testing.assert_allclose(found.targets, np.deg2rad([0.0, 30.0, 60.0]))
    down = np.array([[3.0, 6.0], [13.0, 16.0], [23.0, 26.0]])
    np.testing.assert_allclose(found.reverse / ARCSEC, down)
    np.testing.assert_allclose(found.forward / ARCSEC, down + 1.0)


@pytest.mark.parametrize(
    ("gone", "words"),
    [
        ([0], "missing 0 deg in run 1 up: measure them"),
        ([0, 5, 10], "missing 0 deg in run 1 up, 30 deg in run 1 down, 60 deg in run 2 up: mea"),
        (
            [0, 3, 5, 6, 10],
            "missing 0 deg in run 1 up, 0 deg in run 2 down, 30 deg in run 1 down and 2 more: mea",
        ),
    ],
)
def test_three_that_are_missing_are_named_and_the_others_counted(gone, words):
    left = [row for k, row in enumerate(ROWS) if k not in gone]
    with pytest.raises(DataError, match=words):
        read_runs(table_in(text_of(left)))


def test_a_table_without_a_line_has_no_columns():
    with pytest.raises(BagError, match=r"r\.csv: expected the header .*, found ''"):
        read_runs(table_in("", "r.csv"))


@pytest.mark.parametrize("row", [["x", 1, "up", 2], [0, 1, "up", "x"], ["inf", 1, "up", 2]])
def test_numbers_are_numbers(row):
    with pytest.raises(DataError, match=r"r\.csv, row 14: .* must be a finite number"):
        read_runs(table_in(text_of([*ROWS, row]), "r.csv"))


def result(forward, reverse, kept=True):
    held = RepeatedRuns(np.array([0.0, 1.0]), forward, reverse)
    return Result(
        method="simulated", angles=np.array([0.0, 1.0]), deviations={}, std={}, covariance={},
        sigma0=1.0, dof=1, n_observations=2, runs=held if kept else None,
    )  # fmt: skip


def test_a_result_holds_runs_when_both_directions_have_two():
    up, down = np.array([[1.0, 2.0], [3.0, 4.0]]), np.array([[5.0, 6.0], [7.0, 8.0]])
    for found in (runs_of(result(up, down)), require_runs(result(up, down), "r.json")):
        np.testing.assert_array_equal(found.targets, [0.0, 1.0])
        np.testing.assert_array_equal(found.forward, up)
        np.testing.assert_array_equal(found.reverse, down)
    for lacking in (
        result(up, down, kept=False),
        result(None, down),
        result(up, None),
        result(up[:, :1], down[:, :1]),
    ):
        assert runs_of(lacking) is None
        with pytest.raises(DataError, match=r"^r\.json: the result holds no repeated runs"):
            require_runs(lacking, "r.json")
