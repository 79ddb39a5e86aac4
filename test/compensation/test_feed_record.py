"""What the feed writes down, what it gives to the export, and its limits."""

import hashlib
import json
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
from compensation_examples import even, result_of, wavy
from test_feed import COMP, SECOND, Cell, applied, made_before, table_of, undone

from rotcal_ros.compensation.controller_store import STATE_FOLDER, ControllerFolder
from rotcal_ros.compensation.feed import Feed
from rotcal_ros.compensation.journal import Journal, JournalEntry
from rotcal_ros.compensation.table import table_from_result
from rotcal_ros.foundation.errors import ControllerError, DataError
from rotcal_ros.foundation.units import ARCSEC, DEGREE


@pytest.fixture
def cell(tmp_path):
    return Cell(tmp_path)


def journal_of(cell):
    lines = (cell.folder / STATE_FOLDER / "journal.jsonl").read_text().splitlines()
    return [json.loads(line) for line in lines]


def hash_of(contents):
    """SHA-256 of names and texts as JSON with sorted keys: docs/feed.md."""
    return hashlib.sha256(json.dumps(contents, sort_keys=True).encode()).hexdigest()


def test_every_event_is_noted_with_its_time(cell):
    """docs/feed.md: .rotcal/before-TIME holds the old files, .rotcal/journal.jsonl the events."""
    feed = cell.feed()
    table = table_of()
    feed.take(table, cell.clock())
    start = cell.clock.ns + SECOND  # the age of the measurement is asked first
    done = feed.apply(feed.offer.confirmation)
    first, second = start + SECOND, start + 2 * SECOND
    backup = f"before-{first}"
    names = (COMP, "c_linuxcnc.ini", "c_linuxcnc.provenance.json")
    assert done.files == tuple(str(cell.folder / name) for name in names)
    assert done.backup == cell.folder / STATE_FOLDER / backup
    texts = {name: (cell.folder / name).read_text() for name in names}
    back = undone(feed)
    assert back.files == ()
    assert back.largest_change == pytest.approx(done.largest_change)
    both = {"after_hash": hash_of(texts), "before_hash": hash_of(dict.fromkeys(texts))}
    same = {"table_hash": table.table_hash, "backup": backup, **both}
    third = second + SECOND
    undoing = {"before_hash": both["after_hash"], "after_hash": both["before_hash"]}
    undoing |= {"table_hash": "", "backup": f"before-{third}"}
    assert journal_of(cell) == [
        {"action": "applying", "time_ns": first, **same, "in_force": ""},
        {
            "action": "applied",
            "time_ns": second,
            **same,
            "in_force": hash_of({n: texts[n] for n in names[:2]}),
        },
        {"action": "restoring", "time_ns": third, **undoing, "in_force": ""},
        {"action": "restored", "time_ns": third + SECOND, **undoing, "in_force": "none"},
    ]
    assert back.backup == cell.folder / STATE_FOLDER / f"before-{third}"
    assert json.loads((back.backup / "contents.json").read_text()) == texts
    kept = json.loads((done.backup / "contents.json").read_text())
    assert kept == dict.fromkeys(names)


def test_what_was_put_back_is_noted_and_told(cell):
    feed = cell.feed()
    applied(feed, table_of())
    applied(feed, table_of(1.5))
    back = undone(feed)
    assert {Path(path).name for path in back.files} == set(cell.files())
    largest = np.max(np.abs(wavy(even(24)) - wavy(0.0)))
    assert back.largest_change == pytest.approx(0.5 * largest, rel=1e-6)


def test_a_failed_write_is_rolled_back_and_noted(cell):
    class Damaging(ControllerFolder):
        left = 2

        def _write(self, files):
            if self.left:
                self.left -= 1
                files = {name: f"{text}1" for name, text in files.items()}
            super()._write(files)

    feed = cell.feed(Damaging(cell.folder, 20.0))
    with pytest.raises(ControllerError, match=rf"the controller's {COMP}, c_linuxcnc\.ini, c_lin"):
        applied(feed, table_of())
    actions = [entry["action"] for entry in journal_of(cell)]
    assert actions == ["applying", "rolled_back"]
    assert journal_of(cell)[1]["time_ns"] == journal_of(cell)[0]["time_ns"] + SECOND
    with pytest.raises(DataError, match="no table was applied here"):
        undone(feed)


def test_where_nothing_was_written_nothing_is_said_to_be_put_back(cell):
    class Deaf(ControllerFolder):
        def _write(self, files):
            pass

    feed = cell.feed()
    applied(feed, table_of())
    feed.close()
    before = cell.files()
    deaf = cell.feed(Deaf(cell.folder, 20.0))
    with pytest.raises(ControllerError, match="holds what it held before, nothing had to be put"):
        applied(deaf, table_of(1.5))
    assert cell.files() == before
    assert [entry["action"] for entry in journal_of(cell)][-1] == "rolled_back"


