"""Taking back, what was left unfinished, machines at work, and the secret of those who may."""

import json
import os
import sys

import numpy as np
import pytest
from test_feed import COMP, Cell, applied, table_of, trims, undone

from rotcal_ros.compensation.controller_store import STATE_FOLDER, ControllerFolder
from rotcal_ros.compensation.secret import Secret
from rotcal_ros.foundation.errors import ConfigurationError, ControllerError, DataError
from rotcal_ros.foundation.units import ARCSEC


@pytest.fixture
def cell(tmp_path):
    return Cell(tmp_path)


def test_restore_wants_the_hash_of_what_it_brings_back(cell):
    feed = cell.feed()
    applied(feed, table_of())
    applied(feed, table_of(1.2))
    held = cell.files()
    undo = feed.next_restore()
    for wrong in ("", "0" * 64, feed.offer.confirmation):
        with pytest.raises(DataError, match=f"nothing with the hash .* is undone by {undo}"):
            feed.restore(wrong)
    assert cell.files() == held


def test_a_table_edited_by_hand_is_kept_and_comes_back(cell):
    feed = cell.feed()
    applied(feed, table_of())
    mine = "\n".join(f"{15 * k} 0.001 0.002" for k in range(25)) + "\n"
    (cell.folder / COMP).write_text(mine)
    edited = cell.files()
    done = undone(feed)
    assert json.loads((done.backup / "contents.json").read_text())[COMP] == mine
    assert cell.files() == {}
    by_hand = json.loads(
        (cell.folder / STATE_FOLDER / "journal.jsonl").read_text().splitlines()[-1]
    )
    feed.restore(by_hand["before_hash"])
    assert cell.files() == edited
    undone(feed)
    assert cell.files() == {}


def test_any_state_that_was_kept_can_be_brought_back_and_undone(cell):
    """Three tables; back to the first at once, forward to the third, and back again."""
    feed = cell.feed()
    states = [cell.files()]
    for scale in (1.0, 1.1, 1.2):
        applied(feed, table_of(scale))
        states.append(cell.files())
    hashes = [e.before_hash for e in feed._journal.entries() if e.action == "applying"]
    feed.restore(hashes[1])
    assert cell.files() == states[1]
    newest = feed._journal.entries()[-1]
    assert newest.table_hash == table_of(1.0).table_hash
    assert feed.next_restore() == hashes[0]
    feed.restore(newest.before_hash)
    assert cell.files() == states[3]
    undone(feed)
    assert cell.files() == states[1]
    undone(feed)
    assert cell.files() == states[0]


def test_restore_keeps_to_the_limit_unless_a_larger_one_is_given(cell):
    first = cell.feed()
    applied(first, table_of())
    first.close()
    feed = cell.feed(max_change_arcsec=5.0)
    held = cell.files()
    for limit in (0.0, 10.0, -1.0, np.nan):
        with pytest.raises(DataError, match=r"by up to 1\d\.\d+ arcsec, max_change_arcsec is"):
            undone(feed, max_change_arcsec=limit)
    assert cell.files() == held
    assert undone(feed, max_change_arcsec=20.0).largest_change > 10.0 * ARCSEC


def test_a_backup_that_was_tampered_with_is_not_brought_back(cell):
    feed = cell.feed()
    applied(feed, table_of())
    done = applied(feed, table_of(1.2))
    held = cell.files()
    contents = done.backup / "contents.json"
    contents.write_text(contents.read_text().replace("1", "2"))
    with pytest.raises(ControllerError, match="is not what was kept there"):
        undone(feed)
    assert cell.files() == held


def test_a_failed_restore_puts_back_what_was_there(cell):
    class Damaging(ControllerFolder):
        left = 0

        def _write(self, files):
            if self.left:
                self.left -= 1
                files = {n: t and t.replace("1", "2") for n, t in files.items()}
            super()._write(files)

    store = Damaging(cell.folder, 20.0)
    feed = cell.feed(store)
    applied(feed, table_of())
    applied(feed, table_of(1.2))
    held = cell.files()
    store.left = 1
    with pytest.raises(ControllerError, match=r"differ from what was written; the old table was"):
        undone(feed)
    assert cell.files() == held
    assert feed.unfinished() is None
    undone(feed)
    wanted = np.rad2deg(table_of().correction_forward)
    np.testing.assert_allclose(trims(cell)[:-1], wanted, atol=2e-9)


# Unfinished changes, the lock, and machines at work.


