"""Doing independent jobs on all cores, or on the workers of a Dask cluster."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from typing import Any

from rotcal_ros.errors import ConfigurationError
from rotcal_ros.recordings.many import Job, Outcome, solve_bag


def on_all_cores(jobs: Sequence[Job], workers: int | None = None) -> Iterator[Outcome]:
    """Yield the outcomes as they come; ``workers`` processes, by default one for each core.

    A job whose process dies (out of memory) becomes an outcome with that error.
    """
    workers = min(workers or usable_cores(), max(1, len(jobs)))
    if workers == 1:
        yield from map(solve_bag, jobs)
        return
    # Forked from a server without threads: as fast as fork, as safe as spawn.
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["rotcal_ros.recordings.many"])
    with ProcessPoolExecutor(workers, mp_context=context) as pool:
        futures = {pool.submit(solve_bag, job): job.source for job in jobs}
        for future in as_completed(futures):
            yield _outcome(future, futures[future])


def usable_cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0))


def on_cluster(jobs: Sequence[Job], scheduler: str) -> Iterator[Outcome]:
    """Yield the outcomes as the workers of the Dask ``scheduler`` (tcp://...) deliver them.

    The workers need rotcal_ros installed and the bags and the cache at the same paths.
    """
    try:
        from distributed import Client
        from distributed import as_completed as completed
    except ImportError as error:
        raise ConfigurationError(
            "a cluster needs dask.distributed: pip install 'rotcal_ros[many]'"
        ) from error
    try:
        client = Client(scheduler, timeout="20s")
    except OSError as error:
        raise ConfigurationError(f"no Dask scheduler answers at {scheduler}: {error}") from error
    with client:
        futures = client.map(solve_bag, jobs, pure=False)
        source_of = {future.key: job.source for future, job in zip(futures, jobs, strict=True)}
        for future in completed(futures):
            yield _outcome(future, source_of[future.key])


def _outcome(future: Any, source: str) -> Outcome:
    """Return what a finished future holds; the process or the worker may have died."""
    error = future.exception()
    return Outcome(source, "", error=repr(error)) if error else future.result()
