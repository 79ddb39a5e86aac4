"""Every verb that reads a bag says what it could not read of it, and by its exit code."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from click.testing import CliRunner, Result
from mcap.reader import make_reader

from rotcal_ros.bags.unread_data import collect_unread
from rotcal_ros.cli.main import rotcal
from rotcal_ros.nodes.player.replayed_bag import ReplayedBag

sys.path.insert(0, str(Path(__file__).parents[1] / "bags"))
sys.path.insert(0, str(Path(__file__).parents[1] / "recordings"))
from rearranged import CONFIGURATION, run_messages, write_mcap

pytestmark = pytest.mark.usefixtures("without_figures")


def run(*arguments: object) -> Result:
    return CliRunner().invoke(rotcal, [str(argument) for argument in arguments])


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a sound bag, its result, and a bag with one flipped byte."""
    folder = tmp_path_factory.mktemp("unread")
    sound = write_mcap(folder / "sound.mcap", run_messages(), chunk_size=20_000)
    with sound.open("rb") as file:
        chunks = make_reader(file).get_summary().chunk_indexes
    hit = chunks[1]  # before the first window
    data = bytearray(sound.read_bytes())
    data[hit.chunk_start_offset + hit.chunk_length // 2] ^= 0xFF
    (folder / "bad").mkdir()
    (folder / "bad" / "bad_0.mcap").write_bytes(data)
    (folder / "setup.yaml").write_text(CONFIGURATION)
    assert run("solve", sound, "-o", folder / "sound.json").exit_code == 0
    return folder


LOST = "bad_0.mcap: damaged at byte"
VERBS = {
    "solve {bad}": 1,
    "solve {bad} --json": 1,
    "solve {bad} --from observations": 1,
    "solve {bad} -o {out}/r.json": 1,
    "report {bad} -o {out}/r.html": 1,
    "export {bad} --to linuxcnc --replace --accept age -o {out}/table": 3,  # it is suspect
    "uncertainty {bad} --trials 10 --workers 1": 1,
    "compare {place}/sound.json {bad}": 1,
    "check {place}/sound.json {bad} --within 50": 3,  # nothing new was measured
    "combine {place}/sound.json {bad} -o {out}/c.json": 3,  # one measurement counts once
    "iso230 {bad}": 3,  # there are no runs in both directions
    "reprocess {bad} --setup {place}/setup.yaml -o {out}/many --workers 1": 1,
    "bag info {bad}": 1,
    "bag info {bad} --json": 1,
    "bag check {bad}": 1,
    "bag parquet {bad} -o {out}/parquet": 1,
    "bag parquet {bad} -o {out}/parquet --json": 1,
    "bag choices {bad}": 1,
    "bag reindex {place}/bad": 2,
    "bag repair {bad} -o {out}/repaired": 1,
}


@pytest.mark.slow
@pytest.mark.parametrize("verb", VERBS)
def test_a_damaged_bag(verb: str, place: Path, tmp_path: Path) -> None:
    bad = place / "bad" / "bad_0.mcap"
    found = run(*verb.format(bad=bad, place=place, out=tmp_path).split())
    assert LOST in found.output or ("bag" in verb and "damaged at byte" in found.stdout)
    assert "messages lost" in found.output
    assert "--json" not in verb or LOST in found.stderr
    assert found.exit_code == VERBS[verb], found.output


@pytest.mark.slow
def test_the_same_verbs_are_silent_about_a_sound_bag(place: Path, tmp_path: Path) -> None:
    sound = place / "sound.mcap"
    for verb in ("solve {}", "bag info {}", "bag parquet {} -o {}/parquet", "bag choices {}"):
        found = run(*verb.format(sound, tmp_path).split())
        assert found.exit_code == 0, found.output
        assert "not read completely" not in found.output


@pytest.mark.slow
def test_what_is_known_already_is_told_again(place: Path, tmp_path: Path) -> None:
    verb = ("reprocess", place / "bad", "--setup", place / "setup.yaml", "-o", tmp_path)
    for _ in range(2):
        found = run(*verb, "--workers", 1)
        assert (LOST in found.stderr, found.exit_code) == (True, 1)


def test_a_file_of_the_session_that_is_missing_is_named(place: Path, tmp_path: Path) -> None:
    messages = run_messages()
    half = len(messages) // 2
    for number, part in enumerate((messages[:half], messages[half:])):
        write_mcap(tmp_path / "bag" / f"bag_{number}.mcap", part)
    assert run("bag", "reindex", tmp_path / "bag").exit_code == 0
    (tmp_path / "bag" / "bag_1.mcap").unlink()
    for number, verb in enumerate(("bag parquet", "bag info", "bag choices")):
        output = ("-o", tmp_path / f"p{number}") if verb == "bag parquet" else ()
        found = run(*verb.split(), tmp_path / "bag", *output)
        assert "bag_1.mcap of the session is missing" in found.stderr
        assert found.exit_code == 1


def test_a_replay_knows_what_it_does_not_publish(place: Path) -> None:
    with collect_unread() as missing:
        ReplayedBag.read(place / "bad")
    assert [text for text in missing if text.startswith(LOST)]
