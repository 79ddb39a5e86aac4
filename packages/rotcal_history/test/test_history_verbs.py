"""``rotcal history`` as people and scheduled jobs call it."""

import json
import os
import re
import time
from pathlib import Path

import numpy as np
import pytest
from simulated_park import BEGIN_NS, Table, measured, result

from rotcal_ros.foundation.dates import day_of

DATA = Path(__file__).parents[3] / "examples" / "data"
YEARS = np.linspace(0.0, 5.0, 11)


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """Return files of a table that leaves its tolerance in 2029, and of one that is still."""
    folder, rng = tmp_path_factory.mktemp("results"), np.random.default_rng(1)
    start = np.array([1.0, 0.5, 0.3, 0.0, 0.0, 0.0, 0.0, 0.0])
    tables = [
        Table("DRIFTS", start, drift=0.6 * np.eye(8)[0], tolerance=6.0),
        Table("STAYS", start),
    ]
    for table in tables:
        for number, each in enumerate(measured(table, YEARS, rng)):
            (folder / f"{table.serial}_{number:02}.json").write_text(each.to_json())
    return sorted(folder.iterdir())


@pytest.fixture
def history(warm, tmp_path):
    """Return what runs a verb on a history in ``tmp_path``."""

    def run(*arguments):
        own = ("--database", tmp_path / "history.db")
        verb = ("history", *arguments, *own) if arguments else ("history", *own)
        return warm.run("rotcal", *verb, folder=tmp_path)

    return run


def test_the_park_tells_what_is_due_and_why(history, results, tmp_path):
    added = history("add", *results)
    assert added.returncode == 0, added.stderr
    assert added.stderr.count(", added") == len(results)
    assert history("add", *results).stderr.count("there already") == len(results)
    listed = history()
    first, second = listed.stdout.splitlines()[1:]
    assert first.startswith("DRIFTS/C,2026-01-01,")
    assert "ECC +0.6" in first
    assert "within its tolerance with 95 % until then" in first
    assert "no change seen" in second
    early = history("due", "--before", "2026-02-01")
    assert (early.returncode, early.stdout) == (0, "")
    late = history("due", "--before", "2029-12-31", "--mail", "--ics", "due.ics")
    assert late.returncode == 1
    assert late.stdout.startswith("Subject: 1 table is due before 2029-12-31\n")
    calendar = (tmp_path / "due.ics").read_bytes().decode()
    assert calendar.endswith("END:VCALENDAR\r\n")
    assert "SUMMARY:Calibrate DRIFTS/C" in calendar
    assert all(len(line.encode()) <= 75 for line in calendar.split("\r\n"))
    due = json.loads(history("due", "--before", "2029-12-31", "--json").stdout)["tables"]
    # sqrt((1 + 0.6 t)^2 + 0.5^2) + 0.3 reaches 6 arcsec after 7.8 years; 95 % is sooner.
    assert "2027-06-01" < np.datetime64(due[0]["due_ns"], "ns").astype(str)[:10] < "2028-10-20"
    metrics = history("metrics").stdout
    assert 'rotcal_calibration_ok{serial="STAYS",axis="C"} 1' in metrics
    assert history("check").stdout == "all entries are as they were added\n"


def test_what_happened_is_noted_and_mistakes_are_corrected(history, results, tmp_path):
    history("add", *results)
    noted = history("event", "STAYS", "bearing", "--date", "2025-06-01", "--why", "noise")
    assert noted.returncode == 0, noted.stderr
    shown = json.loads(history("show", "STAYS", "--json").stdout)
    assert [e["what"] for e in shown["entries"] if e["kind"] == "event"] == ["bearing"]
    assert len(shown["outlook"]["deviations"][0]["times_ns"]) == 2
    assert "as agreed (fewer than 3 results)" in shown["outlook"]["reason"]
    number = shown["entries"][0]["id"]
    corrected = history("correct", number, "--serial", "DRIFTS", "--why", "label")
    assert corrected.returncode == 0, corrected.stderr
    assert f"{number},2021-01-01,result" in history("show", "STAYS").stdout
    refused = history("correct", number, "--withdraw", "--why", "again")
    assert (refused.returncode, "was corrected already" in refused.stderr) == (3, True)
    back = history(
        "show", "DRIFTS", "--entry", corrected.stderr.split()[1][:-1], "-o", "back.json"
    )
    assert back.returncode == 0, back.stderr
    original = next(path for path in results if path.name == "STAYS_00.json")
    assert json.loads((tmp_path / "back.json").read_text()) == json.loads(original.read_text())


def test_an_entry_of_another_table_is_not_written(history, results, tmp_path):
    history("add", results[0], results[-1])
    refused = history("show", "DRIFTS", "--entry", 2, "-o", "two.json")
    assert refused.returncode == 3
    assert "entry 2 is of STAYS/C, not of DRIFTS/C: name that table" in refused.stderr
    assert not (tmp_path / "two.json").exists()
    history("correct", 2, "--withdraw", "--why", "upside down")
    assert history("show", "STAYS", "--entry", 2, "-o", "two.json").returncode == 0
    assert json.loads((tmp_path / "two.json").read_text()) == json.loads(results[-1].read_text())


def test_what_is_due_today_is_due(history, tmp_path):
    now = result("NOW", time.time_ns(), np.zeros(24), 0.3, verdict="suspect")
    (tmp_path / "now.json").write_text(now.to_json())
    history("add", "now.json")
    assert history("due").returncode == 1


