"""Documented examples of the controllers, worked out by hand: files, readers and rules."""

import re
from dataclasses import replace

import numpy as np
import pytest
from compensation_examples import d4_table, even, result_of, two_ways

from rotcal_ros.compensation.controllers import make_controller
from rotcal_ros.compensation.table import table_from_result
from rotcal_ros.foundation.errors import BagError, ConfigurationError
from rotcal_ros.foundation.observations import Approach
from rotcal_ros.foundation.units import DEGREE

UP, DOWN = Approach.POSITIVE, Approach.NEGATIVE


def example(name, table=None, **values):
    controller = make_controller(name, values)
    return controller.write(table or d4_table(), "x"), controller


def applied(files, controller, degrees, approach):
    """What the control adds, in degrees."""
    return controller.read(files).correction(np.asarray(degrees) * DEGREE, approach) / DEGREE


def test_sinumerik_enc_comp_by_hand():
    files, controller = example("sinumerik")
    values = [float(v) for v in re.findall(r"ENC_COMP\[0,\d,C1\]=(\S+)", files["x.ini"])]
    np.testing.assert_allclose(values, [0, 0.005, -0.003, 0.001, 0], atol=1e-9)
    assert files["x.ini"].startswith("%_N_AX_EEC_INI\nCHANDATA(1)\n")
    for line in ("STEP[0,C1]=90.0", "MIN[0,C1]=0.0", "MAX[0,C1]=360.0", "IS_MODULO[0,C1]=1"):
        assert f"$AA_ENC_COMP_{line}" in files["x.ini"]
    # A positive value moves the axis in the negative direction.
    np.testing.assert_allclose(applied(files, controller, [90, 450, -270], UP), -0.005, atol=1e-9)


def test_fanuc_slots_by_hand():
    table = table_from_result(result_of(even(4), np.deg2rad([0, 0.005, -0.003, 0.001])))
    files, controller = example("fanuc", table, reference_slot=60)
    slots = dict(re.findall(r"N100(\d\d)P(-?\d+);", files["x.txt"]))
    assert slots == {"60": "1", "61": "-3", "62": "5", "63": "-3", "64": "1"}
    assert "N03623A4P2;" in files["x.txt"]
    # The running sum is -3, +2, -1, 0 in steps of 0.002 deg, from the middle of each interval.
    got = applied(files, controller, [0, 44.9, 45.1, 134.9, 135.1, 260, 316, 359.9, 405.1], UP)
    expected = [0, 0, -0.006, -0.006, 0.004, -0.002, 0, 0, -0.006]
    np.testing.assert_allclose(got, expected, atol=1e-12)


def test_fanuc_slots_of_a_rotary_axis_as_in_the_manual():
    """B-63980EN/01 p. 100: reference 60, every 45 deg: 60 .. 68, increments that sum to zero."""
    steps = np.array([1, 2, -3, 0, 4, -6, 1, 1])
    total = np.deg2rad(np.cumsum(np.append(0, steps[:-1])) * 0.001)
    files, _ = example("fanuc", table_from_result(result_of(even(8), -total)), reference_slot=60)
    found = dict(re.findall(r"N(\d+)(?:A4)?P(-?[\d.]+);", files["x.txt"]))
    assert [found[k] for k in ("03620", "03621", "03622", "03623")] == ["60", "60", "68", "1"]
    assert (float(found["03624"]), float(found["03625"])) == (45.0, 360.0)
    assert [int(found[f"{10060 + k}"]) for k in range(1, 9)] == steps.tolist()
    assert found["10060"] == found["10068"]


@pytest.mark.parametrize(
    ("before", "after"), [("N10060P1;", "N10060P2;"), ("N10061P-3;", "N10061P-4;")]
)
def test_fanuc_slots_that_do_not_close_are_refused(before, after):
    table = table_from_result(result_of(even(4), np.deg2rad([0, 0.005, -0.003, 0.001])))
    files, controller = example("fanuc", table, reference_slot=60)
    assert before in files["x.txt"]
    with pytest.raises(BagError, match="steps of a turn add up"):
        controller.read({"x.txt": files["x.txt"].replace(before, after)})


