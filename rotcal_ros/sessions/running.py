"""The running processes of a session: its nodes, and the client that reports on the goal."""

from __future__ import annotations

import json
import re
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from queue import SimpleQueue
from threading import Thread
from typing import Any, Final

from rotcal_ros.catalogue.configuration import node_parameters
from rotcal_ros.files import FolderLock, write_atomically
from rotcal_ros.node_names import VIEWERS
from rotcal_ros.sessions.commands import CLIENT, client_command, node_command, node_names
from rotcal_ros.sessions.environment import node_environment
from rotcal_ros.sessions.processes import Processes
from rotcal_ros.sessions.session import Session, require_as_found

PAGE: Final = "page"
_LINES: Final = 200
_ADDRESS: Final = re.compile(r"page: http://\S+")


class RunningSession:
    """Nodes and client of a session; ``events`` holds what the client reports, then ``end``."""

    def __init__(self, processes: Processes) -> None:
        self._processes = processes
        self.events: SimpleQueue[dict[str, Any]] = SimpleQueue()
        Thread(target=self._read, name="client reader", daemon=True).start()

    def ended(self) -> dict[str, int]:
        """Return the exit codes of nodes that have ended; those for people may."""
        ended = self._processes.ended()
        return {n: code for n, code in ended.items() if n not in (CLIENT, *VIEWERS.values())}

    def deaths(self) -> list[str]:
        """Return how the processes died that were killed or failed, in words."""
        return [
            _death(name, code, self.log_tail(name))
            for name, code in self._processes.ended().items()
            if code
        ]

    def cancel(self) -> None:
        """Ask the client to cancel its goal."""
        self._processes.signal(CLIENT, signal.SIGINT)

    def resume(self) -> None:
        """Let the planner know that the work it waits for is done."""
        self._processes.tell(CLIENT, "resume")

    def log_tail(self, name: str) -> str:
        """Return the last lines of a process's log."""
        return self._processes.log_tail(name)

    def page(self) -> str:
        """Return where the operator's page is, or why there is none; empty: not known yet."""
        for name in self._processes.children.keys() & {VIEWERS[PAGE]}:
            log = self._processes.log_tail(name, _LINES)
            if found := _ADDRESS.search(log):
                return found[0]
            if name in self._processes.ended():
                return f"no page: {log}"
        return ""

    def _read(self) -> None:
        stream = self._processes.children[CLIENT].stdout
        assert stream is not None
        for line in stream:
            self.events.put(json.loads(line))
        self.events.put({"event": "end"})


def _death(name: str, code: int, log: str) -> str:
    """Return how a process died; the last thing it wrote may say why."""
    if code == -signal.SIGKILL:
        return f"{name} was killed (SIGKILL: out of memory?)"
    how = f"exit code {code}"
    if code < 0:
        how = signal.Signals(-code).name if -code in {*signal.Signals} else f"signal {-code}"
    return f"{name} ended ({how}): " + (log.splitlines() or ["it wrote nothing"])[-1]


@contextmanager
def running(session: Session) -> Iterator[RunningSession]:
    """Start the nodes and the client of a session, and end them.

    The folder stays locked until the last of them is dead.
    """
    lock = FolderLock(session.folder.path)
    try:
        require_as_found(session)
        write_atomically(session.folder.parameters, node_parameters(session.configuration))
        environment = node_environment(alone=session.configuration.simulated)
        with Processes(session.log_folder, environment, (lock.descriptor,)) as processes:
            for name in node_names(session):
                processes.start(name, node_command(session, name))
            processes.start(CLIENT, client_command(session), piped=True)
            yield RunningSession(processes)
    finally:
        lock.release()
