"""``rotcal web`` without a browser: who is let in, what is understood, asked, solved and made."""

import asyncio
import json
import os
import re
import signal
import socket
import subprocess
import sys
import urllib.request

import numpy as np
import pytest
from click.testing import CliRunner
from exports import DATA, EXPORTS, MM, lines
from starlette.requests import Request
from starlette.testclient import TestClient

import rotcal_ros as rc
from rotcal_ros.cli.main import rotcal
from rotcal_ros.compensation.controllers import controller_names
from rotcal_ros.foundation.plugins import FUNCTIONS, names
from rotcal_ros.foundation.units import ARCSEC
from rotcal_tables import web
from rotcal_tables.table_work import name_page_fields
from rotcal_tables.web import UploadSession, WorkProcess, make_app, page_settings

ORIGIN = "http://127.0.0.1:8000"
METHOD = "tracer_multistation"
OWN = (DATA / "lengths.csv", DATA / "targets.csv")
IDENTITY = (
    "item=rotary table", "serial=4711", "place=hall 3", "operator=A. Brown", "measured=2026-03-31",
    "laboratory=Lab", "laboratory_address=1 Street", "laboratory_country=DE", "customer=Firm",
    "customer_address=2 Street", "certificate_number=K-1", "instruments.tracer.serial=T1",
    "instruments.tracer.calibrated=2026-01-31",
)  # fmt: skip

ANGLES = np.deg2rad(np.arange(12) * 30.0)
FOR_CSV = {
    "controller": "csv", "settings": "", "in_force": "replace", "accept": [], "spacing": None,
    "axis": "", "serial": "",
}  # fmt: skip


class Visitor:
    """One person's browser: what it was told at the start, and what it asks for."""

    def __init__(self, app):
        self.client = TestClient(app, base_url=ORIGIN, follow_redirects=True)
        assert self.client.get("/", params={"key": app.key}).status_code == 200
        self.start = self.client.get("/start").json()
        self.own = {"origin": ORIGIN, "x-rotcal-token": self.start["token"]}

    def drop(self, role, name, content):
        return self.client.post(
            f"/files/{role}", params={"name": name}, content=content, headers=self.own
        )

    def work(self, what, *changes, method=METHOD, **options):
        # The sample lengths have numbers of positions, whose angles the page is told.
        told = ("plan.table_positions=12", "plan.table_step_deg=30") if method == METHOD else ()
        changes = (*told, *changes)
        asked = {"method": method, "changes": changes, **options}
        return self.client.post(f"/do/{what}", json=asked, headers=self.own).json()

    def lengths(self, text, name="mine.csv"):
        """Drop a table, text or bytes, and the targets of the samples."""
        self.drop("table", name, text)
        self.drop("targets", "targets.csv", OWN[1].read_bytes())

    def deviations(self, *changes, **options):
        told = self.work("solve", *changes, **options)
        assert "error" not in told, told["error"]
        return json.loads(self.made("result.json").text)["deviations"]

    def made(self, name):
        return self.client.get(f"/made/{name}")


@pytest.fixture
def app(tmp_path):
    return make_app(tmp_path, 8000)


@pytest.fixture
def visitor(app):
    return Visitor(app)


@pytest.fixture(scope="module")
def expected():
    """What the clean table gives with the set-up of the samples, without the page."""
    result = rc.read_table(OWN[0], DATA / "tracer.yaml").solve()
    return {name: values.tolist() for name, values in result.deviations.items()}


def test_the_address_lets_in_one_browser_once(app):
    first, second = (TestClient(app, base_url=ORIGIN, follow_redirects=False) for _ in range(2))
    assert first.get("/").status_code == 403
    assert first.get("/", params={"key": "another"}).status_code == 403
    entered = first.get("/", params={"key": (key := app.key)})
    assert (entered.status_code, entered.headers["location"]) == (303, "/")
    cookie = entered.headers["set-cookie"].lower()
    assert "httponly" in cookie
    assert "samesite=strict" in cookie
    assert first.get("/").status_code == 200
    assert second.get("/", params={"key": key}).status_code == 403
    assert second.get("/", params={"key": ""}).status_code == 403
    for path in ("/start", "/words", "/static/web.js", "/made/result.json"):
        assert second.get(path).status_code == 403


@pytest.mark.parametrize(
    "host", ["evil.example", "evil.example:8000", "127.0.0.1:9", "[::1]:8000"]
)
def test_it_is_served_under_its_own_name_alone(visitor, host):
    assert visitor.client.get("/", headers={"host": host}).status_code == 421


