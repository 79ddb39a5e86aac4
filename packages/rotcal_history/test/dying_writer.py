"""Adds a result again and again in processes that die, or whose disk fails, at each call in turn.

usage: dying_writer.py DATABASE ERRNO, with dying_writer.so preloaded; ERRNO 0: SIGKILL.
Prints a line of JSON for each call: how the process ended (4: before that call), and what the
history holds afterwards.
"""

import ctypes
import json
import os
import sys
from itertools import count
from pathlib import Path

import numpy as np
import simulated_park

from rotcal_history.database import BagError, ParkHistory, canonical_json, result_of

SURVIVED, REFUSED, WHOLE = 0, 3, 4
MOST = 500
"""Calls of one addition, many more than there are."""


def add(database, number, error, result):
    """Add a result in a process that fails at call ``number``; return how it ended."""
    if child := os.fork():
        return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    code, library = SURVIVED, ctypes.CDLL(None)
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
    library.arm(number, error, int("://" in database))
    try:
        with ParkHistory(database) as history:
            history.add_result(result)
    except BagError:
        code = REFUSED
    os._exit(code if library.fired() else WHOLE)


def main():
    database, error = sys.argv[1], int(sys.argv[2])
    if "://" not in database:
        Path(database).unlink(missing_ok=True)
    with ParkHistory(database) as history:
        base = sum(1 for _ in history.entries())
    for number in count(1):
        time_ns = simulated_park.BEGIN_NS + number + error * 1000
        result = simulated_park.result("D1", time_ns, np.arange(6.0), 0.1 + number / 1e3)
        ended = add(database, number, error, result)
        with ParkHistory(database) as history:
            here = {e.content: e for e in history.entries(content=True)}
            kept = canonical_json(result) in here
            again = history.add_result(result)
            entries = list(history.entries(content=True))
            same = result_of(history.entry(again.entry.id)).to_json() == result.to_json()
            wrong = history.check() if number % 5 == 1 or ended == WHOLE else []
        line = {
            "ended": ended, "kept": kept, "new": again.new, "entries": len(entries) - base,
            "expected": number, "same": same, "wrong": wrong,
        }  # fmt: skip
        sys.stdout.write(json.dumps(line) + "\n")
        sys.stdout.flush()
        if ended == WHOLE or number > MOST:
            break


if __name__ == "__main__":
    main()
