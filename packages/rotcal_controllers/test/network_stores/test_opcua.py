"""Feeding a controller over OPC UA: a real server, its death at every step, and strangers."""

import json
from dataclasses import replace

import pytest
from test_feed import Clock, applied, table_of, undone

from rotcal_controllers.network_stores.opcua_link import OpcUaLink
from rotcal_controllers.network_stores.settings import OpcUaSettings
from rotcal_ros.compensation.bridge_settings import BridgeSettings
from rotcal_ros.compensation.feed import Feed
from rotcal_ros.foundation.errors import ConfigurationError, ControllerError, DataError

pytest.importorskip("asyncua")
import opcua_bench

CSV = "c_csv.csv"


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    with opcua_bench.serving(tmp_path_factory.mktemp("opcua")) as server:
        yield server


class Machine:
    """A controller behind the server, and feeds for it; the books are in ``books``."""

    def __init__(self, server, books, fresh=True):
        self.server, self.books = server, books
        self.clock = Clock()
        if fresh:
            server.clear()
            server.start()

    def feed(self, changes=(), **bridge):
        settings = BridgeSettings(
            transport="opcua",
            spacing_deg=30.0,
            controller_folder=str(self.books),
            answer_timeout_s=30.0,
            opcua=OpcUaSettings(**self.server.settings(**dict(changes))),
        )
        return Feed(replace(settings, **bridge), "C", self.clock)

    def journal(self):
        lines = (self.books / ".rotcal" / "journal.jsonl").read_text().splitlines()
        return [json.loads(line)["action"] for line in lines]


@pytest.fixture
def machine(server, tmp_path):
    return Machine(server, tmp_path / "books")


def csv_of(scale):
    """Return the file of :func:`table_of` as another feed would write it."""
    feed = Feed(BridgeSettings(spacing_deg=30.0), "C", Clock())
    feed.take(table_of(scale), 1)
    return feed.offer.export.files[CSV]


@pytest.mark.slow
def test_a_table_goes_over_and_comes_back(machine):
    feed = machine.feed()
    done = applied(feed, table_of())
    assert machine.server.files() == {CSV: csv_of(1.0)}
    assert done.files == (
        f"opc.tcp://127.0.0.1:{machine.server.port} 2:Machine/FileSystem/{CSV}",
        str(machine.books / "c_csv.provenance.json"),
    )
    assert done.backup.parent == machine.books / ".rotcal"
    assert json.loads((machine.books / "c_csv.provenance.json").read_text())["controller"] == "csv"
    second = applied(feed, table_of(1.5))
    assert second.largest_change == pytest.approx(0.5 * done.largest_change, rel=1e-6)
    assert machine.server.files() == {CSV: csv_of(1.5)}
    undone(feed)
    assert machine.server.files() == {CSV: csv_of(1.0)}
    undone(feed)
    assert machine.server.files() == {}
    assert machine.journal() == ["applying", "applied"] * 2 + ["restoring", "restored"] * 2


def test_several_files_of_many_writes(machine):
    """LinuxCNC: 241 rows, more than one message, and the lines of the ini file."""
    feed = machine.feed(controller="linuxcnc", spacing_deg=1.5)
    applied(feed, table_of())
    files = machine.server.files()
    assert files.keys() == {"c_linuxcnc.comp", "c_linuxcnc.ini"}
    assert len(files["c_linuxcnc.comp"]) > 8192
    assert files == {n: feed.offer.export.files[n] for n in files}


@pytest.mark.slow
@pytest.mark.parametrize("said", [0, 1, 10**6])
def test_the_content_counts_and_not_what_the_server_says_of_its_size(machine, said):
    machine.server.say_size(said)
    feed = machine.feed()
    first = applied(feed, table_of())
    held = feed.in_force()
    assert len(held) == 64
    assert machine.server.files() == {CSV: csv_of(1.0)}
    second = applied(feed, table_of(1.5))
    assert second.largest_change == pytest.approx(0.5 * first.largest_change, rel=1e-6)
    undone(feed)
    assert machine.server.files() == {CSV: csv_of(1.0)}
    assert feed.in_force() == held


