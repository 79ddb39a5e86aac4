"""Ctrl-C while `rotcal` is still being loaded ends it like any program: without a traceback."""

import os
import signal
import subprocess
import sys

import pytest

LOADING = """
import os, signal, sys
class Finder:
    def find_spec(self, name, *_):
        if name == "rotcal_ros.cli.main":
            os.kill(os.getpid(), signal.SIGINT)
sys.meta_path.insert(0, Finder())
from rotcal_ros.cli.start import main
main()
"""
LOADED = """
import signal, sys, types
import rotcal_ros.cli
sys.modules["rotcal_ros.cli.main"] = types.SimpleNamespace(
    main=lambda: print(signal.getsignal(signal.SIGINT) is signal.default_int_handler)
)
from rotcal_ros.cli.start import main
main()
"""


@pytest.mark.parametrize(
    ("script", "code", "out"), [(LOADING, -signal.SIGINT, ""), (LOADED, 0, "True\n")]
)
def test_ctrl_c_is_quiet_while_rotcal_is_loaded_and_its_own_afterwards(script, code, out):
    path = os.pathsep.join(filter(None, sys.path))
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=False,
        env={**os.environ, "PYTHONPATH": path},
    )  # fmt: skip
    assert (done.returncode, done.stdout, done.stderr) == (code, out, "")
