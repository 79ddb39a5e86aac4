"""Tables of lengths that were read while the table turned, and what is wrong with them."""

from dataclasses import replace

import numpy as np
import pytest
from turning_scene import turning_scene, write_turns

import rotcal_ros as rc
from rotcal_ros.foundation.errors import ConfigurationError, DataError, PlanError
from rotcal_ros.methods.tracer.plan import turning_plan
from rotcal_ros.methods.tracer.settings import TracerPlanSettings

NOISE = "solver: {length_std_m: 3.5e-8, error_motion_std_m: 0.0}\n"


@pytest.fixture(scope="module")
def scene():
    return turning_scene(31, angles=36)


def setup(scene, plan=""):
    place = scene.place.round(3).tolist()
    return f"plan: {{tracer_m: {place}{plan}}}\n{NOISE}"


def read(scene, folder, plan="", **more):
    table, settings = write_turns(scene, folder, setup=setup(scene, plan), **more)
    return rc.read_table(table, rc.read_configuration(settings))


def test_both_directions_of_a_table_are_found_with_their_speeds(scene, tmp_path):
    measured = read(scene, tmp_path)
    assert measured.configuration.plan.turning_deg_s == pytest.approx((12.0, -12.0), rel=1e-3)
    result = measured.solve()
    assert result.verdict == "ok"
    assert result.angles == pytest.approx(scene.angles, abs=1e-12)
    mean = scene.ecc.mean(axis=0)
    error = result.deviations["ECC"] - (mean - mean[0])
    assert np.abs(error[1:] / result.std["ECC"][1:]).max() < 4.0
    reversal = result.directions["ECC"].forward - result.directions["ECC"].reverse
    true = scene.ecc[0] - scene.ecc[1]
    assert reversal == pytest.approx(true - true.mean(), abs=4e-6)
    # sources of the uncertainty belong to the angles of the mean
    total = np.sum([std**2 for std in result.budget.values()], axis=0)
    assert total == pytest.approx(result.std["ECC"] ** 2, rel=1e-9)


def test_times_are_not_needed_where_speeds_are_stated(scene, tmp_path):
    result = read(scene, tmp_path, ", turning_deg_s: [12, -12]", with_times=False).solve()
    assert result.verdict == "ok"


@pytest.mark.parametrize(
    ("plan", "more", "error", "what"),
    [
        ("", {"with_times": False}, ConfigurationError, "how fast did the table turn"),
        (", turning_deg_s: [20, -20]", {}, DataError, "12 deg/s by its times"),
        (", turning_deg_s: [12]", {}, DataError, "no speed of this sign"),
        (", table_step_deg: 7", {}, DataError, "none of the table angles"),
        ("", {"rows": np.random.default_rng(1).permutation(288)}, DataError, "rows are mixed"),
    ],
)
def test_what_does_not_fit_is_refused_with_what_to_do(scene, tmp_path, plan, more, error, what):
    with pytest.raises(error, match=what):
        read(scene, tmp_path, plan, **more)


@pytest.mark.parametrize(
    ("old", "new", "what"),
    [
        (",1,", ",2,", "row 2: direction must be 1"),
        ("0.0,0,", "0.0,9,", "row 2: target 9 is not one of the 4 targets"),
    ],
)
def test_a_wrong_cell_is_named_by_its_row(scene, tmp_path, old, new, what):
    table, settings = write_turns(scene, tmp_path, setup=setup(scene))
    table.write_text(table.read_text().replace(old, new, 1))
    with pytest.raises(DataError, match=what):
        rc.read_table(table, rc.read_configuration(settings)).solve()


def test_three_targets_leave_nothing_to_check_a_place(tmp_path):
    with pytest.raises(PlanError, match="at least 4"):
        read(turning_scene(31, angles=12, targets=3), tmp_path)


def test_more_angles_than_a_result_can_hold_are_refused():
    most = TracerPlanSettings(
        table_positions=3600, table_step_deg=0.1, turning_deg_s=(12.0, -12.0),
        targets_m=(0.5, 0.0, 0.3, 0.0, 0.5, 0.6, -0.5, 0.0, 0.3, 0.0, -0.5, 0.6),
    )  # fmt: skip
    assert len(turning_plan(most).counting) == 3600 * 2 * 4
    with pytest.raises(PlanError, match="7201 angles at 2 speeds are 14402 places"):
        turning_plan(replace(most, table_positions=7201))


def test_a_table_of_any_other_form_is_not_held_to_be_one_that_turned(scene, tmp_path):
    table, settings = write_turns(scene, tmp_path, setup=setup(scene), with_times=False)
    rows = [line.split(",") for line in table.read_text().splitlines()]
    table.write_text("\n".join(",".join([b, a, *rest]) for a, b, *rest in rows) + "\n")
    try:
        measured = rc.read_table(table, rc.read_configuration(settings))
    except rc.RotcalError:
        return  # refused, where no package reads tables of any form
    assert measured.configuration.plan.turning_deg_s == ()
