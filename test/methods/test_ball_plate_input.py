"""Plates and their files: good ones and bad ones."""

from pathlib import Path

import numpy as np
import pytest
from plate_data import PAPER_PLATE, RADIUS

from rotcal_ros.catalogue.setup_file import read_setup
from rotcal_ros.errors import ConfigurationError
from rotcal_ros.methods.ball_plate.plate import Plate, parse_plate
from rotcal_ros.methods.ball_plate.separability import separability
from rotcal_ros.planning.ball_layout import best_layout

PLATES = Path(__file__).parents[2] / "config" / "plates"
GOOD = {"grid": 72, "ball_steps": PAPER_PLATE, "circle_radius_m": 0.185, "ball_diameter_m": 0.025}


def read_plate(path):
    return read_setup(path).plan.plate


@pytest.mark.parametrize("path", sorted(PLATES.glob("*.yaml")), ids=lambda p: p.stem)
def test_shipped_plates_are_readable_and_separable(path):
    plate = read_plate(path)
    found = separability(plate.grid, np.array(plate.ball_steps))
    assert found.separable != plate.separate_groups
    assert plate.material
    assert plate.places.shape == (plate.grid, 3)


def test_all_six_plates_are_shipped():
    assert len(list(PLATES.glob("*.yaml"))) == 6
    paper = read_plate(PLATES / "ball_plate_12_of_72.yaml")
    degrees = [step * 5 for step in paper.ball_steps]
    assert degrees == [0, 40, 60, 90, 105, 140, 160, 185, 210, 250, 290, 310]


@pytest.mark.parametrize("count", [6, 8, 10])
def test_shipped_subsets_are_the_best_ones(count):
    plate = read_plate(PLATES / f"ball_plate_{count}_of_72.yaml")
    assert plate.ball_steps == best_layout(72, count, subset_of=PAPER_PLATE).steps


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"grid": 2}, "plate.yaml.grid: 2 is out of range"),
        ({"grid": 72.0}, "plate.yaml.grid: expected int"),
        ({"ball_steps": [0, 8, 72]}, r"must lie in 0..71, found \[72\]"),
        ({"ball_steps": [0, -8, 7]}, "out of range"),
        ({"ball_steps": "0 8 12"}, "expected a list"),
        ({"ball_steps": [0, 8, 8, 9]}, r"named twice: \[8\]"),
        ({"circle_radius_m": 185.0}, "looks like millimetres"),
        ({"circle_radius_m": "wide"}, "expected float"),
        ({"ball_diameter_m": 0.1}, "less than their diameter"),
        ({"radius": 1.0}, "unknown setting 'radius'"),
        ({"separate_groups": "yes please"}, "expected bool"),
    ],
)
def test_bad_plates_are_refused(change, text):
    with pytest.raises(ConfigurationError, match=text):
        parse_plate({**GOOD, **change}, "plate.yaml")


def test_balls_may_not_overlap_across_the_first_step():
    """Steps 11 and 0 of 12 lie side by side: 2 r sin(15 deg) = 95.8 mm apart."""
    apart = {**GOOD, "grid": 12, "ball_steps": [0, 5, 11], "ball_diameter_m": 0.095}
    assert parse_plate(apart, "plate.yaml").ball_steps == (0, 5, 11)
    text = "balls 1 grid steps apart are 0.0958 m apart, less than their diameter of 0.0970 m"
    with pytest.raises(ConfigurationError, match=text):
        parse_plate({**apart, "ball_diameter_m": 0.097}, "plate.yaml")


def test_bad_plate_files_are_refused(tmp_path):
    path = tmp_path / "plate.yaml"
    with pytest.raises(ConfigurationError, match="cannot read the set-up"):
        read_plate(path)
    for text, expected in (
        ("grid: [", "not valid YAML"),
        ("method: ball_plate\ngrid: 72\n", "setting 'ball_steps' is missing"),
        ("grid: 72\n", "expected a ROS 2 parameter file"),
        ("method: plane_mirror\ngrid: 72\n", "expected a ROS 2 parameter file"),
    ):
        path.write_text(text)
        with pytest.raises(ConfigurationError, match=expected):
            read_plate(path)


def test_a_plate_file_may_state_the_noise_of_a_centre(tmp_path):
    path = tmp_path / "plate.yaml"
    good = (PLATES / "ball_plate_12.yaml").read_text()
    path.write_text(good + "sigma_centre_m: 2.0e-7\n")
    assert read_setup(path).solver.sigma_centre_m == 2.0e-7


def test_plate_defaults():
    plate = Plate(grid=12, ball_steps=(0, 1, 5), circle_radius_m=RADIUS, ball_diameter_m=0.02)
    np.testing.assert_allclose(plate.places[0], [RADIUS, 0, 0])
