"""An instrument from a package of somebody else, driven against a fake of it behind TCP."""

import importlib.util
import math
import socket
import time
from contextlib import suppress
from pathlib import Path
from threading import Thread

import pytest

from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.machine_load import load_scaled_timeout
from rotcal_ros.foundation.node_state import Why
from rotcal_ros.foundation.observations import (
    Approach,
    Command,
    LengthStatus,
    PointKind,
    TableSample,
)
from rotcal_ros.nodes.instrument_driver import driver
from rotcal_ros.nodes.instrument_driver.driver import (
    DriverCallbacks,
    InstrumentDriver,
    TableRestDetector,
    make_instrument,
)
from rotcal_ros.nodes.instrument_driver.instrument import (
    InstrumentError,
    Length,
    Place,
    Tracer,
    Tracker,
)
from rotcal_ros.nodes.instrument_driver.settings import InstrumentSettings

EXAMPLE = Path(__file__).parents[3] / "examples" / "own_instrument" / "mytracer.py"
SPEC = importlib.util.spec_from_file_location("mytracer", EXAMPLE)
mytracer = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(mytracer)
DEADLINE_S = 10.0
SILENCE = None
ORDER = Command(3, 1, 0.5, Approach.POSITIVE, PointKind.DIRECT, 2, (1.0, 2.0, 3.0), 1)


class Fake:
    """A MyTracer: each connection gets the next of ``talks``, then it is closed."""

    def __init__(self, *talks):
        self.asked, self._talks = [], talks
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.address = f"127.0.0.1:{self._listener.getsockname()[1]}"
        Thread(target=self._serve, daemon=True).start()

    def _serve(self):
        for talk in self._talks:
            connection, _ = self._listener.accept()
            with connection:
                self.asked.append(connection.recv(100).decode())
                for part in talk:
                    if part is SILENCE:
                        connection.recv(1)  # until the other one has had enough
                    else:
                        connection.sendall(part)
                        time.sleep(0.02)  # so that it comes in a piece of its own


class Heard:
    """What a driver told, until its end."""

    def __init__(self, instrument, settings, why_not=lambda _: None):
        self.lengths, self.places, self.complaints = [], [], []
        listeners = DriverCallbacks(
            self.lengths.append, self.places.append, self.complaints.append
        )
        self.driver = InstrumentDriver(instrument, settings, listeners, why_not, now_ns=lambda: 7)
        self.driver.begin()

    def until(self, condition):
        deadline = time.monotonic() + load_scaled_timeout(DEADLINE_S)
        while not condition(self):
            assert time.monotonic() < deadline, (self.lengths, self.complaints)
            time.sleep(0.01)
        self.driver.stop()
        return self


@pytest.fixture(autouse=True)
def connects_again_at_once(monkeypatch):
    monkeypatch.setattr(InstrumentSettings, "reconnect_s", 0.05)


def settings(address, **others):
    return InstrumentSettings(plugin="mytracer", address=address, **({"silence_s": 0.3} | others))


def test_lengths_arrive_in_metres_whatever_the_pieces_and_a_broken_beam_is_told():
    fake = Fake([b"1234.567 OK\n1234", b".600 OK\n0.000 NOBEAM\n5.0 UNSTABLE\n"])
    heard = Heard(mytracer.make(fake.address, {"rate_hz": "200"}), settings(fake.address))
    heard.until(lambda h: len(h.lengths) >= 4)
    assert fake.asked == ["START 200\n"]
    assert [s.length for s in heard.lengths[:2]] == pytest.approx([1.234567e-3, 1.2346e-3])
    assert [s.status for s in heard.lengths[:4]] == [
        *[LengthStatus.OK] * 2, LengthStatus.BEAM_BROKEN, LengthStatus.UNSTABLE
    ]  # fmt: skip
    assert [s.sequence for s in heard.lengths[:4]] == [0, 1, 2, 3]
    assert heard.lengths[0].stamp_ns == 7
    assert heard.lengths[3].length == pytest.approx(5e-6)