def test_fanuc_step_above_seven_is_refused_with_the_numbers():
    table = table_from_result(result_of(even(4), np.deg2rad([0, 0.005, -0.003, 0.001])))
    with pytest.raises(
        ConfigurationError, match=r"step to 180 deg is 8 at magnification 1.*least 2"
    ):
        example("fanuc", table, magnification=1)


def test_twincat_by_hand():
    files, controller = example("twincat")
    assert files["x.lis"] == (
        "kw.ssfk.unit 1\nkw.ssfk.interval 900000\nkw.ssfk.kw_startpos 0\nkw.ssfk.kw_nr_max 5\n"
        "kw.ssfk.bilateral 1\nkw.ssfk.modulo 1\n"
        "kw.ssfk.table[0].pos 0\nkw.ssfk.table[0].neg -20\n"
        "kw.ssfk.table[1].pos 50\nkw.ssfk.table[1].neg 30\n"
        "kw.ssfk.table[2].pos -30\nkw.ssfk.table[2].neg -50\n"
        "kw.ssfk.table[3].pos 10\nkw.ssfk.table[3].neg -10\n"
        "kw.ssfk.table[4].pos 0\nkw.ssfk.table[4].neg -20\n"
    )
    np.testing.assert_allclose(applied(files, controller, [90, 315], UP), [-0.005, -0.0005])
    np.testing.assert_allclose(applied(files, controller, 315, DOWN), 0.0015)


def test_pmac_writes_the_example_of_its_manual():
    """Turbo PMAC User Manual p. 192: motor 3, load positions every 500 of 4000 counts."""
    load = np.array([
        [0, 510, 995, 1492.5, 1994, 2497.5, 3003.5, 3500.5],
        [5, 516, 998.5, 1494, 2000, 2501, 3010.5, 3508.5],
    ])  # fmt: skip
    off = np.deg2rad((load - 500.0 * np.arange(8)) * 360.0 / 4000.0)
    table = replace(two_ways(8), correction_forward=-off[0], correction_reverse=-off[1])
    files, controller = example("pmac", table, motor=3, counts_per_turn=4000)
    assert files["x.pmc"] == (
        "#3 DELETE BLCOMP\n#3 DELETE COMP\n#3 DEFINE COMP 8,4000\n-160 80 120 96 40 -56 -8 0\n"
        "#3 DEFINE BLCOMP 8,4000\n16 -24 -56 16 -24 32 48 0\nI385=16\nI386=80\nI51=1\n"
    )
    at = np.append(np.arange(8), 9) * 45.0
    for column, way in zip(off, (UP, DOWN), strict=True):
        expected = -np.rad2deg(np.append(column, column[1]))
        np.testing.assert_allclose(applied(files, controller, at, way), expected, atol=1e-12)


def pmac_takes(text, there):
    """What a Turbo PMAC holds after a download: its rules of pp. 301, 303 for tables, and no more.

    ``there`` are (kind, motor) from before. COMP is rejected while a BLCOMP of any motor is there,
    each of them while one of its kind is there for a lower motor, or for this one.
    """
    for motor, verb, kind in re.findall(r"^#(\d+) (DEFINE|DELETE) (\w+)", text, re.MULTILINE):
        if verb == "DELETE":
            there = there - {(kind, int(motor))}
            continue
        in_the_way = {k for k in there if k[0] == kind and k[1] <= int(motor)}
        if kind == "COMP":
            in_the_way |= {k for k in there if k[0] == "BLCOMP"}
        assert not in_the_way, f"ERR003: {kind} of motor {motor}, there is {in_the_way}"
        there = there | {(kind, int(motor))}
    return there