@pytest.mark.parametrize(("half", "found"), [(False, "the old files"), (True, "neither all old")])
def test_an_unfinished_change_is_named_at_the_start_and_has_to_be_undone(
    cell, monkeypatch, half, found
):
    feed = cell.feed()
    applied(feed, table_of())
    assert feed.open() is None
    held, undo = cell.files(), feed._journal.entries()[-1].after_hash

    def crash(_files):
        if half:
            (cell.folder / COMP).write_text("half")
        raise KeyboardInterrupt

    monkeypatch.setattr(feed._store, "write", crash)
    table = table_of(1.2)
    with pytest.raises(KeyboardInterrupt):
        applied(feed, table)
    feed.close()
    again = cell.feed()
    words = again.open()
    assert words.startswith(f"applying table {table.table_hash[:12]}, begun at 2023-11-14T22:13:")
    assert f"the controller holds {found}" in words
    assert undo in words
    with pytest.raises(DataError, match=f"{undo}.*was never finished"):
        again.restore("")
    with pytest.raises(ControllerError, match="was never finished"):
        applied(again, table)
    done = again.restore(undo)
    assert done.unfinished == words
    assert cell.files() == held
    assert again.open() is None


def test_a_clock_that_was_set_back_is_noticed(cell):
    """Else a table that was measured before the restore would seem to be younger."""
    feed = cell.feed()
    applied(feed, table_of())
    held, now_ns = cell.files(), cell.clock.ns
    cell.clock.ns -= 3600 * 10**9
    for change in (lambda: applied(feed, table_of(1.2)), lambda: undone(feed)):
        with pytest.raises(ControllerError, match="the clock is behind the last change"):
            change()
    assert cell.files() == held
    cell.clock.ns = now_ns
    undone(feed)


def test_a_lock_whose_folder_was_exchanged_is_taken_anew(cell):
    first, second = cell.feed(), cell.feed()
    applied(first, table_of())
    cell.folder.rename(cell.folder.with_name("away"))
    cell.folder.mkdir()
    second.open()
    with pytest.raises(ControllerError, match="fed by process"):
        applied(first, table_of())
    assert cell.files() == {}


def asking(text):
    return (sys.executable, "-c", text)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("command", "words"),
    [
        (asking("print('spindle turns'); exit(1)"), "the machine is at work: spindle turns"),
        (asking("exit(1)"), "the machine is at work: .* says so"),
        (asking("exit(3)"), "not known whether the machine is at work .* ended with code 3"),
        (("/no/such/program",), "not known whether the machine is at work .*No such file"),
        (asking("import time; time.sleep(99)"), "not known whether .* timed out"),
    ],
)
def test_nothing_is_changed_while_the_machine_is_at_work(cell, command, words):
    feed = cell.feed()
    applied(feed, table_of())
    feed.close()
    held, entries = cell.files(), feed._journal.entries()
    patience_s = 2.0 if "sleep" in command[-1] else 60.0
    feed = cell.feed(busy_command=command, answer_timeout_s=patience_s)
    for change in (lambda: applied(feed, table_of(1.2)), lambda: undone(feed)):
        with pytest.raises(ControllerError, match=words):
            change()
    assert (cell.files(), feed._journal.entries()) == (held, entries)
    feed.close()
    applied(cell.feed(busy_command=asking("exit(0)"), answer_timeout_s=60.0), table_of(1.2))
    assert cell.files() != held


def test_a_store_that_can_tell_is_asked(cell):
    class Turning(ControllerFolder):
        def busy(self):
            return "axis C turns"

    with pytest.raises(ControllerError, match="the machine is at work: axis C turns"):
        applied(cell.feed(Turning(cell.folder, 20.0)), table_of())
    assert cell.files() == {}


# The secret.


def secret_file(tmp_path, text="0123456789abcdef\n", mode=0o600):
    path = tmp_path / "secret"
    path.write_text(text)
    path.chmod(mode)
    return path


def test_the_secret_is_the_whole_secret(tmp_path):
    secret = Secret(secret_file(tmp_path))
    assert secret.is_in("0123456789abcdef")
    assert secret.is_in("0123456789abcdef\n")
    for wrong in ("", "0123456789abcde", "0123456789abcdefg", "0123456789ABCDEF", "\udcff\u20ac"):
        assert not secret.is_in(wrong)
    assert "0123456789abcdef" not in f"{secret!r} {secret} {vars(Secret)}"


def test_a_secret_that_others_could_know_is_refused(tmp_path):
    for mode in (0o640, 0o604, 0o620, 0o602):
        with pytest.raises(ConfigurationError, match=rf"mode {mode:03o}.*chmod 600"):
            Secret(secret_file(tmp_path, mode=mode))
    with pytest.raises(ConfigurationError, match="has 15 bytes, expected at least 16"):
        Secret(secret_file(tmp_path, " 0123456789abcde \n"))
    link = tmp_path / "link"
    link.symlink_to(secret_file(tmp_path))
    for path in (link, tmp_path / "gone"):
        with pytest.raises(ConfigurationError, match="cannot be read"):
            Secret(path)
    os.mkfifo(tmp_path / "pipe", 0o600)
    for path in (tmp_path, tmp_path / "pipe"):
        with pytest.raises(ConfigurationError, match=r"is not a plain file|cannot be read"):
            Secret(path)
