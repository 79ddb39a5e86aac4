"""The MyTracer, a laser tracer behind TCP: lines of text, lengths in micrometres.

It is made up; put your instrument's language in its place. After ``START n`` it sends n lines a
second::

    1234.567 OK        a length, um, longer the farther the reflector is
    1234.570 UNSTABLE  one that is not to be used
    0.000 NOBEAM       the beam is broken; lengths behind it count from another zero

``WHERE x y z`` (m, where the reflector should be) is answered, among the lengths, by
``PLACE x y z`` in metres or by ``NONE``. ``ERROR text`` may come at any time.
"""

import socket
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace

from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.nodes.instrument_driver.instrument import (
    InstrumentError,
    Length,
    Place,
    Tracer,
)

MICROMETRE = 1e-6
CONNECT_TIMEOUT_S = 3.0


class MyTracer(Tracer):  # (Tracer, Tracker): it answers orders on probe_target too
    """One MyTracer; ``rate_hz`` readings a second."""

    def __init__(self, host: str, port: int, rate_hz: int) -> None:
        self._address, self._rate_hz = (host, port), rate_hz
        self._socket: socket.socket | None = None
        self._text = b""
        self._kept: list[Length] = []  # came while a place was measured

    def connect(self) -> None:
        """Connect, and let it send lengths."""
        self._text, self._kept = b"", []
        self._socket = socket.create_connection(self._address, CONNECT_TIMEOUT_S)
        self._socket.sendall(f"START {self._rate_hz}\n".encode())

    def read(self, timeout_s: float) -> Sequence[Length]:
        """Return what came; a line that is no length is an error, never a wrong number."""
        kept, self._kept = self._kept, []
        return kept or [self._length(line) for line in self._lines(timeout_s)]

    def measure(self, near: tuple[float, float, float], timeout_s: float) -> Place:
        """Ask where the reflector is, and wait for the answer among the lengths."""
        assert self._socket is not None
        self._socket.sendall("WHERE {} {} {}\n".format(*near).encode())
        place, deadline_s = None, time.monotonic() + timeout_s
        while place is None and (left_s := deadline_s - time.monotonic()) > 0:
            for line in self._lines(left_s):
                word, _, rest = line.partition(" ")
                if word in ("PLACE", "NONE"):
                    place = rest
                else:
                    self._kept.append(replace(self._length(line), stamp_ns=time.time_ns()))
        if place is None:  # begin anew: a late answer is not one to the next question
            raise TimeoutError(f"no answer to WHERE within {timeout_s:g} s")
        if not place:
            raise InstrumentError(f"no reflector near {near}")
        try:
            x, y, z = map(float, place.split())
        except ValueError as error:
            raise InstrumentError(f"not a place: {place!r:.60}") from error
        return Place((x, y, z))

    def close(self) -> None:
        """Let go of the connection."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _length(self, line: str) -> Length:
        number, _, state = line.partition(" ")
        if number == "ERROR":
            raise InstrumentError(f"the tracer says: {state}")
        try:
            length = float(number) * MICROMETRE
        except ValueError as error:
            raise InstrumentError(f"not a length: {line!r:.60}") from error
        return Length(length, valid=state != "NOBEAM", stable=state == "OK")

    def _lines(self, timeout_s: float) -> list[str]:
        """Return the whole lines that came; the rest waits for its end."""
        assert self._socket is not None
        self._socket.settimeout(timeout_s)
        try:
            received = self._socket.recv(65536)
        except TimeoutError:
            return []
        if not received:
            raise ConnectionError("the tracer has closed the connection")
        *whole, self._text = (self._text + received).split(b"\n")
        return [line.decode("ascii", "replace").strip() for line in whole]


def make(address: str, options: Mapping[str, str]) -> MyTracer:
    """Return a tracer at ``host:port``; options: ``rate_hz`` (1 to 1000, 100 unless given)."""
    host, colon, port = address.rpartition(":")
    rate_hz = options.get("rate_hz", "100")
    if not (colon and port.isdigit()):
        raise ConfigurationError(f"instrument.address: {address!r:.80} is not host:port")
    if set(options) - {"rate_hz"} or not (rate_hz.isdigit() and 1 <= int(rate_hz) <= 1000):
        raise ConfigurationError("instrument.options: rate_hz=1 to rate_hz=1000 is all there is")
    return MyTracer(host, int(port), int(rate_hz))