def test_pmac_takes_a_second_download():
    table = replace(two_ways(8), correction_reverse=two_ways(8).correction_forward - 1e-4)
    both, _ = example("pmac", table, motor=3, counts_per_turn=360_000)
    one, _ = example("pmac", table, motor=3, counts_per_turn=360_000, reversal="mean")
    there = pmac_takes(both["x.pmc"], frozenset())
    assert there == {("COMP", 3), ("BLCOMP", 3)}
    assert pmac_takes(both["x.pmc"], there) == there
    assert pmac_takes(one["x.pmc"], there) == {("COMP", 3)}


def test_pmac_has_no_negative_backlash():
    """The axis of the example comes out 0.002 deg lower from above, which Ixx86 cannot hold."""
    words = r"zero is -32 sixteenths of a count \(-7.2 arcsec\), and I186 holds 0 .. 8388607: give"
    with pytest.raises(ConfigurationError, match=words):
        example("pmac")
    files, controller = example("pmac", reversal="mean")
    assert (
        files["x.pmc"]
        == "#1 DELETE BLCOMP\n#1 DELETE COMP\n#1 DEFINE COMP 4,360000\n-80 48 -16 0\nI51=1\n"
    )
    for way in (UP, DOWN):
        np.testing.assert_allclose(applied(files, controller, [90, 450], way), -0.005)


def test_twincat_nc_by_hand():
    """The mean of both directions, zero at 0; added to the actual position its sign turns."""
    head = (
        "VAR_GLOBAL\n    C1_Both_parameter : ST_PositionCompensationTableParameter := (\n"
        "        MinPosition := 0.0, MaxPosition := 360.0, NoOfTableElements := 5,\n"
        "        Direction := WorkDirectionBoth, Modulo := TRUE);\n"
        "    C1_Both_table : ARRAY [0..4] OF ST_PositionCompensationTableElement := [\n"
    )
    for added_to, sign in (("setpoint", 1.0), ("actual", -1.0)):
        files, controller = example("twincat_nc", added_to=added_to)
        values = [0.0, -0.005 * sign, 0.003 * sign, -0.001 * sign, 0.0]
        rows = [
            f"        (Position := {90 * k:.6f}, Compensation := {value:.9f})"
            for k, value in enumerate(values)
        ]
        assert files["x.st"] == head + ",\n".join(rows) + "\n    ];\nEND_VAR\n"
        for way in (UP, DOWN):
            np.testing.assert_allclose(applied(files, controller, [90, -45], way),
                                       [-0.005, -0.0005])  # fmt: skip


def test_twincat_nc_with_a_table_for_each_direction():
    files, controller = example("twincat_nc", directions="each")
    assert re.findall(r"Direction := (\w+)", files["x.st"]) == [
        "WorkDirectionPositive", "WorkDirectionNegative"
    ]  # fmt: skip
    np.testing.assert_allclose(applied(files, controller, [90, 180], UP), [-0.005, 0.003])
    np.testing.assert_allclose(applied(files, controller, [90, 180], DOWN), [-0.003, 0.005])


def test_kflop_by_hand():
    """The wiki's table of A: to get to 0 the axis is commanded to 10, to get to 90 to 95 deg."""
    files, controller = example("kflop", first_turn=-1, turns=2)
    lines = files["x.txt"].splitlines()
    assert lines[:3] == ["9", "90.000000", "-360.000000"]
    assert lines[3:6] == ["0,-360.000000000", "1,-270.005000000", "2,-179.997000000"]
    assert lines[-2:] == ["7,269.999000000", "8,360.000000000"]
    np.testing.assert_allclose(applied(files, controller, [90, -45, 135], UP),
                               [-0.005, -0.0005, -0.001], atol=1e-12)  # fmt: skip
    wiki = {"a.txt": "5\n90\n0\n0,10\n1,95\n2,180\n3,270\n4,370\n"}
    rule = make_controller("kflop")
    np.testing.assert_allclose(applied(wiki, rule, [0, 90, 45, 180], DOWN), [10, 5, 7.5, 0])


