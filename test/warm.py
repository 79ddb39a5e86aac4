"""Processes of Python as copies of one that has imported the suite.

A fresh process spends a second of processor time on imports before its first line runs, the nodes
of a short calibration more than all that they do then. Tests that ask what a command or a node
does, and not how a process begins, start it here; cli/test_cli_main.py, nodes/test_run.py,
cli/test_solve_loads_little.py and api/test_names.py start theirs anew.

    server ADDRESS KIND    import all, with ROS or without, then copy this process for who asks
    client ADDRESS ...     ask for a copy with these streams, this folder and this environment
"""

from __future__ import annotations

import atexit
import ctypes
import fcntl
import gc
import inspect
import json
import os
import re
import signal
import socket
import subprocess
import sys
import termios
import threading
import time
from collections.abc import Iterable, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from itertools import count
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any, NoReturn

ROOT = Path(__file__).parents[1]
PACKAGES = ("rotcal_ros", *(path.parent.name for path in ROOT.glob("packages/*/setup.py")))
ROTCAL = ("-m", "rotcal_ros.cli.main")
WITH_ROS = re.compile(r"rotcal_ros\.(nodes|ros)\b|rotcal_\w+\.node\b")
"""What needs ROS, or starts it."""
START_NODES = ("run", "verify", "doctor")
"""Commands whose own processes begin as copies, too."""
LOADED_LATE = ("rosidl_generator_py", "type_description_interfaces.srv", "scipy.interpolate")
"""What each node imports once it runs."""
NOT_COPIED = ("LD_PRELOAD", "LD_LIBRARY_PATH")
"""Variables that count from the first instruction of a process."""
REQUEST_BYTES = 1 << 20
CRASHED = 70
SET_DEATH_SIGNAL, SET_NAME, SET_CHILD_SUBREAPER = 1, 15, 36
"""Options of prctl(2): what a child hears when its parent dies, its name, who adopts orphans."""
numbers = count()
servers: dict[int, WarmServer] = {}
"""That with ROS of each process; a copy remembers those of its parents."""


