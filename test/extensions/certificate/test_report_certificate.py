"""``rotcal report --dcc``: where the certificate goes, and what is refused how."""

import json
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest
from click.testing import CliRunner

from rotcal_ros.cli.main import rotcal
from rotcal_ros.foundation import plugins
from rotcal_ros.foundation.circumstances import Circumstances
from rotcal_ros.foundation.identity import Identity
from rotcal_ros.foundation.results import Result

pytestmark = pytest.mark.usefixtures("without_figures")

DATA = Path(__file__).parents[3] / "examples" / "data"
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


def test_a_result_without_identity_is_refused_with_all_it_needs(tmp_path):
    refused = run(DATA / "result_ball_plate.json", "--dcc", "-o", tmp_path / "c.xml")
    assert refused.exit_code == 2
    assert refused.output.count("identity.") == 11
    assert not (tmp_path / "c.xml").exists()


def test_a_signature_needs_key_and_certificate(result_file):
    assert run(result_file, "--dcc", "--sign", result_file).exit_code == 2
    assert "belong to --dcc" in run(result_file, "--sign", result_file).output


def test_missing_packages_are_named_with_what_brings_them(result_file, monkeypatch):
    for name in [n for n in sys.modules if n.startswith("rotcal_ros.extensions.certificate.")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "lxml", None)
    refused = run(result_file, "--dcc")
    assert refused.exit_code == 2
    assert refused.output == (
        "rotcal: a certificate needs the package lxml: pip install 'rotcal_ros[dcc]'\n"
    )


def test_without_the_extension_it_is_said_what_to_install(result_file, monkeypatch):
    monkeypatch.setattr(plugins, "CERTIFICATES", "nobody.registers_this")
    refused = run(result_file, "--dcc")
    assert refused.exit_code == 2
    assert refused.output == (
        "rotcal: a certificate needs the extension 'dcc': pip install 'rotcal_ros[dcc]'\n"
    )
