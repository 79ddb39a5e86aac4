"""Real recorders, fed over DDS by a process of their own."""

import json
import os
import sys
from collections import defaultdict
from pathlib import Path
from threading import Thread

from rotcal_ros.sessions.processes import Processes, node_environment

WINDOW = 50
"""Readings per observation."""


class Recorders:
    """A feeder and the recorders it feeds.

    ``receipts`` holds the steps that each has confirmed, ``failures`` why it gave up.
    """

    def __init__(self, folder, *depth):
        self.folder = folder
        self.receipts = defaultdict(list)
        self.failures = {}
        self.processes = Processes(folder, node_environment())
        feeder = str(Path(__file__).with_name("feeder.py"))
        self.processes.start(
            "feeder", [sys.executable, feeder, str(WINDOW), *map(str, depth)], piped=True
        )
        Thread(target=self._listen, daemon=True).start()

    def start(self, name, folder=None):
        self.processes.start(
            name,
            [
                sys.executable, "-m", "rotcal_ros.nodes.recorder.node", "--ros-args",
                "-r", "__ns:=/cell", "-r", f"__node:={name}",
                "-r", f"start_recording:=start_{name}",
                "-r", f"observation_recorded:=receipts_{name}",
                "-p", f"recorder.folder:={json.dumps(str(folder or self.folder))}",
                "-p", f"recorder.session:={name}",
            ],
        )  # fmt: skip
        self.processes.tell("feeder", name)

    def file(self, name):
        return self.folder / name / "bag" / "bag_0.mcap"

    def _listen(self):
        for line in self.processes.children["feeder"].stdout:
            event = json.loads(line)
            if "failure" in event:
                self.failures[event["recorder"]] = event["failure"]
            else:
                self.receipts[event["recorder"]].append(event["step"])


def fed(folder, *depth):
    """Yield recorders that find this package; all of it ends with the caller."""
    before = os.environ.get("PYTHONPATH")
    os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, sys.path))
    made = Recorders(folder, *depth)
    yield made
    made.processes.end()
    os.environ.pop("PYTHONPATH")
    if before is not None:
        os.environ["PYTHONPATH"] = before