class WarmServer:
    """The process to copy, as whoever started it sees it."""

    def __init__(self, environment: Mapping[str, str] = os.environ, *, ros: bool = False) -> None:
        self.address, self.environment = new_address(), environment
        self._process: subprocess.Popen[bytes] | None = subprocess.Popen(
            [sys.executable, __file__, "server", self.address, "ros" if ros else "alone"],
            stdout=subprocess.PIPE,
            env={**environment, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"},
            start_new_session=True,
        )
        assert self._process.stdout is not None
        assert self._process.stdout.readline() == b"ready\n"

    @classmethod
    def of_this_process(cls) -> WarmServer:
        """Let a copy of this process serve; it ends with this one."""
        made = cls.__new__(cls)
        made.address, made.environment, made._process = new_address(), os.environ, None
        with listening(made.address) as asked:
            if os.fork() == 0:
                os.setsid()
                with Path(os.devnull).open("r+b", buffering=0) as nothing:
                    for stream in range(3):
                        os.dup2(nothing.fileno(), stream)
                serve(asked)
        return made

    def close(self) -> None:
        """End it; whoever runs already runs on."""
        if self._process is not None:
            self._process.terminate()
            self._process.communicate()

    def program(self, kind: str) -> str:
        """Return a script of the shell that runs as ``rotcal`` or ``python`` would."""
        client = f"{sys.executable} -IS {__file__} client {self.address}"
        return f'#!/bin/sh\nexec {" ".join([client, *leading(kind)])} "$@"\n'

    def start(self, kind: str, *arguments: object, **options: Any) -> Copy:
        """Start ``rotcal`` or ``python``; options as of subprocess.Popen."""
        command = [sys.executable, *leading(kind), *map(str, arguments)]
        return Copy(command, server=self, **{"env": self.environment, **options})

    def run(
        self, kind: str, *arguments: object, folder: Path | None = None, **options: Any
    ) -> subprocess.CompletedProcess[str]:
        """Run a command in a folder and return its exit code and what it printed."""
        piped = {"stdin": subprocess.DEVNULL, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
        with self.start(kind, *arguments, cwd=folder, text=True, **piped, **options) as process:
            texts = process.communicate()
        return subprocess.CompletedProcess(process.args, process.wait(), *texts)


def server_with_ros() -> WarmServer:
    """Return that of this process whose copies have imported the nodes; started when needed."""
    if os.getpid() not in servers:
        servers[os.getpid()] = WarmServer(ros=True)
        atexit.register(servers[os.getpid()].close)
    return servers[os.getpid()]


class Copy:
    """A child, copied from a server and then handed over; what tests use of subprocess.Popen."""

    def __init__(
        self,
        command: Sequence[Any],
        *,
        server: WarmServer,
        env: Mapping[str, str] | None = None,
        cwd: Path | None = None,
        start_new_session: bool = False,
        pass_fds: Iterable[int] = (),
        text: bool = False,
        **streams: Any,
    ) -> None:
        self.args, self.text = command, text
        self.returncode: int | None = None
        self.stdin: Any = None
        self.stdout: Any = None
        self.stderr: Any = None
        self._looking = threading.Lock()
        request = asking(command[1:], env, cwd)
        request |= {"parent": os.getpid(), "new_session": start_new_session}
        with ExitStack() as closing:
            ends = [
                self._end(number, name, streams.get(name), closing)
                for number, name in enumerate(("stdin", "stdout", "stderr"))
            ]
            with adopting(), ask(server.address, request, [*ends, *pass_fds]) as asked:
                self.pid = int(asked.recv(20))
                while parent_of(self.pid) != os.getpid():
                    time.sleep(0.001)

    def _end(self, number: int, name: str, stream: Any, closing: ExitStack) -> int:
        """Return what the child has as a stream; ours of a pipe is an attribute."""
        if stream is None:
            return number
        if stream == subprocess.PIPE:
            ends = os.pipe()
            theirs, ours = ends if number == 0 else ends[::-1]
            mode = ("w" if number == 0 else "r") + ("" if self.text else "b")
            setattr(self, name, os.fdopen(ours, mode, encoding="utf-8" if self.text else None))
        elif stream == subprocess.DEVNULL:
            theirs = os.open(os.devnull, os.O_RDWR)
        else:
            return stream if isinstance(stream, int) else int(stream.fileno())
        closing.callback(os.close, theirs)
        return theirs

    def __enter__(self) -> Copy:
        return self

    def __exit__(self, *_error: object) -> None:
        for stream in filter(None, (self.stdin, self.stdout, self.stderr)):
            with suppress(OSError):
                stream.close()
        self.wait()

    def poll(self) -> int | None:
        """Return the exit code, None while it runs."""
        with self._looking:
            if self.returncode is None:
                ended, status = os.waitpid(self.pid, os.WNOHANG)
                self.returncode = os.waitstatus_to_exitcode(status) if ended else None
            return self.returncode

    def wait(self, timeout: float | None = None) -> int:
        """Return the exit code when it has ended."""
        begun = time.monotonic()
        while (code := self.poll()) is None:
            if timeout is not None and time.monotonic() - begun > timeout:
                raise subprocess.TimeoutExpired(self.args, timeout)
            time.sleep(0.002)
        return code

    def communicate(self, words: Any = None, timeout: float | None = None) -> tuple[Any, Any]:
        """Write ``words`` to it, and return what it writes until it ends."""
        found: dict[str, Any] = {"stdout": None, "stderr": None}

        def read(name: str) -> None:
            if (stream := getattr(self, name)) is not None:
                found[name] = stream.read()

        readers = [threading.Thread(target=read, args=(name,), daemon=True) for name in found]
        for reader in readers:
            reader.start()
        if self.stdin is not None:
            with suppress(BrokenPipeError):
                if words:
                    self.stdin.write(words)
                self.stdin.close()
        self.wait(timeout)
        for reader in readers:
            reader.join()
        return found["stdout"], found["stderr"]

    def send_signal(self, number: int) -> None:
        """Send a signal, unless it has ended."""
        if self.poll() is None:
            os.kill(self.pid, number)

    def terminate(self) -> None:
        """Ask it to end."""
        self.send_signal(signal.SIGTERM)

    def kill(self) -> None:
        """End it."""
        self.send_signal(signal.SIGKILL)


def popen(command: Sequence[Any], **options: Any) -> subprocess.Popen[Any] | Copy:
    """Start a process as subprocess.Popen does; one of the suite, or a script, as a copy."""
    environment = options.get("env") or os.environ
    first, second, third = [*map(str, command), "", ""][:3]
    ours = (second == "-m" and third.partition(".")[0] in PACKAGES) or second.endswith(".py")
    other = any(environment.get(name) != os.environ.get(name) for name in NOT_COPIED)
    if first != sys.executable or not ours or other:
        return subprocess.Popen(command, **options)
    return Copy(command, server=server_with_ros(), **options)


def run(
    command: Sequence[Any], *, timeout: float | None = None, **options: Any
) -> subprocess.CompletedProcess[Any]:
    """Run a process with its output captured, as subprocess.run does; see :func:`popen`."""
    piped = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    with popen(command, **piped | options) as process:
        try:
            texts = process.communicate(timeout=timeout)
        except subprocess.TimeoutExpired:
            process.kill()
            raise
    return subprocess.CompletedProcess(process.args, process.wait(), *texts)


WARM_SUBPROCESS = SimpleNamespace(**{**vars(subprocess), "Popen": popen})
"""What stands in a module for ``subprocess``, so that it starts copies."""


def leading(kind: str) -> tuple[str, ...]:
    return ROTCAL if kind == "rotcal" else ()


def new_address() -> str:
    """Return an address of an abstract socket that nobody has."""
    return f"@rotcal-warm-{os.getpid()}-{next(numbers)}"


def at(address: str) -> str:
    return address.replace("@", "\0", 1)


def listening(address: str) -> socket.socket:
    asked = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    asked.bind(at(address))
    asked.listen(16)
    return asked


def asking(
    arguments: Iterable[Any], environment: Mapping[str, str] | None, folder: Any
) -> dict[str, Any]:
    """Return what to ask for: a process of Python with these arguments."""
    return {
        "arguments": list(map(str, arguments)),
        "environment": dict(os.environ if environment is None else environment),
        "folder": str(folder or Path.cwd()),
    }


def ask(address: str, request: Mapping[str, Any], streams: Sequence[int]) -> socket.socket:
    """Ask the server at ``address`` for a copy with these streams; the socket gives the answer."""
    asked = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    asked.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, REQUEST_BYTES)
    asked.connect(at(address))
    socket.send_fds(asked, [json.dumps(request).encode()], streams)
    return asked


@contextmanager
def adopting() -> Any:
    """Take over as children the orphans that fall meanwhile below this process, for init."""
    prctl(SET_CHILD_SUBREAPER, 1)
    try:
        yield
    finally:
        prctl(SET_CHILD_SUBREAPER, 0)


def prctl(option: int, value: int | bytes) -> None:
    ctypes.CDLL(None).prctl(option, value, 0, 0, 0)


def parent_of(process: int) -> int:
    status = Path(f"/proc/{process}/stat").read_text(encoding="utf-8", errors="replace")
    return int(status.rpartition(")")[2].split()[1])


def serve(asked: socket.socket) -> NoReturn:
    """Copy this process for everyone who asks, until its parent dies."""
    prctl(SET_DEATH_SIGNAL, signal.SIGKILL)
    while True:
        client, _ = asked.accept()
        if os.fork() == 0:
            asked.close()
            attend(client)
        client.close()
        with suppress(ChildProcessError):
            while os.waitpid(-1, os.WNOHANG)[0]:
                pass


def attend(client: socket.socket) -> NoReturn:
    """Make the copy that is asked for. Hand it over, or tell its exit code."""
    text, streams, *_ = socket.recv_fds(client, REQUEST_BYTES, 16)
    request = json.loads(text)
    process = os.fork()
    if process == 0:
        client.close()
        become(request, streams)
    for stream in streams:
        os.close(stream)
    answer = process
    if "parent" not in request:
        answer = os.waitstatus_to_exitcode(os.waitpid(process, 0)[1])
    client.send(str(answer).encode())
    os._exit(0)


def become(request: Mapping[str, Any], streams: Sequence[int]) -> NoReturn:
    """Run as ``python`` with the arguments of the request."""
    while os.getppid() != request.get("parent", os.getppid()):
        time.sleep(0.001)
    for number, stream in enumerate(streams[:3]):
        os.dup2(stream, number)
        os.close(stream)
    if request.get("new_session"):
        os.setsid()
        if os.isatty(0):
            fcntl.ioctl(0, termios.TIOCSCTTY, 0)
    os.chdir(request["folder"])
    os.environ.clear()
    os.environ.update(request["environment"])
    sys.stdin, sys.stdout, sys.stderr = (
        open(n, "rww"[n], 1, "utf-8", errors, closefd=False)  # noqa: SIM115
        for n, errors in enumerate(("strict", "strict", "backslashreplace"))
    )
    code = 1
    try:
        begin(request["arguments"])
        code = 0
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else int(end.code is not None)
        if isinstance(end.code, str):
            print(end.code, file=sys.stderr)  # noqa: T201
    except BaseException:
        sys.excepthook(*sys.exc_info())
    leave(code)


def leave(code: int) -> NoReturn:
    """End as ``python`` would, but before the libraries of the middleware are unloaded.

    Their destructors were made for processes that did not begin as a copy, and now and then crash.
    """
    threading._shutdown()  # type: ignore[attr-defined]
    atexit._run_exitfuncs()
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError):
            stream.flush()
    os._exit(code)


