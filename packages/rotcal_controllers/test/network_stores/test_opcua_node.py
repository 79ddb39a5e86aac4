"""Feeding a controller over OPC UA: a server that shares nothing with ours but the standard.

node-opcua with node-opcua-file-transfer, on Node.js.
"""

from pathlib import Path

import pytest
from aids import on_node
from test_feed import applied, table_of, undone

pytest.importorskip("asyncua")
import opcua_bench
from test_opcua import CSV, Machine, csv_of

from rotcal_ros.foundation.errors import ControllerError

pytestmark = pytest.mark.slow

HERE = Path(__file__).parent / "node"


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    program = on_node(HERE / "file_server.mjs")
    work = tmp_path_factory.mktemp("opcua_node")
    opcua_bench.make_certificates(work)
    made = opcua_bench.Server(work, ["node", str(program)], "1:Machine/FileSystem")
    made.start()
    yield made
    made.end()


@pytest.fixture
def machine(server, tmp_path):
    """A controller behind the server, which goes on running."""
    return Machine(server, tmp_path / "books", fresh=False)


def test_a_table_goes_over_and_comes_back(machine):
    feed = machine.feed()
    applied(feed, table_of())
    applied(feed, table_of(1.5))
    assert machine.server.files() == {CSV: csv_of(1.5)}
    undone(feed)
    assert machine.server.files() == {CSV: csv_of(1.0)}
    undone(feed)
    assert machine.server.files() == {}


def test_strangers_are_refused(machine):
    work = machine.server.work
    stray = {"certificate": str(work / "stray.pem"), "private_key": str(work / "stray_key.pem")}
    foreign = {"server_certificate": str(work / "foreign.pem")}
    for changes in (stray, foreign, {"user": "visitor"}):
        feed = machine.feed(changes, answer_timeout_s=5.0)
        with pytest.raises(ControllerError, match="cannot read"):
            applied(feed, table_of())
        feed.close()
    assert machine.server.files() == {}


def test_a_cut_line_puts_nothing_half_in_force(machine):
    """A move that replaces: the old table or the new one, at every moment."""
    feed = machine.feed()
    applied(feed, table_of())
    step = 0
    while True:
        machine.server.fail(step, "cut", "")
        try:
            applied(feed, table_of(1.5))
            break
        except ControllerError:
            assert machine.server.files()[CSV] == csv_of(1.0)
        step += 1
    assert step == 7  # open to read; create, open, write, open to read, move; open to read
    assert machine.server.files()[CSV] == csv_of(1.5)
    machine.server.fault.unlink()
    undone(feed)
    assert machine.server.files() == {CSV: csv_of(1.0)}


def test_a_server_that_only_shows_files_is_written_in_place(machine):
    """A killed server leaves half a table: that is reported, and the next start repairs it."""
    held = machine.server.work / "fixed" / CSV
    feed = machine.feed({"directory": "1:Machine/1:Fixed"})
    assert held.read_text() == ""
    applied(feed, table_of())
    assert held.read_text() == csv_of(1.0)
    machine.server.fail(2, "cut", "")
    with pytest.raises(ControllerError, match="the old table was put back"):
        applied(feed, table_of(1.5))
    assert held.read_text() == csv_of(1.0)
    machine.server.fail(2, "kill", "")
    with pytest.raises(ControllerError, match="it is not known what the controller holds"):
        applied(feed, table_of(1.5))
    wanted = csv_of(1.5)
    assert held.read_text() == wanted[: len(wanted) // 2]
    feed.close()
    machine.server.start()
    undone(machine.feed({"directory": "1:Machine/1:Fixed"}))
    assert held.read_text() == csv_of(1.0)


def test_a_server_that_only_shows_files_makes_none(machine):
    feed = machine.feed({"directory": "1:Machine/1:Fixed"}, controller="linuxcnc")
    with pytest.raises(ControllerError, match=r"there is no file c_linuxcnc\.ini, and"):
        applied(feed, table_of())
