"""The database: everything once, nothing ever changed, read back to the last bit."""

import multiprocessing
import sqlite3
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import sqlalchemy as sa
from alembic.autogenerate import compare_metadata
from alembic.runtime.migration import MigrationContext
from simulated_park import BEGIN_NS, YEAR_NS, result

from rotcal_history.database import (
    METADATA,
    TABLES,
    ParkHistory,
    canonical_json,
    result_of,
)
from rotcal_history.exchange import export_history, restore_history
from rotcal_ros.foundation.dates import day_of, time_of
from rotcal_ros.foundation.errors import BagError, ConfigurationError, DataError
from rotcal_ros.recordings.result_sources import read_source

DATA = Path(__file__).parents[3] / "examples" / "data"
CURVE = np.sin(np.arange(24.0)) / 3.0


def some(serial="4711", year=0.0, u=0.3, **more):
    return result(serial, BEGIN_NS + round(year * YEAR_NS), CURVE, u, **more)


def tamper(history, statement):
    """Change the database behind the back of its triggers."""
    engine = history._engine
    with engine.connect() as connection, connection.begin():
        if engine.dialect.name == "postgresql":
            connection.exec_driver_sql("SET session_replication_role = replica")
        else:
            for table in TABLES:
                connection.exec_driver_sql(f"DROP TRIGGER {table}_update")
        connection.exec_driver_sql(statement)


def test_an_entry_says_its_verdict_and_that_it_was_replaced(database):
    with ParkHistory(database) as history:
        first = history.add_result(some()).entry
        second = history.add_result(some(u=0.4), corrects=first).entry
        history.correct(second.id, "the plate was upside down")
        history.add_result(some(year=1.0, verdict="suspect"))
        states = [entry.state for entry in history.entries()]
    assert states[:3] == ["replaced", "replaced", ""]
    assert states[3].startswith("suspect")


def test_a_result_is_kept_once_and_comes_back_to_the_last_bit(database):
    real = [read_source(DATA / f"result_{name}.json").result for name in ("tracer", "ball_plate")]
    day = time_of("2026-03-31")
    with ParkHistory(database) as history:
        for serial, each in zip("AB", real, strict=True):
            given = {"serial": serial, "axis": "C", "measured_ns": day}
            first, second = (history.add_result(each, **given) for _ in range(2))
            assert (first.new, second.new) == (True, False)
            assert first.entry.sha256 == second.entry.sha256
            back = result_of(history.entry(first.entry.id))
            assert back.to_json() == each.to_json()
            (campaign,) = history.campaigns(history.item(serial))
            for name, curve in campaign.curves.items():
                assert curve.covariance.tobytes() == each.covariance[name].tobytes()
                assert curve.deviation.tobytes() == each.deviations[name].tobytes()
        assert [entry.day for entry in history.entries()] == ["2026-03-31"] * 2
        assert history.check() == []


def test_numbers_that_only_float64_tells_apart_stay_apart(database):
    deviation = CURVE + np.array([5e-324, np.nextafter(1.0, 2.0), -0.0] * 8)
    added = result("4711", BEGIN_NS, deviation, 0.1)
    with ParkHistory(database) as history:
        entry = history.add_result(added).entry
        curve = history.campaigns(history.item("4711"))[0].curves["ECC"]
        assert curve.deviation.tobytes() == added.deviations["ECC"].tobytes()
        assert history.entry(entry.id).content == canonical_json(added)


@pytest.mark.parametrize(
    ("serial", "axis", "given", "words"),
    [
        ("", "C", {}, "no serial number; give it with --serial"),
        (" ", "C", {"serial": " "}, "no serial number; give it with --serial"),
        ("4711", "", {}, "no axis; give it with --axis"),
        ("4711", "C", {"serial": "4712"}, "'4711', not '4712'"),
        ("4711", "c axis", {}, "axis name"),
    ],
)
def test_a_result_without_identity_is_refused_with_the_reason(
    tmp_path, serial, axis, given, words
):
    with (
        ParkHistory(str(tmp_path / "history.db")) as history,
        pytest.raises((DataError, ConfigurationError), match=words),
    ):
        history.add_result(some(serial, axis=axis), **given)


def test_an_undated_result_is_refused_with_the_reason(tmp_path):
    undated = some()
    undated = replace(undated, circumstances=replace(undated.circumstances, begun_ns=None))
    with ParkHistory(str(tmp_path / "history.db")) as history:
        with pytest.raises(DataError, match="when it was measured: give the day with --measured"):
            history.add_result(undated)
        assert history.add_result(undated, measured_ns=BEGIN_NS).entry.day == day_of(BEGIN_NS)


