"""Processes of the nodes: what they need to run, how they are started, watched and ended.

They end with their parent, each by its own process id.
"""

from __future__ import annotations

import os
import signal
import subprocess
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path
from typing import Final

from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.machine_load import load_scaled_timeout
from rotcal_ros.foundation.middleware import middleware
from rotcal_ros.report.terminal.console import say
from rotcal_ros.sessions.domains import DEFAULT_DOMAIN, free_domain

TERMINATE_TIMEOUT_S: Final = 25.0
_POLL_S: Final = 0.05
_NEWEST_MESSAGE: Final = "_text_code.py"
_OF_THE_PAGE: Final = ("sse_starlette", "starlette", "uvicorn")


def require_ros() -> None:
    """Raise ConfigurationError when the nodes cannot run here."""
    missing = [name for name in ("rclpy", "rotcal_msgs") if find_spec(name) is None]
    if missing:
        raise ConfigurationError(
            f"live calibration needs ROS 2; not found: {', '.join(missing)}; run rotcal in the "
            "project's environment (make setup) or source a ROS 2 workspace; recorded bags are "
            "solved without ROS: rotcal solve BAG"
        )
    if not messages_are_current():
        raise ConfigurationError(
            "rotcal_msgs was built from earlier definitions: run 'make setup', or build msg_defs "
            "with colcon again"
        )


def messages_are_current() -> bool:
    """Return whether the newest message is built; looks at files, since an import takes long."""
    spec = find_spec("rotcal_msgs")
    folders = spec.submodule_search_locations if spec else None
    return any(Path(folder, "msg", _NEWEST_MESSAGE).exists() for folder in folders or ())


def page_can_be_served() -> bool:
    """Return whether all that the operator's page needs is installed; print what is missing."""
    missing = [name for name in _OF_THE_PAGE if find_spec(name) is None]
    if missing:
        say(f"no page: not installed: {', '.join(missing)} (pip install 'rotcal_ros[page]')")
    return not missing


def node_environment(*, alone: bool = True) -> dict[str, str]:
    """Return the variables for the nodes; those set by the user stay.

    ``alone``: they need no other nodes and get a domain of their own, else ROS's default.
    """
    domain = os.environ.get("ROS_DOMAIN_ID") or str(free_domain() if alone else DEFAULT_DOMAIN)
    usual = {"PYTHONUNBUFFERED": "1", "OMP_NUM_THREADS": "1"}
    environment = {name: os.environ.get(name) or value for name, value in usual.items()}
    environment |= {"ROS_DOMAIN_ID": domain, **middleware(os.environ)}
    session = f"{time.monotonic_ns()}-{os.getpid()}"
    return environment | {"ROTCAL_SUPERVISOR": str(os.getpid()), "ROTCAL_SESSION": session}


@dataclass
class Processes:
    """Named child processes with their output in ``log_folder``; a context manager.

    Every child leads a process group of its own, so that Ctrl-C in the terminal reaches only the
    parent, which then ends the children in the order in which they were started. ``inherited``
    are descriptors that the children hold too: a lock lasts until the last of them is dead.
    """

    log_folder: Path
    environment: Mapping[str, str]
    inherited: tuple[int, ...] = ()
    children: dict[str, subprocess.Popen[bytes]] = field(default_factory=dict)

    def start(self, name: str, command: Sequence[str], *, piped: bool = False) -> None:
        """Start ``command``; its output goes to ``<name>.log``.

        With ``piped`` only its errors go there: standard input and output are pipes.
        """
        with (self.log_folder / f"{name}.log").open("wb") as log:
            self.children[name] = subprocess.Popen(
                command,
                env={**os.environ, **self.environment},
                stdin=subprocess.PIPE if piped else subprocess.DEVNULL,
                stdout=subprocess.PIPE if piped else log,
                stderr=log,
                # A new session keeps Ctrl-C of the terminal from the child.
                start_new_session=True,
                pass_fds=self.inherited,
            )

    def ended(self) -> dict[str, int]:
        """Return the exit codes of the children that have ended."""
        return {
            name: code
            for name, child in self.children.items()
            if (code := child.poll()) is not None
        }

    def tell(self, name: str, text: str) -> None:
        """Write a line to a piped child; nothing happens when it has ended."""
        stream = self.children[name].stdin
        assert stream is not None
        with suppress(OSError):
            stream.write(f"{text}\n".encode())
            stream.flush()

    def signal(self, name: str, number: signal.Signals) -> None:
        """Send a signal to one child if it runs."""
        child = self.children[name]
        if child.poll() is None:
            with suppress(ProcessLookupError):
                child.send_signal(number)

    def log_tail(self, name: str, lines: int = 5) -> str:
        """Return the last lines that a child wrote to its log."""
        text = (self.log_folder / f"{name}.log").read_text(errors="replace")
        return "\n".join(text.splitlines()[-lines:])

    def end(self) -> None:
        """Ask all children to end, wait for them, and kill those that hang."""
        for name in self.children:
            self.signal(name, signal.SIGTERM)
        deadline = time.monotonic() + load_scaled_timeout(TERMINATE_TIMEOUT_S)
        while len(self.ended()) < len(self.children) and time.monotonic() < deadline:
            time.sleep(_POLL_S)
        for child in self.children.values():
            if child.poll() is None:
                child.kill()
            child.wait()
            for stream in (child.stdin, child.stdout):
                if stream is not None:
                    with suppress(OSError):
                        stream.close()

    def __enter__(self) -> Processes:
        return self

    def __exit__(self, *_error: object) -> None:
        self.end()
