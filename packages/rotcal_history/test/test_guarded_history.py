"""What a history does not touch, does not believe, and does not hand on to other programs."""

import sqlite3
import tracemalloc
import zlib
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from datetime import datetime, timezone
from hashlib import sha256

import numpy as np
import pytest
from click.testing import CliRunner
from simulated_park import Table, measured

from rotcal_history.database import TABLES, ParkHistory
from rotcal_history.exchange import due_calendar, prometheus_metrics, reminder_mail
from rotcal_history.outlook import all_outlooks
from rotcal_history.page import OURS, write_park
from rotcal_history.settings import HistorySettings
from rotcal_ros.cli.main import rotcal
from rotcal_ros.foundation.errors import BagError

SETTINGS = HistorySettings()


@pytest.fixture
def place(tmp_path):
    """A history of one table with six results and a report."""
    path, rng = str(tmp_path / "history.db"), np.random.default_rng(1)
    table = Table("4711", np.append([1.0, 0.5], np.zeros(6)), drift=0.6 * np.eye(8)[0])
    with ParkHistory(path) as history:
        for each in measured(table, np.linspace(0.0, 5.0, 6), rng):
            history.add_result(each)
        history.add_document(history.item("4711"), "report", "report.html", 1, b"<h1>It</h1>")
    return path


def rotcal_history(place, *words):
    own = () if "--database" in words else ("--database", place)
    done = CliRunner().invoke(rotcal, ["history", *words, *own])
    return done.exit_code, done.output + done.stderr


def tampered(place, *statements):
    """Change a file as somebody would who removes the triggers, and does not see to keys."""
    with sqlite3.connect(place) as connection:
        for table in TABLES:
            connection.execute(f"DROP TRIGGER {table}_update")
        for statement in statements:
            connection.execute(*statement) if isinstance(statement, tuple) else (
                connection.execute(statement)
            )


def test_a_file_of_somebody_else_and_one_without_a_history_stay_as_they_are(tmp_path):
    foreign, empty = tmp_path / "songs.db", tmp_path / "empty.db"
    with sqlite3.connect(foreign) as connection:
        connection.execute("CREATE TABLE songs (title)")
    empty.touch()
    before = foreign.read_bytes()
    for words in ((), ("due",), ("add", "examples/data/result_ball_plate.json")):
        code, said = rotcal_history(str(foreign), *words)
        assert (code, "is a database of something else (it has songs)" in said) == (2, True)
    assert foreign.read_bytes() == before
    code, said = rotcal_history(str(empty))
    assert (code, "there is no history in" in said) == (2, True)
    assert empty.read_bytes() == b""
    (tmp_path / "link.db").symlink_to(tmp_path / "nothing.db")
    with pytest.raises(BagError, match="a link to nothing"):
        ParkHistory(str(tmp_path / "link.db"))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["empty.db", "link.db", "songs.db"]


def test_a_content_is_not_written_through_a_link(place, tmp_path):
    (tmp_path / "out.html").symlink_to(tmp_path / "elsewhere.html")
    code, said = rotcal_history(
        place, "show", "4711", "--entry", "7", "-o", str(tmp_path / "out.html")
    )
    assert (code, "is not overwritten" in said) == (2, True)
    assert not (tmp_path / "elsewhere.html").exists()


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("correct", "9" * 30, "--withdraw", "--why", "x"), "not in the range"),
        (("show", "4711", "--entry", "9" * 30, "-o", "x"), "not in the range"),
        (("correct", "-1", "--withdraw", "--why", "x"), "Error"),
        (("due", "--before", "99999-01-01"), "expected"),
        (("event", "4711", "crash", "--date", "9999-99-99"), "expected"),
        (("due", "--set", f"history.interval_days={'9' * 30}"), "64 bits"),
        (("due", "--set", "history.interval_days=1e300"), "out of range"),
        (("due", "--set", "history.longest_days=1e300"), "out of range"),
        (("--database", "postgresql://host:port/db"), "the URL of the history cannot be read"),
        (("--database", "postgresql://[::1/db"), "the URL of the history cannot be read"),
    ],
)
def test_no_number_and_no_url_is_unexpected(place, words, told):
    code, said = rotcal_history(place, *words)
    assert code == 2, said
    assert told in said
    assert "unexpected" not in said


