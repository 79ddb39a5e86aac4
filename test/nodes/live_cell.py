"""Live cells: real nodes as processes, talking over DDS in a domain of their own."""

import json
import os
import signal
import sys
import time
from contextlib import contextmanager
from pathlib import Path
from queue import Empty, SimpleQueue
from threading import Thread

import pytest
import warm
from mcap.reader import make_reader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from rotcal_ros.foundation.machine_load import WaitBudget, describe_load, load_scaled_timeout
from rotcal_ros.foundation.node_names import EXECUTABLES, NODES
from rotcal_ros.foundation.plugins import NODES as NODES_BESIDE
from rotcal_ros.foundation.plugins import names, node_module
from rotcal_ros.foundation.results import Result
from rotcal_ros.methods.configuration import changed, read_configuration
from rotcal_ros.recordings.replay import read_recording
from rotcal_ros.sessions.processes import Processes, node_environment

DEMO = Path(__file__).parents[2] / "config" / "tracer_paper.yaml"
SUITE = NODES
SHORT = (
    "plan.table_positions=5",
    "plan.box_points=[3, 2, 2]",
    "planner.preflight_timeout_s=20.0",
    "simulation.faults.blocked_targets=[1]",
    "simulation.tracer.rate_hz=100.0",
    "capture.window_samples=10",
    "simulation.table.feedback_rate_hz=25.0",
    "simulation.faults.blocked_from_deg=-30.0",
    "simulation.faults.blocked_to_deg=-20.0",
    "solver.length_std_m=8.0e-8",  # more than there is: chance makes no live run suspect
)
DEADLINE_S = 120.0
"""On a machine that has a core for us; beside others it takes as much longer as they take."""
LOOK_S = 0.05
NAME_LENGTH = 15
"""What Linux keeps of the name of a process."""


class LiveCell:
    """Nodes of one cell and the clients that send it goals; ``recordings`` takes the session.

    ``restart_wait_s`` is how long a goal waits for lost nodes to be started again.
    """

    restart_wait_s = 0.0

    def __init__(self, folder, configuration):
        self.folder = folder
        self.recordings = folder
        self.file = folder / "cell.yaml"
        self.file.write_text(configuration.text, encoding="utf-8")
        (folder / "log").mkdir()
        self.processes = Processes(folder / "log", node_environment())

    @property
    def session(self):
        return self.recordings / "session"

    @property
    def bag(self):
        return self.session / "bag"

    def start(self, *nodes, name=None, file=None, arguments=()):
        for node in nodes:
            own = ["--params-file", str(file or self.file), *arguments]
            if node == "recorder":
                own += ["-p", f"recorder.folder:={json.dumps(str(self.recordings))}"]
                own += ["-p", "recorder.session:=session"]
            if node == "planner":
                own += ["-p", f"restart_wait_s:={self.restart_wait_s}"]
            if name:
                own += ["-r", f"__node:={name}"]
            self.processes.start(name or node, [*self._python(node), *own])

    def client(self, name="client", *, configuration="", start_index=0, person=False):
        """Start a client; configuration None: the planner shall take its own parameters.

        A ``person`` resumes whenever it is asked.
        """
        own = ["-p", f"start_index:={start_index}"]
        if configuration is not None:
            own += ["-p", f"configuration_file:={json.dumps(str(configuration or self.file))}"]
        self.processes.start(name, [*self._python("client"), *own], piped=True)
        return Client(self.processes, name, person)

    def calibrate(self):
        """Run a whole calibration and return its outcome."""
        self.start(*SUITE, "simulated_cell")
        return self.client().result()

    def calibrate_with_a_person(self):
        """Run a calibration, resume whenever it asks; return how it ended, and what it asked."""
        self.start(*SUITE, "simulated_cell")
        client = self.client(person=True)
        return client.result(), client.asked

    def repeated(self):
        """Return the recording, which gives the result again to the last bit, and the result."""
        recording = read_recording(self.bag)
        text = (self.session / "result.json").read_text()
        assert recording.same_as_recorded
        assert recording.solve().to_json() == text
        return recording, Result.from_dict(json.loads(text))

    def kill(self, name):
        self.processes.signal(name, signal.SIGKILL)

    @contextmanager
    def held(self):
        """Let the simulated cell stand still meanwhile, so that a calibration cannot end."""
        self.processes.signal("simulated_cell", signal.SIGSTOP)
        try:
            yield
        finally:
            self.processes.signal("simulated_cell", signal.SIGCONT)

    def log(self, name):
        return (self.folder / "log" / f"{name}.log").read_text()

    def wait_for_log(self, name, text):
        wait_until(lambda: text in self.log(name), f"{name} logs {text!r}")

    def _python(self, node):
        client = "rotcal_ros.nodes.client.json_client"
        ours = node in (*EXECUTABLES, *names(NODES_BESIDE))
        module = node_module(node) if ours else client
        return [sys.executable, "-m", module, "--ros-args", "-r", "__ns:=/cell"]


