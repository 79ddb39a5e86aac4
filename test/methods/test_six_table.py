"""Lengths of several places as a plain table."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rotcal_ros.foundation.errors import BagError, ConfigurationError, DataError
from rotcal_ros.methods import changed, prepare, read_configuration
from rotcal_ros.methods.measurements import read_measurements

DEMO = Path(__file__).parents[2] / "config" / "tracer_six_demo.yaml"
SMALL = (
    "plan.table_positions=4", "plan.table_step_deg=90.0", "plan.box_points=[2, 2, 2]",
    "plan.closes=true",
)  # fmt: skip


@pytest.fixture
def configuration():
    return changed(read_configuration(DEMO), SMALL)


def table_of(observations, path, header="place,position,target,length_m"):
    """Write observations as a table."""
    rows = [f"{o.station},{o.table_position},{o.target},{o.mean[0]!r}" for o in observations]
    path.write_text("\n".join(["# from another program", header, *rows]) + "\n")
    return path


def test_a_table_holds_what_the_plan_measures(configuration, tmp_path):
    observations = prepare(configuration).nominal_observations()
    found = read_measurements(table_of(observations, tmp_path / "lengths.csv"), configuration)
    assert found.observations == observations
    assert list(found.sha256) == ["lengths.csv"]


def test_targets_beside_the_table_take_the_place_of_the_planned_ones(configuration, tmp_path):
    observations = prepare(configuration).nominal_observations()
    path = table_of(observations, tmp_path / "lengths.csv")
    targets = np.array(prepare(configuration).plan.targets) + 0.001
    rows = [f"{number},{x},{y},{z}" for number, (x, y, z) in enumerate(targets.tolist())]
    (tmp_path / "targets.csv").write_text("\n".join(["target,x_m,y_m,z_m", *rows]))
    found = read_measurements(path, configuration)
    np.testing.assert_array_equal(found.calibration.plan.targets, targets)
    assert sorted(found.sha256) == ["lengths.csv", "targets.csv"]


def test_what_cannot_be_names_row_and_place(configuration, tmp_path):
    good = prepare(configuration).nominal_observations()
    path = tmp_path / "lengths.csv"
    with pytest.raises(
        DataError,
        match=r"row 3: place 7, position 0, target 0 is not in the plan,"
        " which has places 0 to 2, positions 0 to 3 and targets 0 to 7",
    ):
        read_measurements(table_of([replace(good[0], station=7)], path), configuration)
    twice = [good[0], good[8], good[8]]  # closing measures position 0 twice, not position 1
    with pytest.raises(DataError, match=r"row 5: place 0, position 1.* already .*row 4"):
        read_measurements(table_of(twice, path), configuration)
    wrong = [good[0], replace(good[1], mean=(good[1].mean[0] + 40.0,))]
    with pytest.raises(DataError, match="row 4: implausible: length changed by"):
        read_measurements(table_of(wrong, path), configuration)
    with pytest.raises(BagError, match=r"no column target.*place,position,target,length_m"):
        read_measurements(table_of(good, path, "place,position,goal,length_m"), configuration)


SHORT = """
method: tracer_six
table_angles_deg: [0, 90, 180, 270]
places_m: [[0.15, 0, 0.1], [-0.07, 0.13, 0.1], [-0.07, -0.13, 0.12]]
length_std_m: 3.0e-7
zero: per_station
"""


def test_a_short_setup_lists_settings_and_points(tmp_path):
    file = tmp_path / "setup.yaml"
    file.write_text(SHORT)
    made = read_configuration(file)
    assert made.method.name == "tracer_six"
    assert made.plan.places_m == (0.15, 0.0, 0.1, -0.07, 0.13, 0.1, -0.07, -0.13, 0.12)
    assert made.plan.table_angles_deg == (0.0, 90.0, 180.0, 270.0)
    assert (made.solver.length_std_m, made.solver.zero) == (3e-7, "per_station")
    assert made.solver.datum == "prior"
    file.write_text(SHORT + "target_std: 1.0e-6\n")
    with pytest.raises(
        ConfigurationError, match=r"setup\.yaml: .*'target_std'; did you mean 'target_"
    ):
        read_configuration(file)


def test_the_column_segment_numbers_unbroken_beams(configuration, tmp_path):
    observations = [
        replace(o, segment=int(o.table_position > 1))
        for o in prepare(configuration).nominal_observations()
    ]
    path = tmp_path / "lengths.csv"
    rows = [
        f"{o.station},{o.table_position},{o.target},{o.mean[0]!r},{o.segment}"
        for o in observations
    ]
    path.write_text("\n".join(["place,position,target,length_m,segment", *rows]))
    found = read_measurements(path, configuration)
    assert found.observations == tuple(observations)
    assert found.solve().details["zero"] == "per_segment"
    assert len(found.solve().details["segments"]) == 6
