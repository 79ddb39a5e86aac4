"""Damaged sqlite3 files: told as what they are, all that SELECT reads saved, never changed.

``ROTCAL_FUZZ_SQLITE=5000 pytest test/bags/test_sqlite_fuzz.py`` tries as many seeds.
"""

from __future__ import annotations

import os
import shutil
import sqlite3
from collections import Counter
from contextlib import closing, suppress
from pathlib import Path

import pytest
from sqlite_mutations import mutate, payloads, write_bag

from rotcal_ros.bags.reader import check_files
from rotcal_ros.bags.repair import repair
from rotcal_ros.bags.verdict import FileVerdict
from rotcal_ros.foundation.errors import BagError

SEEDS = int(os.environ.get("ROTCAL_FUZZ_SQLITE", "60"))
N_MESSAGES = 150


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    path = tmp_path_factory.mktemp("sound") / "bag.db3"
    write_bag(path, payloads(N_MESSAGES))
    return path.read_bytes()


_ROW = (
    "SELECT data FROM messages WHERE id = ? AND typeof(timestamp) = 'integer'"
    " AND typeof(topic_id) = 'integer'"
)


def judged_by_sqlite(path: Path, scratch: Path) -> tuple[bool, Counter[bytes]]:
    """Return what sqlite3 itself says of a copy: sound or not, and all it reads row by row."""
    shutil.rmtree(scratch, ignore_errors=True)
    scratch.mkdir()
    for file in path.parent.glob(f"{path.name}*"):
        shutil.copy(file, scratch)
    rows: Counter[bytes] = Counter()
    with closing(sqlite3.connect(scratch / path.name)) as database:
        database.text_factory = bytes
        try:
            intact = database.execute("PRAGMA integrity_check").fetchall() == [(b"ok",)]
        except (sqlite3.Error, UnicodeDecodeError):
            intact = False
        for row_id in (*range(1, N_MESSAGES + 1), 2**63 - 1, -(2**63)):
            with suppress(sqlite3.Error, UnicodeDecodeError):
                found = database.execute(_ROW, (row_id,))
                rows.update(data for (data,) in found if isinstance(data, bytes))
    return intact, rows


def is_no_bag(path: Path) -> bool:
    """Tell whether a sound database lacks the tables of a bag."""
    with closing(sqlite3.connect(f"file:{path}?immutable=1", uri=True)) as database:
        try:
            database.execute("SELECT id, topic_id, timestamp, data FROM messages LIMIT 1")
            database.execute("SELECT id, name, type FROM topics")
        except (sqlite3.Error, UnicodeDecodeError):
            return True
        kinds = database.execute(
            "SELECT count(*) FROM sqlite_master WHERE type = 'table' AND sql NOT LIKE"
            " '%GENERATED%' AND name IN ('messages', 'topics')"
        ).fetchone()
    return kinds != (2,)


def checked(path: Path) -> tuple[FileVerdict | None, str]:
    """Return the verdict on a file, or with what words it is refused."""
    try:
        return check_files((path,))[0], ""
    except BagError as error:
        return None, str(error)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(SEEDS))
def test_every_damage_is_answered(seed: int, sound: bytes, tmp_path: Path) -> None:
    path = tmp_path / "bad" / "bag.db3"
    path.parent.mkdir()
    what = mutate(path, sound, seed)
    before = {file.name: file.read_bytes() for file in path.parent.iterdir()}
    intact, rows = judged_by_sqlite(path, tmp_path / "scratch")
    verdict, refusal = checked(path)
    if verdict is None:
        assert refusal.count("\n") == 0
        assert not rows or is_no_bag(path), f"{what}: {refusal}"
        with pytest.raises(BagError):
            repair(path, tmp_path / "good")
        return
    if verdict.state == "complete":
        assert intact, what
        assert verdict.messages == rows.total(), what
    assert verdict.messages >= rows.total(), what
    (after,) = repair(path, tmp_path / "good").after
    assert (after.state, after.messages) == ("complete", verdict.messages), what
    assert {file.name: file.read_bytes() for file in path.parent.iterdir()} == before, what
