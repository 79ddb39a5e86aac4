"""The index of refraction against the tables of Ciddor's paper and of NIST's toolbox."""

import numpy as np
import pytest

from rotcal_ros.foundation.errors import DataError
from rotcal_ros.foundation.refraction import EQUATIONS, Air, Sensors, ciddor, edlen, index_std

CIDDOR_TABLE_1 = [
    (20, 80, 21458.0), (20, 100, 26824.4), (20, 120, 32191.6), (10, 100, 27774.7),
    (30, 100, 25937.2),
]  # fmt: skip
"""degC, kPa, (n - 1) 1e8 of dry air, 633 nm, 450 umol/mol."""
CIDDOR_TABLE_3 = [
    (20, 80, 0.75, 21394.0), (20, 120, 0.75, 32127.8), (40, 120, 0.75, 29941.8),
    (50, 80, 1.0, 19058.4), (50, 120, 1.0, 28792.4),
]  # fmt: skip
"""degC, kPa, relative humidity, (n - 1) 1e8."""
CIDDOR_TABLE_2 = [
    (19.526, 102094.8, 1065, 510, 27392.9), (19.173, 102993.0, 641, 450, 27682.4),
    (19.532, 103603.2, 986, 600, 27802.0), (19.534, 103599.2, 951, 610, 27802.2),
]  # fmt: skip
"""degC, Pa, Pa of water, umol/mol of carbon dioxide, (n - 1) 1e8."""
NIST = [
    (20, 0, 101.325, 633, 1.000271800, 1.000271799), (20, 0, 60, 633, 1.000160924, 1.000160920),
    (20, 0, 120, 633, 1.000321916, 1.000321918), (50, 0, 100, 633, 1.000243285, 1.000243270),
    (5, 0, 100, 633, 1.000282756, 1.000282750), (-40, 0, 100, 633, 1.000337580, 1.000337471),
    (50, 100, 120, 633, 1.000287924, 1.000287864), (40, 75, 120, 633, 1.000299418, 1.000299406),
    (20, 100, 100, 633, 1.000267394, 1.000267394),
    (20, 0, 101.325, 1700, 1.000268479, 1.000268483),
    (40, 100, 110, 1700, 1.000270247, 1.000270237), (40, 100, 110, 300, 1.000289000, 1.000288922),
]  # fmt: skip
"""degC, %, kPa, nm, Ciddor, modified Edlen: J. A. Stone and J. H. Zimmerman, section VII."""


def air(celsius, pascal, humidity):
    return Air(*(np.array([float(value)]) for value in (celsius, pascal, humidity)))


@pytest.mark.parametrize(("celsius", "kilopascal", "refractivity"), CIDDOR_TABLE_1)
def test_ciddor_gives_the_dry_air_of_his_paper(celsius, kilopascal, refractivity):
    (index,) = ciddor(air(celsius, kilopascal * 1e3, 0.0), 633.0)
    assert (index - 1.0) * 1e8 == pytest.approx(refractivity, abs=0.06)


@pytest.mark.parametrize(("celsius", "kilopascal", "humidity", "refractivity"), CIDDOR_TABLE_3)
def test_ciddor_gives_the_moist_air_of_his_paper(celsius, kilopascal, humidity, refractivity):
    (index,) = ciddor(air(celsius, kilopascal * 1e3, humidity), 633.0)
    assert (index - 1.0) * 1e8 == pytest.approx(refractivity, abs=0.06)


@pytest.mark.parametrize(("celsius", "pascal", "water", "co2", "refractivity"), CIDDOR_TABLE_2)
def test_ciddor_knows_carbon_dioxide(celsius, pascal, water, co2, refractivity):
    saturated = float(air(celsius, pascal, 1.0).vapour_pressure()[0])
    (index,) = ciddor(air(celsius, pascal, water / saturated), 633.0, co2)
    assert (index - 1.0) * 1e8 == pytest.approx(refractivity, abs=0.06)


@pytest.mark.parametrize(("celsius", "percent", "kilopascal", "nanometre", "one", "other"), NIST)
def test_both_equations_agree_with_the_toolbox_of_nist(
    celsius, percent, kilopascal, nanometre, one, other
):
    known = air(celsius, kilopascal * 1e3, percent / 100)
    # The toolbox takes another formula for the saturation pressure of water.
    assert ciddor(known, nanometre)[0] == pytest.approx(one, abs=1e-9)
    assert edlen(known, nanometre)[0] == pytest.approx(other, abs=1e-9)


def test_the_uncertainty_follows_the_well_known_sensitivities():
    """About 0.95e-6 per kelvin, 0.27e-6 per hectopascal, 0.85e-8 per per cent of humidity."""
    known, equation = air(20.0, 101_325.0, 0.5), EQUATIONS["ciddor"]

    def std(kelvin=0.0, pascal=0.0, humidity=0.0):
        sensors = Sensors(kelvin, pascal, humidity)
        return float(index_std(equation, known, sensors, 633.0, 450.0)[0])

    assert std() == 1e-8
    assert std(kelvin=1.0) == pytest.approx(0.95e-6, rel=0.02)
    assert std(pascal=100.0) == pytest.approx(0.268e-6, rel=0.02)
    assert std(humidity=0.1) == pytest.approx(np.hypot(8.5e-8, 1e-8), rel=0.03)


@pytest.mark.parametrize(
    ("values", "unit"),
    [
        ((293.15, 1e5, 0.5), "kelvin"),
        ((20, 1013.25, 0.5), "hectopascal"),
        ((20, 1e5, 50), "per cent"),
    ],
)
def test_another_unit_is_refused_by_name(values, unit):
    with pytest.raises(DataError, match=unit):
        air(*values)
