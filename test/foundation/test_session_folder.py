"""The names inside a session folder, which people and their scripts rely on."""

import shlex
from pathlib import Path

import pytest

from rotcal_ros.foundation.session_folder import REQUEST, SessionFolder, resume_command, unfinished

FOLDER = SessionFolder(Path("/data/out"))


def test_the_names_stay():
    names = {
        name: getattr(FOLDER, name).relative_to(FOLDER.path).as_posix()
        for name in ("configuration", "bag", "result", "truth", "report", "compensation")
    }
    assert names == {
        "configuration": "configuration.yaml",
        "bag": "bag",
        "result": "result.json",
        "truth": "truth.json",
        "report": "report.html",
        "compensation": "compensation",
    }


def test_every_run_has_its_own_log_and_continuation():
    assert [FOLDER.log(run).name for run in (0, 1, 12)] == ["log", "log_1", "log_12"]
    assert FOLDER.continuation(3) == Path("/data/out/continuation_3.json")


def begun(path):
    folder = SessionFolder(path)
    folder.bag.mkdir(parents=True)
    folder.configuration.write_text("method: tracer_multistation\n")
    return path


def test_the_command_that_goes_on_is_whole_and_a_shell_takes_it_as_it_is(tmp_path):
    session = begun(tmp_path / "a folder; rm -r x")
    words = shlex.split(resume_command(session))
    assert words == ["rotcal", "run", "--resume", str(session)]


@pytest.mark.parametrize("part", ["", "after", "again"])
def test_every_measurement_of_a_verification_goes_on_as_a_part_of_it(tmp_path, part):
    session = begun(tmp_path / "table" / part)
    (tmp_path / "table" / REQUEST).write_text("{}")
    assert resume_command(session) == f"rotcal verify --resume {tmp_path / 'table'}"


def test_a_session_is_unfinished_until_it_has_a_result(tmp_path):
    session = begun(tmp_path / "table")
    assert unfinished(session)
    SessionFolder(session).result.write_text("{}")
    assert not unfinished(session)
    assert not unfinished(tmp_path)
