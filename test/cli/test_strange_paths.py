"""Paths that lead to a pipe, a device, themselves or nowhere: one line, at once, no traceback."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import strange_paths as strange
from click.testing import CliRunner

from rotcal_ros.cli import main
from rotcal_ros.foundation.escapes import printable_lines
from rotcal_ros.foundation.machine_load import load_scaled_timeout

pytestmark = pytest.mark.usefixtures("without_figures")

LONG = bool(os.environ.get("ROTCAL_FUZZ_SECONDS"))
"""All endings of files, not only those that a kind is most likely taken for."""
SHORT = {"pipe": (".mcap", ".json", ".yaml"), "endless": (".csv",), "folder of pipes": ("",),
         "folder in itself": ("",), "no text": (".json",), "new line": (".csv",)}  # fmt: skip
SLOW = (["reprocess"], ["run"], ["verify"], ["doctor"], ["plan", "check"])
"""Verbs that load much before they answer; one kind of path stands for all of them."""


def answer(arguments):
    with strange.must_answer():
        return CliRunner().invoke(main.rotcal, arguments, prog_name="rotcal")


def wrong(arguments):
    """Return what is wrong with the answer to a command line; empty where it is one line."""
    result = answer(arguments)
    said = [line for line in result.stderr.splitlines() if not line.startswith(("Usage", "Try"))]
    if result.exception and not isinstance(result.exception, SystemExit):
        return f"{arguments}: {result.exception!r}"
    if "unexpected" in result.stderr or "it blocks" in result.stderr:
        return f"{arguments}: {result.stderr}"
    if set(result.output) - set(printable_lines(result.output)):
        return f"{arguments}: {result.output!r} has what nobody sees"
    if result.exit_code in (2, 3) and len([line for line in said if line]) != 1:
        return f"{arguments}: {len(said)} lines: {result.stderr}"
    return ""


def commands(kind, path, new):
    for arguments in strange.reading(path, new):
        slow = any(arguments[: len(verb)] == verb for verb in SLOW)
        if LONG or not slow or (kind == "folder of pipes" and arguments[0] != "reprocess"):
            yield arguments


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "suffix"),
    [(k, s) for k in strange.KINDS for s in (strange.SUFFIXES if LONG else SHORT.get(k, ()))],
)
def test_a_path_to_no_good_file_is_answered_in_one_line(tmp_path, monkeypatch, kind, suffix):
    monkeypatch.chdir(tmp_path)
    path = strange.made(kind, tmp_path, suffix)
    found = [wrong(arguments) for arguments in commands(kind, path, tmp_path / "new")]
    assert not [text for text in found if text]


def of_anybody(locked, command):
    """Return what a command says of a folder that must not be read, which it is given last.

    Root may read everything unless its rights to pass by those of files are taken away.
    """
    locked.chmod(0)
    command = [*command, str(locked)]
    if os.geteuid() == 0:
        if not shutil.which("setpriv"):
            pytest.skip("root reads every folder, and setpriv is not here to prevent it")
        command = ["setpriv", "--bounding-set=-dac_override,-dac_read_search", *command]
    ended = subprocess.run(
        command, capture_output=True, text=True, timeout=load_scaled_timeout(60), check=False
    )
    locked.chmod(0o700)
    if ended.returncode == 77 or "setpriv:" in ended.stderr:
        pytest.skip(f"this user reads every folder: {ended.stderr}")
    assert ended.returncode == 0, ended.stderr
    return ended


def test_a_folder_that_nobody_may_read_is_answered(tmp_path):
    locked = tmp_path / "locked"
    (locked / "inside").mkdir(parents=True)
    (locked / "bag_0.mcap").touch()
    script = str(Path(__file__).with_name("locked_folder.py"))
    answers = of_anybody(locked, [sys.executable, script]).stdout.splitlines()
    assert len(answers) == 6
    for line in answers:
        assert line.startswith("2 "), line
        assert "is not readable" in line or "Permission denied" in line, line


@pytest.mark.slow
def test_nothing_is_ever_put_in_the_place_of_a_pipe(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = strange.made("pipe", tmp_path, "")
    strange.made("pipe", tmp_path, ".svg")
    for arguments in strange.writing(path):
        assert not wrong(arguments)
        assert path.is_fifo(), arguments
        assert path.with_suffix(".svg").is_fifo(), arguments


def test_a_name_that_is_no_text_is_read_and_shown_escaped(tmp_path):
    path = tmp_path / os.fsdecode(b"\xff\x1b[31m.csv")
    path.write_bytes((strange.DATA / "lengths.csv").read_bytes())
    (tmp_path / "targets.csv").write_bytes((strange.DATA / "targets.csv").read_bytes())
    setup = str(strange.DATA / "tracer.yaml")
    result = answer(["solve", str(path), "--setup", setup, "-o", str(path.with_suffix(".json"))])
    assert result.exit_code in (0, 1)
    assert r"\udcff\x1b[31m.json" in result.stderr
