"""Two ways to the same answer, run alternately; the least processor time of each counts.

Processor time, for beside other work the wall clock measures that work, too.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Row:
    """Times in seconds; ``difference`` is the largest one between the answers, rad or m."""

    name: str
    ours_s: float
    opponent_s: float | None
    ratio: float | None
    difference: float | None


def race(
    ours: Callable[[], np.ndarray], opponent: Callable[[], np.ndarray], repeats: tuple[int, int]
) -> tuple[float, float, float]:
    """Return both best times and the largest difference; ``repeats`` are (ours, opponent)."""
    best, answers = [np.inf, np.inf], [ours(), opponent()]
    for turn in range(max(repeats)):
        for side, function in enumerate((ours, opponent)):
            if turn < repeats[side]:
                start = time.process_time()
                answers[side] = function()
                best[side] = min(best[side], time.process_time() - start)
    return best[0], best[1], float(np.abs(answers[0] - answers[1]).max())
