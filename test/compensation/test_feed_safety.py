"""Trying to fool the feed: other files than those looked at, planted links, nonsense in tables."""

import os
from dataclasses import replace

import numpy as np
import pytest
from compensation_examples import d4_table, even
from test_feed import COMP, SECOND, Cell, applied, table_of, trims, undone

from rotcal_ros.compensation.controller_store import STATE_FOLDER
from rotcal_ros.compensation.feed import write_steps
from rotcal_ros.compensation.table import CompensationTable
from rotcal_ros.foundation.errors import ControllerError, DataError

INI = "c_linuxcnc.ini"


@pytest.fixture
def cell(tmp_path):
    return Cell(tmp_path)


# What is confirmed.


def test_other_options_are_another_confirmation_in_a_folder_of_its_own(cell):
    table = table_of()
    first = cell.feed()
    paths = first.take(table, 1)
    for changes in (
        {"spacing_deg": 30.0},
        {"reference_deg": 90.0},
        {"options": ("file_type=0",)},
        {"options": ("feed_deg_s=10.0",)},  # the files are the same, the options are not
        {"controller": "csv"},
    ):
        other = cell.feed(**changes)
        found = other.take(table, 1)
        assert other.offer.confirmation != first.offer.confirmation
        assert found[0].parent != paths[0].parent
        assert dict(other.offer.files) == {path.name: path.read_text() for path in found}
        with pytest.raises(DataError, match=other.offer.confirmation):
            other.apply(first.offer.confirmation)
    assert cell.files() == {}


def test_the_same_again_has_the_same_confirmation_whenever_it_comes(cell):
    first, second = cell.feed(), cell.feed(output_folder="")
    first.take(table_of(), 1)
    cell.clock.ns += 3600 * SECOND
    second.take(table_of(), 5)
    assert first.offer.confirmation == second.offer.confirmation
    assert len(first.offer.confirmation) == 64


def test_the_table_hash_is_no_confirmation(cell):
    feed = cell.feed()
    table = table_of()
    feed.take(table, 1)
    with pytest.raises(DataError, match="confirm this hash"):
        feed.apply(table.table_hash)


def test_what_is_applied_is_what_lies_in_the_folder_to_the_last_byte(cell):
    """The provenance too, whose time is that of the first writing."""
    paths = cell.feed().take(table_of(), 1)
    cell.clock.ns += 3600 * SECOND
    applied(cell.feed(), table_of())
    assert cell.files() == {path.name: path.read_bytes() for path in paths}


@pytest.mark.parametrize("name", [COMP, INI, "c_linuxcnc.provenance.json", "old_table.comp"])
def test_a_folder_that_holds_anything_else_is_refused(cell, name):
    first = cell.feed()
    folder = first.take(table_of(), 1)[0].parent
    old = (folder / name).read_text() if (folder / name).exists() else ""
    (folder / name).write_text(old.replace("1", "2") + " ")
    with pytest.raises(DataError, match=f"does not hold exactly the files.*{name}"):
        cell.feed().take(table_of(), 2)
    if old:
        with pytest.raises(DataError, match=f"{name} was changed since it was written"):
            first.apply(first.offer.confirmation)
    assert cell.files() == {}


def test_a_link_among_the_files_that_are_looked_at_is_refused(cell, tmp_path):
    feed = cell.feed()
    paths = {path.name: path for path in feed.take(table_of(), 1)}
    same = tmp_path / "same"
    same.write_bytes(paths[COMP].read_bytes())
    paths[COMP].unlink()
    paths[COMP].symlink_to(same)
    with pytest.raises(DataError, match=f"{COMP} was changed"):
        feed.apply(feed.offer.confirmation)


# Tables that cannot be believed.


def test_no_other_table_has_the_same_hash():
    """Two rows; what one calls uncertainties of the way back the other calls its angles."""
    numbers = np.array([0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0])
    common = {"axis": "C", "method": "m", "period": 0.0, "reference_angle": 0.0, "verdict": "ok"}
    names = ("angles", "correction_forward", "correction_reverse", "std")
    first = dict(zip((*names, "std_reverse"), numbers.reshape(5, 2), strict=True))
    second = dict(zip(names, numbers[2:].reshape(4, 2), strict=True))
    second |= {"between_std": numbers[0], "widest_gap": numbers[1]}
    hashes = {CompensationTable(**common, **fields).table_hash for fields in (first, second)}
    assert len(hashes) == 2


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"period": np.nan}, "period nan rad, expected 2 pi or 0"),
        ({"reference_angle": np.nan}, "reference angle nan, expected a number"),
        ({"reference_angle": np.inf}, "reference angle inf"),
        ({"std_reverse": np.array([0.0, 0.0, 0.0, -1.0])}, "std_reverse in row 3 is -1.0"),
        ({"std": np.array([0.0, 0.0, -1e-9, 0.0])}, "std in row 2 is -1e-09, expected 0 or more"),
    ],
)
def test_a_table_of_nonsense_is_no_table(changes, words):
    with pytest.raises(DataError, match=words):
        replace(d4_table(), **changes)


@pytest.mark.parametrize(("factor", "refused"), [(2.99, False), (3.01, True), (1e9, True)])
def test_an_uncertainty_far_above_the_correction_is_refused(cell, factor, refused):
    table = table_of()
    largest = np.max(np.abs(table.correction_forward))
    doubtful = replace(table, std=np.where(even(24) == 0.0, factor * largest, table.std))
    if not refused:
        assert cell.feed().take(doubtful, 1)
        return
    with pytest.raises(DataError, match="more than 3 times its largest correction"):
        cell.feed().take(doubtful, 1)
    assert not cell.output.exists()