def test_a_half_written_table_has_no_change_to_tell(cell):
    feed = cell.feed()
    applied(feed, table_of())
    (cell.folder / COMP).write_text("half")
    with pytest.raises(ControllerError, match="to restore nevertheless, give max_change_arcsec"):
        undone(feed)
    assert np.isnan(undone(feed, max_change_arcsec=20.0).largest_change)


@pytest.mark.parametrize(("later_s", "stale"), [(-1, True), (0, True), (1, False)])
def test_a_table_has_to_be_younger_than_the_last_restore(cell, later_s, stale):
    feed = cell.feed()
    applied(feed, table_of())
    undone(feed)
    table = table_of(1.5)
    feed.take(table, journal_of(cell)[-1]["time_ns"] + later_s * SECOND)
    if not stale:
        assert feed.apply(feed.offer.confirmation).files
        return
    words = f"the table is stale: it was made {-later_s} s before the controller's old table was"
    with pytest.raises(DataError, match=words):
        feed.apply(feed.offer.confirmation)


def test_the_settings_reach_the_export(cell):
    """LinuxCNC type 0 for two turns, a row every 30 degrees, zero at 90."""
    feed = cell.feed(spacing_deg=30.0, reference_deg=90.0, options=("turns=2", "file_type=0"))
    table = table_of()
    paths = {path.name: path for path in feed.take(table, 1)}
    rows = np.loadtxt(paths[COMP])
    np.testing.assert_allclose(rows[:, 0], np.arange(25) * 30.0)
    actual = rows[:, 1] - rows[:, 0]
    expected = np.rad2deg(wavy(rows[:, 0] * DEGREE) - wavy(np.pi / 2))
    np.testing.assert_allclose(actual, expected, atol=2e-9)
    side = json.loads(paths["c_linuxcnc.provenance.json"].read_text())
    assert side["settings"]["turns"] == 2
    assert side["reference_angle_deg"] == pytest.approx(90.0)
    assert side["written"] == "2023-11-14T22:13:21+00:00"  # 1.7e9 s after 1970 and one more
    folder = paths[COMP].parent
    assert folder == cell.output / f"c-{feed.offer.confirmation}"
    assert side["confirmation_sha256"] == feed.offer.confirmation
    assert feed.offer.stamp_ns == 1
    assert feed.offer.table is table
    assert dict(feed.offer.files) == {n: p.read_text() for n, p in paths.items()}


def test_a_table_has_its_own_reference_unless_told_otherwise(cell):
    result = replace(result_of(even(24), wavy(even(24))), measured_on="none")
    table = made_before(table_from_result(result, reference_angle=2.0, axis="C"))
    feed = cell.feed()
    feed.take(table, 1)
    assert feed.offer.export.table.reference_angle == 2.0


def test_without_an_output_folder_nothing_is_written_for_people(cell):
    feed = cell.feed(output_folder="")
    assert feed.take(table_of(), 1) == ()
    assert feed.offer is not None
    assert not cell.output.exists()


def test_a_table_that_was_written_before_is_not_written_again(cell):
    """An empty folder of that name is filled."""
    (first,) = {path.parent for path in cell.feed().take(table_of(), 1)}
    for path in first.iterdir():
        path.unlink()
    paths = cell.feed().take(table_of(), 1)
    assert [path.parent for path in paths] == [first] * 3
    times = [path.stat().st_mtime_ns for path in paths]
    assert cell.feed().take(table_of(), 2) == paths
    assert [path.stat().st_mtime_ns for path in paths] == times


@pytest.mark.parametrize(("share", "refused"), [(1.001, False), (0.999, True)])
def test_the_largest_change_is_held_against_the_limit(cell, share, refused):
    """A table of 8 arcsec between its rows: between 3 and 4 of 12 rows the spline is highest."""
    largest = np.max(np.abs(wavy(even(24)) - wavy(0.0))) / ARCSEC
    feed = cell.feed(max_change_arcsec=share * largest)
    if refused:
        words = rf"by up to {largest:.4g} arcsec, max_change_arcsec is {share * largest:.4g}: look"
        with pytest.raises(DataError, match=words):
            applied(feed, table_of())
        return
    assert applied(feed, table_of()).largest_change / ARCSEC == pytest.approx(largest, rel=1e-6)


def arc_table(scale=1.0):
    """An arc 705 .. 795 degrees, 100 arcsec high at 750: outside of LinuxCNC's first turn."""
    angles = np.deg2rad(np.arange(705.0, 796.0, 15.0))
    bump = np.where(np.isclose(angles, np.deg2rad(750.0)), 100.0 * ARCSEC * scale, 0.0)
    table = table_from_result(replace(result_of(angles, bump), measured_on="none"))
    return made_before(table)


def test_the_change_of_an_arc_is_sought_where_the_arc_is(cell):
    feed = cell.feed(spacing_deg=15.0, max_change_arcsec=120.0)
    table = arc_table()
    assert table.period == 0.0
    first = applied(feed, table)
    assert first.largest_change / ARCSEC == pytest.approx(100.0, rel=1e-3)
    assert applied(feed, arc_table(1.25)).largest_change / ARCSEC == pytest.approx(25.0, rel=1e-3)
    feed.close()
    wide = cell.feed(spacing_deg=45.0, max_change_arcsec=130.0)  # no row at 750 degrees
    done = applied(wide, arc_table(0.01))
    assert done.largest_change / ARCSEC == pytest.approx(124.0, rel=0.01)


