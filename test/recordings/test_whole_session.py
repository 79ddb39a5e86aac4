"""What every reader of a session says when it is not whole: in its JSON, and never plainly ok."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
from bag_samples import Run, open_writer, write_run
from click.testing import CliRunner, Result

from rotcal_ros.bags import names
from rotcal_ros.bags.reader import bag_files
from rotcal_ros.bags.repair import repair
from rotcal_ros.bags.rosbag2_metadata import FileInfo
from rotcal_ros.bags.settings import WriterSettings
from rotcal_ros.bags.writer import BagWriter
from rotcal_ros.cli.main import rotcal
from rotcal_ros.recordings.replay import read_recording

pytestmark = pytest.mark.usefixtures("without_figures")

EARLIER = [FileInfo(f"bag_{number}.mcap") for number in range(18)]
MISSING = "bag_7.mcap of the session is missing"


def run(*arguments: object) -> Result:
    return CliRunner().invoke(rotcal, [str(argument) for argument in arguments])


@pytest.fixture(scope="module")
def split(simulated_run: Run, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a session of many files; tests must not change it."""
    folder = tmp_path_factory.mktemp("whole") / "bag"
    settings = WriterSettings(min_free_bytes=0, split_bytes=76_000)
    write_run(folder, simulated_run, settings, tick_every=200)
    return folder


@pytest.fixture
def part(split: Path, tmp_path: Path) -> Path:
    """Return a copy that lacks a file, without which the verdict would still be ok."""
    shutil.copytree(split, tmp_path / "bag")
    (tmp_path / "bag" / "bag_7.mcap").unlink()
    return tmp_path / "bag"


@pytest.mark.slow
def test_whole_it_is_ok_and_a_part_is_suspect_whoever_asks(
    split: Path, part: Path, tmp_path: Path
) -> None:
    whole = read_recording(split).solve()
    assert whole.verdict == "ok"
    assert not any("bag_" in text for text in whole.warnings)
    recording = read_recording(part)
    assert recording.calibration.solve(recording.observations).verdict == "ok"  # by the data alone
    path = tmp_path / "result.json"
    solved = run("solve", part, "-o", path, "--json")
    assert solved.exit_code == 1
    result = json.loads(path.read_text())
    assert json.loads(solved.stdout) == result
    assert result["verdict"] == "suspect"
    assert any(MISSING in text for text in result["warnings"])
    page = tmp_path / "page.html"
    assert run("report", part, "-o", page).exit_code == 1
    assert MISSING in page.read_text()
    exported = run("export", part, "--to", "csv", "-o", tmp_path / "files", "--replace")
    assert exported.exit_code not in (0, 1)
    assert MISSING in exported.output
    checked = run("bag", "check", part, "--json")
    assert checked.exit_code == 1
    assert any(MISSING in text for text in json.loads(checked.stdout)["session"]["missing"])
    assert MISSING in run("bag", "info", part).output


@pytest.mark.slow
def test_every_warning_on_standard_error_is_in_the_json(part: Path, tmp_path: Path) -> None:
    """All at once: missing, damaged, truncated, lost live, not decodable, repaired before."""
    last = bag_files(part)[-1]
    last.write_bytes(last.read_bytes()[:-200])
    data = bytearray((part / "bag_12.mcap").read_bytes())
    data[len(data) // 2] ^= 0xFF
    (part / "bag_12.mcap").write_bytes(data)
    (part / "bag_7.mcap").touch()  # nobody continues a session that lacks a file
    with BagWriter(part, WriterSettings(min_free_bytes=0), earlier=EARLIER) as w:
        w.note(
            names.LOSSES, {"gap /cell/tracer_length": 4, f"{names.SILENT} /cell/temperature": 1}
        )
        schema = "float64 temperature\n"
        broken = w.channel("/cell/temperature", "sensor_msgs/msg/Temperature", schema)
        w.write(broken, b"\0\1\0\0\1", 1, 1)
    (part / "bag_7.mcap").unlink()
    repaired = tmp_path / "repaired"
    repair(part, repaired)
    for folder, words in (
        (part, (MISSING, "bag_12.mcap: damaged at byte", "bag_17.mcap: truncated at byte",
                "4 lost live", "fell silent", "cannot be decoded", "differ from those captured")),
        (repaired, (MISSING, "from bag_12.mcap: damaged", "from bag_17.mcap: truncated",
                    "4 lost live", "fell silent", "cannot be decoded")),
    ):  # fmt: skip
        path = tmp_path / f"{folder.name}.json"
        solved = run("solve", folder, "-o", path, "--json")
        said = [
            line.removeprefix("warning: ")
            for line in solved.stderr.splitlines()
            if line.startswith("warning: ")
        ]
        kept = json.loads(path.read_text())["warnings"]
        assert said == kept
        for word in words:
            assert any(word in text for text in kept), word
        plain = " ".join(run("solve", folder).output.split())
        assert [plain.count(text) for text in kept] == [1] * len(kept)


@pytest.mark.slow
def test_files_of_another_table_are_refused_by_name(
    split: Path, simulated_run: Run, tmp_path: Path
) -> None:
    shutil.copytree(split, tmp_path / "bag")
    another = read_recording(split).configuration.text.replace("positions: 4", "positions: 5")
    writer, channels = open_writer(tmp_path / "other", configuration=another)
    with writer:
        writer.note(names.SUBJECT, {"item": "table 2", "simulated": "false"})
        writer.write(channels[names.PLAN], b"\0\1\0\0", 5, 5)
    shutil.copy(tmp_path / "other" / "other_0.mcap", tmp_path / "bag")
    solved = run("solve", tmp_path / "bag")
    assert solved.exit_code == 2
    assert "holds files of 2 measurements" in solved.stderr
    assert "other_0.mcap" in solved.stderr
    assert "table 2" in solved.stderr
    checked = run("bag", "check", tmp_path / "bag")
    assert checked.exit_code == 1
    assert "2 measurements" in checked.output
