"""The last bit of a result depends on the threads of the linear algebra: it gets one."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

DATA = Path(__file__).parents[2] / "examples" / "data"
VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
SCRIPT = f"""
import os, sys
from rotcal_ros.cli.main import rotcal
try:
    rotcal(["solve", {str(DATA / "lengths.csv")!r}, "--setup", {str(DATA / "tracer.yaml")!r},
            "--targets", {str(DATA / "targets.csv")!r}])
except SystemExit as end:
    assert end.code == 0, end.code
assert "numpy" in sys.modules
print(len(os.listdir("/proc/self/task")), *(os.environ[name] for name in {VARIABLES}))
"""


def solve(**more):
    """Solve a table in a fresh process; return its threads afterwards, and the variables."""
    environment = {name: text for name, text in os.environ.items() if name not in VARIABLES}
    ran = subprocess.run(
        [sys.executable, "-c", SCRIPT], env=environment | more, capture_output=True, text=True
    )
    assert ran.returncode == 0, ran.stderr
    return ran.stdout.splitlines()[-1].split()


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="needs /proc")
def test_a_solver_in_a_fresh_process_has_one_thread():
    assert solve() == ["1", "1", "1", "1"]


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="needs /proc")
def test_what_the_user_has_set_stays():
    assert solve(OPENBLAS_NUM_THREADS="2")[1:] == ["1", "2", "1"]
