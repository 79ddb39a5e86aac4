"""Output that outlives whoever took it."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from rotcal_ros.foundation.machine_load import load_scaled_timeout

PROGRAM = """
import os, signal, sys
from pathlib import Path
from rotcal_ros.sessions.lasting_output import lasting_output
with lasting_output(Path(sys.argv[1])):
    print("before", flush=True)
    sys.stdin.readline()
    for number in range(3):
        print("out", number)
        print("err", number, file=sys.stderr)
print("behind the block")
sys.exit(7)
"""


def start(log, **streams):
    return subprocess.Popen([sys.executable, "-c", PROGRAM, str(log)], **streams)


def test_a_closed_pipe_is_replaced_by_the_log(tmp_path):
    log = tmp_path / "run.log"
    with start(log, stdin=-1, stdout=-1, stderr=-1) as process:
        assert process.stdout.readline() == b"before\n"
        process.stdout.close()
        process.stdin.write(b"\n")
        process.stdin.close()
        assert process.stderr.read() == b"err 0\nerr 1\nerr 2\n"
        assert process.wait(load_scaled_timeout(30)) == 7
    assert log.read_text() == "out 0\nout 1\nout 2\nbehind the block\n"


def test_a_hangup_leaves_pipes_and_files_alone(tmp_path):
    log = tmp_path / "run.log"
    with start(log, stdin=-1, stdout=-1, stderr=-1) as process:
        assert process.stdout.readline() == b"before\n"
        process.send_signal(signal.SIGHUP)
        out, err = process.communicate(b"\n", timeout=load_scaled_timeout(30))
        assert process.returncode == 7
    assert out == b"out 0\nout 1\nout 2\nbehind the block\n"
    assert err == b"err 0\nerr 1\nerr 2\n"
    assert not log.exists()


def test_a_hangup_takes_the_terminal_away_though_it_still_works(tmp_path):
    log = tmp_path / "run.log"
    master, slave = os.openpty()
    with start(log, stdin=slave, stdout=slave, stderr=slave) as process:
        shown = b""
        while b"before" not in shown:
            shown += os.read(master, 100)
        process.send_signal(signal.SIGHUP)
        assert process.wait(load_scaled_timeout(30)) == 7  # what it waits to read has ended
    expected = [f"{kind} {n}" for n in range(3) for kind in ("out", "err")]
    assert log.read_text().split("\n") == [*expected, "behind the block", ""]
    os.close(master)
    os.close(slave)


def test_a_full_disk_is_an_error_still(tmp_path):
    device = Path("/dev/full")
    if not device.exists():
        pytest.skip("no /dev/full")
    with device.open("w") as full:
        process = start(tmp_path / "x", stdin=-1, stdout=full, stderr=-1)
        _, complaint = process.communicate(b"\n", timeout=load_scaled_timeout(30))
    assert b"No space left on device" in complaint
    assert process.returncode not in (0, 7)
    assert not (tmp_path / "x").exists()
