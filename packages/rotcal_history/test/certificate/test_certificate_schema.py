"""Certificates against the schema that PTB publishes."""

from datetime import date

import pytest
from certified import IDENTITY, certified, certified_axis
from dcc_schema import read_schema
from lxml import etree

from rotcal_history.certificate.document import REQUIRED, make_certificate

ISSUED = date(2026, 3, 20)


@pytest.fixture(scope="module")
def schema():
    return read_schema()


NEEDED = {name: IDENTITY[name] for name in REQUIRED} | {
    "instruments": {"tracker": {"serial": "1", "calibrated": "2026-01-01"}}
}


@pytest.mark.parametrize(
    "result",
    [
        certified(),
        certified("tracer"),
        certified_axis(),
        certified(simulated=True),
        certified(identity=NEEDED, pressure_pa=None, temperature_c=None, humidity=None),
        certified(identity=IDENTITY | {"place": "  hall \n 3 ", "serial": " 00 17 "}),
    ],
    ids=["plate", "tracer", "axis", "simulated", "least", "blanks"],
)
def test_a_certificate_is_valid(schema, result):
    schema.assertValid(etree.fromstring(make_certificate(result, "Ball plate", ISSUED)))


def test_the_schema_notices_what_is_wrong(schema):
    root = etree.fromstring(make_certificate(certified(), "Ball plate", ISSUED))
    core = root.find(".//{https://ptb.de/dcc}beginPerformanceDate")
    core.text = "yesterday"
    assert not schema.validate(root)