@pytest.mark.parametrize(
    "wrong",
    [
        {"origin": "http://evil.example"}, {"origin": ""}, {"origin": "http://127.0.0.1:9"},
        {"x-rotcal-token": "guessed"}, {"sec-fetch-site": "same-site"},
    ],
)  # fmt: skip
def test_another_page_is_not_heard(visitor, wrong, tmp_path):
    headers = visitor.own | wrong
    answers = (
        visitor.client.post("/files/table", content=b"x", headers=headers),
        visitor.client.request("DELETE", "/files/table", headers=headers),
        visitor.client.post("/do/explain", json={"method": METHOD}, headers=headers),
    )
    assert [answer.status_code for answer in answers] == [403] * 3
    assert list(tmp_path.iterdir()) == []


def test_nothing_from_elsewhere_is_loaded_and_a_report_runs_nothing(visitor):
    page = visitor.client.get("/")
    named = re.findall(r'(?:src|href)="([^"]+)"', page.text)
    assert len(named) > 4
    assert all(visitor.client.get(name).status_code == 200 for name in named)
    assert "unsafe" not in page.headers["content-security-policy"]
    visitor.lengths(OWN[0].read_bytes())
    visitor.work("solve")
    assert visitor.work("report", language="de")["files"] == ["report.html"]
    report = visitor.made("report.html")
    policy = report.headers["content-security-policy"]
    assert policy.startswith("default-src 'none'")
    assert "script" not in policy
    assert '<html lang="de"' in report.text
    assert "mine.csv" in report.text


def test_names_of_files_are_no_paths(visitor, tmp_path):
    for name in ("../../evil.csv", "/etc/passwd", "a\0b", "report.html"):
        assert visitor.drop("table", name, b"x").json()["names"]["table"]
    assert visitor.drop("../table", "x", b"x").status_code == 404
    assert visitor.drop("another", "x", b"x").status_code == 400
    assert visitor.drop("in_force", "../evil", b"x").status_code == 400
    assert visitor.drop("in_force", "c.comp", b"x").status_code == 200
    found = {str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*") if path.is_file()}
    assert found == {"table.txt", "in_force/c.comp"}
    for name in ("table.txt", "..%2Ftable.txt", "%2Fetc%2Fpasswd"):
        assert visitor.made(name).status_code == 404


def test_a_file_that_is_too_large_is_not_kept(visitor, tmp_path, monkeypatch):
    monkeypatch.setattr(web, "LARGEST_FILE", 1000)
    answer = visitor.drop("table", "big.csv", b"1" * 1001)
    assert answer.status_code == 400
    assert (
        answer.json()["error"]["text"]
        == "big.csv has more than the 1,000 bytes that we read: split it"
    )
    assert list(tmp_path.iterdir()) == []
    assert visitor.drop("table", "fits.csv", b"1" * 1000).status_code == 200


def test_of_an_upload_that_is_cut_off_nothing_stays(tmp_path):
    parts = iter([
        {"type": "http.request", "body": b"angle_deg,", "more_body": True},
        {"type": "http.disconnect"},
    ])  # fmt: skip

    async def receive():
        return next(parts)

    scope = {
        "type": "http", "method": "POST", "headers": [], "path": "/", "query_string": b"",
        "path_params": {"role": "table"},
    }  # fmt: skip
    asyncio.run(UploadSession(tmp_path).receive_file(Request(scope, receive)))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"\0\x01\x02" * 50, "neither text nor a workbook"),
        (b"PK\x03\x04 no workbook", "cannot read the workbook"),
        (b"", "neither text nor a workbook|no row names the columns"),
        (b"just words\n", "no row names the columns"),
    ],
)  # fmt: skip
def test_nonsense_is_told_by_the_name_of_the_file(visitor, content, words, tmp_path):
    visitor.drop("table", "holiday.xlsx", content)
    error = visitor.work("explain")["error"]
    assert re.search(words, error["text"])
    assert "holiday.xlsx" in error["text"]
    assert str(tmp_path) not in error["text"]


def test_without_a_table_nothing_can_be_done(visitor):
    assert "drop one" in visitor.work("solve")["error"]["text"]
    visitor.lengths(OWN[0].read_bytes())
    refused = visitor.client.post("/do/format", json={"method": METHOD}, headers=visitor.own)
    assert refused.status_code == 400