def test_a_result_of_nobody_gets_its_table_by_option(history):
    refused = history("add", DATA / "result_tracer.json")
    assert (refused.returncode, "no serial number" in refused.stderr) == (3, True)
    named = ("--serial", "4711", "--measured", "2026-03-31")
    assert history("add", DATA / "result_tracer.json", *named).returncode == 0
    kept = history("add", DATA / "tracer.yaml", "--as", "check", "--serial", "4711")
    assert kept.returncode == 0, kept.stderr


def test_one_that_is_refused_keeps_no_other_out(history, results):
    nobody = DATA / "result_tracer.json"
    added = history("add", results[0], nobody, results[1], "--json")
    assert added.returncode == 1
    told = json.loads(added.stdout)
    assert [entry["serial"] for entry in told["entries"]] == ["DRIFTS", "DRIFTS"]
    assert len(told["refused"]) == 1
    assert "which table it is of" in told["refused"][0]
    assert "1 of 3 were not added" in added.stderr
    assert history("add", nobody).returncode == 3


def test_files_that_cannot_be_read_keep_no_other_out(history, results, tmp_path):
    (tmp_path / "broken.json").write_text("{")
    added = history("add", *results[:2], "broken.json", *results[2:], "--json")
    assert added.returncode == 1
    told = json.loads(added.stdout)
    assert (len(told["entries"]), len(told["refused"])) == (len(results), 1)
    assert "broken.json" in told["refused"][0]
    reports = ("--as", "report", "--serial", "STAYS", "--json")
    told = json.loads(history("add", "no.html", "broken.json", *reports).stdout)
    assert (len(told["entries"]), len(told["refused"])) == (1, 1)


def test_a_history_that_is_not_there_is_not_begun_by_a_look(history, tmp_path):
    looked = history("show", "4711")
    assert (looked.returncode, "there is no history" in looked.stderr) == (2, True)
    assert list(tmp_path.iterdir()) == []


def test_what_is_named_counts_before_the_variable(warm, results, tmp_path):
    environment = os.environ | {"ROTCAL_HISTORY": str(tmp_path / "variable.db")}
    named = ("history", "--database", tmp_path / "named.db", "add", results[0])
    for arguments in (named, ("history", "add", results[0])):
        ran = warm.run("rotcal", *arguments, folder=tmp_path, env=environment)
        assert ran.returncode == 0, ran.stderr
    assert {path.name for path in tmp_path.glob("*.db")} == {"named.db", "variable.db"}


def test_export_and_import(history, results, tmp_path, warm):
    history("add", *results[:3])
    assert history("export", "out").returncode == 0
    again = warm.run("rotcal", "history", "import", "out", "--database", "b.db", folder=tmp_path)
    assert "3 entries added, 0 were there already" in again.stderr


def test_duckdb_finds_every_deviation_in_an_export(history, results, tmp_path):
    duckdb = pytest.importorskip("duckdb")
    history("add", *results[:3], "--why", "yearly")
    assert history("export", "out").returncode == 0
    asked = duckdb.sql(
        "SELECT max(deviation) - min(deviation), count(*), any_value(why), any_value(serial), "
        "epoch_ns(any_value(measured)), any_value(covered) "
        f"FROM '{tmp_path}/out/deviations.parquet' GROUP BY entry ORDER BY entry"
    ).fetchall()
    read = [json.loads(path.read_text()) for path in results[:3]]
    for row, data in zip(asked, read, strict=True):
        ecc = data["deviations"]["ECC"]
        begun = data["circumstances"]["begun_ns"]
        assert row == (max(ecc) - min(ecc), len(ecc), "yearly", "DRIFTS", begun, False)


@pytest.mark.parametrize("chart", ["shewhart", "cusum", "ewma", "t2"])
def test_charts_are_drawn(history, results, tmp_path, chart):
    history("add", *results[:11])
    drawn = history("plot", "DRIFTS", "--chart", chart, "--limits", "own", "-o", "chart.svg")
    assert drawn.returncode == 0, drawn.stderr
    assert "<svg" in (tmp_path / "chart.svg").read_text()


def test_a_suspect_result_is_due_at_once(history, tmp_path):
    bad = result("BAD", BEGIN_NS, np.sin(np.arange(24.0)), 0.3, verdict="suspect")
    (tmp_path / "bad.json").write_text(bad.to_json())
    history("add", "bad.json")
    listed = json.loads(history("due", "--json").stdout)["tables"]
    assert "measure again" in listed[0]["reason"]
    assert "suspect" in history("show", "BAD").stdout


def test_the_drift_of_each_harmonic_is_told(history, results):
    history("add", *results[:11])
    shown = " ".join(history("show", "DRIFTS").stderr.split())
    assert re.search(r"ECC, change per year by order / arcsec: 1: 0\.[56]\d? ± 0\.\d+, 2: ", shown)


def test_the_next_check_is_proposed_for_the_day_on_which_the_table_is_due(history, results):
    history("add", *results[:11])
    due = json.loads(history("--json").stdout)["tables"][0]["due_ns"]
    shown = history("show", "DRIFTS").stderr
    asked = f"rotcal plan check DRIFTS --from-history .*history.db --at {day_of(due)} "
    assert re.search(asked, " ".join(shown.split())), shown
