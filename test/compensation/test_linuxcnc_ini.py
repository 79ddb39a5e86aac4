"""The ini file of a LinuxCNC: read as it reads it, completed where the lines belong, checked."""

from dataclasses import replace
from datetime import datetime, timezone

import numpy as np
import pytest
from compensation_examples import TAU, even, result_of, wavy

from rotcal_ros.compensation.agreement import AcceptedConflicts, MachineIdentity
from rotcal_ros.compensation.controllers import make_controller
from rotcal_ros.compensation.earlier_export import combine_with_earlier_export
from rotcal_ros.compensation.export import prepare_export
from rotcal_ros.compensation.feed import largest_change
from rotcal_ros.compensation.held_table import hash_in_force
from rotcal_ros.compensation.linuxcnc import UNKNOWN_BACKLASH, find_loaded_tables
from rotcal_ros.compensation.linuxcnc_machine import IniFile, Joint, agent_command
from rotcal_ros.compensation.table import table_from_result
from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.units import DEGREE

NOW = datetime(2026, 1, 2, tzinfo=timezone.utc)
TEXT = """# a machine
[EMCMOT]
SERVO_PERIOD = 500000
[KINS]
JOINTS = 4
KINEMATICS = trivkins coordinates=XYZA
[TRAJ]
ANGULAR_UNITS = degree
[AXIS_A]
MIN_LIMIT = -360
MAX_LIMIT = 1e6
[JOINT_3]
TYPE = ANGULAR
 MAX_VELOCITY=90.0
MAX_ACCELERATION = 200.0   # deg/s^2
MIN_LIMIT = -400
MAX_LIMIT = 720
COMP_FILE = old.comp
MAX_VELOCITY = 7

# the last axis
[JOINT_0]
TYPE = LINEAR
"""


@pytest.fixture
def machine(tmp_path):
    path = tmp_path / "xyza.ini"
    path.write_text(TEXT)
    return path


def exported(machine, axis="A", **settings):
    table = table_from_result(result_of(even(36), wavy(even(36))), axis=axis)
    settings = {"machine_ini": str(machine), "first_turn": -1, "turns": 3} | settings
    return prepare_export(table, "linuxcnc", now=NOW, spacing=TAU / 36, settings=settings)


def test_the_first_section_and_the_first_line_count(machine):
    ini = IniFile.read(machine)
    assert ini.value("JOINT_3", "MAX_VELOCITY") == "90.0"
    assert ini.number("JOINT_3", "MAX_ACCELERATION", 1.0) == 200.0
    assert ini.value("JOINT_3", "HOME") is None
    assert ini.value("JOINT_1", "TYPE") is None
    twice = IniFile(machine, TEXT + "[JOINT_3]\nHOME = 5\n")
    assert twice.value("JOINT_3", "HOME") is None  # LinuxCNC does not look there
    assert twice.count("JOINT_3") == 2


def test_lines_go_into_their_section_and_nothing_else_changes():
    text = TEXT.replace("\n", "\r\n").replace("a machine", "Dreht\xfcr")
    merged = IniFile(None, text).merged("JOINT_3", {"COMP_FILE": "new.comp", "COMP_FILE_TYPE": 1})
    lines = merged.split("\r\n")
    gone = [line for line in text.split("\r\n") if line not in lines]
    new = [line for line in lines if line not in text.split("\r\n")]
    assert (gone, new) == (
        ["COMP_FILE = old.comp"],
        ["COMP_FILE = new.comp", "COMP_FILE_TYPE = 1"],
    )
    ini = IniFile(None, merged)
    assert ini.value("JOINT_3", "COMP_FILE") == "new.comp"
    assert ini.value("JOINT_3", "COMP_FILE_TYPE") == "1"
    again = ini.merged("JOINT_3", {"COMP_FILE": "new.comp", "COMP_FILE_TYPE": 1})
    assert again == merged


def test_a_section_at_the_end_without_a_line_end_is_completed():
    merged = IniFile(None, "[JOINT_0]\nTYPE = ANGULAR").merged("JOINT_0", {"COMP_FILE": "a.comp"})
    assert merged == "[JOINT_0]\nTYPE = ANGULAR\nCOMP_FILE = a.comp\n"


def test_what_stands_twice_or_elsewhere_is_not_merged(machine):
    with pytest.raises(ConfigurationError, match="ignores all but the first"):
        IniFile(machine, TEXT + "[JOINT_3]\n").merged("JOINT_3", {"COMP_FILE": "a"})
    with pytest.raises(ConfigurationError, match=r"holds 0 sections \[JOINT_7\]"):
        IniFile(machine, TEXT).merged("JOINT_7", {"COMP_FILE": "a"})
    (machine.parent / "joint.inc").write_text("[JOINT_9]\nTYPE = ANGULAR\n")
    included = IniFile(machine, TEXT + "#INCLUDE joint.inc\n")
    assert included.value("JOINT_9", "TYPE") == "ANGULAR"
    with pytest.raises(ConfigurationError, match="in an included file"):
        included.merged("JOINT_9", {"COMP_FILE": "a"})


