"""Two that continue one session at once: the second one measures nothing, and says so."""

import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "bags"))
import bag_samples

from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.folder_lock import FolderLock
from rotcal_ros.sessions.running import calibrate, run_processes
from rotcal_ros.sessions.session import resume_session

VIEWERS = SimpleNamespace(say=lambda _text: None)


@pytest.fixture(scope="module")
def measured():
    return bag_samples.simulate()


@pytest.fixture
def folder(measured, tmp_path):
    """A session that was interrupted behind its last step."""
    (tmp_path / "out" / "log").mkdir(parents=True)
    (tmp_path / "out" / "configuration.yaml").write_text(bag_samples.CONFIGURATION)
    bag_samples.write_run(tmp_path / "out" / "bag", measured)
    return tmp_path / "out"


def resumed(folder):
    return resume_session(folder / "configuration.yaml", folder, ())


@pytest.mark.slow
def test_the_second_one_is_refused_when_the_first_one_has_solved_it(folder):
    first, second = resumed(folder), resumed(folder)
    assert calibrate(first, VIEWERS)["verdict"] == "ok"
    result = (folder / "result.json").read_bytes()
    with pytest.raises(ConfigurationError, match="this one has measured nothing"):
        calibrate(second, VIEWERS)
    assert (folder / "result.json").read_bytes() == result


@pytest.mark.slow
def test_the_second_one_starts_no_node_when_the_first_one_has_recorded(folder):
    second = resumed(folder)
    (folder / "bag" / "out_1.mcap").write_bytes(b"")  # a run went on, and was interrupted again
    (folder / "bag" / "out_0.mcap").write_bytes((folder / "bag" / "bag_0.mcap").read_bytes())
    with pytest.raises(ConfigurationError, match="another run went on"), run_processes(second):
        raise AssertionError
    FolderLock(folder).release()


def test_one_that_waited_until_the_first_one_was_done_is_refused(folder, monkeypatch):
    def finished_meanwhile(path):
        (path / "result.json").write_text("{}")

    monkeypatch.setattr("rotcal_ros.sessions.session._wait_for_lock", finished_meanwhile)
    with pytest.raises(ConfigurationError, match="is finished"):
        resumed(folder)