def test_what_the_change_would_be_is_told_by_what_the_server_holds(machine):
    first = machine.feed()
    applied(first, table_of())
    first.close()
    with pytest.raises(DataError, match="max_change_arcsec is 2"):
        applied(second := machine.feed(max_change_arcsec=2.0), table_of(1.5))
    second.close()
    (machine.server.folder / CSV).write_text("by hand\n")
    with pytest.raises(ControllerError, match="the change is not known"):
        applied(machine.feed(), table_of(1.5))
    assert machine.server.files() == {CSV: "by hand\n"}


def test_two_bridges_on_one_server(machine):
    first = machine.feed()
    applied(first, table_of())
    with pytest.raises(ControllerError, match="fed by process"):
        applied(machine.feed(), table_of(1.5))
    assert machine.server.files() == {CSV: csv_of(1.0)}


@pytest.mark.slow
def test_a_journal_is_that_of_one_controller(machine):
    feed = machine.feed()
    applied(feed, table_of())
    feed.close()
    other = machine.feed({"directory": "ns=2;s=files"})
    with pytest.raises(ControllerError, match=r"the journal in .* is that of opc\.tcp.*, not of"):
        undone(other)
    with pytest.raises(ControllerError, match="not of this folder itself"):
        undone(machine.feed(transport="folder"))
    undone(machine.feed())
    assert machine.server.files() == {}


# Death at every step. What the folder of the server holds is what a controller would load.


def whole(files):
    """Whether the table is not there, the old or the new one; other names load nothing."""
    return files.get(CSV) in (None, csv_of(1.0), csv_of(1.5))


def tables(machine):
    """Return the controller's files; what a cut transfer left is written over by the next."""
    files = machine.server.files()
    return {name: text for name, text in files.items() if not name.startswith("new_")}


@pytest.mark.long  # the line is cut at every step below
def test_every_step_of_an_application_may_be_the_last(machine):
    """The server is killed in the middle of each call of a method, the next start repairs."""
    feed = machine.feed()
    applied(feed, table_of())
    reports, step = [], 0
    while True:
        machine.server.fail(step, "kill", "before")
        try:
            applied(feed, table_of(1.5))
            break
        except ControllerError as error:
            reports.append(str(error))
        files = machine.server.files()
        assert whole(files), (step, files)
        machine.server.start()
        if "not known" in reports[-1]:
            assert "restore it before the axis moves" in reports[-1]
            undone(feed)
        else:  # before anything was written
            assert machine.journal()[-1] != "applying"
        assert tables(machine) == {CSV: csv_of(1.0)}, step
        step += 1
    assert machine.server.fault.exists()  # no step was left to die in
    assert machine.server.files() == {CSV: csv_of(1.5)}
    unknown = ["not known" in report for report in reports]
    reading = unknown.index(True)
    assert unknown == [False] * reading + [True] * (step - reading)
    assert reading >= 4
    assert step - reading >= 16  # make, write, read, rename four times, read back


@pytest.mark.slow
def test_a_line_that_is_cut_at_every_step_is_taken_up_again(machine):
    """The server lives on: the old table is put back at once."""
    feed = machine.feed()
    applied(feed, table_of())
    step, put_back, untouched = 5, 0, 0  # the calls before it only read
    while True:
        machine.server.fail(step, "cut", "after")
        try:
            applied(feed, table_of(1.5))
            break
        except ControllerError as error:
            put_back += "the old table was put back" in str(error)
            untouched += "nothing had to be put back" in str(error)
        assert tables(machine) == {CSV: csv_of(1.0)}, step
        step += 3
    assert put_back >= 1
    assert untouched >= 1  # what was sent had not got its name yet
    assert put_back + untouched >= 4
    assert machine.server.files() == {CSV: csv_of(1.5)}


@pytest.mark.slow
def test_a_crash_of_the_bridge_while_the_server_goes_away(machine):
    """The next bridge, of another process, finds the journal and brings the old table back."""
    feed = machine.feed()
    applied(feed, table_of())
    machine.server.fail(14, "gone", "after")
    with pytest.raises(ControllerError, match="it is not known what the controller holds"):
        applied(feed, table_of(1.5))
    assert machine.journal()[-1] == "applying"
    feed.close()
    feed = machine.feed()
    with pytest.raises(ControllerError, match="cannot read"):
        undone(feed)
    machine.server.start()
    undone(feed)
    assert machine.server.files() == {CSV: csv_of(1.0)}


