"""A kill, a full disk, a lost network at every call of ``add``: nothing lost, nothing twice."""

import errno
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

HERE = Path(__file__).parent
KILLED, REFUSED, WHOLE = -9, 3, 4


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    """Return the library that lets calls fail."""
    made = tmp_path_factory.mktemp("library") / "dying_writer.so"
    source = HERE / "dying_writer.c"
    subprocess.run(["cc", "-O1", "-shared", "-fPIC", "-o", made, source, "-ldl"], check=True)
    return made


def calls(library, database, error):
    """Return what came of each call, the last one being beyond the last call."""
    environment = os.environ | {"LD_PRELOAD": str(library), "PYTHONPATH": str(HERE)}
    ran = subprocess.run(
        [sys.executable, HERE / "dying_writer.py", database, str(error)],
        env=environment, capture_output=True, text=True,
    )  # fmt: skip
    assert ran.returncode == 0, ran.stderr
    return [json.loads(line) for line in ran.stdout.splitlines()]


@pytest.mark.parametrize(
    "error",
    [
        pytest.param(0, id="kill"),
        pytest.param(errno.ENOSPC, id="full", marks=pytest.mark.slow),
        pytest.param(errno.EIO, id="broken", marks=pytest.mark.slow),
    ],
)
def test_nothing_is_lost_or_written_twice(library, database, error):
    if error and "://" in database:
        error = errno.ECONNRESET
    found = calls(library, database, error)
    *failed, last = found
    assert len(failed) >= 3
    assert last["ended"] == WHOLE
    assert all(call["kept"] or call["new"] for call in found)
    assert [call["entries"] for call in found] == [call["expected"] for call in found]
    assert all(call["same"] for call in found)
    assert [call["wrong"] for call in found if call["wrong"]] == []
    if error == 0:
        assert {call["ended"] for call in failed} == {KILLED}
    else:
        # What could be written all the same was written: a failed clean-up at the end is none.
        assert {call["ended"] for call in failed} <= {0, REFUSED}
    # Both happen: died before it was written, and after it was.
    assert not failed[0]["kept"]
    assert last["kept"]
