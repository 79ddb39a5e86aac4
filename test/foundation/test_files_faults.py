"""What is written beside bags, with every call to the disk failing in its turn."""

import json
from pathlib import Path

import pytest
from faulty_disk import Fault, FaultyDisk, faults

from rotcal_ros.compensation.journal import Journal, JournalEntry
from rotcal_ros.compensation.writing import write_files
from rotcal_ros.foundation.errors import BagError, ControllerError
from rotcal_ros.foundation.files import DurableFile, append_line, write_atomically

OLD, NEW = "old\n" * 2000, "new\n" * 3000
REFUSALS = (OSError, BagError, ControllerError)


def replaced(folder: Path) -> None:
    write_atomically(folder / "state.json", NEW)


def noted(folder: Path) -> None:
    Journal(folder).note(JournalEntry("applied", 2, "b", "before-2", "00", "01"))


def exported(folder: Path) -> None:
    write_files({"a.txt": OLD, "b.txt": NEW}, folder / "new" / "tables")


def is_old_or_new(folder: Path, *, done: bool) -> None:
    text = (folder / "state.json").read_text()
    assert text == NEW if done else text in (OLD, NEW)


def is_a_journal(folder: Path, *, done: bool) -> None:
    entries = [entry.time_ns for entry in Journal(folder).entries()]
    assert entries == [1, 2] if done else entries in ([1], [1, 2])
    append_line(folder / "journal.jsonl", b'{"action": "restored", "time_ns": 3, "table_hash": '
                b'"", "backup": "", "before_hash": "01", "after_hash": "00"}\n')  # fmt: skip
    assert [entry.time_ns for entry in Journal(folder).entries()] == [*entries, 3]


def is_whole(folder: Path, *, done: bool) -> None:
    texts = {p.name: p.read_text() for p in (folder / "new" / "tables").glob("*.txt")}
    assert texts.items() <= {"a.txt": OLD, "b.txt": NEW}.items()
    assert len(texts) == 2 or not done


CASES = {"atomic": (replaced, is_old_or_new), "journal": (noted, is_a_journal),
         "export": (exported, is_whole)}  # fmt: skip


def attempt(work, root: Path, monkeypatch, fault: Fault | None = None):
    """Do the work on a disk that holds what was safe before; return the disk, and if it went."""
    root.mkdir()
    faulty = FaultyDisk(root)
    done = True
    with monkeypatch.context() as patch:
        faulty.install(patch)
        write_atomically(root / "state.json", OLD)
        append_line(root / "journal.jsonl", json.dumps(
            {"action": "applied", "time_ns": 1, "table_hash": "a", "backup": "before-1",
             "before_hash": "", "after_hash": ""}
        ).encode() + b"\n")  # fmt: skip
        faulty.calls.clear()
        faulty.fault = fault
        try:
            work(root)
        except REFUSALS:
            done = False
    assert not faulty.open
    return faulty, done


@pytest.mark.parametrize("case", CASES)
def test_whichever_call_fails_there_is_the_old_or_the_new_and_no_lie(case, tmp_path, monkeypatch):
    work, check = CASES[case]
    sound, done = attempt(work, tmp_path / "sound", monkeypatch)
    assert done
    possible = faults(sound.calls)
    assert len(possible) > 20
    for number, fault in enumerate(possible):
        faulty, done = attempt(work, tmp_path / str(number), monkeypatch, fault)
        assert faulty.hit
        for seed in (None, -1, number):
            left = tmp_path / f"left_{number}_{seed}"
            left.mkdir()
            faulty.power_cut(left, seed)
            check(left, done=done)
        check(tmp_path / str(number), done=done)


def test_after_one_failed_sync_no_later_one_is_believed(tmp_path, monkeypatch):
    faulty = FaultyDisk(tmp_path, Fault("error", 2))
    faulty.install(monkeypatch)
    file = DurableFile(tmp_path / "bag")
    file.write(b"confirmed")
    for _ in range(3):
        with pytest.raises(OSError, match="Input/output"):
            file.sync()
    file.close()
    assert faulty.calls == ["create", "write", "sync", "close"]


def test_a_failed_export_names_what_it_could_not_take_away(tmp_path, monkeypatch):
    sound, _ = attempt(exported, tmp_path / "sound", monkeypatch)
    second_link = [n for n, call in enumerate(sound.calls) if call == "link"][1]
    root = tmp_path / "failing"
    faulty = FaultyDisk(root, Fault("error", second_link, lasting=True))
    root.mkdir()
    faulty.install(monkeypatch)
    with pytest.raises(BagError, match=r"tables/a\.txt must be removed by hand"):
        exported(root)
