"""Where ``rotcal report`` writes: beside what it is about, never into a bag, never over a file."""

import json
import shutil
from pathlib import Path

import pytest
from click.testing import CliRunner

from rotcal_ros.cli.main import rotcal
from rotcal_ros.cli.report import default_report_path

pytestmark = pytest.mark.usefixtures("without_figures")

ROOT = Path(__file__).parents[2]
BAG = ROOT / "test" / "golden" / "tracer" / "bag"


@pytest.fixture
def session(tmp_path):
    """A session's folder with the bag of a measurement in it."""
    shutil.copytree(BAG, tmp_path / "session" / "bag")
    shutil.copy(BAG.parent / "result.json", tmp_path / "session" / "result.json")
    return tmp_path / "session"


def report(*words):
    return CliRunner().invoke(rotcal, ["report", *map(str, words)])


def test_a_report_of_a_bag_is_written_beside_it(session):
    before = sorted((session / "bag").iterdir())
    ran = report(session / "bag")
    assert ran.exit_code == 0, ran.output
    assert (session / "report.html").read_text().startswith("<!DOCTYPE html>")
    assert sorted((session / "bag").iterdir()) == before
    again = report(session / "bag")
    assert again.exit_code == 2
    assert "is not overwritten" in again.stderr


@pytest.mark.slow
@pytest.mark.parametrize(
    ("left", "code", "words"),
    [
        (0.0, 0, "table acts: "),
        (1.0, 1, "it is inactive, or on the wrong axis"),
        (2.0, 1, "its sign is wrong"),
    ],
)
def test_a_result_on_top_of_a_table_says_whether_that_table_acts(left, code, words, tmp_path):
    data = json.loads((ROOT / "examples/data/result_ball_plate.json").read_text())
    whole = data["deviations"]["ECC"]
    source = tmp_path / "first.json"
    source.write_text(json.dumps(data))
    out = ["--to", "csv", "--replace", "-o", str(tmp_path / "files"), "--json"]
    done = CliRunner().invoke(rotcal, ["export", str(source), *out])
    held = json.loads(done.stdout)["provenance"]["contents_sha256"]
    # What the table leaves: that share of it, and 0.002 arcsec of something else.
    rest = [1e-8 * (7 * n % 5 - 2) for n in range(len(whole))]
    data["deviations"]["ECC"] = [left * x + r for x, r in zip(whole, rest, strict=True)]
    second = tmp_path / "second.json"
    second.write_text(json.dumps(data | {"measured_on": held}))
    if not left:  # what is said of a table that nobody shows is one and the same
        plain = report(second, "-o", tmp_path / "plain.html")
        assert plain.exit_code == 0
        assert "Does that table act? not tested" in (tmp_path / "plain.html").read_text()
    ran = report(second, "-o", tmp_path / "page.html", "--in-force", tmp_path / "files")
    assert (ran.exit_code, words in ran.stderr) == (code, True)
    page = (tmp_path / "page.html").read_text()
    assert "times what it corrects is left" in page
    assert (words in page) == bool(left)
    second.write_text(json.dumps(data | {"measured_on": "a" * 64}))
    other = report(second, "-o", tmp_path / "other.html", "--in-force", tmp_path / "files")
    assert other.exit_code == 2
    assert "name the folder with the files of the table that was in force" in other.stderr
    assert not (tmp_path / "other.html").exists()


def test_a_report_never_goes_into_a_bag(session):
    for bag in (session / "bag", session / "bag" / "bag_0.mcap"):
        ran = report(bag, "-o", session / "bag" / "page.html")
        assert ran.exit_code == 2
        assert "would lie inside the bag" in ran.stderr
    (session / "bag" / "metadata.yaml").unlink()  # as after a crash
    assert report(session / "bag", "-o", session / "bag" / "page.html").exit_code == 2
    assert not (session / "bag" / "page.html").exists()


def test_the_name_follows_the_source(session, tmp_path):
    other = shutil.copytree(session / "bag", tmp_path / "run.1")
    single = shutil.copy(session / "bag" / "bag_0.mcap", tmp_path / "alone.mcap")
    assert default_report_path(session / "bag") == session / "report.html"
    assert default_report_path(session / "bag" / "bag_0.mcap") == session / "report.html"
    assert default_report_path(session / "result.json") == session / "report.html"
    assert default_report_path(other) == tmp_path / "run.1_report.html"
    assert default_report_path(Path(single)) == tmp_path / "alone_report.html"
    assert default_report_path(tmp_path / "lengths.csv") == tmp_path / "lengths_report.html"
