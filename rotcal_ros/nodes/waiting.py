"""Waiting for conditions inside a coroutine of a single-threaded executor."""

from __future__ import annotations

import time
from collections.abc import Callable, Generator


class NextTurn:
    """Await this to let the executor work; it resumes with the executor's next event.

    The heartbeat's timer bounds the pause, so that time-outs are noticed too.
    """

    def __await__(self) -> Generator[None, None, None]:
        yield


async def until(
    condition: Callable[[], bool], timeout_s: float, check: Callable[[], None] | None = None
) -> bool:
    """Wait until ``condition``; False after ``timeout_s``. ``check`` may raise to give up."""
    deadline = time.monotonic() + timeout_s
    while not condition():
        if check is not None:
            check()
        if time.monotonic() > deadline:
            return False
        await NextTurn()
    return True
