"""Work that takes its time, beside a node that goes on meanwhile."""

from __future__ import annotations

import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

from rotcal_ros.nodes.cell_node import until

T = TypeVar("T")


async def done_aside(work: Callable[..., T], *arguments: object) -> T:
    """Return what ``work`` returns, or raise what it raises; it has a thread of its own."""
    with ThreadPoolExecutor(max_workers=1) as aside:
        found = aside.submit(work, *arguments)
        await until(found.done, math.inf)
        return found.result()
