"""The full circle in six minutes, live: U, the true error, and what the capture of it costs.

    python benchmarks/turning_cost.py [--set GROUP.NAME=VALUE ...]

A simulated cell at the speed of life (``config/tracer_turning_demo.yaml``) turns at 12 deg/s past
360 angles, once forward and once back for each of four targets, and sends 1,000 lengths and 200
table angles a second. Settings that follow take the place of these. Shares of a core are by
processor time, so a busy machine does not spoil them. Linux only.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from rotcal_ros.foundation.results import Result
from rotcal_ros.foundation.units import ARCSEC
from rotcal_ros.methods import changed, prepare_to_measure, read_configuration
from rotcal_ros.methods.dry_run import DryRun
from rotcal_ros.methods.simulated_run import visible_truth

CONFIG = Path(__file__).parents[1] / "config" / "tracer_turning_demo.yaml"
CAPTURE = "rotcal_ros.nodes.capture.node"
TICKS = os.sysconf("SC_CLK_TCK")
SIX_MINUTES = (
    "plan.table_positions=360", "plan.table_step_deg=1.0", "plan.turning_deg_s=[12.0, -12.0]",
    "plan.run_up_deg=15.0", "plan.passing_deg=0.5", "simulation.tracer.rate_hz=1000.0",
)  # fmt: skip


def capture_of(parent: int) -> int | None:
    """Return the capture node among the descendants of a process, if it is there."""
    children = Path(f"/proc/{parent}/task/{parent}/children").read_text().split()
    for child in map(int, children):
        if CAPTURE in Path(f"/proc/{child}/cmdline").read_text():
            return child
        if (found := capture_of(child)) is not None:
            return found
    return None


def cost_of(process: int) -> tuple[float, float]:
    """Return the processor time of a process, s, and its peak memory, MB."""
    fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    status = Path(f"/proc/{process}/status").read_text()
    peak = status.partition("VmHWM:")[2].split()[0]
    return (int(fields[11]) + int(fields[12])) / TICKS, int(peak) / 1024.0


def main() -> None:
    """Measure one calibration, and print what it found and what it cost."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--set", action="append", default=[], dest="settings")
    settings = [*SIX_MINUTES, *parser.parse_args().settings]
    with tempfile.TemporaryDirectory() as folder:
        command = [
            str(Path(sys.executable).with_name("rotcal")), "run", str(CONFIG), "-o",
            f"{folder}/out", "--no-report", "--no-export", "--no-page",
        ]  # fmt: skip
        command += [word for each in settings for word in ("--set", each)]
        began, run = time.monotonic(), subprocess.Popen(command)
        seen, node = list[tuple[float, float, float]](), None
        while run.poll() is None:
            try:
                node = node or capture_of(run.pid)
                if node is not None:
                    seen.append((time.monotonic(), *cost_of(node)))
            except (FileNotFoundError, ProcessLookupError, IndexError):
                node = None
            time.sleep(1.0)
        took = time.monotonic() - began
        result = Result.from_dict(json.loads((Path(folder) / "out" / "result.json").read_text()))
    calibration = prepare_to_measure(changed(read_configuration(CONFIG), settings))
    planned, _ = DryRun(calibration, calibration.plan.steps[0].table_angle).time_estimate()
    n = len(result.angles)
    centring = np.eye(n) - 1.0 / n
    std = np.sqrt((centring @ result.covariance["ECC"] @ centring).diagonal())
    error = centring @ (result.deviations["ECC"] - visible_truth(calibration)["ECC"][:n])
    shares = [100.0 * (b[1] - a[1]) / (b[0] - a[0]) for a, b in zip(seen, seen[10:], strict=False)]
    print(
        f"{result.verdict}, {n} angles, {result.n_observations} lengths; "
        f"{planned:.0f} s of cell time planned, {took:.0f} s from command to result\n"
        f"U (k = 2, rms about the mean) {2.0 * np.sqrt(np.mean(std**2)) / ARCSEC:.2f} arcsec, "
        f"2 rms error {2.0 * np.std(error) / ARCSEC:.2f}, "
        f"{100.0 * np.mean(np.abs(error) < 1.96 * std):.1f} % within; "
        f"lag {1e6 * result.details['turning']['lag']:.2f} us\n"
        f"capture node: {np.median(shares):.0f} % of a core in the median, at most "
        f"{max(shares):.0f} % for 10 s, {max(row[2] for row in seen):.0f} MB"
    )
    for text in result.warnings:
        print(f"  {text}")


if __name__ == "__main__":
    main()