@pytest.mark.parametrize("name", ["german_ansi.csv", "targets_inside.xlsx", "open.ods"])
def test_an_export_gives_the_digits_of_the_clean_table(visitor, name, tmp_path_factory, expected):
    """Text, and workbooks of two programs; test_exports.py reads all that there are."""
    path = tmp_path_factory.mktemp("export") / name
    EXPORTS[name](path)
    visitor.drop("setup", "tracer.yaml", (DATA / "tracer.yaml").read_bytes())
    visitor.drop("table", name, path.read_bytes())
    if not name.startswith("targets"):
        visitor.drop("targets", "targets.csv", OWN[1].read_bytes())
    told = visitor.work("explain")
    assert told["error"] is None
    assert told["tables"][0]["rows"] == len(MM)
    assert visitor.deviations() == expected


def test_the_set_up_that_was_made_gives_the_same_on_the_command_line(visitor, tmp_path):
    visitor.lengths(lines(("Position", "Target", "Weg"), MM, ";"))
    found = visitor.deviations(
        "solver.length_std_m=1.2e-7", "identity.item=table", "sheet.length_unit=mm",
        'sheet.columns=["length=Weg"]',
    )  # fmt: skip
    (tmp_path / "mine.csv").write_text(lines(("Position", "Target", "Weg"), MM, ";"))
    (tmp_path / "setup.yaml").write_text(visitor.made("setup.yaml").text)
    again = rc.read_table(tmp_path / "mine.csv", tmp_path / "setup.yaml", OWN[1]).solve()
    assert again.deviations["ECC"].tolist() == found["ECC"]
    assert again.circumstances.identity.item == "table"
    assert not again.circumstances.simulated


def test_a_unit_that_is_not_told_is_asked_and_the_answer_counts(visitor, expected):
    visitor.lengths(lines(("Position", "Target", "Length"), MM, ","))
    question = visitor.work("explain")["error"]["question"]
    assert question["setting"] == "sheet.length_unit"
    answers = dict(question["answers"])
    assert answers["mm"] == "574.172198 mm = 0.574172 m"
    assert answers["m"] == "574.172198 m = 574.172 m"
    visitor.drop("setup", "tracer.yaml", (DATA / "tracer.yaml").read_bytes())
    assert visitor.deviations("sheet.length_unit=mm") == expected


def test_a_decimal_mark_that_nothing_tells_is_asked(visitor):
    rows = [(p, t, f"{float(n):.3f}".replace(".", ",")) for p, t, n in MM]
    visitor.lengths(lines(("Position", "Target", "Length [mm]"), rows, ";"))
    question = visitor.work("explain")["error"]["question"]
    assert question["setting"] == "sheet.decimal"
    assert question["answers"] == [[".", "313,167 = 313167"], [",", "313,167 = 313.167"]]
    first = visitor.work("explain", "sheet.decimal=,")["tables"][0]["first"][0]
    assert first == [2, ["0", "0", "0.313167"]]


def test_columns_in_a_language_that_nobody_knows_are_asked_one_by_one(visitor, expected):
    visitor.lengths(lines(("Asento", "Kohde", "Pituus (mm)"), MM, ";"))
    visitor.drop("setup", "tracer.yaml", (DATA / "tracer.yaml").read_bytes())
    named, meant = [], {"position": "Asento", "target": "Kohde", "length": "Pituus (mm)"}
    while error := visitor.work("explain", f"sheet.columns={json.dumps(named)}")["error"]:
        assert error["question"]["setting"] == "sheet.columns"
        assert len(named) < 3
        column = error["question"]["answers"][0][0].partition("=")[0]
        assert [f"{column}={meant[column]}", meant[column]] in error["question"]["answers"]
        named.append(f"{column}={meant[column]}")
    assert visitor.deviations(f"sheet.columns={json.dumps(named)}") == expected


def test_a_wrong_column_is_corrected(visitor, expected):
    rows = [(p, t, "300.0", n) for p, t, n in MM]
    visitor.lengths(lines(("Position", "Target", "Length [mm]", "Corrected [mm]"), rows, ","))
    (table, _targets) = visitor.work("explain")["tables"]
    assert table["head"] == ["Position", "Target", "Length [mm]", "Corrected [mm]"]
    assert table["aside"] == ["Corrected [mm]"]
    assert [(c["name"], c["text"], c["units"]) for c in table["columns"]] == [
        ("position", "Position", []), ("target", "Target", []), ("length", "Length [mm]", ["mm"])
    ]  # fmt: skip
    assert table["first"][0] == [2, ["0", "0", "0.3000"]]
    visitor.drop("setup", "tracer.yaml", (DATA / "tracer.yaml").read_bytes())
    assert visitor.deviations('sheet.columns=["length=Corrected [mm]"]') == expected


