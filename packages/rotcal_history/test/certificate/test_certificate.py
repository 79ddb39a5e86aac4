"""Certificates: what they say, read back by another library, and what is refused."""

import gzip
import json
from base64 import b64decode
from dataclasses import replace
from datetime import date
from hashlib import sha256
from xml.etree import ElementTree

import numpy as np
import pytest
from certified import AXIS, IDENTITY, certified, certified_axis

from rotcal_history.certificate import document as written
from rotcal_history.certificate.document import make_certificate
from rotcal_ros.foundation.errors import ConfigurationError, DataError
from rotcal_ros.foundation.results import Result

NAMES = {"dcc": "https://ptb.de/dcc", "si": "https://ptb.de/si"}
ISSUED = date(2026, 3, 20)


def document(result):
    return ElementTree.fromstring(make_certificate(result, "Ball plate", ISSUED))


def text_of(root, path):
    return root.find(path, NAMES).text


def floats(element, path):
    return np.array([float(word) for word in element.find(path, NAMES).text.split()])


@pytest.mark.parametrize("name", ["ball_plate", "tracer"])
def test_the_numbers_come_back_to_the_last_bit(name):
    result = certified(name)
    results = document(result).findall(".//dcc:result", NAMES)
    assert [text_of(r, "dcc:name/dcc:content") for r in results] == list(result.components)
    for component, element in zip(result.components, results, strict=True):
        angle, deviation = element.findall("dcc:data/dcc:quantity/si:realListXMLList", NAMES)
        assert floats(angle, "si:valueXMLList").tolist() == result.angles.tolist()
        assert text_of(angle, "si:unitXMLList") == r"\radian"
        assert text_of(deviation, "si:unitXMLList") == (
            r"\metre" if component in ("EXC", "EYC", "EZC") else r"\radian"
        )
        values = floats(deviation, "si:valueXMLList")
        assert values.tolist() == result.deviations[component].tolist()
        expanded = floats(deviation, ".//si:valueExpandedMUXMLList")
        assert (expanded / 2.0).tolist() == result.std[component].tolist()
        assert text_of(deviation, ".//si:expandedMUXMLList/si:coverageFactorXMLList") == "2"
        columns = deviation.findall(".//si:covarianceXMLList", NAMES)
        matrix = np.array([floats(column, "si:valueXMLList") for column in columns]).T
        assert matrix.tolist() == result.covariance[component].tolist()


def test_where_the_axis_stands_comes_back_to_the_last_bit():
    first = document(certified_axis()).find(".//dcc:result", NAMES)
    assert text_of(first, "dcc:name/dcc:content") == "Average line of the axis C"
    quantities = first.findall("dcc:data/dcc:quantity", NAMES)
    names = [text_of(q, "dcc:name/dcc:content") for q in quantities]
    assert names == ["Nominal point of the axis, x y z", "XOC YOC", "AOC BOC"]
    origin, place, turns = (q.find("si:realListXMLList", NAMES) for q in quantities)
    assert floats(origin, "si:valueXMLList").tolist() == AXIS.origin.tolist()
    for found, at, unit in ((place, slice(2), r"\metre"), (turns, slice(2, 4), r"\radian")):
        assert text_of(found, "si:unitXMLList") == unit
        assert floats(found, "si:valueXMLList").tolist() == AXIS.value[at].tolist()
        expanded = floats(found, ".//si:valueExpandedMUXMLList")
        assert (expanded / 2.0).tolist() == AXIS.std[at].tolist()
        columns = found.findall(".//si:covarianceXMLList", NAMES)
        matrix = [floats(column, "si:valueXMLList").tolist() for column in columns]
        assert matrix == AXIS.covariance[at, at].tolist()