def test_an_export_for_a_machine_knows_joint_limits_and_period(machine, tmp_path):
    made = exported(machine)
    controller = made.controller
    assert (controller.joint, controller.servo_period_ns) == (3, 500_000)
    assert (controller.max_acceleration_deg_s2, controller.max_velocity_deg_s) == (200.0, 90.0)
    copy = IniFile(tmp_path, made.with_machine_files()["xyza.ini"])
    assert copy.value("JOINT_3", "COMP_FILE") == "a_linuxcnc.comp"
    assert copy.value("JOINT_3", "COMP_FILE_TYPE") == "1"
    assert exported(machine, max_acceleration_deg_s2=5.0).controller.max_acceleration_deg_s2 == 5.0
    assert agent_command(str(machine), "A", 0)[-4:] == ["--axis", "A", "--joint", "3"]
    assert controller.home_deg == 0.0
    machine.write_text(TEXT.replace("MAX_LIMIT = 720", "MAX_LIMIT = 720\nHOME = 7.5"))
    assert exported(machine).controller.home_deg == 7.5
    assert exported(machine, home_deg=-5.0).controller.home_deg == -5.0


@pytest.mark.parametrize(
    ("change", "settings", "complaint"),
    [
        ((), {"turns": 2}, r"may travel from -360 to 720 deg .* -360 to 360.*revolutions -1:2"),
        (("coordinates=XYZA", "coordinates=XYZB"), {}, "has the axes XYZB and none named A"),
        ((), {"joint": 2}, "axis A is joint 3, not 2"),
        (("TYPE = ANGULAR", "TYPE = LINEAR"), {}, "a table of degrees needs ANGULAR"),
        (("= degree", "= grad"), {}, "ANGULAR_UNITS = grad"),
        (("[JOINT_0]", "[JOINT_3]"), {}, r"holds 2 sections \[JOINT_3\]"),
        (("= -400", "= low"), {}, "MIN_LIMIT = 'low', expected a number"),
    ],
)
def test_a_machine_that_does_not_fit_is_refused(machine, change, settings, complaint):
    machine.write_text(TEXT.replace(*change) if change else TEXT)
    with pytest.raises(ConfigurationError, match=complaint):
        exported(machine, **settings)


def test_other_kinematics_leave_the_joint_to_the_settings(machine):
    machine.write_text(TEXT.replace("trivkins", "5axiskins"))
    assert exported(machine, joint=3).controller.joint == 3
    with pytest.raises(ConfigurationError, match="TYPE = LINEAR"):
        exported(machine)
    machine.write_text(TEXT.replace("coordinates=XYZA", "coordinates=XAZA"))
    with pytest.raises(ConfigurationError, match="axis A is joint 1 and 3"):
        exported(machine)


def test_a_machine_without_a_file_is_refused(tmp_path):
    with pytest.raises(ConfigurationError, match="cannot read the machine's ini file"):
        exported(tmp_path / "none.ini")


def in_use(made, folder):
    files = {n: t for n, t in made.files.items() if not n.endswith(".json")}
    return made.controller.not_in_use("A", files, folder)


def test_a_table_that_the_machine_does_not_name_is_not_in_use(machine, tmp_path):
    made = exported(machine)
    (wrong,) = in_use(made, tmp_path)
    assert "COMP_FILE = old.comp is not" in wrong
    machine.write_text(made.with_machine_files()["xyza.ini"])
    assert in_use(made, tmp_path) == ()
    (wrong,) = in_use(made, tmp_path / "elsewhere")
    assert "is not" in wrong
    text = machine.read_text()
    machine.write_text(text.replace("COMP_FILE_TYPE = 1", "COMP_FILE_TYPE = 0"))
    (wrong,) = in_use(made, tmp_path)
    assert "COMP_FILE_TYPE is 0, the table is of type 1" in wrong
    machine.write_text(text.replace("COMP_FILE_TYPE = 1\n", "").replace("= 720", "= 1080"))
    assert [w.count("missing, which means 0") for w in in_use(made, tmp_path)] == [1, 0]
    machine.write_text(text.replace("COMP_FILE = a_linuxcnc.comp\n", ""))
    (wrong,) = in_use(made, tmp_path)
    assert "names no table" in wrong
    assert make_controller("linuxcnc").not_in_use("A", made.files, tmp_path) == ()


