"""Where ``rotcal report`` writes: beside what it is about, never into a bag, never over a file."""

import shutil
from pathlib import Path

import pytest
from click.testing import CliRunner

from rotcal_ros.cli.main import rotcal
from rotcal_ros.cli.report import page_beside

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
    assert page_beside(session / "bag") == session / "report.html"
    assert page_beside(session / "bag" / "bag_0.mcap") == session / "report.html"
    assert page_beside(session / "result.json") == session / "report.html"
    assert page_beside(other) == tmp_path / "run.1_report.html"
    assert page_beside(Path(single)) == tmp_path / "alone_report.html"
    assert page_beside(tmp_path / "lengths.csv") == tmp_path / "lengths_report.html"