@pytest.mark.parametrize(("ahead_s", "refused"), [(0.9, False), (1.1, True), (1e9, True)])
def test_a_stamp_in_the_future_is_refused(cell, ahead_s, refused):
    feed = cell.feed()
    stamp_ns = cell.clock.ns + SECOND + round(ahead_s * SECOND)  # the clock's next second
    if not refused:
        assert feed.take(table_of(), stamp_ns)
        return
    with pytest.raises(DataError, match=r"stamped .* s in the future"):
        feed.take(table_of(), stamp_ns)
    assert feed.offer is None


# Links and half tables in the controller's folder.


def test_a_planted_link_is_not_followed(cell, tmp_path):
    victim = tmp_path / "victim"
    victim.write_text("precious")
    for name in (f"{COMP}.tmp", f"{INI}.tmp", f".{COMP}.tmp"):
        (cell.folder / name).symlink_to(victim)
    applied(cell.feed(), table_of())
    assert victim.read_text() == "precious"
    assert trims(cell).shape == (25,)


@pytest.mark.parametrize("kind", ["link", "dangling", "hard", "pipe", "folder"])
@pytest.mark.parametrize("name", [COMP, INI])
def test_a_controller_file_that_is_no_plain_file_is_left_as_it_is(cell, tmp_path, kind, name):
    applied(feed := cell.feed(), table_of())
    path, target = cell.folder / name, tmp_path / "target"
    path.rename(target)
    if kind == "link":
        path.symlink_to(target)
    elif kind == "dangling":
        path.symlink_to(tmp_path / "gone")
    elif kind == "hard":
        os.link(target, path)
    elif kind == "pipe":
        os.mkfifo(path)
    else:
        path.mkdir()
    before, status = target.read_bytes(), path.lstat()
    for change in (lambda: applied(feed, table_of(1.5)), lambda: undone(feed)):
        with pytest.raises(ControllerError, match=rf"{name} (is a link|is not a|has 2 names)"):
            change()
    assert target.read_bytes() == before
    assert (path.lstat().st_ino, path.lstat().st_mode) == (status.st_ino, status.st_mode)


@pytest.mark.parametrize("name", ["lock", "journal.jsonl", ""])
def test_links_in_the_place_of_our_own_files_are_not_followed(cell, tmp_path, name):
    victim = tmp_path / "victim"
    if name:
        victim.write_text("precious")
        (cell.folder / STATE_FOLDER).mkdir()
    else:
        victim.mkdir()
    (cell.folder / STATE_FOLDER / name).symlink_to(victim)
    with pytest.raises(ControllerError):
        applied(cell.feed(), table_of())
    assert (list(victim.iterdir()) == []) if not name else (victim.read_text() == "precious")
    assert cell.files() == {}


def kind_of(ini):
    return int(ini.rpartition("=")[2])


@pytest.mark.parametrize("crash", range(1, 8))
def test_rows_are_never_read_by_the_rule_of_another_table(cell, monkeypatch, crash):
    """The bridge dies at any system call that changes a name; trims are below a degree."""
    applied(first := cell.feed(), table_of())
    first.close()
    old = cell.files()
    feed = cell.feed(options=("file_type=0",))
    feed.take(table_of(), feed._now_ns())
    left = crash

    def dying(real):
        def call(*arguments, **named):
            nonlocal left
            if cell.folder in (getattr(a, "parent", None) for a in arguments[:2]):
                left -= 1
                if left == 0:
                    raise KeyboardInterrupt
            return real(*arguments, **named)

        return call

    with monkeypatch.context() as patch:
        for name in ("unlink", "replace"):
            patch.setattr(f"pathlib.Path.{name}", dying(getattr(type(cell.folder), name)))
        try:
            feed.apply(feed.offer.confirmation)
        except KeyboardInterrupt:
            assert left == 0
    feed.close()
    found = cell.files()
    if COMP in found:
        rows = np.loadtxt(cell.folder / COMP)
        actual_angles = np.max(np.abs(rows[:, 1])) > 1.0
        assert actual_angles == (kind_of(found[INI].decode()) == 0)
    if left == 0:
        again = cell.feed(options=("file_type=0",))
        assert "was never finished" in again.open()
        undone(again)
        assert cell.files() == old


def test_the_table_is_away_while_the_way_it_is_read_changes():
    held = {"t": "1", "how": "a", "t.provenance.json": "x"}
    wanted = {"t": "2", "how": "a", "t.provenance.json": "y"}
    assert write_steps(held, held) == []
    assert write_steps(held, wanted) == [{"t": "2", "t.provenance.json": "y"}]
    both = {**wanted, "how": "b"}
    rest = {"how": "b", "t.provenance.json": "y"}
    assert write_steps(held, both) == [{"t": None}, rest, {"t": "2"}]
    same_rows = {**held, "how": "b"}
    assert write_steps(held, same_rows) == [{"t": None}, {"how": "b"}, {"t": "1"}]
    assert write_steps({}, both) == [rest, {"t": "2"}]
    none = dict.fromkeys(held)
    assert write_steps(held, none) == [{"t": None}, {"how": None, "t.provenance.json": None}]
