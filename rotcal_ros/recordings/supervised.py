"""A process of its own for work that may kill it: its death costs one try of one job."""

from __future__ import annotations

import contextlib
import pickle
import signal
import subprocess
import sys
from collections.abc import Callable, Sequence
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, Final

from rotcal_ros.recordings.kept import Outcome
from rotcal_ros.recordings.many import Job

Work = Callable[[Job], Outcome]
TRIES: Final = 2
"""Deaths of its worker that are held against a bag."""
FROM_OUTSIDE: Final = 5
"""Deaths in all, when somebody else may have ended the worker."""
_OUTSIDE: Final = ("SIGKILL", "SIGTERM", "SIGHUP")
_OOM_COUNTERS: Final = ("/sys/fs/cgroup/memory.events", "/proc/vmstat")
MEMORY: Final = ", out of memory"
_START_S: Final = 120.0
_GRACE_S: Final = 30.0
"""How much longer than its supervisor a process waits for itself, in case that has died."""


class Supervised:
    """Does jobs one by one in a process that is started again when it dies.

    A job that kills it twice, or takes longer than ``time_limit_s``, becomes an outcome that
    says so. That somebody else ends the process is not held against the job, up to
    ``FROM_OUTSIDE`` times. One thread calls :meth:`do`; :meth:`close` may come from another.
    """

    def __init__(self, work: Work, time_limit_s: float) -> None:
        self._work = work
        self._time_limit_s = time_limit_s
        self._process: subprocess.Popen[bytes] | None = None
        self._connection: Connection[Any, Any] | None = None
        self._closed = False

    def do(self, job: Job) -> Outcome:
        """Return what became of ``job``."""
        died: list[str] = []
        while not (_blamed(died) or self._closed):
            out_of_memory = _oom_kills()
            try:
                connection = self._connection or self._start()
                connection.send((self._work, job, self._time_limit_s + _GRACE_S))
                if not connection.poll(self._time_limit_s):
                    self._end()
                    return Outcome(job.source, "", error=self._too_long())
                outcome: Outcome = connection.recv()
            except (EOFError, OSError, pickle.UnpicklingError):
                died.append(self._end() + (MEMORY if _oom_kills() > out_of_memory else ""))
            else:
                return outcome
        if self._closed:
            return Outcome(job.source, "", error="ended before it was done")
        return Outcome(job.source, "", error=f"set aside: it killed its worker {_times(died)}")

    def close(self) -> None:
        """End the process, whatever it does."""
        self._closed = True
        process = self._process
        if process is not None:
            process.kill()

    def _start(self) -> Connection[Any, Any]:
        ours, theirs = Pipe()
        with theirs:
            number = theirs.fileno()
            command = [sys.executable, "-m", __name__, str(number)]
            self._process = subprocess.Popen(command, pass_fds=(number,), stdin=subprocess.DEVNULL)
        if self._closed:  # meanwhile
            self._process.kill()
        self._connection = ours
        if not ours.poll(_START_S):
            raise EOFError("it does not start")
        ours.recv()
        return ours

    def _end(self) -> str:
        """Make sure that the process is gone; return how it went, in words."""
        if self._process is None or self._connection is None:
            return "it cannot be started"
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(0.5)  # it may be dying on its own
        self._process.kill()
        code = self._process.wait()
        self._connection.close()
        self._process = self._connection = None
        if code >= 0:
            return f"exit code {code}"
        try:
            return signal.Signals(-code).name
        except ValueError:
            return f"signal {-code}"

    def _too_long(self) -> str:
        return (
            f"set aside: not done after {self._time_limit_s:g} s, so its worker was ended "
            "(--time-limit)"
        )


def _blamed(died: Sequence[str]) -> bool:
    """Return whether a job died often enough for it not to be chance."""
    own = [way for way in died if way not in _OUTSIDE]
    return len(own) >= TRIES or len(died) >= FROM_OUTSIDE


def _times(died: Sequence[str]) -> str:
    return f"{len(died)} times ({', '.join(dict.fromkeys(died))})"


def _oom_kills() -> int:
    """Return how many processes the system has ended for want of memory."""
    found = 0
    for name in _OOM_COUNTERS:
        with contextlib.suppress(OSError, ValueError):
            counters = (line.split() for line in Path(name).read_text().splitlines())
            found += sum(int(value) for counter, value in counters if counter == "oom_kill")
    return found


def _serve(connection: Connection[Any, Any]) -> None:
    """Do jobs until nobody asks any more; the terminal's Ctrl-C is the supervisor's matter."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with contextlib.suppress(EOFError, OSError):
        connection.send("ready")
        while True:
            work, job, patience_s = connection.recv()
            signal.setitimer(signal.ITIMER_REAL, patience_s)  # SIGALRM ends whatever hangs
            outcome = work(job)
            signal.setitimer(signal.ITIMER_REAL, 0.0)
            connection.send(outcome)


if __name__ == "__main__":
    _serve(Connection(int(sys.argv[1])))