def test_smoothieware_by_hand():
    """Slopes of -0.005, 0.008, -0.004 and 0.001 deg in 90 deg: multipliers off 1 by them."""
    files, controller = example("smoothieware", letter="Y")
    rows = [line.split() for line in files["x.dat"].splitlines()]
    assert {row[0] for row in rows} == {"Y"}
    ends = [0, 89.99, 90.01, 179.99, 180.01, 269.99, 270.01, 360]
    np.testing.assert_allclose([float(row[1]) for row in rows], ends, atol=2e-5)
    slopes = np.repeat([-0.005, 0.008, -0.004, 0.001], 2) / 90.0
    np.testing.assert_allclose([float(row[2]) for row in rows], 1.0 + slopes, atol=2e-7)
    found = applied(files, controller, [45.0, 90.0, 135.0, 270.0], UP)
    np.testing.assert_allclose(found, [-0.0025, -0.005, -0.001, -0.001], atol=5e-5)


def test_smoothieware_counts_from_zero_and_skips_what_is_too_steep():
    with pytest.raises(ConfigurationError, match=r"the turns 1 \.\. 2 leave out 0 deg"):
        example("smoothieware", first_turn=1)
    steep = replace(two_ways(4), correction_forward=np.deg2rad([0.0, 60.0, 0.0, 0.0]))
    steep = replace(steep, correction_reverse=steep.correction_forward)
    words = "from 0 to 89.99 deg the correction changes by 2400 arcsec per degree"
    with pytest.raises(ConfigurationError, match=words):
        example("smoothieware", steep)
    rule = make_controller("smoothieware")
    points = "X -100 1.5\nZ 0 0.5\nX 100 1.5\n"
    np.testing.assert_allclose(applied({"a.dat": points}, rule, [0, 10, -10, 300], UP),
                               [0, 5, -5, 150])  # fmt: skip
    with pytest.raises(BagError, match=r"line 3: the multiplier 1.51 is not in 0.5 .. 1.5, the"):
        rule.read(
            {"a.dat": points.replace("100 1.5\n", "100 1.51\n").replace("-100 1.51", "-9 1")}
        )


def test_heidenhain_and_fagor_hold_errors():
    files, controller = example("heidenhain")
    assert "1 90.00000 0.00300 0.00500" in files["x.COM"]
    assert files["x.CMA"] == "BEGIN x.CMA\nNR ACTIVE C1\n0 * x\n[END]\n"
    assert files["x.COM"].startswith("BEGIN x.COM\nNR AXISPOS BACKLASH C1\n0 ")
    assert files["x.COM"].endswith("\n[END]\n")
    np.testing.assert_allclose(applied(files, controller, 90, UP), -0.005)
    files, controller = example("fagor")
    assert files["x.txt"].splitlines()[1] == "P002 C1 90.0000 EC1 0.0050 EC1 0.0030"
    assert files["x.txt"].splitlines()[-1] == "P005 C1 360.0000 EC1 0.0000 EC1 -0.0020"
    np.testing.assert_allclose(applied(files, controller, [90, 450], DOWN), -0.003)


def test_fagor_would_take_the_positive_column_for_both():
    table = table_from_result(
        result_of(even(4), np.deg2rad([0, 0.005, 0.003, 0.001])),
        reverse=result_of(even(4), np.zeros(4)),
    )
    with pytest.raises(ConfigurationError, match="positive column for both"):
        example("fagor", table)


def test_fagor_control_takes_the_positive_column_when_the_other_is_all_zero():
    text = "P001 C 0 EC 0 EC 0\nP002 C 180 EC 0.004 EC 0\nP003 C 360 EC 0 EC 0\n"
    np.testing.assert_allclose(
        applied({"x.txt": text}, make_controller("fagor"), 180, DOWN), -0.004
    )