# Who may talk to whom.


@pytest.mark.slow
@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"server_certificate": "foreign.pem"}, "cannot read"),
        ({"certificate": "stray.pem", "private_key": "stray_key.pem"}, "cannot read"),
        ({"user": "visitor"}, "BadIdentityTokenRejected|BadUserAccessDenied"),
        ({"directory": "2:Machine/Nothing"}, "BadNoMatch"),
    ],
)
def test_strangers_are_refused(machine, changes, words):
    work = machine.server.work
    changes = {k: str(work / v) if v.endswith(".pem") else v for k, v in changes.items()}
    feed = machine.feed(changes, answer_timeout_s=5.0)
    with pytest.raises(ControllerError, match=words):
        applied(feed, table_of())
    assert machine.server.files() == {}


def test_a_user_may_come_by_a_certificate(machine):
    work = machine.server.work

    def user(name):
        changes = {"user": "", "password_from": "", "user_certificate": str(work / f"{name}.pem")}
        return machine.feed(changes | {"user_key": str(work / f"{name}_key.pem")})

    feed = user("stray")
    with pytest.raises(ControllerError, match="Bad"):
        applied(feed, table_of())
    feed.close()
    applied(user("person"), table_of())
    assert machine.server.files() == {CSV: csv_of(1.0)}


def test_a_wrong_password_is_refused_and_not_repeated(machine, monkeypatch):
    monkeypatch.setenv("SECRET_OF_TEST", "wrong pass word")
    with pytest.raises(ControllerError, match="Bad") as caught:
        applied(machine.feed({"password_from": "env:SECRET_OF_TEST"}), table_of())
    assert "wrong pass word" not in str(caught.value)
    monkeypatch.setenv("SECRET_OF_TEST", opcua_bench.PASSWORD)
    machine.books.rename(machine.books.with_name("away"))
    applied(machine.feed({"password_from": "env:SECRET_OF_TEST"}), table_of())
    assert machine.server.files() == {CSV: csv_of(1.0)}


def test_a_channel_without_encryption_is_not_tried(machine):
    """What goes over the line shows nothing of table, file, user and password."""
    seen = []
    with opcua_bench.Tap(machine.server.port, seen.append) as tap:
        feed = machine.feed({"endpoint": f"opc.tcp://127.0.0.1:{tap.port}"})
        applied(feed, table_of())
    talk = b"".join(seen)
    assert len(talk) > 10_000
    assert b"Basic256Sha256" in talk
    for word in (b"angle_deg", b"c_csv", b"operator", opcua_bench.PASSWORD.encode()):
        assert word not in talk


@pytest.mark.slow
def test_a_server_that_does_not_answer(machine):
    """Nothing listens, or something that never answers: an error in time, nothing changed."""
    machine.server.stop()
    link = OpcUaLink(OpcUaSettings(**machine.server.settings()), 5.0)
    with pytest.raises(ControllerError, match="cannot read: "):
        link.read([CSV])
    with opcua_bench.silent_port() as port:
        settings = machine.server.settings(endpoint=f"opc.tcp://127.0.0.1:{port}")
        link = OpcUaLink(OpcUaSettings(**settings), 0.5)
        with pytest.raises(ControllerError, match=r"cannot write: not done within 0\.5 s"):
            link.write({CSV: "x"})


@pytest.mark.slow
def test_a_password_that_others_may_read_is_refused(machine):
    path = machine.server.work / "open_password"
    path.write_text(opcua_bench.PASSWORD)
    path.chmod(0o644)
    feed = machine.feed({"password_from": f"file:{path}"})
    with pytest.raises(ConfigurationError, match="others may read"):
        applied(feed, table_of())
    feed.close()
    with pytest.raises(ConfigurationError, match="no variable NOT_THERE_AT_ALL"):
        applied(machine.feed({"password_from": "env:NOT_THERE_AT_ALL"}), table_of())