def test_rows_left_out_are_told_with_their_reason(visitor):
    visitor.lengths(lines(("Position", "Target", "Length [mm]"), [*MM, ("Mean", "", "1")], ","))
    assert visitor.work("explain")["tables"][0]["left_out"] == [
        [290, ["a line about others ({0})", "Mean"]]
    ]


def test_of_methods_that_fit_the_one_that_needs_nothing_else_comes_first(visitor):
    runs = 'Soll [°],Abweichung 1 ["],Abweichung 2 ["]\n0,0,0\n90,3,5\n180,1,2\n'
    visitor.drop("table", "runs.csv", runs.encode())
    assert visitor.work("fit")["methods"] == ["deviations", "angle_comparison"]


def test_what_a_method_has_to_be_told_is_named(visitor):
    visitor.drop("table", "balls.csv", (DATA / "balls.csv").read_bytes())
    error = visitor.work("explain", method="ball_plate")["error"]
    asked = {s["name"] for s in page_settings("ball_plate") if s["default"] == "-"}
    assert len(asked) == 4
    assert set(error["names"]) == asked
    text, *labels = error["text"]
    assert "--set" not in text
    assert ["diameter of the balls"] in labels
    error = visitor.work("explain", "plan.plate.grid=x", method="ball_plate")["error"]
    text, label = error["text"]
    assert text.startswith('"{0}": expected int')
    assert label[0].startswith("number of table positions")
    assert error["names"] == ["plan.plate.grid"]


@pytest.mark.parametrize(
    ("method", "told", "shown"),
    [
        ("deviations", "Say which ('rotcal' knows; rotcal export --replace, --add-to)",
         "Say which ('rotcal' knows; rotcal export "
         '"None: the new table replaces whatever is there", '
         '"One was: the new table is added to it")'),
        ("deviations", "add it (rotcal export --add-to); nothing was written",
         'add it ("One was: the new table is added to it"); nothing was written'),
        ("deviations", "is 40 days old, at most 30 are accepted (--max-age, bridge.max_age_days)",
         "is 40 days old, at most 30 are accepted"),
        ("deviations", "say so: --accept age --accept axis (bridge.accept: [age, axis]); nothing",
         "say so: a tick below; nothing"),
        ("deviations", "Give --accept-unverified to write the file", "Give a tick below to write"
         " the file"),
        ("deviations", "needs --set machine_ini=a.ini",
         'needs "Settings, one in a line as NAME=VALUE" machine_ini'),
        ("table_balls", "correct plan.axis_m, or plan.chain",
         'correct "nominal point of the table axis in the machine\'s coordinates: XOC and YOC are '
         "how far the axis is from it at its height, EXC and EYC are the table's motions there\", "
         "or plan.chain (in a set-up file)"),
        ("tracer_multistation", "give --targets TARGETS.csv with x, or --targets a.csv",
         'give "Targets" with x, or "Targets"'),
        ("tracer_multistation", "no column length_m. State a column with another name by --set "
         r"""'sheet.columns=["length=A 1 [\"]"]' or --set 'sheet.columns=["length=B"]'""",
         "no column length_m"),
        ("deviations", "no {place} for --option in laser.csv", "no (place) for --option in"
         " laser.csv"),
    ],
)  # fmt: skip
def test_options_and_settings_are_boxes_of_the_page(method, told, shown):
    assert name_page_fields(told, method) == shown


def test_an_uncertainty_that_is_missing_is_that_of_its_box(visitor):
    table = b"angle [deg],error [arcsec]\n0,0.5\n90,3.2\n180,-1\n270,2\n"
    visitor.drop("table", "laser.csv", table)
    error = visitor.work("solve", "sheet.values=deviations", method="deviations")["error"]
    text, label = error["text"]
    assert text.endswith('add a column of standard uncertainties, or state one for all with "{0}"')
    assert text.startswith("nothing states how sure")
    assert label[0].startswith("standard uncertainty (k = 1) of each deviation")
    assert error["names"] == ["solver.u_arcsec"]


