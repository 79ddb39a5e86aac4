"""What a session needs to go on, and what it has cost once it has."""

import sys
from pathlib import Path

import pytest
from click.testing import CliRunner

sys.path.insert(0, str(Path(__file__).parents[1] / "bags"))
import bag_samples

from rotcal_ros.bags.unread_data import collect_unread
from rotcal_ros.cli.main import rotcal
from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.session_folder import resume_command
from rotcal_ros.sessions.session import resume_session


@pytest.fixture
def killed(tmp_path, capsys):
    """A session whose recorder was killed: its file ends in the midst of a record."""
    folder = tmp_path / "out"
    (folder / "log").mkdir(parents=True)
    (folder / "configuration.yaml").write_text(bag_samples.CONFIGURATION)
    bag_samples.write_run(folder / "bag", bag_samples.simulate())
    (file,) = (folder / "bag").glob("*.mcap")
    file.write_bytes(file.read_bytes()[: 9 * file.stat().st_size // 10])
    (folder / "bag" / "metadata.yaml").unlink()
    return folder


def test_a_killed_recorder_is_told_and_does_not_count_against_the_resumed_run(killed, capsys):
    with collect_unread() as noted:
        session = resume_session(None, killed, ())
    assert "truncated at byte" in capsys.readouterr().err
    assert session.continuation.observations
    assert noted == {}


def test_the_folder_alone_says_how_to_go_on(killed, tmp_path):
    assert resume_command(killed) == f"rotcal run --resume {killed}"
    with pytest.raises(ConfigurationError, match=r"holds no session: configuration\.yaml"):
        resume_session(None, tmp_path, ())
    neither = CliRunner().invoke(rotcal, ["run"])
    assert neither.exit_code == 2
    assert "give a CONFIG, or --resume FOLDER" in neither.stderr
