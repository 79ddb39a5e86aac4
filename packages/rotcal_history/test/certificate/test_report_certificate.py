"""``rotcal report --dcc``: where the certificate goes, and what is refused how."""

import json
import re
import shutil
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest
import yaml
from click.testing import CliRunner

import rotcal_ros as rc
from rotcal_ros.cli.main import rotcal
from rotcal_ros.foundation import plugins
from rotcal_ros.foundation.circumstances import Circumstances
from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.identity import Identity
from rotcal_ros.foundation.results import Result

pytestmark = pytest.mark.usefixtures("without_figures")

DATA = Path(__file__).parents[4] / "examples" / "data"
IDENTITY = {
    "item": "table", "serial": "1", "place": "hall", "operator": "A", "laboratory": "L",
    "laboratory_address": "Town", "laboratory_country": "DE", "customer": "C",
    "customer_address": "Town", "certificate_number": "7",
    "instruments": {"machine": {"serial": "2", "calibrated": "2026-01-01"}},
}  # fmt: skip


@pytest.fixture
def result_file(tmp_path):
    data = json.loads((DATA / "result_ball_plate.json").read_text())
    known = Circumstances(identity=Identity.from_dict(IDENTITY), begun_ns=1_770_000_000 * 10**9)
    data["circumstances"] = known.to_dict()
    path = tmp_path / "result.json"
    path.write_text(Result.from_dict(data).to_json())
    return path


def run(*arguments):
    return CliRunner().invoke(rotcal, ["report", *map(str, arguments)])


def test_it_is_written_beside_the_result_once(result_file):
    assert run(result_file, "--dcc").exit_code == 0
    written = result_file.with_name("certificate.xml")
    assert ElementTree.parse(written).getroot().get("schemaVersion") == "3.3.0"
    again = run(result_file, "--dcc")
    assert (again.exit_code, "not overwritten" in again.output) == (2, True)
    other = result_file.with_name("other.xml")
    assert run(result_file, "--dcc", "-o", other).exit_code == 0
    assert other.read_bytes() == written.read_bytes()


def test_the_function_writes_what_the_verb_writes(result_file, tmp_path):
    assert run(result_file, "--dcc").exit_code == 0
    written = rc.write_certificate(rc.read_result(result_file), tmp_path / "c.xml")
    assert written.read_bytes() == result_file.with_name("certificate.xml").read_bytes()
    with pytest.raises(rc.RotcalError, match="not overwritten"):
        rc.write_certificate(rc.read_result(result_file), written)


def test_a_result_without_identity_is_refused_with_all_it_needs(tmp_path):
    refused = run(DATA / "result_ball_plate.json", "--dcc", "-o", tmp_path / "c.xml")
    assert refused.exit_code == 2
    assert refused.output.count("identity.") == 12
    assert not (tmp_path / "c.xml").exists()


def test_a_signature_needs_key_and_certificate(result_file):
    assert run(result_file, "--dcc", "--sign", result_file).exit_code == 2
    assert "belong to --dcc" in run(result_file, "--sign", result_file).output


def test_missing_packages_are_named_with_what_brings_them(result_file, monkeypatch):
    for name in [n for n in sys.modules if n.startswith("rotcal_history.certificate.")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "lxml", None)
    refused = run(result_file, "--dcc")
    assert refused.exit_code == 2
    assert refused.output == (
        "rotcal: a certificate needs the package lxml: pip install 'rotcal_history[dcc]'\n"
    )


def test_a_script_is_told_what_brings_them(monkeypatch):
    for name in [n for n in sys.modules if n.startswith("rotcal_history.certificate.")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "lxml", None)
    with pytest.raises(ConfigurationError, match=r"lxml.*: pip install 'rotcal_history\[dcc\]'$"):
        plugins.load.__wrapped__(plugins.FUNCTIONS, "write_certificate", "function")


SETUP = """method: tracer_multistation
table_positions: 12
length_std_m: 1.2e-7
target_std_m: 8.5e-7
error_motion_std_m: 7.0e-8
air: {temperature_c: 20.3, pressure_pa: 101325.0, humidity: 0.45}
"""
NAMES = {"dcc": "https://ptb.de/dcc", "si": "https://ptb.de/si"}


@pytest.fixture
def lengths(tmp_path):
    """A plain table with a set-up in short that says all that a certificate needs."""
    for name in ("lengths.csv", "targets.csv"):
        shutil.copy(DATA / name, tmp_path)
    identity = yaml.safe_dump({"identity": {**IDENTITY, "measured": "2026-03-31T10:00"}})
    (tmp_path / "setup.yaml").write_text(SETUP + identity)
    return tmp_path / "lengths.csv"


def test_a_plain_table_gets_a_certificate_by_what_its_set_up_states(lengths):
    setup = lengths.with_name("setup.yaml")
    done = run(lengths, "--setup", setup, "--set", "identity.certificate_number=007", "--dcc")
    assert done.exit_code == 0, done.output
    root = ElementTree.parse(lengths.with_name("certificate.xml")).getroot()
    core = root.find(".//dcc:coreData", NAMES)
    assert core.findtext("dcc:uniqueIdentifier", None, NAMES) == "007"
    assert core.findtext("dcc:beginPerformanceDate", None, NAMES) == "2026-03-31"
    assert core.findtext("dcc:endPerformanceDate", None, NAMES) == "2026-03-31"
    said = "".join(root.itertext())
    assert "hall" in said
    assert "SIMULATED" not in said
    conditions = root.findall(".//dcc:influenceCondition", NAMES)
    values = [[v.text for v in c.findall(".//si:value", NAMES)] for c in conditions]
    assert values == [["20.3"], ["101325.0"], ["0.45"]]  # nobody has seen a lowest or highest


def test_a_report_of_a_plain_table_names_day_place_person_and_air(lengths):
    page = lengths.with_name("page.html")
    done = run(lengths, "--setup", lengths.with_name("setup.yaml"), "-o", page)
    assert done.exit_code == 0, done.output
    stated = dict(re.findall(r"<dt>(.*?)</dt><dd>(.*?)</dd>", page.read_text()))
    facts = {re.sub(r"\W*<.*", "", name): text for name, text in stated.items()}
    assert facts["Date of calibration"] == "2026-03-31 10:00"
    assert (facts["Place"], facts["Operator"]) == ("hall", "A")
    assert facts["Conditions"] == (
        "temperature 20.30 °C; air pressure 1013.2 hPa; relative humidity 45 %"
    )


def test_the_age_of_a_plain_table_is_that_of_its_stated_day(lengths, tmp_path):
    setup = str(lengths.with_name("setup.yaml"))
    for to in ("csv", "volumetric"):
        asked = ["export", str(lengths), "--setup", setup, "--to", to, "-o", str(tmp_path / to)]
        asked += ["--set", "identity.measured=2020-01-01"]
        asked += ["--replace"] if to == "csv" else []
        refused = CliRunner().invoke(rotcal, asked)
        assert refused.exit_code == 3, to
        assert re.search("the measurement is [0-9]{4,} days old", refused.output), to
        assert not (tmp_path / to).exists()


def test_a_table_without_a_day_is_told_how_to_state_it(lengths):
    setup = lengths.with_name("setup.yaml")
    refused = run(lengths, "--setup", setup, "--set", "identity.measured=", "--dcc")
    assert refused.exit_code == 2
    assert refused.output.splitlines()[2:] == [  # below how the table was read, and the error
        "  identity.measured: when it was measured: a bag records it, a table does not"
    ]
