import json
from dataclasses import dataclass, replace
from math import inf, nan

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from rotcal_ros.foundation.errors import DataError
from rotcal_ros.foundation.results import (
    AxisLine,
    Directions,
    ErrorMotion,
    Placement,
    Rejection,
    Residuals,
    Result,
    json_fields,
)

finite = st.floats(allow_nan=False, allow_infinity=False, width=64)


def result(values: np.ndarray) -> Result:
    n = len(values)
    return Result(
        method="some_method",
        angles=np.arange(n, dtype=float),
        deviations={"ECC": values},
        std={"ECC": np.abs(values)},
        covariance={"ECC": np.diag(np.abs(values))},
        sigma0=1.25,
        dof=3,
        n_observations=n,
        rejected=(Rejection(1, "too far"),),
        verdict="suspect",
        warnings=("careful",),
        adjacent_deviations=np.diff(values),
        residuals=Residuals(
            table_position=np.arange(n),
            target=np.zeros(n, dtype=np.int64),
            residual=values,
            redundancy=np.ones(n),
            test_value=values,
            used=np.arange(n) != 1,
        ),
        details={"circle": {"centre": np.array([1.0, 2.0])}, "note": ("a", np.float64(2.5))},
    )


@given(arrays(np.float64, 4, elements=st.floats(-1e300, 1e300)))
def test_json_keeps_every_bit(values: np.ndarray) -> None:
    original = result(values)
    again = Result.from_dict(json.loads(original.to_json()))
    assert again.deviations["ECC"].tobytes() == values.tobytes()
    assert again.to_json() == original.to_json()
    assert again.residuals is not None
    np.testing.assert_array_equal(again.residuals.used, [True, False, True, True])


def test_what_a_method_finds_of_axis_and_error_motion_is_kept() -> None:
    placement = Placement.upwards(
        np.array([0.1, 0.2, 0.3]), np.array([0.3, 0.0, -3.0]), np.array([0, 2]), np.eye(3)[:2]
    )
    motion = ErrorMotion(None, 1e-7, 2e-7, 5, 3e-7)
    known = replace(result(np.array([0.0, 1.0])), placement=placement, error_motion=motion)
    written = known.to_json()
    again = Result.from_dict(json.loads(written))
    assert again.to_json() == written
    assert again.error_motion == motion
    assert "error_motion" not in again.details
    assert again.placement is not None
    np.testing.assert_allclose(again.placement.direction, [-0.0995037, 0.0, 0.9950372], atol=1e-7)
    np.testing.assert_array_equal(again.placement.stations, placement.stations)
    # The axis leans away from x: a point on x at height 0.3 is nearer by the cosine.
    assert again.placement.distance(np.array([1.1, 0.2, 0.3])) == pytest.approx(0.9950372)


@pytest.mark.parametrize(
    ("entry", "value", "words"),
    [
        ("point", [0.0, 1.0], "placement.point has shape"),
        ("direction", [0.0, 0.0, 2.0], "unit vector"),
        ("stations", [[0.0, 1.0, 2.0]], "placement.stations has shape"),
        ("positions", ["first"], "damaged rotcal result"),
        ("positions", [0.5], "whole numbers"),
        ("stations", [[0.0, None, 2.0]], "finite stations"),
        ("direction", [0.0, 0.0, -1.0], "points upwards"),
    ],
)
def test_a_damaged_placement_is_refused(entry: str, value: object, words: str) -> None:
    placement = Placement(np.zeros(3), np.array([0.0, 0.0, 1.0]))
    data = replace(result(np.array([0.0, 1.0])), placement=placement).to_dict()
    data["placement"][entry] = value
    with pytest.raises(DataError, match=words):
        Result.from_dict(data)


def test_form_follows_the_published_schema() -> None:
    data = result(np.array([0.0, 1e-5, 2e-5])).to_dict()
    assert data["schema"] == 1
    assert data["n_rejected"] == 1
    assert data["rejected"] == [{"index": 1, "why": "too far"}]
    assert data["adjacent_deviations_rad"] == [1e-5, 1e-5]
    assert set(data["deviations"]) == {"ECC"}
    assert data["details"] == {"circle": {"centre": [1.0, 2.0]}, "note": ["a", 2.5]}


@pytest.mark.parametrize("values", [np.array([0.0, np.nan]), np.array([0.0, np.inf])])
def test_a_deviation_is_a_number_or_absent(values: np.ndarray) -> None:
    with pytest.raises(DataError, match=r"ECC is (nan|inf) at .* deg \(row 1\)"):
        result(values)


def test_what_a_detail_does_not_know_is_null_in_json() -> None:
    known = result(np.array([0.0, 1.0]))
    unknown = replace(known, details={"redundancy": np.array([np.nan, 0.5])})
    assert json.loads(unknown.to_json())["details"] == {"redundancy": [None, 0.5]}