def test_the_change_of_a_turn_is_sought_in_every_turn_of_the_travel(cell):
    """The old table covers one turn, the new one two: in the second all of it is new."""
    feed = cell.feed()
    first = applied(feed, table_of())
    feed.close()
    two = cell.feed(options=("turns=2",))
    assert applied(two, table_of()).largest_change == pytest.approx(first.largest_change, rel=1e-6)
    two.close()
    assert applied(cell.feed(options=("turns=2",)), table_of()).largest_change < 1e-12


def test_a_feed_keeps_to_the_folder_and_the_patience_of_its_settings(cell):
    feed = Feed(cell.settings, "C", cell.clock)
    assert feed._store.folder == cell.folder
    assert feed._store._timeout_s == cell.settings.answer_timeout_s
    assert (feed.axis, feed.offer) == ("C", None)


# The journal.

ENTRY = JournalEntry("applying", 5, "ab", "before-5", "00", "01")


def test_entries_come_back_in_their_order(tmp_path):
    journal = Journal(tmp_path)
    assert journal.entries() == []
    assert journal.last_restore_ns() == 0
    assert journal.last_undoable() is None
    written = [replace(ENTRY, time_ns=k, backup=f"b{k}") for k in range(3)]
    for entry in written:
        journal.note(entry)
    assert journal.entries() == written
    text = (tmp_path / "journal.jsonl").read_text()
    assert [json.loads(line) for line in text.splitlines()] == [asdict(e) for e in written]
    assert text.endswith("}\n")


@pytest.mark.parametrize("cut", ['{"action"', "x"])
def test_a_line_that_was_cut_off_never_happened_and_is_taken_away(tmp_path, cut):
    journal = Journal(tmp_path)
    journal.note(ENTRY)
    path = tmp_path / "journal.jsonl"
    path.write_text(path.read_text() + cut)
    assert journal.entries() == [ENTRY]
    journal.note(replace(ENTRY, time_ns=6))
    assert journal.entries() == [ENTRY, replace(ENTRY, time_ns=6)]
    path.write_text(cut)
    journal.note(ENTRY)
    assert path.read_text() == json.dumps(asdict(ENTRY)) + "\n"


@pytest.mark.parametrize("line", ["nonsense", "{}", '{"action": "applying", "time": 1}', "[]"])
def test_a_line_that_is_no_event_is_damage(tmp_path, line):
    (tmp_path / "journal.jsonl").write_text(line + "\n")
    with pytest.raises(ControllerError, match=r"journal\.jsonl is damaged: .* move the file away"):
        Journal(tmp_path).entries()


def test_a_journal_that_cannot_be_written_is_told(tmp_path):
    journal = Journal(tmp_path / "gone")
    words = r"cannot note 'applying' in .*gone/journal\.jsonl: No such file"
    with pytest.raises(ControllerError, match=words):
        journal.note(ENTRY)


@pytest.mark.parametrize(
    ("events", "undo", "restored_ns"),
    [
        ("A1 a2", "A1", 0),
        ("A1", "A1", 0),
        ("A1 a2 A3 a4", "A3", 0),
        ("A1 a2 A3 r4", "A1", 0),
        ("A1 a2 A3 a4 B5 R6", "A1", 6),
        ("A1 a2 A3 a4 B5 R6 B7 R8", None, 8),
        ("A1 r2", None, 0),
        ("A1 a2 B5", "B5", 0),
        ("A1 a2 B5 r6", "A1", 0),
        ("A1 a2 B5 R6 A7 a8", "A7", 6),
    ],
)
def test_what_is_undone_next(tmp_path, events, undo, restored_ns):
    """A: applying, a: applied, r: rolled back, B: restoring, R: restored, each with its time."""
    actions = {"A": "applying", "a": "applied", "r": "rolled_back", "B": "restoring"}
    journal, held, wanted = Journal(tmp_path), "nothing", ""
    for event in events.split():
        if event[0] == "A":
            wanted = f"table {event}"
        elif event[0] == "B":
            wanted = journal.last_undoable().before_hash
        action = actions.get(event[0], "restored")
        journal.note(JournalEntry(action, int(event[1:]), "ab", event, held, wanted))
        held = wanted if event[0] in "aR" else held
    found = journal.last_undoable()
    assert (found and found.backup) == undo
    assert journal.last_restore_ns() == restored_ns


def test_backups_of_one_moment_get_numbers(tmp_path):
    journal = Journal(tmp_path)
    files = [{"a.txt": f"text {k}", "b.txt": None} for k in range(3)]
    names = [journal.keep(kept, 7) for kept in files]
    assert names == ["before-7", "before-7-1", "before-7-2"]
    assert [journal.kept(name) for name in names] == files
    with pytest.raises(
        ControllerError, match=r"the old table in .*before-8/contents\.json cannot"
    ):
        journal.kept("before-8")
