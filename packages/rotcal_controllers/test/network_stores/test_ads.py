"""Feeding a table over ADS: pyads' own server, the array bit for bit, its death at each step."""

import contextlib
import os
import socket
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from test_feed import Clock, applied, table_of, undone

from rotcal_controllers.network_stores.settings import AdsSettings
from rotcal_ros.compensation.bridge_settings import BridgeSettings
from rotcal_ros.compensation.feed import Feed
from rotcal_ros.compensation.plain_csv import PlainCsv
from rotcal_ros.foundation.errors import ConfigurationError, ControllerError

pytest.importorskip("pyads")
from rotcal_controllers.network_stores.ads_link import AdsLink

CAPACITY = 100
PORT = 48898
"""Of ADS: the library knows no other, so that every process of tests has an address of its own."""


class Plc:
    """A PLC in a process of its own; ``feed`` makes feeds for it."""

    def __init__(self, folder):
        number = os.getpid()
        self.host = f"127.{number >> 16 & 63 | 64}.{number >> 8 & 255}.{number & 255}"
        self.memory, self.books = folder / "memory", folder / "books"
        self.clock, self.process = Clock(), None
        self.start()

    def start(self):
        self.end()
        server = Path(__file__).with_name("ads_server.py")
        self.process = subprocess.Popen(
            [sys.executable, str(server), self.host, str(CAPACITY), str(self.memory)],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE,
        )  # fmt: skip
        self.say("hello")
        while True:  # the thread that listens
            with contextlib.suppress(OSError), socket.create_connection((self.host, PORT)):
                return
            time.sleep(0.05)

    def say(self, line):
        self.process.stdin.write(line.encode() + b"\n")
        self.process.stdin.flush()
        assert self.process.stdout.readline()

    def end(self):
        if self.process is not None:
            self.process.kill()
            self.process.wait()
            self.process.stdin.close()
            self.process.stdout.close()

    def held(self):
        """Return the rows (n, 5) that are in force, as the PLC's memory holds them."""
        count, table = map(bytes.fromhex, self.memory.read_text().split())
        rows = np.frombuffer(table, dtype="<f8").reshape(CAPACITY, 5)
        return rows[: int.from_bytes(count, "little")]

    def feed(self, *, ads=(), **bridge):
        settings = BridgeSettings(
            transport="ads",
            spacing_deg=15.0,
            controller_folder=str(self.books),
            answer_timeout_s=30.0,
            ads=AdsSettings(
                **{"net_id": "5.4.3.2.1.1", "host": self.host, "capacity": CAPACITY, **dict(ads)}
            ),
        )
        return Feed(replace(settings, **bridge), "C", self.clock)


@pytest.fixture
def plc(tmp_path):
    made = Plc(tmp_path)
    yield made
    made.end()


def rows_of(scale):
    """Return the numbers of the CSV file of :func:`table_of`, read by numpy, and a column -1."""
    feed = Feed(BridgeSettings(spacing_deg=15.0), "C", Clock())
    feed.take(table_of(scale), 1)
    text = feed.offer.export.files["c_csv.csv"]
    rows = np.loadtxt(text.splitlines(), delimiter=",", skiprows=1)
    return np.column_stack([rows, np.full(len(rows), -1.0)])


def same_bits(found, wanted):
    return found.shape == wanted.shape and found.tobytes() == wanted.tobytes()


def test_the_array_holds_the_same_bits_and_goes_back(plc):
    feed = plc.feed()
    done = applied(feed, table_of())
    assert same_bits(plc.held(), rows_of(1.0))
    assert len(plc.held()) == 25
    assert done.files[0] == f"ads://{plc.host}/5.4.3.2.1.1:851/GVL.rotcal_table/c_csv.csv"
    second = applied(feed, table_of(1.5))
    assert second.largest_change == pytest.approx(0.5 * done.largest_change, rel=1e-6)
    assert same_bits(plc.held(), rows_of(1.5))
    undone(feed)
    assert same_bits(plc.held(), rows_of(1.0))
    undone(feed)
    assert len(plc.held()) == 0


def test_a_table_of_two_uncertainties(plc):
    """The fifth column of the file, when both directions were measured."""
    rows = rows_of(1.0)
    rows[:, 4] = rows[:, 3] + 0.25
    text = PlainCsv().text_of(rows)
    assert text.splitlines()[0].endswith(",std_reverse_arcsec")
    settings = AdsSettings(net_id="5.4.3.2.1.1", host=plc.host, capacity=CAPACITY)
    link = AdsLink(settings, 30.0, PlainCsv())
    link.write({"c_csv.csv": text})
    np.testing.assert_allclose(plc.held(), rows, atol=5e-7)
    assert link.read(["c_csv.csv"]) == {"c_csv.csv": text}


def test_a_bit_that_differs_is_seen_and_the_old_table_put_back(plc):
    feed = plc.feed()
    applied(feed, table_of())
    plc.say("damage")
    with pytest.raises(ControllerError, match=r"array differs .*; the old table was put back"):
        applied(feed, table_of(1.5))
    assert same_bits(plc.held(), rows_of(1.0))


@pytest.mark.long
def test_every_request_may_be_the_last(plc):
    """Killed in the middle of each request: all rows in force, or none; then the old ones."""
    feed = plc.feed(answer_timeout_s=3.0)
    applied(feed, table_of())
    step, unknown = 0, 0
    while True:
        plc.say(f"die {step}")
        try:
            applied(feed, table_of(1.5))
            break
        except ControllerError as error:
            report = str(error)
        held = plc.held()
        assert len(held) == 0 or same_bits(held, rows_of(1.0)) or same_bits(held, rows_of(1.5))
        plc.start()
        if "it is not known what the controller holds" in report:
            unknown += 1
            undone(feed)
        assert same_bits(plc.held(), rows_of(1.0)), step
        step += 1
    assert same_bits(plc.held(), rows_of(1.5))
    assert step == 10  # count, array; count, read; array, read; count, read; count, array
    assert unknown == 8


@pytest.mark.slow
def test_what_the_array_cannot_hold(plc):
    feed = plc.feed(ads={"capacity": 20})
    with pytest.raises(ControllerError, match="parameter size not correct"):
        applied(feed, table_of())
    feed.close()
    small = AdsSettings(net_id="5.4.3.2.1.1", host=plc.host, capacity=24)
    text = PlainCsv().text_of(rows_of(1.0))
    with pytest.raises(ControllerError, match=r"25 rows, the array holds ads\.capacity = 24"):
        AdsLink(small, 5.0, PlainCsv()).write({"c_csv.csv": text})
    with pytest.raises(ConfigurationError, match="LinuxCNC has none: choose the controller csv"):
        plc.feed(controller="linuxcnc")
    with pytest.raises(ControllerError, match="cannot read"):
        applied(plc.feed(ads={"count": "GVL.nothing"}), table_of())
    assert len(plc.held()) == 0
