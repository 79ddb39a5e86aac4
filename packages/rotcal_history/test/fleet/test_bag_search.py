"""Bags are found once, however they are linked; loops of links and lists end."""

import os

import pytest
from fleet_bags import RECORDING, configuration_text

from rotcal_history.fleet.bag_search import find_bags
from rotcal_history.fleet.batch_solving import BagJob, solve_bag
from rotcal_ros.foundation.errors import BagError
from rotcal_ros.methods.configuration import parse_configuration

CONFIGURATION = parse_configuration(configuration_text())


@pytest.fixture
def bags(tmp_path):
    """Two sessions, one of two files."""
    for name, files in (("one", 1), ("two", 2)):
        for number in range(files):
            file = tmp_path / "bags" / name / f"bag_{number}.mcap"
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_bytes((RECORDING / "ball_plate_bag_0.mcap").read_bytes())
    return tmp_path / "bags"


def test_a_session_stands_for_its_files_whichever_is_named_first(bags):
    folder, file = str(bags / "two"), str(bags / "two" / "bag_1.mcap")
    assert find_bags([folder, file]) == (folder,)
    assert find_bags([file, folder]) == (folder,)
    assert find_bags([file]) == (file,)


def test_links_hard_links_and_dots_lead_to_the_same(bags, tmp_path):
    (tmp_path / "link").symlink_to(bags / "two")
    (tmp_path / "link.mcap").symlink_to(bags / "one" / "bag_0.mcap")
    (tmp_path / "hard").mkdir()
    for file in (bags / "two").iterdir():
        (tmp_path / "hard" / file.name).hardlink_to(file)
    ways = [bags, bags, tmp_path / "link", tmp_path / "link.mcap", tmp_path / "hard",
            bags / "one" / ".." / "two", tmp_path]  # fmt: skip
    assert find_bags([str(way) for way in ways]) == (str(bags / "one"), str(bags / "two"))


def test_loops_of_links_end(bags):
    for name in ("a", "b", "c", "d"):
        (bags / name).symlink_to(bags)
    (bags / "itself").symlink_to(bags / "itself")
    (bags / "itself.mcap.txt").symlink_to(bags / "itself.mcap.txt")
    expected = {str(bags / "one"), str(bags / "two")}
    assert {b for b in find_bags([str(bags)]) if "/a/" not in b} == expected
    found = find_bags([str(bags / "**")])
    assert len(found) == 2
    assert len(find_bags([str(bags / "**" / "*.mcap")])) == 3


def test_nothing_is_asked_of_each_of_very_many_files(bags, monkeypatch):
    """The folder itself tells files from folders; a question to each took 20 s of 100,000."""
    for number in range(100_000 if os.environ.get("ROTCAL_LONG_TESTS") else 1000):
        (bags / f"photo_{number:06}.jpg").touch()
    asked = []
    ask = os.stat
    monkeypatch.setattr(os, "stat", lambda path, **given: asked.append(path) or ask(path, **given))
    assert find_bags([str(bags)]) == (str(bags / "one"), str(bags / "two"))
    assert find_bags([str(bags / "**" / "*.mcap")])
    assert len(asked) < 100


def test_a_list_that_names_itself_ends(bags, tmp_path):
    (tmp_path / "list.txt").write_text("# lists may name lists\nlist.txt\nmore.txt\nbags/one\n")
    (tmp_path / "more.txt").write_text("list.txt\nbags/two\n")
    names = {str(bags / "two"), str(bags / "one")}
    assert set(find_bags([str(tmp_path / "list.txt")])) == names


def test_what_names_no_bag_is_said(bags, tmp_path):
    for nothing in ("nothing*", "nothing", "**/nothing.mcap"):
        with pytest.raises(BagError, match="names no bag"):
            find_bags([str(tmp_path / nothing)])
    (tmp_path / "list.txt").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(BagError, match="cannot read the list"):
        find_bags([str(tmp_path / "list.txt")])


def test_a_folder_with_brackets_in_its_name_is_a_folder(bags):
    named = bags.rename(bags.with_name("bags [2026]"))
    assert len(find_bags([str(named)])) == 2


def test_a_line_that_names_nothing_stays_a_bag_that_cannot_be_read(bags, tmp_path):
    (tmp_path / "empty").mkdir()
    (tmp_path / "list.txt").write_text(
        "bags/one\nbags/gone\nempty\nbags/*.nothing\nlist.txt\nbags/one\n"
    )
    found = find_bags([str(tmp_path / "list.txt")])
    gone = [str(tmp_path / name) for name in ("bags/gone", "empty", "bags/*.nothing")]
    assert found == (str(bags / "one"), *gone)
    for name in gone:
        outcome = solve_bag(BagJob(name, CONFIGURATION, str(tmp_path / "cache")))
        assert "does not exist" in outcome.error or "is not a bag" in outcome.error
