"""A file is replaced as a whole or not at all, and is on the medium before it gets its name."""

import errno
import os

import pytest

from rotcal_ros.foundation import disk
from rotcal_ros.foundation.files import (
    append_line,
    replace_atomically,
    write_atomically,
    write_durably,
)


@pytest.mark.parametrize("old", [None, b"old"])
def test_a_write_that_fails_leaves_what_was_there(tmp_path, old):
    path = tmp_path / "table"
    if old is not None:
        path.write_bytes(old)

    def fail(temporary):
        temporary.write_bytes(b"half")
        raise OSError("the disk is full")

    with pytest.raises(OSError, match="full"):
        replace_atomically(path, fail)
    assert {p.name: p.read_bytes() for p in tmp_path.iterdir()} == (
        {} if old is None else {"table": old}
    )


def test_the_content_is_synced_under_its_temporary_name(tmp_path, monkeypatch):
    path, synced, real = tmp_path / "table", [], os.fsync

    def note(descriptor):
        synced.append((os.fstat(descriptor).st_ino, path.exists()))
        real(descriptor)

    monkeypatch.setattr(os, "fsync", note)
    replace_atomically(path, lambda temporary: temporary.write_bytes(b"new"))
    assert path.read_bytes() == b"new"
    inodes = [p.stat().st_ino for p in (path, tmp_path)]
    assert synced == [(inodes[0], False), (inodes[1], True)]


@pytest.mark.parametrize("write", [
    lambda path: write_atomically(path, "text"),
    lambda path: write_durably(path, "text"),
    lambda path: append_line(path, b"line\n"),
    lambda path: replace_atomically(path, _full),
])  # fmt: skip
def test_a_full_disk_names_the_file(tmp_path, monkeypatch, write):
    monkeypatch.setattr(disk, "write", _full)
    with pytest.raises(OSError, match="No space left on device") as raised:
        write(tmp_path / "result.json")
    assert raised.value.filename == str(tmp_path / "result.json")


def _full(*_):
    raise OSError(errno.ENOSPC, "No space left on device")
