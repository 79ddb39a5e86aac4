"""A process of its own for work that may kill it: its death costs one try of one job."""

from __future__ import annotations

import contextlib
import pickle
import signal
import subprocess
import sys
from collections.abc import Callable
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from typing import Any, Final

from rotcal_ros.recordings.kept import Outcome
from rotcal_ros.recordings.many import Job

Work = Callable[[Job], Outcome]
TRIES: Final = 2
_GRACE_S: Final = 30.0
"""How much longer than its supervisor a process waits for itself, in case that has died."""


class Supervised:
    """Does jobs one by one in a process that is started again when it dies.

    A job that kills it twice, or takes longer than ``time_limit_s``, becomes an outcome that
    says so. One thread calls :meth:`do`; :meth:`close` may come from another.
    """

    def __init__(self, work: Work, time_limit_s: float) -> None:
        self._work = work
        self._time_limit_s = time_limit_s
        self._process: subprocess.Popen[bytes] | None = None
        self._connection: Connection[Any, Any] | None = None
        self._closed = False

    def do(self, job: Job) -> Outcome:
        """Return what became of ``job``."""
        died = []
        while len(died) < TRIES and not self._closed:
            connection = self._connection or self._start()
            try:
                connection.send((self._work, job, self._time_limit_s + _GRACE_S))
                if not connection.poll(self._time_limit_s):
                    self._end()
                    return Outcome(job.source, "", error=self._too_long())
                outcome: Outcome = connection.recv()
            except (EOFError, OSError, pickle.UnpicklingError):
                died.append(self._end())
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
        return ours

    def _end(self) -> str:
        """Make sure that the process is gone; return how it went, in words."""
        assert self._process is not None
        assert self._connection is not None
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


def _times(died: list[str]) -> str:
    ways = " and ".join(dict.fromkeys(died))
    hint = "; SIGKILL is how the system ends what needs too much memory"
    return f"{len(died)} times ({ways}{hint if 'SIGKILL' in died else ''})"


def _serve(connection: Connection[Any, Any]) -> None:
    """Do jobs until nobody asks any more; the terminal's Ctrl-C is the supervisor's matter."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with contextlib.suppress(EOFError, OSError):
        while True:
            work, job, patience_s = connection.recv()
            signal.setitimer(signal.ITIMER_REAL, patience_s)  # SIGALRM ends whatever hangs
            outcome = work(job)
            signal.setitimer(signal.ITIMER_REAL, 0.0)
            connection.send(outcome)


if __name__ == "__main__":
    _serve(Connection(int(sys.argv[1])))