def test_a_row_is_not_replaced_by_a_connection_that_asks_for_nothing(place):
    with sqlite3.connect(place) as connection:
        before = {t: connection.execute(f"SELECT * FROM {t}").fetchall() for t in TABLES}
        for table in TABLES:
            for row in before[table]:
                marks = ",".join("?" * len(row))
                changed = [*row[:-1], b"" if isinstance(row[-1], bytes) else row[-1]]
                connection.execute(f"INSERT OR REPLACE INTO {table} VALUES ({marks})", changed)
        entry = dict(zip(_columns(connection, "entries"), before["entries"][0], strict=True))
        entry |= {"id": None, "why": "mine", "sha256": "0" * 64}  # only its content is there
        names, marks = ",".join(entry), ",".join("?" * len(entry))
        statement = f"INSERT OR REPLACE INTO entries ({names}) VALUES ({marks})"
        connection.execute(statement, [*entry.values()])
        assert before == {t: connection.execute(f"SELECT * FROM {t}").fetchall() for t in TABLES}
    with ParkHistory(place) as history:
        assert history.check() == []


def _columns(connection, table):
    return [row[1] for row in connection.execute(f"PRAGMA table_info({table})")]


def test_an_older_history_is_protected_when_it_is_opened(place):
    with sqlite3.connect(place) as connection:
        for table in TABLES:
            connection.execute(f"DROP TRIGGER {table}_insert")
        connection.execute("UPDATE alembic_version SET version_num = '1'")
    with ParkHistory(place) as history:
        assert history.check() == []
    with sqlite3.connect(place) as connection:
        made = connection.execute("SELECT name FROM sqlite_master WHERE type = 'trigger'")
        assert {f"{table}_insert" for table in TABLES} <= {name for (name,) in made}


def test_a_changed_due_date_is_noticed(place):
    code, said = rotcal_history(place, "due", "--before", "2100-01-01")
    assert (code, "4711/C" in said) == (1, True)
    assert rotcal_history(place, "check")[0] == 0
    tampered(
        place,
        "UPDATE forecasts SET content = json_replace(content, '$.due_ns',"
        " json_extract(content, '$.due_ns') + 86400000000000 * 400)",
    )
    code, said = rotcal_history(place, "check")
    assert (code, "4711/C: its kept forecast is not that of its entries" in said) == (1, True)


def test_an_entry_that_unpacks_to_gigabytes_is_bounded(place):
    packer = zlib.compressobj(9)
    block = bytes(1 << 24)
    bomb = b"".join(packer.compress(block) for _ in range(40)) + packer.flush()  # 640 MB
    assert len(bomb) < 1 << 20
    tampered(place, ("UPDATE entries SET content = ? WHERE id = 7", (bomb,)))
    with ParkHistory(place) as history:
        tracemalloc.start()
        assert "its content is not what was added" in history.check()[0]
        assert tracemalloc.get_traced_memory()[1] < 60e6
        tracemalloc.stop()


def test_calendar_metrics_and_letter_hold_visible_characters_alone(place):
    with ParkHistory(place) as history:
        (view,) = all_outlooks(history, SETTINGS)
    bad = replace(view, serial='a\rX-EVIL:1\x1b[2J\u202eb\n"c\\', reason="r\r\nATTACH:x\x1b")
    texts = (
        due_calendar([bad], datetime(2026, 1, 2, tzinfo=timezone.utc)),
        prometheus_metrics([bad]),
    )
    for text in (*texts, reminder_mail([bad], "2026-01-01")):
        lines = text.replace("\r\n", "\n").split("\n")
        assert all(line.isprintable() for line in lines)
        assert not any(line.startswith(("X-EVIL", "ATTACH", "c")) for line in lines)
    assert texts[0].count("\r\n") == texts[0].count("\n") == texts[0].count("\r")


