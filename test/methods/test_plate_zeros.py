"""Two groups of table positions have two zeros: what the data leave open, by algebra."""

import json
from dataclasses import replace

import numpy as np
import pytest
from two_groups import ALTERNATING, ANGLES, ARCSEC, GRID, RADIUS, plate_problem

from rotcal_ros.foundation.components import COMPONENTS
from rotcal_ros.foundation.errors import DataError
from rotcal_ros.foundation.results import FreeDirection, Result, Zeros
from rotcal_ros.methods.ball_plate.solver import solve

OFFSET = "the offset between the odd and even table positions is not measured"


def design(balls, own_plate):
    """Eq. 12 of the paper, dense: columns c R, d (positions), a (balls), b (CMM), u R, v."""
    plates = 2 if own_plate else 1
    width = 6 * GRID + 3 * GRID * plates + 3 * GRID + 6
    at_plate, at_cmm, at_pose = 6 * GRID, 6 * GRID + 3 * GRID * plates, width - 6
    rows = []
    for i in range(GRID):
        turn = np.array(
            [
                [np.cos(ANGLES[i]), -np.sin(ANGLES[i]), 0.0],
                [np.sin(ANGLES[i]), np.cos(ANGLES[i]), 0.0],
                [0.0, 0.0, 1.0],
            ]
        )
        for j in balls:
            k = (i + j) % GRID
            p = np.array([np.cos(ANGLES[k]), np.sin(ANGLES[k]), 0.0])
            across = np.column_stack([np.cross(e, p) for e in np.eye(3)])
            block = np.zeros((3, width))
            block[:, 6 * i : 6 * i + 3], block[:, 6 * i + 3 : 6 * i + 6] = across, np.eye(3)
            place = at_plate + 3 * (j + GRID * (i % 2) * (plates - 1))
            block[:, place : place + 3] = turn
            block[:, at_cmm + 3 * k : at_cmm + 3 * k + 3] = np.eye(3)
            block[:, at_pose : at_pose + 3], block[:, at_pose + 3 :] = across, np.eye(3)
            rows.append(block)
    return np.concatenate(rows)


def invisible_curves(balls, own_plate):
    """An orthonormal basis (6 N, q) of the curves, component by component, that leave no trace."""
    _, s, vt = np.linalg.svd(design(balls, own_plate))
    null = vt[np.sum(s > 1e-9 * s[0]) :]
    c, d = (null[:, : 6 * GRID].reshape(-1, GRID, 2, 3)[:, :, half] for half in (0, 1))
    stacked = np.concatenate([d, c], axis=2).transpose(2, 1, 0).reshape(6 * GRID, -1)
    u, s, _ = np.linalg.svd(stacked, full_matrices=False)
    return u[:, s > 1e-9 * s[0]]


def ordinary():
    """What no plate sees: six constants, and what turns in both pairs, (6 N, 10)."""
    columns = np.zeros((10, 6, GRID))
    columns[range(6), range(6)] = 1.0
    for at, (x, y) in zip((6, 8), ((0, 1), (3, 4)), strict=True):
        columns[at, x], columns[at, y] = np.cos(ANGLES), np.sin(ANGLES)
        columns[at + 1, x], columns[at + 1, y] = -np.sin(ANGLES), np.cos(ANGLES)
    return columns.reshape(10, -1).T


def stated(result):
    """The free directions of a result, stacked like the curves."""
    return np.concatenate([result.zeros.of(name, GRID) for name in COMPONENTS])


def left_of(columns, space):
    q, _ = np.linalg.qr(space)
    return np.abs(columns - q @ (q.T @ columns)).max()


def test_what_two_groups_leave_open_is_what_the_dense_model_does_not_see():
    balls = range(0, GRID, 2)
    result = solve(plate_problem(balls))
    space = np.hstack([ordinary(), stated(result)])
    # each group by itself, as the paper solves them: six constants and four turning parts more
    apart = invisible_curves(balls, own_plate=True)
    assert apart.shape[1] == 20
    assert left_of(apart, space) < 1e-9
    assert left_of(space, apart) < 1e-9
    # a plate that both share would show what turns, never a constant: six more
    together = invisible_curves(balls, own_plate=False)
    assert together.shape[1] == 16
    constants = stated(result)[:, :6]
    assert left_of(constants, together) < 1e-9
    assert left_of(together, space) < 1e-9
    # twelve balls leave what every plate leaves
    assert invisible_curves(range(GRID), own_plate=False).shape[1] == 10
    assert solve(plate_problem(range(GRID))).zeros.free == ()