def begin(arguments: Sequence[str]) -> None:
    """Run a module, ``-c TEXT``, ``-`` or a file, as ``python`` would."""
    first, *rest = arguments
    paths = filter(None, os.environ.get("PYTHONPATH", "").split(os.pathsep))
    sys.path[:0] = [path for path in paths if path not in sys.path]
    if first == "-m":
        import importlib

        module = importlib.import_module(rest.pop(0))
        prctl(SET_NAME, module.__name__.removesuffix(".node").rpartition(".")[2].encode())
        sys.argv = [str(module.__file__), *rest]
        if ("-m", module.__name__) == ROTCAL and rest and rest[0] in START_NODES:
            start_copies()
        module.main()
        return
    sys.argv = [first, *rest]
    if first in ("-c", "-"):
        text = rest.pop(0) if first == "-c" else sys.stdin.read()
        sys.argv = [first, *rest]
        sys.path.insert(0, "")
        exec(compile(text, "<string>", "exec"), {"__name__": "__main__"})
        return
    import runpy

    sys.path.insert(0, str(Path(first).resolve().parent))
    runpy.run_path(first, run_name="__main__")


def start_copies() -> None:
    """Let the processes of a session begin as copies of this one, where that knows the nodes."""
    if "rotcal_ros.nodes.planner.node" not in sys.modules:
        return
    processes: ModuleType = sys.modules["rotcal_ros.sessions.processes"]
    servers[os.getpid()] = WarmServer.of_this_process()
    processes.subprocess = WARM_SUBPROCESS  # type: ignore[attr-defined]


def import_all(ros: bool) -> None:
    """Import the suite, and what optional libraries there are."""
    import pkgutil
    from importlib import import_module

    for package in PACKAGES:
        with suppress(ImportError):
            place = import_module(package).__path__
            for module in pkgutil.walk_packages(place, f"{package}."):
                if module.name.endswith("__main__") or (not ros and WITH_ROS.match(module.name)):
                    continue
                with suppress(ImportError):
                    import_module(module.name)
    if ros:
        for name in LOADED_LATE:
            import_module(name)
        inspect.getframeinfo(inspect.currentframe())  # whoever first logs looks at every module
    gc.freeze()  # or the collector would touch, and so copy, all of that in each copy


def main() -> None:
    """Serve, or ask."""
    signal.signal(signal.SIGINT, signal.default_int_handler)
    role, address, *words = sys.argv[1:]
    if role == "client":
        with ask(address, asking(words, None, None), (0, 1, 2)) as asked:
            sys.exit(int(asked.recv(20) or CRASHED))
    import_all(words == ["ros"])
    with listening(address) as asked:
        print("ready", flush=True)  # noqa: T201
        serve(asked)


if __name__ == "__main__":
    main()
