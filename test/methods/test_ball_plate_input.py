"""Plate files, tables of centres and touch points: good ones and bad ones."""

from pathlib import Path

import numpy as np
import pytest
from plate_data import PAPER_PLATE, RADIUS, simulated
from rotcal_ros.methods.ball_plate.probing import (
    Touches,
    centres_from_touches,
    parse_centres,
    read_centres,
)

from rotcal_ros.errors import ConfigurationError, DataError
from rotcal_ros.methods.ball_plate import solve
from rotcal_ros.methods.ball_plate.plate import Plate, parse_plate, read_plate
from rotcal_ros.methods.ball_plate.separability import separability
from rotcal_ros.planning.ball_layout import rank_subsets

PLATES = Path(__file__).parents[2] / "config" / "plates"
GOOD = {"grid": 72, "ball_steps": PAPER_PLATE, "circle_radius_m": 0.185, "ball_diameter_m": 0.025}
PLATE = parse_plate(GOOD, "plate")
TIP = 0.0015


@pytest.mark.parametrize("path", sorted(PLATES.glob("*.yaml")), ids=lambda p: p.stem)
def test_shipped_plates_are_readable_and_separable(path):
    plate = read_plate(path)
    found = separability(plate.grid, np.array(plate.ball_steps))
    assert found.separable != plate.separate_groups
    assert plate.material
    assert len(plate.nominal_centres) == len(plate.ball_steps)


def test_all_six_plates_are_shipped():
    assert len(list(PLATES.glob("*.yaml"))) == 6
    paper = read_plate(PLATES / "ball_plate_12_of_72.yaml")
    degrees = [step * 5 for step in paper.ball_steps]
    assert degrees == [0, 40, 60, 90, 105, 140, 160, 185, 210, 250, 290, 310]


@pytest.mark.parametrize("count", [6, 8, 10])
def test_shipped_subsets_are_the_best_ones(count):
    plate = read_plate(PLATES / f"ball_plate_{count}_of_72.yaml")
    layouts, _ = rank_subsets(72, PAPER_PLATE, count)
    assert plate.ball_steps == tuple(layouts[0].tolist())


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"grid": 2}, "grid must be a whole number"),
        ({"grid": 72.0}, "grid must be a whole number"),
        ({"ball_steps": [0, 8, 72]}, r"whole numbers in 0..71"),
        ({"ball_steps": "0 8 12"}, "list of whole numbers"),
        ({"ball_steps": [0, 8, 8, 9]}, r"named twice: \[8\]"),
        ({"circle_radius_m": 185.0}, "looks like millimetres"),
        ({"circle_radius_m": "wide"}, "positive length in metres"),
        ({"ball_diameter_m": 0.1}, "less than their diameter"),
        ({"radius": 1.0}, r"unknown entries \['radius'\]"),
        ({"method": "plane_mirror"}, "not 'ball_plate'"),
        ({"separate_groups": "yes please"}, "true or false"),
    ],
)
def test_bad_plates_are_refused(change, text):
    with pytest.raises(ConfigurationError, match=text):
        parse_plate({**GOOD, **change}, "plate.yaml")


def test_bad_plate_files_are_refused(tmp_path):
    with pytest.raises(ConfigurationError, match="cannot read plate file"):
        read_plate(tmp_path / "none.yaml")
    (tmp_path / "broken.yaml").write_text("grid: [")
    with pytest.raises(ConfigurationError, match="not a YAML file"):
        read_plate(tmp_path / "broken.yaml")
    with pytest.raises(ConfigurationError, match="missing entries"):
        parse_plate({"grid": 72}, "plate")
    with pytest.raises(ConfigurationError, match="list of 'entry: value'"):
        parse_plate([1, 2], "plate")


def test_table_of_centres_gives_the_same_result_as_the_arrays(tmp_path):
    problem, _ = simulated(72, PAPER_PLATE)
    rows = zip(problem.table_index, problem.ball_step, problem.centres, strict=True)
    text = "table_index,ball_step,x_m,y_m,z_m\n" + "".join(
        f"{i},{j},{x!r},{y!r},{z!r}\n"
        for i, j, (x, y, z) in ((i, j, c.tolist()) for i, j, c in rows)
    )
    path = tmp_path / "centres.csv"
    path.write_text(text)
    assert solve(read_centres(path, PLATE)).to_json() == solve(problem).to_json()


@pytest.mark.parametrize(
    ("lines", "text"),
    [
        (["i,j,x,y,z"], "the header must be table_index,ball_step,x_m"),
        (["table_index,ball_step,x_m,y_m,z_m"], "no row below the header"),
        (["table_index,ball_step,x_m,y_m,z_m", "0,0,1,2"], "line 2: expected two whole"),
        (["table_index,ball_step,x_m,y_m,z_m", "0,0,1,2,3", "0,0,a,2,3"], "line 3"),
        (["table_index,ball_step,x_m,y_m,z_m", "0,1,0,0,0"], "no ball at step 1"),
        (["table_index,ball_step,x_m,y_m,z_m", "99,0,0,0,0"], "table position 99 is outside"),
    ],
)
def test_bad_tables_are_refused(lines, text):
    with pytest.raises(DataError, match=text):
        parse_centres(lines, PLATE, "centres.csv")


def touches_of(problem, noise=2e-7, diameter=0.025, n=15):
    height = (np.arange(n) + 0.5) / n
    around = 2.399963 * np.arange(n)
    flat = np.sqrt(1 - height**2)
    direction = np.column_stack([flat * np.cos(around), flat * np.sin(around), height])
    rng = np.random.default_rng(4)
    points = problem.centres[:, None] + direction * (diameter / 2 + TIP)
    points = points + noise * rng.normal(size=points.shape)
    return Touches(
        measurement=np.repeat(problem.rows, n),
        table_index=np.repeat(problem.table_index, n),
        ball_step=np.repeat(problem.ball_step, n),
        position=points.reshape(-1, 3),
    )


def test_touch_points_give_the_centres_and_refused_balls_are_named():
    problem, _ = simulated(72, PAPER_PLATE, noise=0.0)
    touches = touches_of(problem)
    touches.position[:13] = np.nan  # only two touches left on the first ball
    found = centres_from_touches(PLATE, touches, TIP)
    (rejection,) = found.rejected
    assert "ball step 0, table position 0): 2 usable touch points" in rejection.why
    expected = problem.take(np.arange(len(problem.centres)) != 0)
    assert (found.problem.rows == expected.rows).all()
    assert np.abs(found.problem.centres - expected.centres).max() < 1e-6
    assert np.nanmedian(found.spheres.form_deviation) < 1e-6


def test_wrong_ball_or_tip_is_refused_with_both_diameters():
    problem, _ = simulated(72, PAPER_PLATE, noise=0.0)
    with pytest.raises(DataError, match=r"diameter 25.4000 mm .* the plate says 25.0000 mm"):
        centres_from_touches(PLATE, touches_of(problem, 0.0, 0.0254), TIP)


def test_touches_that_disagree_about_their_ball_are_refused():
    problem, _ = simulated(72, PAPER_PLATE, noise=0.0)
    touches = touches_of(problem)
    touches.ball_step[3] = 8
    with pytest.raises(DataError, match="name ball_step 8 and 0"):
        centres_from_touches(PLATE, touches, TIP)


def test_plate_defaults():
    plate = Plate(12, (0, 1, 5), RADIUS, 0.02)
    np.testing.assert_allclose(plate.nominal_centres[0], [RADIUS, 0, 0])
