"""The names inside a session folder, which people and their scripts rely on."""

from pathlib import Path

from rotcal_ros.foundation.session_folder import SessionFolder

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