def test_it_says_who_what_when_and_how_warm():
    root = document(certified())
    core = root.find("dcc:administrativeData/dcc:coreData", NAMES)
    assert text_of(core, "dcc:uniqueIdentifier") == "2026-0001"
    assert text_of(core, "dcc:countryCodeISO3166_1") == "DE"
    assert text_of(core, "dcc:receiptDate") == "2026-03-01"
    assert text_of(core, "dcc:beginPerformanceDate") == "2026-03-10"
    assert text_of(core, "dcc:endPerformanceDate") == "2026-03-11"
    assert text_of(core, "dcc:issueDate") == "2026-03-20"
    item = root.find(".//dcc:item", NAMES)
    assert text_of(item, "dcc:name/dcc:content") == "rotary table"
    assert text_of(item, "dcc:identifications/dcc:identification/dcc:value") == "0017"
    conditions = root.findall(".//dcc:influenceCondition", NAMES)
    units = [text_of(c, ".//si:unit") for c in conditions]
    assert units == [r"\degreecelsius", r"\pascal", r"\one"]
    first = [float(value.text) for value in conditions[0].findall(".//si:value", NAMES)]
    assert first == [20.1, 19.9, 20.2]
    equipment = root.findall(".//dcc:measuringEquipment", NAMES)
    assert [text_of(e, "dcc:name/dcc:content") for e in equipment] == ["tracer", "ball plate"]
    assert "Certificate B 77." in ElementTree.tostring(equipment[1], encoding="unicode")
    assert "corrected by the instrument" in ElementTree.tostring(root, encoding="unicode")


def test_a_large_result_is_compressed_and_a_larger_one_named(monkeypatch):
    """A parser of XML takes 10 million characters in one text: here, fewer."""
    result = certified()
    plain = result.to_json().encode()
    packed = len(gzip.compress(plain))
    for limit, name in ((len(plain), "result.json.gz"), (packed, "result.json.sha256")):
        monkeypatch.setattr(written, "LARGEST_TEXT", limit)
        found = document(result).find("dcc:document", NAMES)
        data = b64decode(text_of(found, "dcc:dataBase64"))
        assert text_of(found, "dcc:fileName") == name
        if name.endswith(".gz"):
            assert gzip.decompress(data) == plain
        else:
            assert data.decode().split() == [sha256(plain).hexdigest(), "result.json"]


def test_the_result_itself_is_in_it():
    result = certified()
    data = b64decode(text_of(document(result), "dcc:document/dcc:dataBase64"))
    assert Result.from_dict(json.loads(data)).to_json() == result.to_json()


def test_a_simulation_says_so_wherever_one_looks():
    root = document(certified(simulated=True))
    for path in (".//dcc:item/dcc:name", ".//dcc:measurementResult/dcc:name", ".//dcc:statement"):
        assert "SIMULATED" in "".join(root.find(path, NAMES).itertext())
    assert text_of(root, ".//dcc:uniqueIdentifier") == "SIMULATED-2026-0001"
    real = ElementTree.tostring(document(certified()), encoding="unicode")
    assert "SIMULATED" not in real


def test_everything_that_is_missing_is_listed_by_its_setting():
    with pytest.raises(ConfigurationError) as refused:
        document(certified(identity={"item": "table"}, begun_ns=None))
    lines = refused.value.log.splitlines()
    named = {line.split(":")[0].strip() for line in lines}
    wanted = {f"identity.{name}" for name in IDENTITY} - {
        "identity.item", "identity.maker", "identity.model", "identity.laboratory_email",
        "identity.received", "identity.customer_number", "identity.instruments",
    }  # fmt: skip
    assert named == wanted | {"identity.instruments.*", "identity.measured"}
    assert refused.value.exit_code == 2


@pytest.mark.parametrize("verdict", ["suspect", "failed"])
def test_no_certificate_of_a_result_that_the_data_contradict(verdict):
    with pytest.raises(DataError, match=verdict):
        document(replace(certified(), verdict=verdict))


def test_what_is_ours_is_said_in_german_too_and_what_is_the_users_is_not():
    root = ElementTree.fromstring(
        make_certificate(certified(), "Laser tracer, multi-station", date(2026, 3, 4))
    )
    said = {"en": set(), "de": set()}
    for content in root.iter("{https://ptb.de/dcc}content"):
        said[content.get("lang")].add(content.text)
    assert {"serial number", "Traceability", "Commanded angle"} <= said["en"]
    assert {"Seriennummer", "Rückführung", "Sollwinkel"} <= said["de"]
    assert IDENTITY["place"] in said["en"] - said["de"]
    used = [e.text for e in root.iter("{https://ptb.de/dcc}usedLangCodeISO639_1")]
    mandatory = [e.text for e in root.iter("{https://ptb.de/dcc}mandatoryLangCodeISO639_1")]
    assert (used, mandatory) == (["en", "de"], ["en"])