def test_a_certificate_lists_what_is_missing_and_is_made_with_it(visitor):
    etree = pytest.importorskip("lxml.etree")
    pytest.importorskip("signxml")
    if "write_certificate" not in names(FUNCTIONS):
        pytest.skip("no package that writes certificates is installed")
    visitor.lengths(OWN[0].read_bytes())
    visitor.deviations()
    log = "\n".join(visitor.work("dcc")["error"]["log"])
    assert set(re.findall(r"identity\.(\w+)", log)) >= {"serial", "laboratory", "instruments"}
    visitor.deviations(*(f"identity.{change}" for change in IDENTITY))
    assert visitor.work("dcc")["files"] == ["certificate.xml"]
    root = etree.fromstring(visitor.made("certificate.xml").content)
    assert root.tag == "{https://ptb.de/dcc}digitalCalibrationCertificate"
    assert "4711" in visitor.made("certificate.xml").text


def test_a_controller_gets_its_files_once_it_is_said_what_was_in_force(visitor):
    visitor.lengths(OWN[0].read_bytes())
    visitor.deviations()
    error = visitor.work("controller", **FOR_CSV | {"in_force": ""})["error"]
    text, *labels = error["text"]
    assert text.startswith("not known which table was in force")
    assert ["None: the new table replaces whatever is there"] in labels
    told = visitor.work("controller", **FOR_CSV)
    assert told["files"] == ["c_csv.csv", "c_csv.provenance.json"]
    assert told["words"][0].startswith("replaces the table in force")
    # What was dropped is read: this was not measured with its own table in force.
    for name in told["files"]:
        assert visitor.drop("in_force", name, visitor.made(name).content).status_code == 200
    error = visitor.work("controller", **FOR_CSV | {"in_force": "add"})["error"]
    assert error["text"].startswith(
        "not added: the table in force does not act as it should: it is inactive"
    )
    assert "+1.0" in error["text"]  # what it does of what it should
    error = visitor.work("controller", **FOR_CSV | {"controller": "cvs"})
    assert "did you mean 'csv'?" in error["error"]["text"]


def of_the_command_line(folder, *options):
    """Return the rows that ``rotcal export`` writes for the result on the page."""
    words = ["export", folder / "result.json", "--to", "csv", "-o", folder / "by_verb", *options]
    done = CliRunner().invoke(rotcal, [str(word) for word in words])
    assert done.exit_code == 0, done.stderr
    return (folder / "by_verb" / "c_csv.csv").read_text()


def test_the_rows_are_as_far_apart_as_is_asked_for(visitor, tmp_path):
    visitor.lengths(OWN[0].read_bytes())
    visitor.deviations()
    visitor.work("controller", **FOR_CSV | {"spacing": 7.5})
    rows = visitor.made("c_csv.csv").text
    assert rows == of_the_command_line(tmp_path, "--replace", "--spacing", 7.5)
    side = visitor.made("c_csv.provenance.json").json()
    assert side["rows"] == 48
    assert side["widest_spacing_deg"] == pytest.approx(7.5)


@pytest.mark.parametrize(
    ("word", "changed", "stated", "reason"),
    [
        ("axis", {"axis": "B"}, (), "axis C was measured and the export (--axis, --serial) has"),
        ("serial", {"serial": "12"}, ("identity.serial=11",), "serial number 11 was measured and"),
        ("age", {}, ("identity.measured=2020-03-31",), " days old, at most 30 are accepted"),
        ("unverified", {"controller": "fagor"}, (), "not verified: "),
    ],
)
def test_what_can_be_accepted_is_offered_with_its_reason(visitor, word, changed, stated, reason):
    if changed.get("controller", "csv") not in controller_names():
        pytest.skip("no package with this controller is installed")
    visitor.drop("setup", "tracer.yaml", (DATA / "tracer.yaml").read_bytes())
    visitor.lengths(OWN[0].read_bytes())
    visitor.deviations(*stated)
    question = visitor.work("controller", **FOR_CSV | changed)["error"]["question"]
    ((answer, words),) = question["answers"]
    assert (question["setting"], answer) == ("accept", word)
    assert reason in words
    told = visitor.work("controller", **FOR_CSV | changed | {"accept": [word]})
    assert "error" not in told, told["error"]
    assert any(f"({word})" in line or "not verified" in line for line in told["words"])