class Client:
    """The lines of one client, and what the ``person`` beside it was ``asked``."""

    def __init__(self, processes, name, person):
        self._processes, self._name, self._person = processes, name, person
        self.asked = []
        self._events = SimpleQueue()
        Thread(target=self._read, daemon=True).start()

    def wait_for(self, *kinds, where=lambda event: True):
        """Return the next event of one of the kinds; fail after the deadline."""
        patience = WaitBudget(DEADLINE_S)
        outcome = "no result"
        while not patience.is_over():
            try:
                event = self._events.get(timeout=LOOK_S)
            except Empty:
                continue
            if event["event"] in kinds and where(event):
                return event
            if event["event"] == "paused" and self._person:
                self.asked.append(event["instruction"])
                self._processes.tell(self._name, "resume")
            if event["event"] == "result":
                outcome = event["error_msg"]
            assert event["event"] != "end", (
                f"the client ended without {kinds}: {outcome}; ended before: "
                f"{self._processes.ended()}"
            )
        pytest.fail(f"no {kinds} within {DEADLINE_S} s of an idle machine; {describe_load()}")

    def wait_for_step(self, step):
        return self.wait_for("feedback", where=lambda event: event["accepted"] >= step)

    def result(self):
        return self.wait_for("result")

    def cancel(self):
        self._processes.signal(self._name, signal.SIGINT)

    def _read(self):
        for line in self._processes.children[self._name].stdout:
            self._events.put(json.loads(line))
        self._events.put({"event": "end"})


def published(bag, topic):
    """Return what was published on a topic, as mcap and rosbags read it from a bag."""
    found, store = [], get_typestore(Stores.EMPTY)
    with next(bag.glob("*.mcap")).open("rb") as stream:
        for schema, _, message in make_reader(stream).iter_messages(topics=[topic]):
            store.register(get_types_from_msg(schema.data.decode(), schema.name))
            found.append(store.deserialize_cdr(message.data, schema.name))
    return found


def wait_until(condition, what):
    patience = WaitBudget(DEADLINE_S)
    while not condition():
        if patience.is_over():
            pytest.fail(f"not within {DEADLINE_S} s of an idle machine: {what}; {describe_load()}")
        time.sleep(LOOK_S)


def process_of(parent, node):
    """Return the id of the process of a node that a session in process ``parent`` has started."""
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            state = (folder / "stat").read_text().rsplit(")", 1)[1].split()
            name = (folder / "comm").read_text().strip()
        except OSError:
            continue
        if int(state[1]) == parent and name == node[:NAME_LENGTH]:
            return int(folder.name)
    pytest.fail(f"no process of {node}")


def live_cells(tmp_path, monkeypatch, demo, short):
    """Yield a function that makes a live cell of a changed file; all of it ends with the test."""
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(filter(None, sys.path)))
    cells = []

    def make(*changes):
        made = LiveCell(tmp_path, changed(read_configuration(demo), (*short, *changes)))
        cells.append(made)
        return made

    yield make
    for made in cells:
        made.processes.end()


@pytest.fixture
def cell(tmp_path, monkeypatch):
    """Return a function that makes a live cell with a short plan."""
    yield from live_cells(tmp_path, monkeypatch, DEMO, SHORT)


@pytest.fixture
def rotcal(monkeypatch):
    """Return a function that starts ``rotcal run``; what still runs at the end is ended."""
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(filter(None, sys.path)))
    started = []

    def start(*arguments, log, changes=()):
        parts = [part for change in (*SHORT, *changes) for part in ("--set", change)]
        command = [sys.executable, "-m", "rotcal_ros.cli.main", "run", str(DEMO), *parts]
        process = warm.popen(
            [*command, *map(str, arguments)],
            stdout=log.with_suffix(".json").open("w"), stderr=log.open("w"),
        )  # fmt: skip
        started.append(process)
        return process

    yield start
    for process in started:
        if process.poll() is None:
            process.terminate()
            process.wait(load_scaled_timeout(60))
