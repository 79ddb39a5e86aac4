"""A check of a live cell: a process listens, and what it prints is read again."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Final

from rotcal_ros.catalogue.check_lines import CellReport
from rotcal_ros.catalogue.configuration import read_configuration
from rotcal_ros.errors import ConfigurationError, RotcalError
from rotcal_ros.planning.cell_settings import CellSettings
from rotcal_ros.records import record
from rotcal_ros.sessions.environment import node_environment
from rotcal_ros.settings import check_ros_name

_GRACE_S: Final = 30.0
"""Time for the start of the process and for what is worked out of the plan."""
_END_S: Final = 5.0


def check_cell(path: Path | None, namespace: str = "", seconds: float = 5.0) -> CellReport:
    """Listen for ``seconds`` to the cell of a configuration file, or of a ``namespace``.

    Raises ConfigurationError for a configuration that cannot be used, RotcalError when the
    process that listens ends without an answer.
    """
    if namespace:
        check_ros_name(namespace, "--namespace")
    cell = CellSettings() if path is None else read_configuration(path).cell
    command = [
        sys.executable, "-m", "rotcal_ros.nodes.cell_check", "--ros-args",
        "-r", f"__ns:={namespace or cell.namespace}",
        "-p", f"seconds:={float(seconds)!r}",
    ]  # fmt: skip
    if path is not None:
        command += ["-p", f"configuration_file:={json.dumps(str(path.absolute()))}"]
    return _answer(command, seconds)


def _answer(command: list[str], seconds: float) -> CellReport:
    """Return what the process found; it is ended whatever happens here."""
    environment = {**os.environ, **node_environment(alone=False)}
    with tempfile.TemporaryFile("w+", errors="replace") as log:
        child = subprocess.Popen(
            command, env=environment, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=log,
            text=True, start_new_session=True,
        )  # fmt: skip
        try:
            text, _ = child.communicate(timeout=seconds + _GRACE_S)
        except subprocess.TimeoutExpired:
            text = ""
        finally:
            _end(child)
        log.seek(0)
        last = (log.read().strip().splitlines() or ["it wrote nothing"])[-1]
    if child.returncode == ConfigurationError.exit_code and not text:
        raise ConfigurationError(last)
    try:
        return record(CellReport, json.loads(text))
    except ValueError:
        raise RotcalError(f"the process that listens ended without an answer: {last}") from None


def _end(child: subprocess.Popen[str]) -> None:
    """End the process, kill it where it does not end."""
    if child.poll() is None:
        child.terminate()
        try:
            child.wait(_END_S)
        except subprocess.TimeoutExpired:
            child.kill()
            child.wait()