def test_a_page_replaces_only_what_it_wrote(place, tmp_path):
    out = tmp_path / "out"
    (out / "park" / "deep").mkdir(parents=True)
    mine = {out / "park" / name: name for name in ("mine.txt", "table-1.html", "deep/x")}
    for path, text in mine.items():
        path.write_text(text)
    with ParkHistory(place) as history:
        (view,) = all_outlooks(history, SETTINGS)
        write_park(history, [view], out, "2026-03-31")
        assert all(path.read_text() == text for path, text in mine.items())
        with pytest.raises(BagError, match=r"table-1\.html is not as a page of ours left it"):
            write_park(history, [view, view], out, "2026-03-31")
        assert all(path.read_text() == text for path, text in mine.items())
        (out / "park" / "table-1.html").unlink()
        write_park(history, [view, view], out, "2026-03-31")
        write_park(history, [view], out, "2026-04-01")  # the second one is gone again
        assert not (out / "park" / "table-1.html").exists()
        (out / "park" / "table-0.html").write_text("my notes")
        (out / "park" / OURS).write_text('{"../park.html": ["x"], "park/../../history.db": ["y"]}')
        with pytest.raises(BagError, match="is not replaced"):
            write_park(history, [view], out, "2026-04-01")
    assert (out / "park" / "table-0.html").read_text() == "my notes"


def test_a_page_is_not_written_through_a_link(place, tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "theirs").mkdir()
    (tmp_path / "out" / "park").symlink_to(tmp_path / "theirs")
    with ParkHistory(place) as history:
        with pytest.raises(BagError, match="is a link, through which nothing is written"):
            write_park(history, all_outlooks(history, SETTINGS), tmp_path / "out", "2026-03-31")
        (tmp_path / "out" / "park").unlink()
        (tmp_path / "out" / "park.html").symlink_to(tmp_path / "nothing.html")
        with pytest.raises(BagError, match="is not replaced"):
            write_park(history, all_outlooks(history, SETTINGS), tmp_path / "out", "2026-03-31")
    assert list((tmp_path / "theirs").iterdir()) == []
    assert not (tmp_path / "nothing.html").exists()


def test_pages_at_once_are_whole(place, tmp_path):
    out = tmp_path / "out"
    with ParkHistory(place) as history:
        (view,) = all_outlooks(history, SETTINGS)

    def write(count):
        with ParkHistory(place) as history:
            write_park(history, [view] * count, out, "2026-03-31")

    with ThreadPoolExecutor(3) as pool:
        list(pool.map(write, (3, 2, 1)))
    listed = (out / "park.html").read_text().count('"link"')
    names = {f"table-{number}.html" for number in range(listed)}
    assert {path.name for path in (out / "park").glob("table-*")} == names
    assert (out / "park" / "entry-7-report.html").read_bytes() == b"<h1>It</h1>"


def test_overdue_tables_with_findings_are_due_too(place, tmp_path):
    with ParkHistory(place) as history:
        (view,) = all_outlooks(history, SETTINGS)
        urgent = replace(view, verdict="suspect", due_ns=0, findings=_look(view))
        write_park(history, [urgent, urgent], tmp_path / "out", "2026-03-31")
    text = " ".join((tmp_path / "out" / "park.html").read_text().split())
    assert "2 to look at" in text
    assert "2 due" in text
    assert '"is_due": true' in text


def _look(view):
    from rotcal_history.outlook import TableFinding

    return (*view.findings, TableFinding("verdict", view.last_ns, "measure again"))


def test_the_hash_of_a_document_is_that_of_its_content(place):
    with ParkHistory(place) as history:
        entry = history.entry(7)
    assert entry.content_sha256 == sha256(entry.content).hexdigest()
