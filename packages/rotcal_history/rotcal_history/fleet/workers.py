"""Does independent jobs on all cores, or on the workers of a Dask cluster.

Each worker is a process of its own, since a bag may kill it: that costs one attempt at one job.
"""

from __future__ import annotations

import contextlib
import logging
import pickle
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from itertools import islice
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any, Final

from rotcal_history.fleet.batch_solving import BagJob, BagOutcome, solve_bag
from rotcal_ros.foundation.errors import BagError, ConfigurationError
from rotcal_ros.foundation.machine_load import core_count

TIME_LIMIT_S: Final = 3600.0
"""How long a bag may take by default."""
_WAITING: Final = 4
"""Jobs for each worker that are handed out at a time: enough to keep it busy, no more."""
_SCHEDULER_ANSWERS_S = 20.0
_SCHEDULER_GONE_S: Final = 10.0
_CENSUS_S: Final = 10.0
"""How often the workers of a cluster are counted."""
_TRIES: Final = 5
"""How often Dask may give up on a bag because its workers died."""


def run_on_cores(
    jobs: Iterable[BagJob],
    workers: int | None = None,
    time_limit_s: float = TIME_LIMIT_S,
    work: Work = solve_bag,
) -> Generator[BagOutcome, None, None]:
    """Yield the outcomes as they come; ``workers`` processes, by default one for each core.

    A process that dies is started again and its job tried once more; a job that kills two, or
    takes longer than ``time_limit_s``, becomes an outcome with that error.
    """
    workers = workers or core_count()
    remaining = iter(jobs)
    crew = [SupervisedProcess(work, time_limit_s) for _ in range(workers)]
    idle: SimpleQueue[SupervisedProcess] = SimpleQueue()
    for member in crew:
        idle.put(member)

    def done(job: BagJob) -> BagOutcome:
        member = idle.get()
        try:
            return member.do(job)
        finally:
            idle.put(member)

    with ThreadPoolExecutor(workers) as threads:
        try:
            running: set[Future[BagOutcome]] = set()
            while True:
                wanted = _WAITING * workers - len(running)
                running |= {threads.submit(done, job) for job in islice(remaining, wanted)}
                if not running:
                    return
                finished, running = wait(running, return_when=FIRST_COMPLETED)
                yield from (future.result() for future in finished)
        finally:
            for future in running:
                future.cancel()
            for member in crew:
                member.close()


def run_on_cluster(
    jobs: Iterable[BagJob],
    scheduler: str,
    time_limit_s: float = TIME_LIMIT_S,
    work: Work = solve_bag,
) -> Generator[BagOutcome, None, None]:
    """Yield the outcomes as the workers of the Dask ``scheduler`` (tcp://...) deliver them.

    The workers need rotcal_ros installed and the bags and the cache at the same paths. They may
    die, come and go; each solves its bags in a process of its own, as :func:`run_on_cores` does.
    Raises ConfigurationError when no scheduler answers, BagError when it goes away.
    """
    try:
        from distributed import Client
        from distributed.comm import CommClosedError
    except ImportError as error:
        raise ConfigurationError(
            "a cluster needs dask.distributed: pip install 'rotcal_history[many]'"
        ) from error
    try:
        client = Client(scheduler, timeout=_SCHEDULER_ANSWERS_S, set_as_default=False)
    except (OSError, ValueError) as error:
        raise ConfigurationError(
            f"no Dask scheduler answers at {scheduler}: {error}; start one (dask scheduler), or "
            "leave out --scheduler"
        ) from error
    logging.getLogger("distributed.client").setLevel(logging.CRITICAL)  # its tracebacks
    try:
        yield from _outcomes(client, iter(jobs), scheduler, time_limit_s, work)
    except CommClosedError as error:
        raise _scheduler_gone(scheduler) from error
    finally:
        client.close(timeout=2)


def _outcomes(
    client: Any, jobs: Iterator[BagJob], scheduler: str, time_limit_s: float, work: Work
) -> Iterator[BagOutcome]:
    """Hand out jobs a few at a time and yield their outcomes."""
    finished: SimpleQueue[Any] = SimpleQueue()
    handed: dict[Any, tuple[BagJob, int]] = {}
    size, asked = 0, -_CENSUS_S

    def hand_out(job: BagJob, tries: int) -> None:
        future = client.submit(run_supervised, job, time_limit_s, work, pure=False)
        handed[future] = (job, tries)
        future.add_done_callback(finished.put)

    while True:
        if time.monotonic() > asked + _CENSUS_S:  # a question to the scheduler
            size, asked = max(2, sum(client.nthreads().values())), time.monotonic()
        for job in islice(jobs, max(0, _WAITING * size - len(handed))):
            hand_out(job, 1)
        if not handed:
            return
        for future in _next(client, finished, scheduler):
            if future.status in ("cancelled", "lost"):
                raise _scheduler_gone(scheduler)
            job, tries = handed.pop(future)
            if future.status == "error" and _lost(future) and tries < _TRIES:
                hand_out(job, tries + 1)
            else:
                yield _outcome(future, job.source)


