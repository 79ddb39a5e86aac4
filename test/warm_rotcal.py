"""``rotcal`` and ``python`` as copies of one process that has imported the suite without ROS.

A fresh process spends most of a second of processor time on imports before its first line runs.
Tests that ask what a command does, and not how a process begins, start it here;
cli/test_cli_main.py, cli/test_solve_loads_little.py and api/test_names.py start theirs anew.

    server SOCKET              import all, then copy this process for everyone who asks
    client SOCKET KIND ...     ask, with these streams, this folder and this environment
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

REQUEST_BYTES = 1 << 20
NOT_IMPORTED = ("rotcal_ros.nodes", "rotcal_ros.ros", "rotcal_ros.api.ros")
"""What needs ROS, or starts it."""
CRASHED = 70


class WarmRotcal:
    """The process to copy, as the tests see it."""

    def __init__(self, folder: Path, environment: Mapping[str, str] = os.environ) -> None:
        self.address, self.environment = str(folder / "warm"), environment
        self._process = subprocess.Popen(
            [sys.executable, __file__, "server", self.address],
            stdout=subprocess.PIPE,
            env={**environment, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"},
        )
        assert self._process.stdout is not None
        assert self._process.stdout.readline() == b"ready\n"

    def close(self) -> None:
        """End it; whoever runs already runs on."""
        self._process.terminate()
        self._process.communicate()

    def program(self, kind: str) -> str:
        """Return a script of the shell that runs as ``rotcal`` or ``python`` would."""
        return (
            f'#!/bin/sh\nexec {sys.executable} -IS {__file__} client {self.address} {kind} "$@"\n'
        )

    def start(
        self,
        kind: str,
        arguments: Sequence[object],
        streams: tuple[int, int, int],
        environment: Mapping[str, str],
        folder: Path | None = None,
    ) -> socket.socket:
        """Start a command with these streams; :func:`code_of` waits for its end."""
        words = [str(one) for one in arguments]
        return ask(self.address, kind, words, streams, environment, folder or Path.cwd())

    def run(
        self, kind: str, *arguments: object, folder: Path | None = None
    ) -> subprocess.CompletedProcess[str]:
        """Run a command in a folder and return its exit code and what it printed."""
        with open(os.devnull) as nothing, memory() as out, memory() as err:  # noqa: PTH123
            streams = (nothing.fileno(), out.fileno(), err.fileno())
            code = code_of(self.start(kind, arguments, streams, self.environment, folder))
            texts = [os.pread(file.fileno(), 1 << 30, 0).decode() for file in (out, err)]
        return subprocess.CompletedProcess(list(map(str, arguments)), code, *texts)


@contextlib.contextmanager
def memory() -> Iterator[Any]:
    """Return a file that is in no folder."""
    with os.fdopen(os.memfd_create("stream"), "wb") as file:
        yield file


def ask(
    address: str,
    kind: str,
    arguments: Sequence[str],
    streams: tuple[int, int, int],
    environment: Mapping[str, str],
    folder: Path,
) -> socket.socket:
    """Ask the server at ``address`` for a copy that runs these arguments."""
    request = {
        "kind": kind, "arguments": arguments, "folder": str(folder),
        "environment": dict(environment),
    }  # fmt: skip
    asked = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    asked.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, REQUEST_BYTES)
    asked.connect(address)
    socket.send_fds(asked, [json.dumps(request).encode()], streams)
    return asked


def code_of(asked: socket.socket) -> int:
    """Wait for the end of a command and return its exit code."""
    with asked:
        return int(asked.recv(20) or CRASHED)


def serve(address: str) -> None:
    """Copy this process for everyone who asks; return in a copy only by SystemExit."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as asked:
        asked.bind(address)
        asked.listen(16)
        print("ready", flush=True)  # noqa: T201
        while True:
            client, _ = asked.accept()
            if os.fork() == 0:
                asked.close()
                os._exit(_answer(client))
            client.close()
            with contextlib.suppress(ChildProcessError):
                while os.waitpid(-1, os.WNOHANG)[0]:
                    pass


def _answer(client: socket.socket) -> int:
    """Run what is asked for, tell the exit code, and return it."""
    text, streams, *_ = socket.recv_fds(client, REQUEST_BYTES, 3)
    request = json.loads(text)
    for number, stream in enumerate(streams):
        os.dup2(stream, number)
        os.close(stream)
    os.chdir(request["folder"])
    os.environ.clear()
    os.environ.update(request["environment"])
    sys.stdin, sys.stdout, sys.stderr = (
        open(n, mode, encoding="utf-8", closefd=False)  # noqa: SIM115
        for n, mode in enumerate("rww")
    )
    code = 0
    try:
        _run(request["kind"], request["arguments"])
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else int(end.code is not None)
    except BaseException:
        sys.excepthook(*sys.exc_info())
        code = 1
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError):
            stream.flush()
    client.send(str(code).encode())
    return code


def _run(kind: str, arguments: list[str]) -> None:
    """Run ``rotcal``, or ``python -c TEXT``, ``python -`` or ``python FILE``."""
    if kind == "rotcal":
        from rotcal_ros.cli import main

        sys.argv = [str(main.__file__), *arguments]
        main.main()
        return
    first, *rest = arguments
    if first in ("-c", "-"):
        text = rest.pop(0) if first == "-c" else sys.stdin.read()
        sys.path.insert(0, "")
        sys.argv = [first, *rest]
        exec(compile(text, "<string>", "exec"), {"__name__": "__main__"})
        return
    import runpy

    sys.argv = [first, *rest]
    sys.path.insert(0, str(Path(first).resolve().parent))
    runpy.run_path(first, run_name="__main__")


def _import_all() -> None:
    """Import the suite but for what needs ROS, and what drawing needs."""
    import pkgutil
    from importlib import import_module

    import rotcal_ros

    for module in pkgutil.walk_packages(rotcal_ros.__path__, "rotcal_ros."):
        if not module.name.startswith(NOT_IMPORTED) and not module.name.endswith("__main__"):
            with contextlib.suppress(ImportError):
                import_module(module.name)


def main() -> None:
    """Serve, or ask."""
    signal.signal(signal.SIGINT, signal.default_int_handler)
    role, address, *words = sys.argv[1:]
    if role == "client":
        kind, *arguments = words
        sys.exit(code_of(ask(address, kind, arguments, (0, 1, 2), os.environ, Path.cwd())))
    _import_all()
    serve(address)


if __name__ == "__main__":
    main()
