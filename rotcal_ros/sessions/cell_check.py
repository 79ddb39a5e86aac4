"""Checks a live cell: starts the process that listens, and reads the report that it prints."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Final

from rotcal_ros.foundation.errors import ConfigurationError, RotcalError
from rotcal_ros.foundation.machine_load import load_scaled_timeout
from rotcal_ros.foundation.plugins import node_module
from rotcal_ros.foundation.records import record
from rotcal_ros.foundation.settings import check_ros_name
from rotcal_ros.methods.check_lines import CellReport, CheckLine
from rotcal_ros.methods.configuration import node_parameters, read_configuration
from rotcal_ros.planning.settings import CellSettings
from rotcal_ros.sessions.processes import Processes, node_environment

_GRACE_S: Final = 30.0
"""Time for the start of the process and for working out the plan."""
LONGER_S: Final = 60.0
"""It listens for so much longer at most, if it could not hear enough to judge the clocks."""
_END_S: Final = 5.0
_POLL_S: Final = 0.1
_TRIAL_S: Final = 150.0
"""Time for a trial motion, there and back."""


def check_cell(path: Path | None, namespace: str = "", seconds: float = 5.0) -> CellReport:
    """Listen for ``seconds`` to the cell of a configuration file, or of a ``namespace``.

    It takes up to twice as long where too little has come to judge the clocks, more on a busy
    machine.

    Raises ConfigurationError for a configuration that cannot be used, RotcalError when the
    process that listens ends without an answer.
    """
    if namespace:
        check_ros_name(namespace, "--namespace")
    cell = CellSettings() if path is None else read_configuration(path).cell
    command = [
        sys.executable, "-m", "rotcal_ros.nodes.check.cell_check", "--ros-args",
        "-r", f"__ns:={namespace or cell.namespace}",
        "-p", f"seconds:={float(seconds)!r}",
    ]  # fmt: skip
    if path is not None:
        command += ["-p", f"configuration_file:={json.dumps(str(path.absolute()))}"]
    return _answer(command, seconds)


def move_cell(path: Path, report: CellReport) -> CellReport:
    """Turn the table by a few degrees and back; return ``report`` with what this has shown.

    Call it only after a person has agreed. An adapter of the configuration that is not running yet
    is started for it. Raises RotcalError when the process that orders ends without an answer.
    """
    configuration = read_configuration(path)
    environment = node_environment(alone=False)
    with tempfile.TemporaryDirectory() as name, Processes(Path(name), environment) as processes:
        parameters, output = Path(name) / "parameters.yaml", Path(name) / "lines.json"
        parameters.write_text(node_parameters(configuration), encoding="utf-8")
        ros = ["--ros-args", "-r", f"__ns:={report.namespace}", "--params-file", str(parameters)]
        if "table_adapter" in configuration.given:  # a second one beside that of the cell ends
            adapter = [sys.executable, "-m", node_module("table_adapter"), *ros]
            processes.start("table_adapter", adapter)
        trial = [
            sys.executable, "-m", "rotcal_ros.nodes.check.trial_motion", *ros,
            "-p", f"configuration_file:={json.dumps(str(path.absolute()))}",
            "-p", f"output:={json.dumps(str(output))}",
        ]  # fmt: skip
        processes.start("trial_motion", trial)
        deadline = time.monotonic() + load_scaled_timeout(_TRIAL_S)
        while "trial_motion" not in processes.ended() and time.monotonic() < deadline:
            time.sleep(_POLL_S)
        if not output.exists():
            raise RotcalError(f"no trial motion: {processes.log_tail('trial_motion', 1)}")
        lines = (record(CheckLine, line) for line in json.loads(output.read_text()))
        return replace(report, lines=(*report.lines, *lines), moved=True)


def _answer(command: list[str], seconds: float) -> CellReport:
    """Return what the process found; end it in any case."""
    environment, late = {**os.environ, **node_environment(alone=False)}, False
    limit_s = seconds + min(load_scaled_timeout(seconds), LONGER_S) + load_scaled_timeout(_GRACE_S)
    with tempfile.TemporaryFile("w+", errors="replace") as log:
        child = subprocess.Popen(
            command, env=environment, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=log,
            text=True, start_new_session=True,
        )  # fmt: skip
        try:
            text, _ = child.communicate(timeout=limit_s)
        except subprocess.TimeoutExpired:
            text, late = "", True
        finally:
            _end(child)
        log.seek(0)
        last = (log.read().strip().splitlines() or ["it wrote nothing"])[-1]
    if late:
        raise RotcalError(
            f"no answer within {limit_s:.0f} s, of which {seconds:g} s were for listening: the "
            f"process that listens was ended; the last line that it wrote: {last}; try again, "
            "with a longer --time"
        )
    if child.returncode == ConfigurationError.exit_code and not text:
        raise ConfigurationError(last)
    try:
        return record(CellReport, json.loads(text))
    except ValueError:
        raise RotcalError(f"the process that listens ended without an answer: {last}") from None


def _end(child: subprocess.Popen[str]) -> None:
    """End the process; kill it if it does not end."""
    if child.poll() is None:
        child.terminate()
        try:
            child.wait(_END_S)
        except subprocess.TimeoutExpired:
            child.kill()
            child.wait()