def test_one_result_is_of_one_table_until_it_is_corrected(database):
    unnamed = some("")
    with ParkHistory(database) as history:
        wrong = history.add_result(unnamed, serial="4711").entry
        with pytest.raises(DataError, match="as result of 4711/C"):
            history.add_result(unnamed, serial="4712")
        with pytest.raises(ConfigurationError, match="serial number is empty"):
            history.correct(wrong.id, "labels were swapped", serial=" ")
        right = history.correct(wrong.id, "labels were swapped", serial="4712")
        again = history.correct(wrong.id, "labels were swapped", serial="4712")
        assert (right.new, again.new) == (True, False)
        with pytest.raises(DataError, match=f"entry {wrong.id} was corrected already"):
            history.correct(wrong.id, "no", serial="4713")
        assert [item.serial for item in history.items()] == ["4712"]
        (kept,) = history.of_item(history.item("4712"))
        assert (kept.replaces, kept.why) == (wrong.id, "labels were swapped")
        assert history.entry(wrong.id).serial == "4711"
        withdrawn = history.correct(right.entry.id, "the plate was upside down").entry
        assert history.items() == []
        shown = history.of_item(history.item("4711"), valid=False)
        assert [entry.state for entry in shown] == ["replaced"]
        assert (withdrawn.kind, withdrawn.replaces) == ("withdrawal", right.entry.id)
        assert history.check() == []


def test_what_was_withdrawn_by_mistake_comes_back(database):
    with ParkHistory(database) as history:
        history.add_result(some())
        withdrawn = history.correct(1, "upside down").entry
        again = history.add_result(some())
        assert again.describe().endswith("there already, but replaced")
        back = history.correct(withdrawn.id, "it was not", serial="4711").entry
        assert (back.kind, back.content) == ("result", canonical_json(some()))
        assert len(history.campaigns(history.item("4711"))) == 1
        assert history.check() == []


@pytest.mark.parametrize("statement", ["UPDATE {} SET {} = {}", "DELETE FROM {}"])
def test_no_row_is_ever_changed(database, statement):
    with ParkHistory(database) as history:
        history.add_result(some())
        history.note_forecasts({"basis": "{}"})
        for table in METADATA.sorted_tables:
            column = next(iter(table.c)).name
            with (
                pytest.raises(BagError, match="never changed in place: add a correction"),
                history._connected(writing=True) as connection,
            ):
                connection.exec_driver_sql(statement.format(table.name, column, column))
        assert history.check() == []


@pytest.mark.parametrize(
    ("statement", "words"),
    [
        ("UPDATE entries SET content = '{}' WHERE id = 1", "content"),
        ("UPDATE entries SET why = 'nothing'", "not as it was added"),
        ("UPDATE entries SET measured_ns = 5", "not as it was added"),
        ("UPDATE results SET verdict = 'failed'", "verdict"),
        ("UPDATE curves SET deviation = angles", "curves"),
        ("UPDATE items SET serial = 'other'", "not as it was added"),
    ],
)
def test_check_names_what_was_changed(database, statement, words):
    with ParkHistory(database) as history:
        history.add_result(some())
        if "content" in statement:
            import zlib

            other = zlib.compress(canonical_json(some(u=0.4)))
            text = f"X'{other.hex()}'" if "://" not in database else f"'\\x{other.hex()}'"
            statement = statement.replace("'{}'", text)
        tamper(history, statement)
        (wrong,) = history.check()
    assert words in wrong


def test_a_damaged_content_is_named_and_never_read(tmp_path):
    with ParkHistory(str(tmp_path / "history.db")) as history:
        history.add_result(some())
        tamper(history, "UPDATE entries SET content = CAST(X'00' || content AS BLOB)")
        assert "its content is not what was added" in history.check()[0]
        with pytest.raises(BagError, match="entry 1 is not what was added"):
            history.entry(1)


def test_check_sees_a_row_that_belongs_to_nothing(tmp_path):
    path = tmp_path / "history.db"
    with ParkHistory(str(path)) as history:
        history.add_result(some())
    with sqlite3.connect(path) as connection:
        connection.execute("DROP TRIGGER items_delete")
        connection.execute("DELETE FROM items")
    with ParkHistory(str(path)) as history:
        assert any("belongs to no items" in text for text in history.check())


def test_events_and_files_are_kept_beside_the_results(database):
    with ParkHistory(database) as history:
        history.add_result(some())
        day = BEGIN_NS + YEAR_NS
        event = [
            history.add_event(history.item("4711"), "crash", day, "tailstock") for _ in range(2)
        ]
        assert [added.new for added in event] == [True, False]
        page = history.add_document(
            history.item("4711"), "report", "report.html", day, b"<html>\0"
        ).entry
        assert history.entry(page.id).content == b"<html>\0"
        kinds = [entry.kind for entry in history.of_item(history.item("4711"))]
        assert kinds == ["result", "event", "report"]
        assert history.check() == []


def begun(history):
    """Add a result in a transaction that is not finished."""
    with history.transaction():
        history.add_result(some())
        raise RuntimeError


def test_what_is_added_together_is_there_as_a_whole_or_not_at_all(database):
    unnamed = some("")
    with ParkHistory(database) as history:
        with pytest.raises(RuntimeError):
            begun(history)
        assert history.items() == []
        with history.transaction():
            added = [history.add_result(some()) for _ in range(2)]
            history.add_result(unnamed, serial="4712")
            with pytest.raises(DataError, match="as result of 4712/C"):
                history.add_result(unnamed, serial="4713")
            assert len(history.items()) == 2
        assert [each.new for each in added] == [True, False]
    with ParkHistory(database) as history:
        assert [item.serial for item in history.items()] == ["4711", "4712"]
        assert history.check() == []


