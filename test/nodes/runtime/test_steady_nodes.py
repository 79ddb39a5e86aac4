"""Nothing in the nodes waits by the system clock; a node without memory ends."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[3] / "rotcal_ros"
NODES = [*PACKAGE.glob("nodes/**/*.py"), *PACKAGE.glob("page/*.py")]
WAITING = re.compile(r"\.create_timer\(|create_rate|time\.time\(\) *[<>-]|sleep_until|wall_timer")


def test_timers_are_those_of_the_steady_clock():
    found = {path.name for path in NODES if WAITING.search(path.read_text())}
    assert found == {"timers_and_subscriptions.py"}


@pytest.mark.parametrize(
    ("error", "code"),
    [
        ("MemoryError()", 71),
        ("RuntimeError('cannot compress: Allocation error : not enough memory')", 71),
        ("ValueError()", 0),
    ],
)
def test_a_process_without_memory_ends_with_the_reason(error, code):
    program = (
        f"from rotcal_ros.foundation.machine_load import *; end_without_memory({error}, 'capture')"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.returncode == code
    assert done.stderr == ("out of memory (capture)\n" if code else "")