def test_an_offset_between_groups_is_never_ok():
    """4 arcsec between odd and even positions leave no trace: they were 'ok' at 0.04 arcsec."""
    result = solve(plate_problem())
    error = result.deviations["ECC"] - ALTERNATING
    assert np.ptp(error) > 3.9 * ARCSEC
    assert result.verdict == "suspect"
    assert result.verdict_within == "ok"
    assert OFFSET in result.verdict_line
    assert result.zeros.counts_from == "mean of each group"
    # up to multiples of the free columns the deviations are what the table does
    space = np.column_stack([np.ones(GRID), result.zeros.of("ECC", GRID)])
    left = error - space @ np.linalg.lstsq(space, error, rcond=None)[0]
    assert np.abs(left).max() < 5.0 * result.std["ECC"].max()


def test_a_result_knows_its_zeros_from_its_file():
    result = solve(plate_problem())
    again = Result.from_dict(json.loads(result.to_json()))
    assert again.to_json() == result.to_json()
    assert again.verdict_within == "ok"
    np.testing.assert_array_equal(stated(again), stated(result))
    data = json.loads(result.to_json())
    data["verdict"] = "ok"
    with pytest.raises(DataError, match=OFFSET):
        Result.from_dict(data)
    data["verdict"], data["zeros"]["within"] = "suspect", "perhaps"
    with pytest.raises(DataError, match=r"zeros\.within"):
        Result.from_dict(data)


def test_a_stated_allowance_bounds_the_offset():
    """The error of 4 arcsec is then about one standard uncertainty."""
    bound = 4.0 * ARCSEC * RADIUS
    result = solve(plate_problem(group_allowance=bound))
    assert result.verdict == "ok"
    assert result.zeros.free == ()
    assert result.zeros.counts_from == "mean of each group"
    assert "gauge" not in result.unprotected
    step = np.array([1.0, -1.0] + [0.0] * (GRID - 2))
    between = np.sqrt(step @ result.covariance["ECC"] @ step)
    # uniform within the bound, beside the noise
    assert between == pytest.approx(bound / RADIUS / np.sqrt(3.0), rel=1e-3)
    plain = solve(plate_problem())
    same = np.array([1.0, 0.0, -1.0] + [0.0] * (GRID - 3))
    assert same @ result.covariance["ECC"] @ same == pytest.approx(
        same @ plain.covariance["ECC"] @ same, rel=1e-6
    )
    with pytest.raises(DataError, match="group allowance"):
        plate_problem(group_allowance=-1.0)


def test_the_table_of_values_shows_what_is_open():
    pandas = pytest.importorskip("pandas")
    frame = solve(plate_problem()).to_dataframe()
    assert isinstance(frame, pandas.DataFrame)
    np.testing.assert_array_equal(frame["ECC_free_0"], np.arange(GRID) % 2)
    assert {f"EXC_free_{k}" for k in range(3)} <= set(frame.columns)
    assert "EXC_free_3" not in frame.columns


def test_a_doubt_stays_a_doubt_within_the_groups():
    result = solve(plate_problem())
    assert result.as_suspect().verdict_within == "suspect"
    whole = solve(plate_problem(range(GRID)))
    assert whole.as_suspect().verdict == "suspect"
    assert replace(whole, verdict="failed").as_suspect().verdict == "failed"


def test_zeros_are_stated_in_known_words_and_shapes():
    with pytest.raises(DataError, match="expected one of first angle"):
        Zeros("somewhere")
    whole = solve(plate_problem(range(GRID)))
    with pytest.raises(DataError, match="free direction of ECC has shape"):
        whole.counted_from("mean", [FreeDirection("halves", {"ECC": np.ones(3)})])
    moved = Zeros("mean", (FreeDirection("halves", {"ECC": np.arange(4.0)}),)).mapped(
        np.eye(4)[::2]
    )
    np.testing.assert_array_equal(moved.of("ECC", 2)[:, 0], [0.0, 2.0])
    assert moved.describe() == "the offset between halves is not measured (ECC)"
    assert moved.describe(["EZC"]) == ""
