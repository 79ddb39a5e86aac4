"""An implausible unit is named, with the setting that says which it is."""

import math

import pytest

from rotcal_ros.bags import names
from rotcal_ros.bags.settings import ANGLE_UNITS, LENGTH_UNITS, TopicSettings
from rotcal_ros.capture.instruments.plausibility import (
    Rates,
    implausible_air,
    implausible_angle,
    implausible_length,
    likely_unit,
)

SI = TopicSettings()


@pytest.mark.parametrize(("value", "unit"), [(0.5, None), (500.0, "mm"), (5e5, "um"), (5e8, "nm")])
def test_the_unit_of_a_length(value, unit):
    assert likely_unit(value, 20.0, "m", LENGTH_UNITS) == unit
    text = implausible_length(value, 20.0, SI)
    assert (text is None) if unit is None else text.endswith(f"topics.length_unit: {unit}")


def test_the_unit_of_an_angle():
    assert implausible_angle(math.radians(30.0), SI) is None
    assert "4.8 turns" in implausible_angle(30.0, SI)
    assert implausible_angle(30.0, SI).endswith("set topics.angle_unit: deg")
    assert likely_unit(108000.0, 2 * math.pi, "rad", ANGLE_UNITS) == "arcsec"


def test_a_length_stated_in_micrometres_that_comes_in_nanometres():
    settings = TopicSettings(length_unit="um")
    assert implausible_length(500.0, 20.0, settings).endswith("length_unit: nm")


@pytest.mark.parametrize(
    ("role", "value", "unit"),
    [
        (names.TEMPERATURE, 293.0, "K"),
        (names.TEMPERATURE, 68.0, "degF"),
        (names.AIR_PRESSURE, 1013.0, "hPa"),
        (names.AIR_PRESSURE, 101.3, "kPa"),
        (names.RELATIVE_HUMIDITY, 45.0, "percent"),
    ],
)
def test_the_unit_of_the_air(role, value, unit):
    ((found, text),) = implausible_air({role: value})
    assert found == role
    assert f"{unit}?" in text


def test_plausible_air_needs_no_words():
    air = {names.TEMPERATURE: 20.0, names.AIR_PRESSURE: 1e5, names.RELATIVE_HUMIDITY: 0.4}
    assert list(implausible_air(air)) == []


def test_the_rate_of_bursts_is_their_mean():
    rates = Rates()
    for burst in range(4):
        for k in range(10):
            rates.note("lengths", burst * 1_000_000_000 + k * 1_000_000)
    assert rates.rates_hz()["lengths"] == pytest.approx(39 / 3.009)


def test_stamps_that_stand_still_have_no_rate():
    rates = Rates()
    for _ in range(10):
        rates.note("lengths", 0)
    assert rates.rates_hz() == {"lengths": 0.0}
