"""Work that kills its worker, hangs, or is done, as the name of the bag says."""

import ctypes
import os
import signal
import time
from pathlib import Path

from rotcal_history.fleet.batch_solving import BagJob, BagOutcome, solve_bag


def work(job: BagJob) -> BagOutcome:
    name = Path(job.source).name
    if name.startswith("segfault"):
        ctypes.string_at(0)
    if name.startswith("exit"):
        os._exit(7)
    if name.startswith("hang"):
        signal.pthread_sigmask(signal.SIG_BLOCK, signal.valid_signals())
        time.sleep(600)
    if name.startswith("once"):
        marker = Path(job.cache) / name
        if not marker.exists():
            marker.touch()
            os.kill(os.getpid(), signal.SIGSEGV)
    if name.startswith("killed"):  # from outside, three times
        tries = Path(job.cache) / name
        tries.mkdir(exist_ok=True)
        if (count := len(list(tries.iterdir()))) < 3:
            (tries / str(count)).touch()
            os.kill(os.getpid(), signal.SIGKILL)
    return BagOutcome(job.source, name)


def solve_unless_deadly(job: BagJob) -> BagOutcome:
    """Solve the bag, but for the one whose folder says that it kills."""
    if "deadly" in job.source:
        os._exit(9)
    return solve_bag(job)


def slowly(job: BagJob) -> BagOutcome:
    """Leave time to take the scheduler away."""
    time.sleep(0.3)
    Path(job.cache, Path(job.source).name).touch()
    return BagOutcome(job.source, "k")
