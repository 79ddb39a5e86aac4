"""Child processes: all of them end, also those that do not want to."""

import signal
import sys
import time

import pytest

from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.machine_load import load_scaled_timeout
from rotcal_ros.sessions import processes
from rotcal_ros.sessions.processes import Processes, require_ros

STUBBORN = (
    "import signal, time; signal.signal(signal.SIGTERM, signal.SIG_IGN); "
    "print('ready', flush=True); time.sleep(600)"
)
DEADLINE_S = 30.0


def wait_for(condition):
    deadline = time.monotonic() + load_scaled_timeout(DEADLINE_S)
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.02)


def test_output_goes_to_the_log_and_the_exit_code_is_known(tmp_path):
    with Processes(tmp_path, {"GREETING": "hello"}) as children:
        program = "import os, sys; print(os.environ['GREETING']); sys.exit(3)"
        children.start("a", [sys.executable, "-c", program])
        wait_for(lambda: children.ended() == {"a": 3})
        assert children.log_tail("a") == "hello"


def test_a_piped_child_is_read_and_its_errors_are_logged(tmp_path):
    with Processes(tmp_path, {}) as children:
        program = "import sys; print('out'); print('err', file=sys.stderr)"
        children.start("a", [sys.executable, "-c", program], piped=True)
        assert children.children["a"].stdout.read() == b"out\n"
        wait_for(lambda: children.ended() == {"a": 0})
        assert children.log_tail("a") == "err"


def test_a_child_that_ignores_the_request_is_killed(tmp_path, monkeypatch):
    monkeypatch.setattr(processes, "TERMINATE_TIMEOUT_S", 0.2)
    with Processes(tmp_path, {}) as children:
        children.start("stubborn", [sys.executable, "-c", STUBBORN])
        wait_for(lambda: children.log_tail("stubborn") == "ready")
    assert children.children["stubborn"].returncode == -signal.SIGKILL


def test_children_end_with_an_error_too(tmp_path):
    def fail(children):
        with children:
            children.start("a", [sys.executable, "-c", "import time; time.sleep(600)"])
            raise ZeroDivisionError

    children = Processes(tmp_path, {})
    with pytest.raises(ZeroDivisionError):
        fail(children)
    assert children.children["a"].returncode == -signal.SIGTERM


def test_messages_of_earlier_definitions_are_refused_before_a_node_starts(tmp_path, monkeypatch):
    for name in ("rclpy", "rotcal_msgs"):
        (tmp_path / name / "msg").mkdir(parents=True)
        (tmp_path / name / "__init__.py").touch()
    monkeypatch.syspath_prepend(tmp_path)
    for name in ("rclpy", "rotcal_msgs"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    with pytest.raises(ConfigurationError, match="built from earlier definitions"):
        require_ros()
    (tmp_path / "rotcal_msgs" / "msg" / "_text_code.py").touch()
    require_ros()