def _next(client: Any, finished: SimpleQueue[Any], scheduler: str) -> Iterator[Any]:
    """Yield the futures that are done, at least one; raises BagError without a scheduler."""
    seen = time.monotonic()
    while True:
        try:
            yield finished.get(timeout=1.0)
            break
        except Empty:
            if client.status == "running":
                seen = time.monotonic()
            elif time.monotonic() > seen + _SCHEDULER_GONE_S:
                raise _scheduler_gone(scheduler) from None
    while not finished.empty():
        yield finished.get()


def _scheduler_gone(scheduler: str) -> BagError:
    return BagError(
        f"the Dask scheduler {scheduler} went away; what was solved is kept, and the same call "
        "continues"
    )


_of_thread = threading.local()


def run_supervised(job: BagJob, time_limit_s: float, work: Work) -> BagOutcome:
    """Do a job in a process that belongs to this thread of a Dask worker, and stays for more."""
    processes: dict[Any, SupervisedProcess] = _of_thread.__dict__.setdefault("processes", {})
    process = processes.setdefault((work, time_limit_s), SupervisedProcess(work, time_limit_s))
    return process.do(job)


def _lost(future: Any) -> bool:
    """Return whether Dask gave up on a bag because workers died; a bag cannot kill one itself."""
    return type(future.exception()).__name__ == "KilledWorker"


def _outcome(future: Any, source: str) -> BagOutcome:
    """Return what a finished future holds; its workers may have died under it."""
    error = future.exception()
    if error is None:
        outcome: BagOutcome = future.result()
        return outcome
    if _lost(future):
        return _set_aside(source, "the cluster lost every worker that had it")
    return BagOutcome(source, "", error=f"the cluster could not do it: {error!r}")


Work = Callable[[BagJob], BagOutcome]
TRIES: Final = 2
"""Deaths of its worker that count against a bag."""
FROM_OUTSIDE: Final = 5
"""Deaths in all, when somebody else may have ended the worker."""
_OUTSIDE: Final = ("SIGKILL", "SIGTERM", "SIGHUP")
_OOM_COUNTERS: Final = ("/sys/fs/cgroup/memory.events", "/proc/vmstat")
MEMORY: Final = ", out of memory"
_START_S: Final = 120.0
_GRACE_S: Final = 30.0
"""How much longer than its supervisor a process waits before it ends itself, in case that has
died."""


class SupervisedProcess:
    """Does jobs one by one in a process that is started again when it dies.

    A job that kills it twice, or takes longer than ``time_limit_s``, becomes an outcome that
    says so. If somebody else ends the process, that does not count against the job, up to
    ``FROM_OUTSIDE`` times. One thread calls :meth:`do`; :meth:`close` may come from another.
    """

    def __init__(self, work: Work, time_limit_s: float) -> None:
        self._work = work
        self._time_limit_s = time_limit_s
        self._process: subprocess.Popen[bytes] | None = None
        self._connection: Connection[Any, Any] | None = None
        self._closed = False

    def do(self, job: BagJob) -> BagOutcome:
        """Return what became of ``job``."""
        deaths: list[str] = []
        while not (_blamed(deaths) or self._closed):
            out_of_memory = _oom_kills()
            try:
                connection = self._connection or self._start()
                connection.send((self._work, job, self._time_limit_s + _GRACE_S))
                if not connection.poll(self._time_limit_s):
                    self._end()
                    limit = f"{self._time_limit_s:g} s"
                    ended = "so its worker was ended (--time-limit)"
                    return _set_aside(job.source, f"not done after {limit}, {ended}")
                outcome: BagOutcome = connection.recv()
            except (EOFError, OSError, pickle.UnpicklingError):
                deaths.append(self._end() + (MEMORY if _oom_kills() > out_of_memory else ""))
            else:
                return outcome
        if self._closed:
            return BagOutcome(job.source, "", error="ended before it was done")
        return _set_aside(job.source, f"the worker crashed {_times(deaths)} on this bag")

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
        if self._closed:  # by another thread, while it was started
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


def _set_aside(source: str, reason: str) -> BagOutcome:
    return BagOutcome(source, "", error=f"set aside: {reason}")


def _blamed(deaths: Sequence[str]) -> bool:
    """Return whether the worker of a job died too often for chance."""
    by_itself = [way for way in deaths if way not in _OUTSIDE]
    return len(by_itself) >= TRIES or len(deaths) >= FROM_OUTSIDE


def _times(deaths: Sequence[str]) -> str:
    return f"{len(deaths)} times ({', '.join(dict.fromkeys(deaths))})"


def _oom_kills() -> int:
    """Return how many processes the system has ended for lack of memory."""
    found = 0
    for name in _OOM_COUNTERS:
        with contextlib.suppress(OSError, ValueError):
            counters = (line.split() for line in Path(name).read_text().splitlines())
            found += sum(int(value) for counter, value in counters if counter == "oom_kill")
    return found


def _serve(connection: Connection[Any, Any]) -> None:
    """Do jobs until no more come; Ctrl-C in the terminal is handled by the supervisor."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with contextlib.suppress(EOFError, OSError):
        connection.send("ready")
        while True:
            work, job, time_limit_s = connection.recv()
            signal.setitimer(signal.ITIMER_REAL, time_limit_s)  # SIGALRM ends whatever hangs
            outcome = work(job)
            signal.setitimer(signal.ITIMER_REAL, 0.0)
            connection.send(outcome)


if __name__ == "__main__":
    _serve(Connection(int(sys.argv[1])))
