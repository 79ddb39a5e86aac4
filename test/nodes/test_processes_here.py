"""Whether the process of a beat still exists, and what nobody can tell."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from rotcal_ros.nodes.runtime.processes_here import is_of_here, machine, own_process, why_gone


@pytest.fixture
def sleeper():
    """Return a process that does nothing, and how a beat would tell it."""
    code = "import sys; sys.stdin.read()"
    process = subprocess.Popen([sys.executable, "-c", code], stdin=subprocess.PIPE)
    start = Path(f"/proc/{process.pid}/stat").read_text().rpartition(")")[2].split()[19]
    yield process, f"{machine()} {process.pid} {start}"
    process.kill()
    process.wait()


def test_this_process_exists():
    assert why_gone(own_process()) == ""
    assert is_of_here(own_process())


def test_one_that_is_stopped_exists_and_one_that_was_killed_does_not(sleeper):
    process, told = sleeper
    process.send_signal(signal.SIGSTOP)
    assert why_gone(told) == ""
    process.kill()
    os.waitid(os.P_PID, process.pid, os.WEXITED | os.WNOWAIT)  # dead, and nobody has looked yet
    assert why_gone(told) == f"its process {process.pid} is gone"
    process.wait()
    assert why_gone(told) == f"its process {process.pid} is gone"


def test_a_process_that_only_has_the_number_of_another_is_not_it(sleeper):
    process, told = sleeper
    assert why_gone(told.rpartition(" ")[0] + " 7") == f"its process {process.pid} is gone"


@pytest.mark.parametrize("told", ["", "elsewhere 1 1", f"{machine()} x 1", f"{machine()} 1"])
def test_what_is_not_of_here_or_not_understood_is_not_called_gone(told):
    assert why_gone(told) == ""
