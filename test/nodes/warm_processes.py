"""Nodes forked from one process that has imported all that they import, methods too.

Imports are half of the work of a short cell: a node costs 1.1 s of processor time before its first
line runs, a cell of seven as much as its whole short calibration. ``rotcal run``, the demos and
``check_colcon.sh`` start theirs anew.
"""

from __future__ import annotations

import atexit
import ctypes
import json
import os
import pkgutil
import socket
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

import rotcal_ros
from rotcal_ros.sessions.processes import Processes

PREFIX = "rotcal_ros.nodes."
REQUEST_BYTES = 1 << 17
SET_CHILD_SUBREAPER = 36
"""Option of prctl(2): who takes over the children of those below that die."""
NOT_FORKED = ("LD_PRELOAD",)
"""Variables that count from the first instruction of a process."""


@dataclass
class WarmProcesses(Processes):
    """As Processes; a node begins as a copy of a process that has imported it."""

    def start(self, name: str, command: Sequence[str], *, piped: bool = False) -> None:
        environment = {**os.environ, **self.environment}
        if list(command[:2]) != [sys.executable, "-m"] or not command[2].startswith(PREFIX):
            return super().start(name, command, piped=piped)
        if environment.keys() & set(NOT_FORKED):
            return super().start(name, command, piped=piped)
        with (self.log_folder / f"{name}.log").open("wb") as log:
            self.children[name] = Copy(
                command,
                env=environment,
                stdin=subprocess.PIPE if piped else subprocess.DEVNULL,
                stdout=subprocess.PIPE if piped else log,
                stderr=log,
            )
        return None


class Copy(subprocess.Popen[bytes]):
    """A child like any other, forked by the server and then handed over to this process."""

    def _execute_child(self, args: Sequence[str], *more: Any) -> None:
        environment, pipes = more[5], more[9:15]
        self.pid = server().start(args[2:], environment, (pipes[0], pipes[3], pipes[5]))
        self._child_created = True
        self._close_pipe_fds(*pipes)


class Server:
    """The process with all nodes imported, as its one client sees it."""

    def __init__(self) -> None:
        self._socket, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with theirs:
            self._process = subprocess.Popen(
                [sys.executable, __file__, str(theirs.fileno())],
                env={**os.environ, "OMP_NUM_THREADS": "1", "PYTHONUNBUFFERED": "1"},
                pass_fds=(theirs.fileno(),),
                start_new_session=True,
            )
        atexit.register(self.close)

    def start(
        self, command: Sequence[str], environment: Mapping[str, str], streams: tuple[int, ...]
    ) -> int:
        """Fork a node with these three streams; return its process id, now of a child of ours."""
        request = {
            "argv": list(command), "environment": dict(environment),
            "folder": str(Path.cwd()), "parent": os.getpid(), "path": sys.path,
        }  # fmt: skip
        adopt(True)
        try:
            socket.send_fds(self._socket, [json.dumps(request).encode()], streams)
            return int(self._socket.recv(REQUEST_BYTES))
        finally:
            adopt(False)

    def close(self) -> None:
        """Let the server end; it does so when nobody can ask it any more."""
        self._socket.close()
        self._process.wait()


@cache
def server() -> Server:
    """Return the server of this process; the first call starts it."""
    return Server()


def adopt(wanted: bool) -> None:
    """Say whether orphans below this process become its own children, or those of init."""
    ctypes.CDLL(None).prctl(SET_CHILD_SUBREAPER, int(wanted), 0, 0, 0)


def serve(asked: socket.socket) -> None:
    """Fork a node for every request until the other side is closed; in a node it returns never."""
    while True:
        text, streams, *_ = socket.recv_fds(asked, REQUEST_BYTES, 3)
        if not text:
            return
        told, telling = os.pipe()
        between = os.fork()
        if between == 0:
            node = os.fork()
            if node == 0:
                asked.close()
                os.close(told)
                os.close(telling)
                become(json.loads(text), streams)
            os.write(telling, str(node).encode())
            os._exit(0)
        os.waitpid(between, 0)  # from here on the node is a child of the one who asked
        asked.send(os.read(told, 20))
        for number in (told, telling, *streams):
            os.close(number)


def become(request: Mapping[str, Any], streams: Sequence[int]) -> None:
    """Run a node as ``python -m`` would; end the process."""
    while os.getppid() != request["parent"]:
        time.sleep(0.001)
    os.setsid()
    for number, stream in enumerate(streams):
        os.dup2(stream, number)
        os.close(stream)
    os.chdir(request["folder"])
    os.environ.clear()
    os.environ.update(request["environment"])
    sys.path[:] = request["path"]
    module, *arguments = request["argv"]
    node = import_module(module)
    sys.argv = [str(node.__file__), *arguments]
    ending.code = 1
    try:
        node.main()
        ending.code = 0
    except SystemExit as end:
        ending.code = end.code if isinstance(end.code, int) else int(end.code is not None)
        raise
    sys.exit(0)


class Ending:
    """The last that a copy does in Python, before the libraries of the middleware are unloaded.

    Their destructors were made for processes that did not begin as a copy, and now and then crash.
    """

    code = 0

    def __call__(self) -> None:
        """Leave with the code of the node."""
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(self.code)


ending = Ending()


def main() -> None:
    """Import all nodes, then fork whichever is asked for."""
    atexit.register(ending)  # the first is the last to be called
    asked = socket.socket(fileno=int(sys.argv[1]))
    for module in pkgutil.walk_packages(rotcal_ros.__path__, "rotcal_ros."):
        with suppress(ImportError):  # what an optional library is missing for
            import_module(module.name)
    serve(asked)


if __name__ == "__main__":
    main()