@pytest.mark.parametrize(
    ("talk", "said"),
    [
        ([b"1.0 OK\n"], "the tracer has closed the connection"),
        ([b"1.0 OK\n", b"ERROR laser is warming up\n"], "the tracer says: laser is warming up"),
        ([b"1.0 OK\n", b"one OK\n"], "not a length: 'one OK'"),
        (
            [b"1.0 OK\n", SILENCE],
            "no reading for 0.3 s: make sure that the instrument measures, or raise "
            "instrument.silence_s",
        ),
    ],
)
def test_a_lost_connection_is_named_and_made_again_behind_a_broken_beam(talk, said):
    fake = Fake(talk, [b"2.0 OK\n"])
    heard = Heard(mytracer.make(fake.address, {}), settings(fake.address))
    heard.until(lambda h: any(sample.length == 2e-6 for sample in h.lengths))
    assert heard.complaints[0] == (
        f"instrument mytracer at {fake.address}: {said}; tried again every 0.05 s"
    )
    first, behind, *rest = [(sample.length, sample.status) for sample in heard.lengths]
    again = next(found for found in rest if found[1] == LengthStatus.OK)
    assert (first, behind, again) == (
        (1e-6, LengthStatus.OK), (0.0, LengthStatus.BEAM_BROKEN), (2e-6, LengthStatus.OK)
    )  # fmt: skip


def test_an_instrument_that_is_not_there_is_named_once_and_waited_for():
    with socket.create_server(("127.0.0.1", 0)) as taken:
        address = f"127.0.0.1:{taken.getsockname()[1]}"
    heard = Heard(mytracer.make(address, {}), settings(address))
    time.sleep(0.3)
    heard.until(lambda h: h.complaints)
    assert len(heard.complaints) == 1
    assert "Connection refused" in heard.complaints[0]
    assert heard.driver.state.has(Why.CONNECTION_LOST)


class Finder(Tracker):
    """Finds the reflector 1 mm above where it should be, unless it is told not to."""

    def __init__(self, failing=0):
        self.failing = failing

    def connect(self):
        """Be there."""

    def measure(self, near, timeout_s):
        self.failing -= 1
        if self.failing >= 0:
            raise InstrumentError("no reflector")
        x, y, z = near
        return Place((x, y, z + 1e-3), (1e-6, 1e-6, 2e-6), stamp_ns=11)

    def close(self):
        """Be away."""


def test_an_order_is_measured_when_the_table_rests_and_echoed():
    rest = TableRestDetector(tolerance_arcsec=20.0, speed_deg_s=0.02, settle_s=0.5)
    heard = Heard(Finder(), settings("here"), rest.why_not)
    heard.driver.order(ORDER)
    assert rest.why_not(ORDER) == "no feedback of the table has come"
    for stamp_s, angle, velocity, why in (
        (0.0, 0.4, 0.1, "the table moves"),
        (0.1, 0.5, math.nan, "the feedback reports no velocity"),
        (0.2, 0.4, 0.0, "the table rests at 22.9183° and is ordered to 28.6479°"),
        (1.0, 0.5, 0.0, "the table has just come to rest"),
        (1.4, 0.5, 0.0, "the table has just come to rest"),
    ):
        rest.receive(TableSample(round(stamp_s * 1e9), angle, velocity))
        assert rest.why_not(ORDER) == why
    rest.receive(TableSample(1_500_000_000, 0.5 + 2 * 3.141592653589793, 0.0))  # a turn further
    (place,) = heard.until(lambda h: h.places).places
    assert (place.step, place.attempt, place.kind, place.target, place.station) == (
        3, 1, PointKind.DIRECT, 2, 1
    )  # fmt: skip
    assert place.position == pytest.approx((1.0, 2.0, 3.001))
    assert (place.position_std, place.stamp_ns) == ((1e-6, 1e-6, 2e-6), 11)


def test_an_order_that_waits_too_long_says_for_what(monkeypatch):
    monkeypatch.setattr("rotcal_ros.nodes.instrument_driver.driver.PATIENCE_S", 0.05)
    heard = Heard(Finder(), settings("here"), lambda _: "the table moves")
    heard.driver.order(ORDER)
    heard.until(lambda h: h.driver.waits)
    assert heard.driver.waits == "step 3 is not measured: the table moves"
    assert not heard.driver.trouble


def test_a_place_without_reflector_is_told_and_the_next_attempt_measured():
    heard = Heard(Finder(failing=1), settings("here"))
    heard.driver.order(ORDER)
    deadline = time.monotonic() + load_scaled_timeout(DEADLINE_S)
    while not heard.complaints and time.monotonic() < deadline:
        time.sleep(0.01)
    assert heard.complaints == ["step 3, attempt 1: no reflector"]
    heard.driver.order(ORDER)
    heard.until(lambda h: h.places)
    assert heard.driver.connections == 1


