"""What is no input is refused by its name, and what is shown at a prompt is one short line."""

import pytest

import rotcal_ros as rc
from rotcal_ros.foundation.errors import ConfigurationError, DataError
from rotcal_ros.methods.calibration import prepare

PLATE, TRACER = "examples/data/ball_plate.yaml", "examples/data/tracer.yaml"
RESULT = "examples/data/result_ball_plate.json"


@pytest.mark.parametrize("setup", [PLATE, TRACER])
def test_no_observations_are_refused(setup):
    configuration = rc.read_configuration(setup)
    with pytest.raises(DataError, match=r"observations are empty: .*" + "ball_plate|tracer"):
        rc.solve([], configuration)
    with pytest.raises(ConfigurationError, match="observations hold a int"):
        rc.solve([1], configuration)
    with pytest.raises(ConfigurationError, match="observations hold a NoneType"):
        rc.solve(None, configuration)
    with pytest.raises(ConfigurationError, match="configuration is a str"):
        rc.solve([], setup)


@pytest.mark.parametrize("how", [{}, {"replaces": True}, {"replaces": True, "add_to": "x"}])
def test_a_misspelt_controller_is_said_before_all_else(tmp_path, how):
    table = rc.make_table(rc.read_result(RESULT))
    with pytest.raises(ConfigurationError, match=r"'linuxcncc'; did you mean 'linuxcnc'\?"):
        rc.write_controller_files(table, "linuxcncc", tmp_path, **how)


@pytest.mark.parametrize("name", ["XXX", "EXX", "ecc", "EDC", "", 3, None])
def test_a_deviation_that_is_none_has_no_unit(name):
    with pytest.raises(ConfigurationError, match=f"{name!r} is no deviation of a rotary axis"):
        rc.unit_of(name)


@pytest.mark.parametrize(("name", "label"), [("EXA", "µm"), ("EAA", "arcsec"), ("YOA", "µm")])
def test_those_of_a_tilting_axis_have_theirs(name, label):
    assert rc.unit_of(name)[1] == label


def test_what_a_prompt_shows_is_short():
    configuration, result = rc.read_configuration(PLATE), rc.read_result(RESULT)
    shown = {
        "Configuration: ball_plate, simulated cell": configuration,
        "Calibration: <Configuration: ball_plate": prepare(configuration),
        "Comparison: agree, 12 angles": rc.compare(
            result, rc.read_result("examples/data/result_tracer.json")
        ),
        "CompensationTable: C by ball_plate, ok": rc.make_table(result),
    }
    for begin, thing in shown.items():
        assert repr(thing).startswith(f"<{begin}")
        assert len(repr(thing)) < 300
        assert "\n" not in repr(thing)
