"""Lookup tables of encoders, applied as the firmware's source does it."""

import re
from datetime import datetime, timezone

import numpy as np
import pytest
from compensation_examples import even, result_of, wavy

from rotcal_ros.compensation.controllers import make_controller
from rotcal_ros.compensation.export import prepare_export
from rotcal_ros.compensation.table import table_from_result
from rotcal_ros.foundation.errors import BagError, ConfigurationError
from rotcal_ros.foundation.observations import Approach
from rotcal_ros.foundation.units import ARCSEC

NOW = datetime(2026, 1, 2, tzinfo=timezone.utc)
ERRORS = [(1, 1800.0, 0.4), (2, 300.0, 1.0)]
"""A magnet off its centre: half a degree, once a turn (order, arcsec, phase)."""


def deviation(angle):
    return wavy(angle, ERRORS) - wavy(0.0, ERRORS)


def exported(**settings):
    table = table_from_result(result_of(even(200), deviation(even(200))))
    return prepare_export(table, "encoder_lut", now=NOW, settings={"points": 200, **settings})


def array(done):
    text = next(text for name, text in done.files.items() if name.endswith(".h"))
    return np.array(re.findall(r"-?\d+", text.split("{")[1]), dtype=int)


def simplefoc(lut, raw):
    """getSensorAngle with decodeOffsetU16: raw angle less the offset between two entries, rad."""
    n, raw = len(lut), np.mod(raw, 2.0 * np.pi)
    place = raw * n / (2.0 * np.pi)
    index, share = np.floor(place).astype(int) % n, place - np.floor(place)
    y0, y1 = ((lut[k % n] - 32767.0) / 10430.2191955 for k in (index, index + 1))
    return raw - ((1.0 - share) * y0 + share * y1)


def stepper_servo(lut, reading, counts):
    """CalibrationTable_reverseLookup: between two values that hold the reading, even angles."""
    n, values = len(lut), np.append(lut, lut[0])
    angles = np.empty(len(reading))
    for place, x in enumerate(reading):
        for k in range(n):
            a1, a2 = values[k], values[k + 1]
            if abs(a1 - a2) > counts // 2:
                a1, a2 = (a1 + counts, a2) if a1 < a2 else (a1, a2 + counts)
            for shifted in (x, x + counts):
                if a1 <= shifted <= a2:
                    angles[place] = 2.0 * np.pi / n * (k + (shifted - a1) / (a2 - a1))
    return angles


def away(found, expected):
    return np.max(np.abs((found - expected + np.pi) % (2.0 * np.pi) - np.pi)) / ARCSEC


@pytest.mark.parametrize("sense", [1, -1])
@pytest.mark.parametrize("zero_deg", [0.0, 33.3])
def test_simplefoc_reads_the_true_angle(sense, zero_deg):
    done = exported(form="simplefoc", zero_deg=zero_deg,
                    encoder_turns="forward" if sense > 0 else "backward")  # fmt: skip
    told, zero = np.linspace(0.0, 6.28, 997), np.deg2rad(zero_deg)
    corrected = simplefoc(array(done), sense * told + zero)
    true = sense * (told + deviation(told)) + zero
    assert away(sense * told + zero, true) > 1500.0
    assert away(corrected, true) < 19.8 / 2.0 + 1.0
    assert done.residual.simulated <= done.residual.stated < 50.0 * ARCSEC


def test_stepper_servo_holds_the_reading_at_even_angles():
    done = exported(form="servo", points=50, counts_per_turn=32768)
    lut, told = array(done), np.linspace(0.0, 6.2, 311)
    found = stepper_servo(lut, np.rint(told / (2.0 * np.pi) * 32768), 32768)
    assert len(lut) == 50
    assert away(told, told + deviation(told)) > 1500.0
    # half a count of the reading, half a count of the value, 7.2 deg between two of them
    assert away(found, told + deviation(told)) < 39.6 + done.residual.interpolation / ARCSEC


def test_counts_are_taken_off_the_reading():
    done = exported(counts_per_turn=1 << 20, points=100)
    lut, told = array(done), even(100)
    corrected = told - lut * 2.0 * np.pi / (1 << 20)
    assert away(corrected, told + deviation(told)) < 0.5 * 1296000.0 / (1 << 20) + 1e-6


@pytest.mark.parametrize(
    ("before", "after", "words"),
    [
        ("int16_t encoder_lut[8]", "int16_t encoder_lut[9]", r"N values, found 8"),
        ("int16_t encoder_lut[8]", "int16_t calibrationLut[8]", r"expected encoder_lut\[N\]"),
        ("0, ", "99999999999999999999999, ", "a value is none of 16 bits"),
        ("0, ", "0; ", r"expected encoder_lut\[N\]"),
        ("0, ", "0, x", r"expected encoder_lut\[N\]"),
        ("encoder_lut[8] = {\n0, ", "encoder_lut[7] = {\n", "7 values, expected 8 per turn"),
    ],
)
def test_a_damaged_array_is_named(before, after, words):
    controller = make_controller("encoder_lut", {"points": 8})
    table = table_from_result(result_of(even(8), deviation(even(8))))
    (text,) = controller.write(table, "t").values()
    assert controller.read({"t.h": text}).correction(0.0, Approach.POSITIVE) == 0.0
    with pytest.raises(BagError, match=words):
        controller.read({"t.h": text.replace(before, after, 1)})


def test_a_table_of_nothing_is_not_written():
    """Ten arcsec are less than half a count of 14 bit (79 arcsec)."""
    table = table_from_result(result_of(even(36), wavy(even(36), [(1, 10.0, 0.0)])))
    controller = make_controller("encoder_lut", {"counts_per_turn": 16384})
    with pytest.raises(ConfigurationError, match=r"in steps of 79\.1 arcsec: the table would"):
        controller.write(table, "t")


def test_what_no_encoder_can_need_is_refused():
    table = table_from_result(result_of(even(8), 100.0 * deviation(even(8))))
    with pytest.raises(ConfigurationError, match=r"firmware holds -32768 \.\. 32767"):
        make_controller("encoder_lut", {"points": 8, "counts_per_turn": 1 << 24}).write(table, "t")