def test_the_hook_up_of_a_machine_is_looked_at(machine, tmp_path):
    ((about, wrong),) = find_loaded_tables(machine)
    assert about == "[JOINT_3] old.comp, type 0"
    assert wrong == (
        f"{tmp_path / 'old.comp'}: No such file or directory: LinuxCNC does not start",
    )
    made = exported(machine)
    for name, text in made.with_machine_files().items():
        (tmp_path / name).write_text(text)
    assert list(find_loaded_tables(machine)) == [("[JOINT_3] a_linuxcnc.comp, type 1", ())]

    text = machine.read_text()
    machine.write_text(text.replace("COMP_FILE_TYPE = 1", "COMP_FILE_TYPE = 0"))
    ((_, wrong),) = find_loaded_tables(machine)
    assert ["another type" in words for words in wrong] == [True]
    machine.write_text(text.replace("[JOINT_0]", "[JOINT_3]").replace("= 720", "= 721"))
    ((_, wrong),) = find_loaded_tables(machine)
    assert "ignores all but the first" in wrong[0]
    assert "from -360 to 721 deg" in wrong[1]
    table = tmp_path / "a_linuxcnc.comp"
    machine.write_text(text)
    table.write_text("# header\n" + table.read_text())
    ((_, wrong),) = find_loaded_tables(machine)
    assert wrong == ("of 110 lines LinuxCNC uses 0",)
    machine.write_text(text.replace("COMP_FILE = ", "# "))
    assert list(find_loaded_tables(machine)) == []


def test_the_travel_is_that_of_axis_and_joint(machine):
    joint = Joint.of_axis(IniFile.read(machine), "A", 0)
    assert joint.travel_deg == (-360.0, 720.0)
    assert joint.travel_beyond(-360.0, 720.0) is None
    free = replace(joint, ini=IniFile(machine, TEXT.replace("MAX_LIMIT", "MAXIMUM")))
    assert free.travel_deg == (-360.0, 1e99)
    assert np.char.find(free.travel_beyond(-360.0, 720.0), "revolutions") == -1


PLAY = 0.01
"""BACKLASH of the machine in deg; LinuxCNC 2.9, control.c: half of it for either direction."""
LINE = "COMP_FILE = old.comp\n"


def columns(made):
    """Forward and reverse trim (deg) of the rows of one turn, whatever the type."""
    (text,) = (text for name, text in made.files.items() if name.endswith(".comp"))
    nominal, up, down = np.array([line.split() for line in text.splitlines()], dtype=float).T
    if made.controller.file_type == 0:
        up, down = nominal - up, nominal - down
    turn = (nominal > -1e-9) & (nominal < 359.9)
    return up[turn], down[turn]


@pytest.mark.parametrize(
    ("before", "after", "amount"),
    [
        (LINE, f"BACKLASH = {PLAY}\n", PLAY),
        (LINE, f"{LINE}BACKLASH={PLAY} # measured\nBACKLASH = 7\n", PLAY),
        (LINE, f"\t BACKLASH =\t-{PLAY};\n", -PLAY),
        (LINE, "backlash = 7\n# BACKLASH = 7\n;BACKLASH = 7\n", 0.0),
        ("MAX_LIMIT = 1e6\n", "MAX_LIMIT = 1e6\nBACKLASH = 7\n", 0.0),
        ("[JOINT_0]\n", "[JOINT_0]\nBACKLASH = 7\n", 0.0),
    ],
)
@pytest.mark.parametrize("file_type", [0, 1])
def test_what_backlash_corrected_is_in_both_columns(machine, before, after, amount, file_type):
    plain = columns(exported(machine, file_type=file_type))
    machine.write_text(TEXT.replace(before, after))
    made = exported(machine, file_type=file_type)
    found = np.subtract(columns(made), plain)
    assert found == pytest.approx(np.tile([[amount / 2], [-amount / 2]], 36), abs=3e-9)
    said = [text for text in made.warnings if "BACKLASH = " in text]
    assert [f"{amount * 1800:+.6g} arcsec in the forward column" in text for text in said] == (
        [True] if amount else [False] * ("1e6" in before)
    )
    assert made.residual.simulated <= made.residual.stated < 2.0 * exported_stated(machine)


def exported_stated(machine):
    machine.write_text(TEXT)
    return exported(machine).residual.stated