@pytest.mark.parametrize("data", [{}, {"schema": 2}, {"schema": 1, "method": "x"}, []])
def test_something_else_is_refused(data: object) -> None:
    with pytest.raises(DataError, match="rotcal result"):
        Result.from_dict(data)  # type: ignore[arg-type]


def test_the_missing_entry_of_another_file_is_named() -> None:
    truth = {"schema": 1, "angles_rad": [0.0], "deviations": {"ECC": [0.0]}}
    with pytest.raises(DataError, match="rotcal result: the entry 'method' is missing"):
        Result.from_dict(truth)


def with_directions(**changes):
    given = {
        "angles": np.array([0.0, 1.0 / 3.0]),
        "forward": np.array([0.1, 0.2]),
        "reverse": np.array([0.3, -0.1]),
        "spread": np.diag([1.0, 2.0, 3.0, 4.0]) / 7.0,
    }
    return Directions(**{**given, **changes})


def test_both_directions_keep_every_bit_and_are_absent_where_they_were_not_measured():
    single = Result("m", np.array([0.0, 1.0]), {}, {}, {}, 1.0, 0, 0)
    assert "directions" not in single.to_dict()
    both = replace(single, directions={"ECC": with_directions()})
    text = both.to_json()
    again = Result.from_dict(json.loads(text))
    assert again.to_json() == text
    assert set(json.loads(text)["directions"]["ECC"]) == {
        "angles_rad", "forward", "reverse", "covariance",
    }  # fmt: skip
    np.testing.assert_array_equal(again.directions["ECC"].covariance, with_directions().covariance)
    assert not Result.from_dict(single.to_dict()).directions


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"forward": np.zeros(3)}, "direction forward has shape"),
        ({"reverse": np.array([0.0, np.nan])}, "direction reverse is nan"),
        ({"spread": np.eye(2)}, r"covariance of both directions has shape \(2, 2\)"),
        ({"spread": np.full((4, 4), np.inf)}, "not finite"),
    ],
)
def test_directions_that_do_not_fit_are_refused(changes, words):
    with pytest.raises(DataError, match=words):
        with_directions(**changes)


def test_reversal_is_forward_less_reverse_with_its_own_uncertainty():
    both = with_directions()
    np.testing.assert_allclose(both.reversal, [-0.2, 0.3])
    np.testing.assert_allclose(both.reversal_std, np.sqrt([4.0 / 7.0, 6.0 / 7.0]))
    tied = np.kron(np.ones((2, 2)), np.eye(2))  # what both have in common is in no reversal
    np.testing.assert_allclose(with_directions(spread=tied).reversal_std, 0.0, atol=1e-12)


def test_what_json_lacks_is_null():
    @dataclass(frozen=True)
    class Found:
        size: float
        column: np.ndarray
        by_name: dict[str, float]

    found = json_fields(Found(inf, np.array([1.0, -inf, nan]), {"knock": inf, "drift": 2.0}))
    assert json.loads(json.dumps(found, allow_nan=False)) == {
        "size": None, "column": [1.0, None, None], "by_name": {"knock": None, "drift": 2.0},
    }  # fmt: skip


NAMES = ("YOA", "ZOA", "BOA", "COA")


def line(names=NAMES, **more):
    given = {"value": np.arange(4.0), "std": np.ones(4), "covariance": np.eye(4) + 0.1}
    return AxisLine(names, **{**given, "origin": np.array([0.3, 0.0, -0.1]), **more})


def test_where_an_axis_stands_comes_back_to_the_last_bit():
    """Its values 0, 1 m and 2, 3 rad: from (0.3, 0, -0.1) along (1, 3, -2)."""
    (again,) = Result.from_dict(
        json.loads(replace(result(np.array([0.0, 1.0])), axes=(line(),)).to_json())
    ).axes
    assert (again.names, again.letter) == (NAMES, "A")
    for name in ("value", "std", "covariance", "origin"):
        np.testing.assert_array_equal(getattr(again, name), getattr(line(), name))
    np.testing.assert_array_equal(again.point, [0.3, 0.0, 0.9])
    np.testing.assert_array_equal(again.direction, [1.0, 3.0, -2.0])


@pytest.mark.parametrize(
    ("more", "match"),
    [
        ({"names": ("XOC", "YOC", "AOC", "BOA")}, "expected two places and two turns"),
        ({"std": np.ones(3)}, r"std has shape \(3,\), expected \(4,\)"),
    ],
)
def test_an_axis_of_other_names_or_shapes_is_refused(more, match):
    with pytest.raises(DataError, match=match):
        line(**more)
