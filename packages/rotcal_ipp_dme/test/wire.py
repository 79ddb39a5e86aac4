"""A DME server that answers by a script, to fail in every way that a wire can."""

import socket
import time
from threading import Thread

from rotcal_ipp_dme.protocol import parse_call
from rotcal_ros.foundation.machine_load import load_scaled_timeout

ANSWERS = {
    "GetDMEVersion": ['DMEVersion("1.4.3")'],
    "IsHomed": ["IsHomed(0)"],
    "EnumTools": ['"RefTool"', '"Probe1"'],
    "EnumAllProp": ['"PtMeasPar.Approach", "Number"', '"PtMeasPar.Search", "Number"'],
    "GetProp": ["Tool.AvrRadius(1.5)"],
    "Get": ["X(1), Y(2), Z(300), R(0)"],
    "PtMeas": ["X(1.001), Y(2), Z(3), R(0)"],
    "AlignPart": ["(1, 0, 0, 1, 0, 0)"],
}
LATE_S = 0.1
DEADLINE_S = 10.0


def wait_for(condition):
    deadline = time.monotonic() + load_scaled_timeout(DEADLINE_S)
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.005)


class ScriptedServer:
    """Serves one connection after the other; ``fault`` is done instead of answering ``harmed``.

    ``heard`` holds the calls of all clients in their order, ``answers`` the data of each method.
    """

    def __init__(self, harmed="", fault="", answers=None):
        self.harmed, self.fault, self.heard = harmed, fault, []
        self.answers = ANSWERS | (answers or {})
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = self._listener.getsockname()[1]
        self._open = []
        Thread(target=self._serve, daemon=True).start()

    def names(self):
        return [call.name for call in self.heard]

    def tell(self, text):
        """Say something that nobody asked for."""
        self._open[-1].sendall(f"{text}\r\n".encode())

    def close(self):
        for connection in (self._listener, *self._open):
            connection.close()

    def _serve(self):
        while True:
            try:
                connection, _ = self._listener.accept()
            except OSError:
                return
            self._open.append(connection)
            Thread(target=self._converse, args=(connection,), daemon=True).start()

    def _converse(self, connection):
        with connection, connection.makefile("rb") as lines:
            try:
                for line in lines:
                    tag, _, text = line.decode().rstrip("\r\n").partition(" ")
                    call = parse_call(text)
                    self.heard.append(call)
                    if call.name == self.harmed:
                        if self._harm(connection, tag):
                            return
                    else:
                        self._answer(connection, tag, call)
            except OSError:
                return

    def _answer(self, connection, tag, call):
        data = "".join(f"{tag} # {line}\r\n" for line in self.answers.get(call.name, ()))
        connection.sendall(f"{tag} &\r\n{data}{tag} %\r\n".encode())

    def _harm(self, connection, tag):
        """Do the fault; return whether the connection is to be closed."""
        accepted, done = f"{tag} &\r\n".encode(), f"{tag} %\r\n".encode()
        error = f'{tag} ! Error(3, 2500, "Here", "Machine limit encountered")\r\n'.encode()
        if self.fault == "late":
            time.sleep(LATE_S)
            self._answer(connection, tag, self.heard[-1])
            return False
        wrong = {
            "never": b"",
            "closed": b"",
            "accepted, never done": accepted,
            "error": accepted + error + done,
            "error without end": accepted + error,
            "error at once": error + done,
            "cut in the middle": accepted + f"{tag} # X(1.0".encode(),
            "no line of the protocol": b"HTTP/1.1 400 Bad Request\r\n\r\n",
            "a line without end": b"0" * 70_000,
        }
        connection.sendall(wrong[self.fault])
        return self.fault in ("closed", "cut in the middle")