def test_backlash_is_added_once_and_only_where_it_acted(machine, tmp_path):
    machine.write_text(TEXT.replace(LINE, f"BACKLASH = {PLAY}\n"))
    first = exported(machine)
    machine.write_text(first.with_machine_files()["xyza.ini"])  # the line stays, a table is named
    assert "BACKLASH" in machine.read_text()
    assert exported(machine).files["a_linuxcnc.comp"] == first.files["a_linuxcnc.comp"]
    held = {n: t for n, t in first.files.items() if not n.endswith(".ini")}
    held |= {"a_linuxcnc.ini": first.files["a_linuxcnc.ini"]}
    for name, text in held.items():
        (tmp_path / name).write_text(text)
    left = replace(
        table_from_result(result_of(even(36), 0.05 * wavy(even(36))), axis="A"),
        measured_on=hash_in_force(held),
    )
    machines = {"machine": MachineIdentity("A", "")}
    total = combine_with_earlier_export(
        left, "linuxcnc", machines, AcceptedConflicts(), 0, measured_ns=1, add_to=tmp_path
    )
    settings = {"machine_ini": str(machine), "first_turn": -1, "turns": 3}
    made = prepare_export(total, "linuxcnc", now=NOW, spacing=TAU / 36, settings=settings)
    up, down = columns(made)
    assert up - down == pytest.approx(PLAY, abs=1e-6)
    assert (up[0], down[0]) == pytest.approx((PLAY / 2, -PLAY / 2), abs=1e-6)  # the same zero
    assert any("nothing of it is added" in text for text in made.warnings)
    at = 120.0 * DEGREE  # row 12, where the person wants the zero
    moved = prepare_export(
        total, "linuxcnc", now=NOW, spacing=TAU / 36, reference_angle=at, settings=settings
    )
    moved_up, moved_down = columns(moved)
    assert (moved_up[12], moved_down[12]) == pytest.approx((PLAY / 2, -PLAY / 2), abs=1e-6)
    assert np.ptp(moved_up - up) == pytest.approx(0.0, abs=3e-9)
    assert np.ptp(moved_down - down) == pytest.approx(0.0, abs=3e-9)
    other = exported(machine, backlash_deg=0.0)  # as a person states of the measurement
    assert np.ptp(np.subtract(*columns(other))) == pytest.approx(0.0, abs=1e-9)


def test_a_backlash_that_is_not_known_or_not_read_is_said(machine):
    table = table_from_result(result_of(even(36), wavy(even(36))), axis="A")
    made = prepare_export(table, "linuxcnc", now=NOW, spacing=TAU / 36)
    assert UNKNOWN_BACKLASH in made.warnings
    stated = prepare_export(
        table, "linuxcnc", now=NOW, spacing=TAU / 36, settings={"backlash_deg": PLAY}
    )
    assert UNKNOWN_BACKLASH not in stated.warnings
    assert np.subtract(*columns(stated)) == pytest.approx(PLAY, abs=3e-9)
    machine.write_text(TEXT.replace("MAX_LIMIT = 1e6\n", "MAX_LIMIT = 1e6\nBACKLASH = 0.02\n"))
    (said,) = (text for text in exported(machine).warnings if "BACKLASH" in text)
    assert "[AXIS_A] BACKLASH = 0.02: LinuxCNC reads it in [JOINT_3] only" in said
    machine.write_text(TEXT.replace(LINE, "BACKLASH = 0x1p-7\n"))
    with pytest.raises(ConfigurationError, match="BACKLASH = '0x1p-7', expected a number"):
        exported(machine)


def test_the_hook_up_says_what_becomes_of_backlash(machine, tmp_path):
    machine.write_text(TEXT.replace(LINE, f"BACKLASH = {PLAY}\n"))
    ((about, wrong),) = find_loaded_tables(machine)
    assert about == "[JOINT_3] no table"
    assert "BACKLASH = 0.01 deg (36 arcsec) acts only until it has one" in wrong[0]
    for name, text in exported(machine).with_machine_files().items():
        (tmp_path / name).write_text(text)
    ((about, wrong),) = find_loaded_tables(machine)
    assert about == (
        "[JOINT_3] a_linuxcnc.comp, type 1; BACKLASH = 0.01 deg (36 arcsec) is ignored with "
        "this table"
    )
    assert wrong == ()
    for name, text in exported(machine, backlash_deg=0.0).with_machine_files().items():
        (tmp_path / name).write_text(text)
    ((_, wrong),) = find_loaded_tables(machine)
    assert wrong == (
        "BACKLASH = 0.01 is ignored, and both columns are equal: nothing corrects the reversal",
    )


def test_the_bridge_counts_what_backlash_does_without_a_table(machine, tmp_path):
    machine.write_text(TEXT.replace(LINE, f"BACKLASH = {PLAY}\n"))
    made = exported(machine)
    files = {n: t for n, t in made.files.items() if not n.endswith(".json")}
    change = largest_change(made.controller, {}, files)
    assert change == pytest.approx(made.residual.before, rel=1e-3)
    assert largest_change(made.controller, files, {}) == pytest.approx(change)
