"""What the capture of a table that turns costs: its share of one core, by processor time.

    python benchmarks/turning_cost.py

A simulated cell at the speed of life sends 1,000 lengths and 200 table angles a second
(``config/tracer_turning_demo.yaml``, which passes 20 angles a second). Linux only.
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).parents[1]
CONFIG = ROOT / "config" / "tracer_turning_demo.yaml"
CAPTURE = "rotcal_ros.nodes.capture.node"
TICKS = os.sysconf("SC_CLK_TCK")


def capture_of(parent: int) -> int | None:
    """Return the capture node among the descendants of a process, if it is there."""
    children = Path(f"/proc/{parent}/task/{parent}/children").read_text().split()
    for child in map(int, children):
        if CAPTURE in Path(f"/proc/{child}/cmdline").read_text():
            return child
        if (found := capture_of(child)) is not None:
            return found
    return None


def used_s(process: int) -> float:
    """Return the processor time of a process, s."""
    fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / TICKS


def main() -> None:
    """Measure one calibration, and print the share in percent for each ten seconds."""
    with tempfile.TemporaryDirectory() as folder:
        rotcal = Path(sys.executable).with_name("rotcal")
        command = [
            str(rotcal), "run", str(CONFIG), "-o", f"{folder}/out",
            "--set", "simulation.tracer.rate_hz=1000", "--no-report", "--no-export", "--no-page",
        ]  # fmt: skip
        run = subprocess.Popen(command, stdout=subprocess.DEVNULL)
        seen, node = list[tuple[float, float]](), None
        while run.poll() is None:
            try:
                node = node or capture_of(run.pid)
                if node is not None:
                    seen.append((time.monotonic(), used_s(node)))
            except (FileNotFoundError, ProcessLookupError):
                node = None
            time.sleep(1.0)
        shares = [
            100.0 * (after - before) / (late - early)
            for (early, before), (late, after) in zip(seen[::10], seen[10::10], strict=False)
        ]
        result = Path(folder) / "out" / "result.json"
        verdict = json.loads(result.read_text())["verdict"] if result.exists() else "no result"
    print(f"verdict {verdict}; percent of a core:", *(f"{share:.0f}" for share in shares))


if __name__ == "__main__":
    main()
