"""Plates and their files: good ones and bad ones."""

from pathlib import Path

import numpy as np
import pytest
from plate_data import PAPER_PLATE, RADIUS, parse_plate

from rotcal_ros.foundation.errors import ConfigurationError, DataError
from rotcal_ros.methods.ball_plate.settings import BallPlateSolverSettings, Plate
from rotcal_ros.methods.ball_plate.solver.separability import separability
from rotcal_ros.methods.configuration import read_configuration
from rotcal_ros.methods.measurements import read_measurements

PLATES = Path(__file__).parents[2] / "config" / "plates"
GOOD = {"grid": 72, "ball_steps": PAPER_PLATE, "circle_radius_m": 0.185, "ball_diameter_m": 0.025}


def read_plate(path):
    return read_configuration(path).plan.plate


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
    with pytest.raises(ConfigurationError, match="cannot read the configuration"):
        read_plate(path)
    for text, expected in (
        ("grid: [", "not valid YAML"),
        ("method: ball_plate\ngrid: 72\n", "setting 'ball_steps' is missing"),
        ("grid: 72\n", "expected 'method: NAME' at the top"),
        ("method: plane_mirror\ngrid: 72\n", "unknown setting 'grid'"),
    ):
        path.write_text(text)
        with pytest.raises(ConfigurationError, match=expected):
            read_plate(path)


def test_a_plate_file_may_state_the_noise_of_a_centre(tmp_path):
    path = tmp_path / "plate.yaml"
    good = (PLATES / "ball_plate_12.yaml").read_text()
    path.write_text(good + "sigma_centre_m: 2.0e-7\n")
    made = read_configuration(path)
    assert (made.solver.sigma_centre_m, made.plan.measure) == (2.0e-7, "centre")


@pytest.mark.parametrize(
    ("stated", "sigma", "axes"),
    [
        ("5e-8", 5e-8, ()),  # YAML 1.1 takes this for a text
        ("5E-08", 5e-8, ()),
        ("[5e-8, 5e-8, 1.0e-7]", 0.0, (5e-8, 5e-8, 1e-7)),
    ],
)
def test_noise_in_exponents_and_for_each_axis(tmp_path, stated, sigma, axes):
    path = tmp_path / "plate.yaml"
    good = (PLATES / "ball_plate_12.yaml").read_text()
    path.write_text(good + f"sigma_centre_m: {stated}\n")
    solver = read_configuration(path).solver
    assert (solver.sigma_centre_m, solver.sigma_axes_m) == (sigma, axes)


@pytest.mark.parametrize(
    ("stated", "text"),
    [
        ("5e-8 m", "expected float .* found '5e-8 m'"),
        ("nan", "expected float .* found 'nan'"),
        ("[5e-8, 5e-8]", "three positive lengths"),
        ("[5e-8, 5e-8, 0]", "three positive lengths"),
    ],
)
def test_other_words_for_noise_are_refused(tmp_path, stated, text):
    path = tmp_path / "plate.yaml"
    path.write_text((PLATES / "ball_plate_12.yaml").read_text() + f"sigma_centre_m: {stated}\n")
    with pytest.raises(ConfigurationError, match=text):
        read_configuration(path)


def test_one_standard_deviation_or_three():
    with pytest.raises(ConfigurationError, match="not both"):
        BallPlateSolverSettings(sigma_centre_m=5e-8, sigma_axes_m=(5e-8, 5e-8, 5e-8))


def centres_table(path, std=("", "")):
    """A table of exact centres of a small plate, with further columns."""
    header, cells = std
    lines = [f"position,ball_step,x_m,y_m,z_m{header}"]
    rng = np.random.default_rng(1)
    for ball in (0, 3, 4, 9, 14, 20):
        for i in range(24):
            angle = 2 * np.pi * (i + ball) / 24
            place = np.array([RADIUS * np.cos(angle), RADIUS * np.sin(angle), 0.0])
            place += [5e-8, 5e-8, 1.5e-7] * rng.normal(size=3)
            lines.append(f"{i},{ball}," + ",".join(repr(float(v)) for v in place) + cells)
    path.write_text("\n".join(lines) + "\n")
    return path


SMALL = """method: ball_plate
grid: 24
ball_steps: [0, 3, 4, 9, 14, 20]
circle_radius_m: 0.185
ball_diameter_m: 0.02
"""


def test_a_table_may_state_the_noise_of_each_centre(tmp_path):
    setup = tmp_path / "plate.yaml"
    setup.write_text(SMALL + "sigma_centre_m: 1e-7\n")
    std = (",sx_m,sy_m,sz_m", ",5e-8,5e-8,1.5e-7")
    path = centres_table(tmp_path / "balls.csv", std)
    result = read_measurements(path, read_configuration(setup)).solve()
    assert result.verdict == "ok"
    assert set(result.details["noise"].values()) == {1.0}  # times the stated
    wrong = read_measurements(centres_table(tmp_path / "b.csv"), read_configuration(setup)).solve()
    assert wrong.verdict == "suspect"  # 0.1 um for all does not hold
    setup.write_text(SMALL + "sigma_centre_m: [5e-8, 5e-8, 1.5e-7]\n")
    same = read_measurements(tmp_path / "b.csv", read_configuration(setup)).solve()
    for name, deviations in same.deviations.items():
        np.testing.assert_array_equal(deviations, result.deviations[name])
        np.testing.assert_array_equal(same.std[name], result.std[name])


@pytest.mark.parametrize("bad", ["0", "-1e-7", "0.5", "x"])
def test_a_standard_deviation_in_a_table_must_be_one(tmp_path, bad):
    setup = tmp_path / "plate.yaml"
    setup.write_text(SMALL)
    std = (",sx_m,sy_m,sz_m", f",5e-8,5e-8,{bad}")
    path = centres_table(tmp_path / "balls.csv", std)
    with pytest.raises(DataError, match=r"row 2: sz_m"):
        read_measurements(path, read_configuration(setup))


def test_plate_defaults():
    plate = Plate(grid=12, ball_steps=(0, 1, 5), circle_radius_m=RADIUS, ball_diameter_m=0.02)
    np.testing.assert_allclose(plate.places[0], [RADIUS, 0, 0])
