"""``rotcal reprocess`` feeds the history: each measurement counts once, for the right table."""

import json
import shutil

import pytest

pytest.importorskip("sqlalchemy")
from fleet_bags import configuration_text, write_bag

from rotcal_history.database import ParkHistory


def setup(**identity):
    named = f"    identity: {json.dumps({'measured': '2026-03-31', **identity})}\n    cell:"
    return configuration_text().replace("    cell:", named, 1)


@pytest.fixture
def reprocess(warm, tmp_path):
    """Return what solves all bags with a set-up, and returns the answer and the valid entries."""

    def solved(text, *options):
        (tmp_path / "setup.yaml").write_text(text)
        asked = ("bags", "--setup", "setup.yaml", "-o", "out", "--workers", 1, "--json")
        ran = warm.run("rotcal", "reprocess", *asked, *options, folder=tmp_path)
        with ParkHistory(str(tmp_path / "out" / "history.db")) as history:
            valid = [entry for item in history.items() for entry in history.of_item(item)]
        return ran, valid

    return solved


def test_a_result_of_no_table_is_told_and_of_a_folder_if_asked(reprocess, tmp_path):
    bag = write_bag(tmp_path / "bags" / "T7" / "one", 1)
    ran, valid = reprocess(setup())
    assert (ran.returncode, valid) == (1, [])
    assert f"{bag}: not in the history" in ran.stderr
    assert "no serial number" in ran.stderr
    ran, (entry,) = reprocess(setup(), "--serial", "{folder}")
    assert ran.returncode == 0, ran.stderr
    assert (entry.title, entry.why) == ("T7/C", str(bag))
    (told,) = json.loads(ran.stdout)["bags"]
    assert (told["table"], told["entry"], told["error"]) == ("T7/C", entry.id, "")


def test_another_set_up_replaces_the_result_of_the_same_bag(reprocess, tmp_path):
    write_bag(tmp_path / "bags" / "one", 1)
    write_bag(tmp_path / "bags" / "two", 2)
    _, first = reprocess(setup(serial="T1"))
    assert [entry.title for entry in first] == ["T1/C", "T1/C"]
    _, again = reprocess(setup(serial="T1"))
    assert again == first
    ran, replaced = reprocess(setup(serial="T1", tolerance_arcsec=3.0))
    assert [entry.replaces for entry in replaced] == [entry.id for entry in first], ran.stderr
    assert all(entry.why.endswith(", solved again") for entry in replaced)


def test_of_a_recording_and_its_copies_the_one_with_most_observations_counts(reprocess, tmp_path):
    whole = write_bag(tmp_path / "bags" / "whole", 1, files=6)
    copy = tmp_path / "bags" / "copy"
    shutil.copytree(whole, copy)
    whole = whole.rename(tmp_path / "whole")
    (copy / "bag_5.mcap").unlink()
    _, (part,) = reprocess(setup(serial="T1"))
    shutil.move(whole, tmp_path / "bags")
    ran, (full,) = reprocess(setup(serial="T1"))
    assert full.replaces == part.id
    twins = {bag["source"].rpartition("/")[2]: bag for bag in json.loads(ran.stdout)["bags"]}
    assert twins["copy"]["twin_of"].endswith("whole")
    shutil.rmtree(tmp_path / "bags" / "whole")
    _, valid = reprocess(setup(serial="T1"))
    assert valid == [full]  # a damaged copy replaces nothing


def test_a_bag_that_names_its_table_is_of_that_one(reprocess, tmp_path, monkeypatch):
    import fleet_bags

    messages, _ = fleet_bags.recorded()
    recorded = setup(serial="T9", tolerance_arcsec=4.0).encode()
    monkeypatch.setattr(fleet_bags, "recorded", lambda: (messages, recorded))
    write_bag(tmp_path / "bags" / "one", 1)
    monkeypatch.undo()
    _, (entry,) = reprocess(setup(serial="T1"))
    assert entry.title == "T9/C"
