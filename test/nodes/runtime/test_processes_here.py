"""Whether the process of a beat still exists, and what cannot be known."""

import os
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from rotcal_ros.nodes.runtime.liveness import HostProcess, host_identity


@pytest.fixture
def sleeper():
    """Return a process that does nothing, and how a beat would report it."""
    code = "import sys; sys.stdin.read()"
    process = subprocess.Popen([sys.executable, "-c", code], stdin=subprocess.PIPE)
    start = Path(f"/proc/{process.pid}/stat").read_text().rpartition(")")[2].split()[19]
    yield process, HostProcess(host_identity(), process.pid, int(start))
    process.kill()
    process.wait()


def test_this_process_exists():
    assert not HostProcess.own().is_gone
    assert HostProcess.own().is_of_here


def test_one_that_is_stopped_exists_and_one_that_was_killed_does_not(sleeper):
    process, told = sleeper
    process.send_signal(signal.SIGSTOP)
    assert not told.is_gone
    process.kill()
    os.waitid(os.P_PID, process.pid, os.WEXITED | os.WNOWAIT)  # dead, and nobody has looked yet
    assert told.is_gone
    process.wait()
    assert told.is_gone


def test_a_process_that_only_has_the_number_of_another_is_not_it(sleeper):
    _, told = sleeper
    assert replace(told, start=7).is_gone
    assert not replace(told, start=0).is_gone  # when it began is not known


@pytest.mark.parametrize("host", ["", "elsewhere"])
def test_what_is_not_of_here_is_not_called_gone(host):
    assert not HostProcess(host, 1, 1).is_gone
