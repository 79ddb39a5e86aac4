"""No file whose ending lies: what is written is what the name promises, or nothing is written."""

import shutil
from pathlib import Path
from subprocess import run as run_program

import pytest
from browser import CHROMIUM, REQUIRED
from click.testing import CliRunner

from rotcal_ros.api.evaluating import write_report
from rotcal_ros.cli.main import rotcal
from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.plugins import PLANS, names
from rotcal_ros.recordings.replay import read_recording

pytestmark = pytest.mark.usefixtures("without_figures")

DATA = Path(__file__).parents[2] / "examples" / "data"
CONFIG = Path(__file__).parents[2] / "config"
TRACER, PLATE = DATA / "result_tracer.json", DATA / "result_ball_plate.json"
VERBS = {
    "solve": ("solve", DATA / "ball_plate_bag"),
    "combine": ("combine", TRACER, PLATE),
    "compare": ("compare", TRACER, PLATE),
    "iso230": ("iso230", DATA / "runs.csv"),
    "sequence": ("plan", "sequence", CONFIG / "tracer_demo.yaml"),
    "report": ("report", PLATE),
    "certificate": ("report", PLATE, "--dcc"),
}
VERBS = {
    name: words for name, words in VERBS.items() if name != "sequence" or words[1] in names(PLANS)
}
TRUE = {
    "solve": {".json"}, "combine": {".json"}, "compare": {".svg", ".html"}, "iso230": {".svg"},
    "sequence": {".csv"}, "report": {".html", ".pdf"}, "certificate": {".xml"},
}  # fmt: skip
ENDINGS = (".json", ".svg", ".html", ".csv", ".pdf", ".xml", ".png", ".txt", ".docx")
NEEDS_CHROMIUM = pytest.mark.skipif(
    CHROMIUM is None and not REQUIRED, reason="Chromium is not installed: apt install chromium"
)


def run(*arguments):
    return CliRunner().invoke(rotcal, [str(argument) for argument in arguments])


@pytest.mark.parametrize("verb", VERBS)
def test_a_name_that_says_something_else_is_refused_before_anything_is_done(verb, tmp_path):
    for ending in sorted(set(ENDINGS) - TRUE[verb]):
        ran = run(*VERBS[verb], "-o", tmp_path / f"l{ending}")
        assert ran.exit_code == 2, (ending, ran.output)
        assert any(true in ran.stderr for true in TRUE[verb])
        assert not list(tmp_path.iterdir())


@pytest.mark.slow
@pytest.mark.parametrize("name", ["a.HTML", "a"])
def test_a_report_is_html_under_names_that_allow_it(name, tmp_path):
    assert run("report", TRACER, "-o", tmp_path / name).exit_code == 0
    assert (tmp_path / name).read_bytes().startswith(b"<!DOCTYPE html>")


@NEEDS_CHROMIUM
@pytest.mark.slow
def test_a_report_called_pdf_is_a_pdf_of_the_page(tmp_path):
    path = tmp_path / "l.pdf"
    ran = run("report", DATA / "ball_plate_bag", "-o", path)
    assert ran.exit_code == 0, ran.output
    data = path.read_bytes()
    assert data.startswith(b"%PDF-")
    assert data.rstrip().endswith(b"%%EOF")
    assert [file.name for file in tmp_path.iterdir()] == ["l.pdf"]
    if shutil.which("pdftotext"):
        shown = run_program(
            ["pdftotext", "-layout", str(path), "-"], capture_output=True, text=True
        )
        assert "Measurement: ok" in shown.stdout
        assert "Page 1 of " in shown.stdout


def test_without_a_browser_a_pdf_is_refused_with_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    ran = run("report", PLATE, "-o", tmp_path / "l.pdf")
    assert ran.exit_code == 2
    assert "apt install chromium" in ran.stderr
    assert ".html" in ran.stderr
    assert not list(tmp_path.iterdir())


def test_a_browser_that_prints_nothing_is_an_error_and_no_empty_file(tmp_path, monkeypatch):
    programs = tmp_path / "programs"
    programs.mkdir()
    fake = programs / "chromium"
    fake.write_text("#!/bin/sh\necho 'no display' >&2\nexit 0\n")
    fake.chmod(0o755)
    monkeypatch.setenv("PATH", f"{programs}:/usr/bin:/bin")
    ran = run("report", TRACER, "-o", tmp_path / "l.pdf")
    assert ran.exit_code == 2
    assert "made no PDF (no display)" in ran.stderr
    assert not (tmp_path / "l.pdf").exists()


@pytest.mark.slow
def test_a_script_too_gets_no_file_that_lies(tmp_path):
    recording = read_recording(DATA / "ball_plate_bag")
    with pytest.raises(ConfigurationError, match=r"\.docx"):
        write_report(recording, tmp_path / "l.docx")
    assert not list(tmp_path.iterdir())