def lengths_of(ecc, noise_m=1e-7):
    """Return the lengths of a tracer on a table that deviates by ``ecc`` (rad) at ANGLES."""
    targets = np.loadtxt(OWN[1], delimiter=",", skiprows=1)[:, 1:]
    places = np.array([(0.2 * np.cos(a), 0.2 * np.sin(a), 0.12) for a in ANGLES + ecc])
    lengths = np.linalg.norm(targets[None] - places[:, None], axis=2)
    lengths += np.random.default_rng(5).normal(0.0, noise_m, lengths.shape)
    rows = [(*at, f"{length:.10f}") for at, length in np.ndenumerate(lengths)]
    return lines(("position", "target", "length_m"), rows, ",")


def test_what_a_table_leaves_is_added_to_it_as_the_command_line_does(visitor, tmp_path):
    first, left = 6.0 * ARCSEC * np.sin(ANGLES), 1.5 * ARCSEC * np.sin(2.0 * ANGLES)
    visitor.lengths(lengths_of(first))
    visitor.deviations("solver.length_std_m=1e-7")
    held = {n: visitor.made(n).content for n in visitor.work("controller", **FOR_CSV)["files"]}
    visitor.lengths(lengths_of(left))
    visitor.deviations("solver.length_std_m=1e-7")
    for name, content in held.items():
        visitor.drop("in_force", name, content)
    told = visitor.work("controller", **FOR_CSV | {"in_force": "add"})
    assert "error" not in told, told["error"]
    assert told["words"][0].startswith("adds to the table")
    rows = visitor.made("c_csv.csv").text
    assert rows == of_the_command_line(tmp_path, "--add-to", tmp_path / "in_force")
    angles, corrections, *_ = np.loadtxt(rows.splitlines(), delimiter=",", skiprows=1).T
    wanted = 6.0 * np.sin(np.deg2rad(angles)) + 1.5 * np.sin(np.deg2rad(2.0 * angles))
    assert len(angles) >= 13
    assert np.ptp(corrections + wanted) < 0.5


def test_a_table_in_force_that_is_not_there_is_told_without_a_path(visitor, tmp_path):
    visitor.lengths(OWN[0].read_bytes())
    visitor.deviations()
    error = visitor.work("controller", **FOR_CSV | {"in_force": "add"})["error"]
    assert error["text"].startswith("in_force holds 0 tables of axis C for csv")


def test_another_table_takes_the_results_away(visitor):
    visitor.lengths(OWN[0].read_bytes())
    visitor.deviations()
    visitor.drop("table", "next.csv", OWN[0].read_bytes())
    assert visitor.made("result.json").status_code == 404
    visitor.client.request("DELETE", "/files/table", headers=visitor.own)
    assert visitor.client.get("/start").json()["names"] == {"targets": "targets.csv"}


def test_work_that_takes_too_long_is_ended_and_the_next_is_done(visitor, monkeypatch):
    visitor.lengths(OWN[0].read_bytes())
    with monkeypatch.context() as patched:
        patched.setattr(web, "WORK_TIMEOUT_S", 0.001)
        assert "takes longer than 0.001 s" in visitor.work("solve")["error"]["text"]
    assert visitor.work("explain")["error"] is None


def test_work_whose_process_dies_is_told():
    told = asyncio.run(WorkProcess()(os._exit, 3))
    assert told["error"]["text"].startswith("the work ended without an answer")


def test_the_verb_serves_the_printed_address_and_leaves_nothing(tmp_path):
    started = subprocess.Popen(
        [sys.executable, "-m", "rotcal_ros.cli.main", "web", "--no-browser"],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        env=os.environ | {"TMPDIR": str(tmp_path), "PYTHONUNBUFFERED": "1"},
    )  # fmt: skip
    assert started.stdout is not None
    address = started.stdout.readline().strip()
    assert re.fullmatch(r"http://127\.0\.0\.1:\d+/\?key=[\w-]{43}", address)
    assert [path.name for path in tmp_path.glob("rotcal-web-*")]
    opener = urllib.request.build_opener(urllib.request.HTTPCookieProcessor())
    with opener.open(address, timeout=30) as page:
        assert b"Your measurements" in page.read()
    started.send_signal(signal.SIGINT)
    _, errors = started.communicate(timeout=30)
    assert started.returncode == 0
    assert "Traceback" not in errors
    assert list(tmp_path.iterdir()) == []


def test_a_port_that_is_taken_is_told(tmp_path):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(rc.RotcalError, match="choose another"):
            web.serve(tmp_path, port, print)