class Asked(Fake):
    """A MyTracer at 200 Hz, which answers each WHERE 50 ms later by the next of ``talks``."""

    def _serve(self):
        connection, _ = self._listener.accept()
        connection.settimeout(0.005)
        answers, due_s, sent = list(self._talks), [], 0
        with connection, suppress(OSError):
            while True:
                with suppress(TimeoutError):
                    self.asked.append(connection.recv(100).decode())
                    if "WHERE" in self.asked[-1]:
                        due_s.append(time.monotonic() + 0.05)
                answer = b""
                if due_s and time.monotonic() > due_s[0]:
                    due_s.pop()
                    answer = answers.pop(0)
                connection.sendall(b"%d.0 OK\n" % sent + answer)
                sent += 1


def asked(*answers):
    """Return a fake, and a MyTracer that it answers."""
    fake = Asked(*answers)
    tracer = mytracer.make(fake.address, {"rate_hz": "200"})
    tracer.connect()
    return fake, tracer


def test_a_place_is_awaited_among_the_lengths_and_none_of_these_is_lost():
    _, tracer = asked(b"PLACE 1.0 2.0 3.001\n", b"NONE\n")
    place = tracer.measure((1.0, 2.0, 3.0), DEADLINE_S)
    assert place.position == (1.0, 2.0, 3.001)
    with pytest.raises(InstrumentError, match="no reflector near"):
        tracer.measure((1.0, 2.0, 3.0), DEADLINE_S)
    before = time.time_ns()
    lengths = [*tracer.read(DEADLINE_S), *tracer.read(DEADLINE_S)]
    tracer.close()
    assert [round(length.length * 1e6) for length in lengths] == [*range(len(lengths))]
    stamps = [length.stamp_ns for length in lengths if length.stamp_ns is not None]
    assert len(stamps) >= 2
    assert stamps == sorted(stamps)
    assert all(stamp < before for stamp in stamps)  # not those of the reading, later


def test_no_answer_ends_the_connection_so_that_a_late_one_is_not_that_of_the_next_question():
    _, tracer = asked(b"")
    with pytest.raises(TimeoutError, match=r"no answer to WHERE within 0\.2 s"):
        tracer.measure((1.0, 2.0, 3.0), 0.2)
    tracer.close()


class Both(Tracer, Finder):
    """A slow tracer: a place takes longer than silence may last, and a length comes behind it."""

    measured, reads = False, 0

    def read(self, timeout_s):
        time.sleep(0.01)
        self.reads += self.measured
        return [Length(1.0)] if self.reads == 3 else []

    def measure(self, near, timeout_s):
        time.sleep(0.4)
        self.measured = True
        return super().measure(near, timeout_s)


def test_the_time_of_a_measurement_is_no_silence():
    heard = Heard(Both(), settings("here"))
    heard.driver.order(ORDER)
    heard.until(lambda h: h.lengths)
    assert not heard.complaints


class Wrong(Finder):
    def connect(self):
        raise KeyError("x")


def test_a_fault_of_the_plug_in_is_told_as_its_fault():
    heard = Heard(Wrong(), settings("here")).until(lambda h: h.complaints)
    assert "here: error of the plug-in: KeyError: 'x'" in heard.complaints[0]


@pytest.mark.parametrize(
    ("address", "options", "said"),
    [
        ("tracer", {}, "'tracer' is not host:port"),
        ("tracer:4000", {"rate": "5"}, "rate_hz=1 to rate_hz=1000"),
        ("tracer:4000", {"rate_hz": "0"}, "rate_hz=1 to rate_hz=1000"),
    ],
)
def test_an_address_or_option_that_it_cannot_use_is_refused(address, options, said):
    with pytest.raises(ConfigurationError, match=said):
        mytracer.make(address, options)


def test_a_plug_in_that_fails_while_it_is_made_is_named(monkeypatch):
    def make(address, options):
        return {}[address]

    monkeypatch.setattr(driver, "load", lambda *_: make)
    with pytest.raises(ConfigurationError, match=r"acme cannot be made: KeyError: 'here'"):
        make_instrument(InstrumentSettings(plugin="acme", address="here"))


def test_settings_without_a_plug_in_or_with_half_an_option_are_refused():
    with pytest.raises(ConfigurationError, match=r"unknown instrument \(instrument.plugin\) 'x'"):
        make_instrument(InstrumentSettings(plugin="x"))
    with pytest.raises(ConfigurationError, match="'rate' is not name=value"):
        InstrumentSettings(options=("rate",)).by_name()
