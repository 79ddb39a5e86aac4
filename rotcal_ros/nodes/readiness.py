"""Waits until the nodes of a cell are active, then prints what to do next.

For launch files: ``python -m rotcal_ros.nodes.readiness /cell planner capture``.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Collection
from typing import Final

from rotcal_ros.nodes.runtime.health import Health
from rotcal_ros.nodes.runtime.managed_node import inactive_node_hints
from rotcal_ros.nodes.runtime.running import EndRequest, PeerNode, run_and_exit

REMIND_S: Final = 15.0
_TURN_S: Final = 0.2
NEXT: Final = """\
all nodes of {place} are active: {names}
{shell}calibrate:            ros2 action send_goal --feedback {place}/calibrate \
rotcal_msgs/action/Calibrate '{{}}'
  Ctrl-C there cancels; the bag stays valid. A pause of the plan ends with:
                      ros2 service call {place}/resume std_srvs/srv/Trigger
what is wrong:        ros2 topic echo /diagnostics
deactivate a node:      ros2 lifecycle set {place}/capture deactivate
'rotcal run CONFIG' would start nodes of its own; 'rotcal attach' shows what it has started."""


def inactive_node_lines(health: Health, names: Collection[str]) -> list[str]:
    """Return which nodes are not active, and what to do about it."""
    absent = health.missing(names)
    idle = inactive_node_hints(health, [name for name in names if name not in absent])
    return idle + [f"node {name} is not there (yet)" for name in absent]


def next_steps(place: str, names: Collection[str], domain: str) -> str:
    """Return what to do when all nodes of the namespace ``place`` are active."""
    shell = f"in a shell with      ROS_DOMAIN_ID={domain}\n" if domain else ""
    return NEXT.format(place=place.rstrip("/"), names=", ".join(names), shell=shell)


def _wait(place: str, names: Collection[str]) -> None:
    end, peer = EndRequest(), PeerNode("readiness", place)
    health = Health(peer.node, None)
    remind_s = time.monotonic() + REMIND_S
    reminded: list[str] = []
    while not end:
        peer.work_until(lambda: bool(end), _TURN_S)
        waiting = inactive_node_lines(health, names)
        if not waiting:
            _say(next_steps(place, names, os.environ.get("ROS_DOMAIN_ID", "")))
            break
        if time.monotonic() > remind_s and waiting != reminded:
            _say("still waiting: " + "; ".join(waiting))
            remind_s, reminded = time.monotonic() + REMIND_S, waiting
    peer.close()


def _say(text: str) -> None:
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


def main() -> None:
    """Wait for the nodes that the command line names, after their namespace."""
    _, place, *names = sys.argv
    run_and_exit(lambda: _wait(place, names))


if __name__ == "__main__":
    main()
