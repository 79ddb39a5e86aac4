"""Balls on the table of a machine tool, touched through TCP; the port of the simulated machine."""

import re
import signal
import socket
import subprocess
import sys

import numpy as np
import pytest
from dme_plates import DEMO, measure, simulated_cell
from known_truth import require_injected_truth

from rotcal_ipp_dme.server import DmeServer, serve_in_thread
from rotcal_ros.foundation.units import ARCSEC
from rotcal_ros.methods import changed, prepare
from rotcal_ros.methods.configuration import read_configuration

ONE_BALL = DEMO.with_name("table_balls_demo.yaml")


def test_touches_through_tcp_find_the_axis_and_the_deviations():
    changes = ("simulation.time_scale=1000.0", "capture.temperature_expected=false")
    calibration = prepare(changed(read_configuration(ONE_BALL), changes))
    with serve_in_thread(DmeServer(simulated_cell(calibration), "127.0.0.1", 0)) as server:
        touched = measure(calibration, server.port)
    assert [o.reason for o in touched if not o.accepted] == []
    result = calibration.solve(touched)
    assert result.verdict == "ok", result.warnings
    require_injected_truth(calibration, result)
    configuration = calibration.configuration
    table, height = configuration.simulation.table, configuration.plan.axis_m[2]
    (x, y, _), (a, b) = table.axis_offset_m, np.array(table.axis_tilt_arcsec) * ARCSEC
    axis = result.axes[0]
    away = axis.value - [x + height * b, y - height * a, a, b]
    assert np.abs(away / axis.std).max() < 4.5


@pytest.mark.parametrize("given", [(), ("--port", "{port}")])
def test_the_simulated_machine_is_where_the_configuration_looks_for_it(given, tmp_path):
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    stated = 1294 if given else port
    text = changed(read_configuration(ONE_BALL), (f"dme.port={stated}",)).text
    (tmp_path / "balls.yaml").write_text(text)
    words = [word.format(port=port) for word in given]
    command = [sys.executable, "-m", "rotcal_ros.cli.main", "dme", "serve", "balls.yaml", *words]
    process = subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, text=True)
    try:
        assert re.search(rf"at 127\.0\.0\.1:{port},", process.stdout.readline())
    finally:
        process.send_signal(signal.SIGINT)
        process.communicate()
