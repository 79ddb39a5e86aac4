"""Who and what was calibrated: checked when it is read, whole when it is written."""

import pytest

from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.identity import Identity
from rotcal_ros.foundation.settings import load

KNOWN = {
    "item": "rotary table",
    "maker": "Maker",
    "model": "RT 300",
    "serial": "0815",
    "tolerance_arcsec": 2.5,
    "instruments": {"tracer": {"serial": "7", "calibrated": "2026-01-31"}},
}


def test_what_is_known_comes_back_and_nothing_else_is_written():
    identity = load(Identity, KNOWN, "cell.yaml: identity")
    assert identity.to_dict() == KNOWN
    assert Identity.from_dict(identity.to_dict()) == identity
    assert identity.title == "rotary table Maker RT 300 no. 0815"
    assert list(identity.instruments.known) == ["tracer"]
    assert Identity().to_dict() == {}
    assert Identity().title == ""


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"serial": 815}, "identity.serial: expected str"),
        ({"seriall": "815"}, "did you mean 'serial'"),
        ({"received": "31.1.2026"}, "'31.1.2026' is not a date"),
        ({"received": "20260331"}, "'20260331' is not a date"),
        ({"measured": "31.1.2026"}, "expected one like 2026-03-31 or 2026-03-31T10:00"),
        ({"measured": "2026-03-31T25:00"}, "'2026-03-31T25:00' is not a date"),
        ({"measured": "20260331"}, "'20260331' is not a date"),
        ({"received": "2026-W14-2"}, "'2026-W14-2' is not a date"),
        ({"instruments": {"tracer": {"calibrated": "2026-02-30"}}}, "'2026-02-30' is not a date"),
        ({"laboratory_country": "Germany"}, "two capital letters"),
        ({"tolerance_arcsec": -1.0}, "out of range"),
    ],
)
def test_what_cannot_be_is_refused_with_its_place(values, words):
    with pytest.raises(ConfigurationError, match="identity") as error:
        load(Identity, values, "identity")
    assert words in str(error.value)


@pytest.mark.parametrize("text", ["", "2026-03-31", "2026-03-31T10:00", "2026-03-31T10:00+02:00"])
def test_a_measurement_has_a_day_or_a_time(text):
    assert load(Identity, {"measured": text}, "identity").measured == text
