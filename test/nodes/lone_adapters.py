"""Table adapters, each with a machine and somebody who orders angles: nothing else of a cell."""

import sys
from contextlib import ExitStack
from pathlib import Path

from live_cell import wait_until

from rotcal_ros.foundation.plugins import node_module
from rotcal_ros.sessions.domains import free_domain
from rotcal_ros.sessions.processes import Processes, node_environment

HERE = Path(__file__).parent
CONFIGURATION = """/**:
  ros__parameters:
    cell: {joint: rotary}
    table_adapter: {controller: /drive, speed_deg_s: 60.0, acceleration_deg_s2: 360.0,
                    silence_s: 1.5}
"""
ROS = ("--ros-args", "-r", "__ns:=/cell")
WELL = "at rest at"
"""How a case begins that ends without an error."""
EARLY = "no node publishes"
"""What is complained of when the order is found before the machine is: no case is about it."""


def expect(folder, machine, cases, variables):
    """Run all cases at once, each in a domain of its own, until each has said what it shall.

    ``cases``: what the ``machine`` does wrong -> (angles that it is sent to, what is said then).
    """
    file = folder / "cell.yaml"
    file.write_text(CONFIGURATION)
    with ExitStack() as stack:
        machines = {}
        for wrong in cases:
            (folder / wrong).mkdir()
            domain = {"ROS_DOMAIN_ID": str(free_domain())}
            every = {**node_environment(), **variables, **domain}
            machines[wrong] = stack.enter_context(Processes(folder / wrong, every))
            since = "1" if wrong == "falls silent" else "0"  # the trajectory that it fails at
            machines[wrong].start("machine", [*_python(machine), wrong, since, *ROS])
        for wrong, (angles, _) in cases.items():
            own = [*ROS, "--params-file", str(file)]
            adapter = [sys.executable, "-m", node_module("table_adapter"), *own]
            machines[wrong].start("adapter", adapter)
            machines[wrong].start("orders", [*_python("order_publisher.py"), angles, *ROS])
        for wrong, (_, said) in cases.items():
            logs = [folder / wrong / f"{name}.log" for name in ("adapter", "orders")]
            wait_until(
                lambda: any(said in log.read_text() for log in logs),  # noqa: B023
                f"{wrong}: {said}",
            )
            errors = [line for line in logs[0].read_text().splitlines() if "[ERROR]" in line]
            errors = [line for line in errors if EARLY not in line]
            assert len(errors) == (not said.startswith(WELL)), errors


def _python(name):
    return [sys.executable, str(HERE / name)]