def test_export_and_import_are_round_trips(database, tmp_path):
    with ParkHistory(database) as history:
        wrong = history.add_result(some(year=1.0)).entry
    with ParkHistory(database) as history:
        history.add_event(history.item("4711"), "repair", BEGIN_NS, "new seals")
        history.add_document(history.item("4711"), "table", "c.ent", BEGIN_NS, bytes(range(256)))
        history.correct(wrong.id, "of the other", serial="4712")
        assert export_history(history, tmp_path / "out") == 4
        before = [replace(e, id=0, replaces=None) for e in history.entries(content=True)]
    with ParkHistory(str(tmp_path / "history2.db")) as other:
        assert restore_history(other, tmp_path / "out") == (4, 0)
        assert restore_history(other, tmp_path / "out") == (0, 4)
        after = [replace(e, id=0, replaces=None) for e in other.entries(content=True)]
        assert after == before
        assert other.check() == []
        assert [item.serial for item in other.items()] == ["4711", "4712"]
        export_history(other, tmp_path / "again")
    import pyarrow.parquet as parquet

    tables = [parquet.read_table(tmp_path / f / "deviations.parquet") for f in ("out", "again")]
    assert tables[0].drop(["entry"]).equals(tables[1].drop(["entry"]))
    assert tables[0].num_rows == 24


def test_a_damaged_export_is_refused(tmp_path):
    with ParkHistory(str(tmp_path / "history.db")) as history:
        history.add_result(some())
        export_history(history, tmp_path)
        path = tmp_path / "entries.parquet"
        path.write_bytes(path.read_bytes()[:-30])
        with pytest.raises(BagError, match="no whole export of a history"):
            restore_history(history, tmp_path)


def test_the_steps_lead_to_the_schema_that_is_used(database):
    with ParkHistory(database) as history, history._engine.connect() as connection:
        options = {"compare_type": True}
        assert (
            compare_metadata(MigrationContext.configure(connection, opts=options), METADATA) == []
        )


def test_a_history_of_a_later_rotcal_is_refused(tmp_path):
    path = tmp_path / "history.db"
    ParkHistory(str(path)).__exit__()
    with sqlite3.connect(path) as connection:
        connection.execute("UPDATE alembic_version SET version_num = '99'")
    with pytest.raises(BagError, match=r"written by a later rotcal .*update rotcal"):
        ParkHistory(str(path))


@pytest.mark.parametrize("content", [b"no database at all, but long enough to look like one", b""])
def test_another_file_is_refused_or_begun(tmp_path, content):
    path = tmp_path / "history.db"
    path.write_bytes(content)
    if content:
        with pytest.raises(BagError, match="not a database"):
            ParkHistory(str(path))
        assert path.read_bytes() == content
    else:
        with ParkHistory(str(path)) as history:
            assert history.items() == []


@pytest.mark.parametrize(
    ("database", "words"),
    [("mysql://host/name", "expected a file or postgresql"), ("/proc/none/h.db", "no history at")],
)
def test_what_is_no_database_is_refused(database, words):
    with pytest.raises((BagError, ConfigurationError), match=words):
        ParkHistory(database)


def test_a_url_with_a_password_is_refused_and_a_silent_server_told():
    with pytest.raises(ConfigurationError, match="a URL with a secret in it") as raised:
        ParkHistory("postgresql://me:mine@/none?host=/nowhere")
    assert "mine" not in str(raised.value)
    with pytest.raises(BagError, match=r"postgresql://me@/none"):
        ParkHistory("postgresql://me@/none?host=/nowhere")


def write(database, begin, serial):
    with ParkHistory(database) as history:
        for number in range(10):
            history.add_result(some(serial, year=begin + number / 100, u=0.2))


def test_several_writers_at_once_lose_nothing_and_write_nothing_twice(database):
    """Two pairs add the same results at the same time."""
    context = multiprocessing.get_context("fork")
    jobs = [("one", 0), ("one", 0), ("two", 1), ("two", 1)]
    writers = [context.Process(target=write, args=(database, b, s)) for s, b in jobs]
    for writer in writers:
        writer.start()
    for writer in writers:
        writer.join()
    assert [writer.exitcode for writer in writers] == [0] * 4
    with ParkHistory(database) as history:
        assert len(list(history.entries())) == 20
        assert [len(history.of_item(item)) for item in history.items()] == [10, 10]
        assert history.check() == []


def test_strict_tables_refuse_what_is_no_number(tmp_path):
    with ParkHistory(str(tmp_path / "history.db")) as history:
        kinds = history._engine.connect().exec_driver_sql("PRAGMA table_list").all()
        assert {row.name for row in kinds if row.strict} >= set(TABLES)
        modes = [history._engine.connect().exec_driver_sql(f"PRAGMA {p}").scalar()
                 for p in ("journal_mode", "foreign_keys", "synchronous")]  # fmt: skip
    assert modes == ["wal", 1, 2]
    assert sa.inspect(history._engine).has_table("entries")
