"""LinuxCNC's own way with tables: figures and traps that were seen on the real program."""

import numpy as np
import pytest
from compensation_examples import TAU, d4_table, even, result_of, wavy
from hypothesis import given, settings
from hypothesis import strategies as st

from rotcal_ros.compensation.linuxcnc import LinuxCnc, load_as_linuxcnc
from rotcal_ros.compensation.table import resample, table_from_result
from rotcal_ros.foundation.errors import BagError
from rotcal_ros.foundation.observations import Approach
from rotcal_ros.foundation.units import ARCSEC, DEGREE

TABLE = "0 .010 -.005\n90 .050 .030\n180 -.020 -.040\n270 .015 -.010\n360 .010 -.005\n"
INI = "[JOINT_0]\nCOMP_FILE = a.comp\nCOMP_FILE_TYPE = 1\n"
UP, DOWN = Approach.POSITIVE, Approach.NEGATIVE

MEASURED = [  # joint position, direction, motor command, all read from LinuxCNC 2.9
    (10, UP, 10.014444444),
    (45, UP, 45.029999946),
    (135, UP, 135.015000005),
    (225, UP, 224.997499998),
    (300, UP, 300.013333333),
    (360, UP, 360.010000000),
    (370, UP, 370.010000000),
    (730, UP, 730.010000000),
    (720, DOWN, 719.995000000),
    (350, DOWN, 349.994444444),
    (300, DOWN, 299.991666668),
    (225, DOWN, 224.975000003),
    (45, DOWN, 45.012500004),
    (10, DOWN, 9.998888935),
    (0, DOWN, -0.005000000),
    (-90, DOWN, -90.005000000),
    (-90, UP, -89.990000000),
]


@pytest.mark.parametrize(("joint", "approach", "motor"), MEASURED)
def test_rule_gives_the_motor_commands_of_the_real_program(joint, approach, motor):
    trim = load_as_linuxcnc(TABLE, 1).correction(np.array([joint * DEGREE]), approach)[0] / DEGREE
    assert joint + trim == pytest.approx(motor, abs=1e-7)


@pytest.mark.parametrize(
    ("text", "rows", "messages"),
    [
        ("# header\n" + TABLE, 0, 0),
        (TABLE.replace("90 ", "\n90 ", 1), 1, 0),
        (TABLE.replace(" ", ","), 0, 0),
        (TABLE.replace("\n", " remark\n"), 5, 0),
        (TABLE.replace("\n", "\r\n"), 5, 0),
        (TABLE.replace("90 .050", "0 .050"), 4, 1),
        ("".join(f"{k} 0.001 0.001\n" for k in range(300)), 256, 44),
    ],
)
def test_malformed_tables_load_as_the_real_program_loads_them(text, rows, messages):
    loaded = load_as_linuxcnc(text, 1)
    assert (len(loaded.nominal_deg), len(loaded.messages)) == (rows, messages)


@pytest.mark.parametrize(
    "text",
    [
        "# header\n" + TABLE,
        TABLE.replace("90 ", "\n90 ", 1),
        TABLE.replace(" ", ","),
        TABLE.replace("90 .050", "0 .050"),
        "".join(f"{k} 0.001 0.001\n" for k in range(300)),
        "",
    ],
)
def test_reader_refuses_what_the_program_swallows_in_silence(text):
    with pytest.raises(BagError, match="LinuxCNC uses"):
        LinuxCnc().read({"a.comp": text, "a.ini": INI})


def test_missing_file_type_is_refused():
    with pytest.raises(BagError, match="COMP_FILE_TYPE"):
        LinuxCnc().read({"a.comp": TABLE, "a.ini": "[JOINT_0]\nCOMP_FILE = a.comp\n"})


@settings(max_examples=50, deadline=None)
@given(
    rows=st.integers(3, 85),
    turns=st.integers(1, 3),
    first=st.integers(-2, 1),
    file_type=st.sampled_from([0, 1]),
    scale=st.floats(-3600.0, 3600.0),
)
def test_writer_never_makes_a_table_that_loads_only_partly(rows, turns, first, file_type, scale):
    angles = even(rows)
    table = table_from_result(result_of(angles, wavy(angles, [(1, scale, 1.0)])))
    controller = LinuxCnc(file_type=file_type, turns=turns, first_turn=first)
    files = controller.write(table, "t")
    loaded = load_as_linuxcnc(files["t.comp"], file_type)
    assert len(loaded.nominal_deg) == rows * turns + 1 <= 256
    assert not loaded.messages
    assert loaded.nominal_deg[0] == 360.0 * first
    assert loaded.nominal_deg[-1] == 360.0 * (first + turns)
    assert max(len(line) for line in files["t.comp"].splitlines()) < 254


def test_trims_are_held_in_single_precision():
    trim = (
        load_as_linuxcnc("0 0.1 0.1\n360 0.1 0.1\n", 1).correction(np.array([1.0]), UP)[0] / DEGREE
    )
    assert trim == pytest.approx(float(np.float32(0.1)), abs=1e-16)
    assert trim != pytest.approx(0.1, abs=1e-12)


def test_every_turn_has_the_same_trim():
    angles = even(24)
    table = table_from_result(result_of(angles, wavy(angles)))
    controller = LinuxCnc(first_turn=-1, turns=10)
    loaded = controller.read(controller.write(table, "t"))
    at = np.array([10.0, 100.0]) * DEGREE
    for turn in range(-1, 9):
        np.testing.assert_allclose(
            loaded.correction(at + turn * TAU, UP), loaded.correction(at, UP), atol=1e-7 * ARCSEC
        )


def test_both_types_move_the_motor_alike():
    angles = even(24)
    table = resample(table_from_result(result_of(angles, wavy(angles))), TAU / 50)
    command = np.linspace(0.0, TAU, 777)
    both = []
    for file_type in (0, 1):
        controller = LinuxCnc(file_type=file_type)
        both.append(controller.read(controller.write(table, "t")).correction(command, DOWN))
    np.testing.assert_allclose(both[0], both[1], atol=1e-5 * ARCSEC)


def test_type_1_by_hand():
    controller = LinuxCnc()
    files = controller.write(d4_table(), "x")
    rows = [[float(x) for x in line.split()] for line in files["x.comp"].splitlines()]
    expected = [
        [0, 0, 0.002],
        [90, -0.005, -0.003],
        [180, 0.003, 0.005],
        [270, -0.001, 0.001],
        [360, 0, 0.002],
    ]
    np.testing.assert_allclose(rows, expected, atol=1e-12)
    assert files["x.ini"] == "[JOINT_0]\nCOMP_FILE = x.comp\nCOMP_FILE_TYPE = 1\n"
    rule, at = controller.read(files), np.array([45.0, 360.0, 400.0, -5.0]) * DEGREE
    got = rule.correction(at, UP) / DEGREE
    np.testing.assert_allclose(got, [-0.0025, 0.0, 0.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(rule.correction(at[:1], DOWN) / DEGREE, -0.0005, atol=1e-9)


def test_type_0_holds_actual_angles_by_hand():
    files = LinuxCnc(file_type=0).write(d4_table(), "x")
    rows = [[float(x) for x in line.split()] for line in files["x.comp"].splitlines()]
    expected = [
        [0, 0, -0.002],
        [90, 90.005, 90.003],
        [180, 179.997, 179.995],
        [270, 270.001, 269.999],
        [360, 360, 359.998],
    ]
    np.testing.assert_allclose(rows, expected, atol=1e-12)
    assert "COMP_FILE_TYPE = 0" in files["x.ini"]
