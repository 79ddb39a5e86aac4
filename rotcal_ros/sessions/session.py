"""One run of a cell: its folder, its configuration, its processes."""

from __future__ import annotations

import json
import os
import signal
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from queue import SimpleQueue
from threading import Thread
from types import TracebackType
from typing import Any, Final

from rotcal_ros.catalogue import Calibration, Configuration, changed, prepare, read_configuration
from rotcal_ros.catalogue.continuation import Continuation
from rotcal_ros.errors import ConfigurationError
from rotcal_ros.files import FolderLock
from rotcal_ros.middleware import middleware
from rotcal_ros.node_names import FURTHER_NODES, NODES
from rotcal_ros.sessions.domains import free_domain
from rotcal_ros.sessions.processes import Processes

SIMULATION: Final = "simulation"
CLIENT: Final = "client"
BAG: Final = "bag"
"""Folder of the bag inside the session folder."""


@dataclass(frozen=True)
class Session:
    """A checked configuration and the folder that takes everything.

    ``continuation`` says what is left of an interrupted plan.
    """

    calibration: Calibration
    folder: Path
    continuation: Continuation | None = None

    @property
    def configuration(self) -> Configuration:
        """The configuration with all changes, as it stands in the folder."""
        return self.calibration.configuration

    @property
    def configuration_file(self) -> Path:
        """The configuration in the folder: also the parameter file of the nodes."""
        return self.folder / "configuration.yaml"

    @property
    def log_folder(self) -> Path:
        """Where the nodes' output goes."""
        run = f"_{self.continuation.run}" if self.continuation else ""
        return self.folder / f"log{run}"

    @property
    def continuation_file(self) -> Path:
        """Where the nodes read what is left of the plan."""
        assert self.continuation is not None
        return self.folder / f"continuation_{self.continuation.run}.json"

    @property
    def something_left(self) -> bool:
        """Whether there are steps to measure."""
        return self.continuation is None or bool(self.continuation.steps)

    @property
    def simulated(self) -> bool:
        """Whether the cell is a simulated one."""
        return self.configuration.simulated

    @property
    def further_nodes(self) -> list[str]:
        """The nodes that run only when the configuration has a group for them."""
        given = self.configuration.given
        return [node for group, node in FURTHER_NODES.items() if group in given]

    def start(self) -> RunningSession:
        """Start the nodes and the client; a context manager that ends them."""
        return RunningSession(self)


class RunningSession:
    """The processes of a session; ``events`` holds what the client tells, then ``end``."""

    def __init__(self, session: Session) -> None:
        self._lock = FolderLock(session.folder)
        inherited = (self._lock.descriptor,)
        self._processes = Processes(session.log_folder, node_environment(), inherited)
        self.events: SimpleQueue[dict[str, Any]] = SimpleQueue()
        nodes = [*NODES, *session.further_nodes]
        try:
            for name in nodes:
                self._processes.start(name, _node_command(session, name))
            self._processes.start(CLIENT, _client_command(session), piped=True)
        except BaseException:
            self._end()
            raise
        Thread(target=self._read, name="client reader", daemon=True).start()

    def ended(self) -> dict[str, int]:
        """Return the exit codes of nodes that have ended."""
        ended = self._processes.ended()
        ended.pop(CLIENT, None)
        return ended

    def cancel(self) -> None:
        """Ask the client to cancel its goal."""
        self._processes.signal(CLIENT, signal.SIGINT)

    def resume(self) -> None:
        """Tell the planner that the work it waits for is done."""
        self._processes.tell(CLIENT, "resume")

    def log_tail(self, name: str) -> str:
        """Return the last lines of a process's log."""
        return self._processes.log_tail(name)

    def _read(self) -> None:
        stream = self._processes.children[CLIENT].stdout
        assert stream is not None
        for line in stream:
            self.events.put(json.loads(line))
        self.events.put({"event": "end"})

    def __enter__(self) -> RunningSession:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._end()

    def _end(self) -> None:
        self._processes.end()
        self._lock.release()


def require_ros() -> None:
    """Raise ConfigurationError when the nodes cannot run here."""
    missing = [name for name in ("rclpy", "rotcal_msgs") if find_spec(name) is None]
    if missing:
        raise ConfigurationError(
            f"live calibration needs ROS 2, not found: {', '.join(missing)}; run it from the "
            "project's environment (make setup) or source a ROS 2 workspace; recorded bags are "
            "solved without ROS: rotcal solve BAG"
        )


def prepare_session(
    source: Path, folder: Path, changes: Sequence[str], *, keep_previous: bool = False
) -> Session:
    """Check the whole configuration, then make the folder; nothing is ever overwritten.

    ``changes`` are ``group.name=value`` with the value in YAML. With ``keep_previous`` an
    existing folder is moved aside to the first free ``<folder>-<number>``.
    """
    calibration = checked_calibration(source, changes)
    folder = folder.absolute()
    if folder.exists():
        if not keep_previous:
            raise ConfigurationError(
                f"{folder} exists already and nothing is overwritten; choose another --output, "
                "--keep-previous to move it aside, or --resume to continue what is in it"
            )
        folder.rename(free_name(folder))
    session = Session(calibration, folder)
    session.log_folder.mkdir(parents=True)
    session.configuration_file.write_text(calibration.configuration.text, encoding="utf-8")
    return session


def checked_calibration(source: Path, changes: Sequence[str]) -> Calibration:
    """Read a configuration with ``changes``; all of its groups and its plan are checked."""
    return prepare(changed(read_configuration(source), changes))


def free_name(folder: Path) -> Path:
    """Return ``<folder>-<number>`` with the first number that is not taken."""
    number = 1
    while (candidate := folder.with_name(f"{folder.name}-{number}")).exists():
        number += 1
    return candidate


def node_environment() -> dict[str, str]:
    """Return the variables for the nodes: a domain and a middleware for this machine alone.

    What the user has set stays.
    """
    environment = {
        "ROS_DOMAIN_ID": str(free_domain()),
        "PYTHONUNBUFFERED": "1",
        "OMP_NUM_THREADS": "1",
    }
    environment = {name: os.environ.get(name) or value for name, value in environment.items()}
    environment |= middleware(os.environ)
    return environment | {"ROTCAL_SUPERVISOR": str(os.getpid())}


def _node_command(session: Session, name: str) -> list[str]:
    command = [*_start(session, name), "--params-file", str(session.configuration_file)]
    if name == "recorder":
        # In quotes, so that a folder called 2024 does not become a number.
        command += ["-p", f"recorder.folder:={json.dumps(str(session.folder.parent))}"]
        command += ["-p", f"recorder.session:={json.dumps(session.folder.name)}"]
        if session.continuation is not None:
            command += ["-p", f"recorder.run:={session.continuation.run}"]
    if name in ("planner", "solver") and session.continuation is not None:
        file = json.dumps(str(session.continuation_file))
        command += ["-p", f"continuation_file:={file}"]
    return command


def _client_command(session: Session) -> list[str]:
    file = json.dumps(str(session.configuration_file))
    command = [*_start(session, CLIENT), "-p", f"configuration_file:={file}"]
    if session.continuation is not None:
        command += ["-p", f"start_index:={session.continuation.start_index}"]
    return command


def _start(session: Session, name: str) -> list[str]:
    namespace = session.configuration.cell.namespace
    module = f"rotcal_ros.nodes.{name}"
    return [sys.executable, "-m", module, "--ros-args", "-r", f"__ns:={namespace}"]
