"""Runs a session to its result: starts the nodes, shows progress, asks a person, names errors."""

from __future__ import annotations

import json
import signal
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from queue import Empty, SimpleQueue
from threading import Thread
from typing import Any, Final, NoReturn

from rotcal_ros.bags.repair import finish_interrupted
from rotcal_ros.evaluation.marks import marks
from rotcal_ros.foundation.errors import ConfigurationError, DataError
from rotcal_ros.foundation.files import write_atomically
from rotcal_ros.foundation.folder_lock import FolderLock
from rotcal_ros.foundation.machine_load import load_scaled_timeout
from rotcal_ros.foundation.node_names import NODES, PAGE, VIEWERS
from rotcal_ros.foundation.plugins import node_module, nodes_of_groups
from rotcal_ros.methods.configuration import node_parameters
from rotcal_ros.recordings.replay import read_recording
from rotcal_ros.recordings.result_sources import read_source
from rotcal_ros.report.terminal.console import progress_bar, say
from rotcal_ros.sessions.attaching import Viewers
from rotcal_ros.sessions.person import NO_MACHINE, Event, ProgressDisplay, SessionOperator
from rotcal_ros.sessions.processes import Processes, node_environment
from rotcal_ros.sessions.session import Session, require_unchanged

SILENCE_TIMEOUT_S: Final = 60.0
"""The client prints a line every second; after this silence it counts as hung."""
CANCEL_TIMEOUT_S: Final = 25.0
_POLL_S: Final = 0.2
_LOST: Final = 603
"""Error code of the action: a node is lost."""
_USAGE_ERRORS: Final = (601, 602, 608)
"""Error codes of the action that the user can correct before the next start: bad configuration,
topic missing, emergency stop."""
CLIENT: Final = "client"
_LINES: Final = 200


def calibrate(session: Session, viewers: Viewers, *, at_once: bool = False) -> dict[str, Any]:
    """Run the nodes of a session to the end and return the outcome of the goal.

    A person's work counts as done ``at_once``, or when the person confirms it, here or as a
    viewer. The outcome's ``interrupted`` is true when the user ended it, else its ``verdict_line``
    says how far to trust the result, and its ``marks`` are those of the result. Raises RotcalError
    when it failed.
    """
    if session.configuration.simulated:
        say(NO_MACHINE)
    previous = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        outcome = _solve_bag(session) if session.finished else _run(session, viewers, at_once)
    except KeyboardInterrupt:  # while the first one was still being handled
        viewers.say("interrupted again: the nodes were ended without waiting for the bag")
        viewers.say(_how_to_go_on(session))
        raise
    finally:
        signal.signal(signal.SIGTERM, previous)
    if outcome.get("interrupted"):
        bag = outcome.get("bag_folder") or "none was begun"
        viewers.say(f"interrupted; the bag is closed: {bag}")
        viewers.say(_how_to_go_on(session))
    elif outcome["error_code"]:
        _fail(session, outcome)
    else:
        result = read_source(session.folder.result).result
        outcome["verdict_line"] = result.verdict_line
        outcome["marks"] = [asdict(mark) for mark in marks(result)]
    return outcome


def _how_to_go_on(session: Session) -> str:
    """Return how to continue after an interruption, or that nothing was measured yet."""
    bag = session.folder.bag
    if bag.is_dir() and any(bag.iterdir()):
        return f"to go on: {session.resume_command}"
    return "nothing was recorded yet: start it again as before"


def _run(session: Session, viewers: Viewers, at_once: bool) -> dict[str, Any]:
    """Run the nodes until the client reports the result."""
    with run_processes(session) as nodes:
        try:
            outcome = _follow(nodes, SessionOperator(session.configuration, at_once), viewers)
            if outcome["error_code"]:
                outcome["error_msg"] += "".join(f"; {death}" for death in nodes.deaths())
            return outcome
        except DataError as error:  # the client itself is lost
            return {"error_code": _LOST, "error_msg": "; ".join([str(error), *nodes.deaths()])}
        except KeyboardInterrupt:
            viewers.say("canceling: the bag is being closed")
            nodes.cancel()
            return {**_result_of_cancelling(nodes), "interrupted": True}


def _solve_bag(session: Session) -> dict[str, Any]:
    """Solve the bag of a session that was interrupted after its last step."""
    lock = FolderLock(session.folder.path)
    try:
        require_unchanged(session)
        finish_interrupted(session.folder.bag)
        recording = read_recording(session.folder.bag)
        result = recording.solve()
        write_atomically(session.folder.result, result.to_json())
    finally:
        lock.release()
    accepted = {o.step for o in recording.observations if o.accepted}
    return {
        "error_code": 0,
        "verdict": result.verdict,
        "n_used": len(accepted),
        "n_rejected": sum(not o.accepted for o in recording.observations),
        "skipped_steps": sorted({o.step for o in recording.observations} - accepted),
    }


def _result_of_cancelling(nodes: RunningSession) -> Event:
    """Return the result of a canceled goal; empty when none arrives."""
    deadline = time.monotonic() + load_scaled_timeout(CANCEL_TIMEOUT_S)
    while time.monotonic() < deadline:
        try:
            event = nodes.events.get(timeout=_POLL_S)
        except Empty:
            continue
        if event["event"] in ("result", "end"):
            return event
    return {}


def _follow(nodes: RunningSession, person: SessionOperator, viewers: Viewers) -> dict[str, Any]:
    """Show the progress and ask the person; return the result event.

    Raises KeyboardInterrupt when a viewer stops it, as Ctrl-C would.
    """
    with progress_bar(time_left=False) as bar:  # the planner knows better
        display = ProgressDisplay(bar)
        heard, begun, page_told = time.monotonic(), False, False
        while True:
            _obey(viewers, person)
            if not page_told and (failure := nodes.page_failure()) is not None:
                page_told = True
                _tell_page(f"no page: {failure}", display, viewers)
            if person.is_done():
                nodes.resume()
            try:
                event = nodes.events.get(timeout=_POLL_S)
            except Empty:
                _check(nodes, begun, time.monotonic() - heard)
                continue
            heard = time.monotonic()
            if event["event"] in ("result", "refused", "end"):
                return _ending(nodes, event, begun)
            begun = begun or event["event"] == "started"
            if event["event"] == "warning":
                _warn(event["text"], display, viewers)
                continue
            if event["event"] == "page":
                page_told = True
                _tell_page(f"page: {event['address']}", display, viewers)
                continue
            viewers.publish(event)
            display.line(person.receive(event))
            if event["event"] == "feedback":
                display.feedback(event)


def _warn(text: str, display: ProgressDisplay, viewers: Viewers) -> None:
    """Show warnings, here and to viewers."""
    display.line(f"warning: {text}")
    viewers.publish({"event": "line", "text": f"warning: {text}"})


def _tell_page(text: str, display: ProgressDisplay, viewers: Viewers) -> None:
    """Say where the page is, or why there is none, here and to viewers."""
    display.line(text)
    viewers.publish({"event": "page", "text": text})


def _obey(viewers: Viewers, person: SessionOperator) -> None:
    """Carry out the requests of viewers."""
    for order in viewers.orders():
        if order.get("event") == "stop":
            raise KeyboardInterrupt
        if order.get("event") == "done":
            person.confirm(order.get("instruction", ""))


def _check(nodes: RunningSession, begun: bool, silence_s: float) -> None:
    """Raise when a node could not start, or the client hangs."""
    ended = nodes.ended()
    if ended and not begun:
        name, code = next(iter(ended.items()))
        raise ConfigurationError(
            f"node {name} ended at its start (exit code {code})", nodes.log_tail(name)
        )
    if silence_s > load_scaled_timeout(SILENCE_TIMEOUT_S):
        raise DataError(
            f"the client has been silent for {silence_s:.0f} s: it hangs; resume with --resume"
        )


def _ending(nodes: RunningSession, event: dict[str, Any], begun: bool) -> dict[str, Any]:
    """Return a result event; raise an error for any other ending."""
    if event["event"] == "refused":
        raise ConfigurationError(f"the goal was refused: {event['reason']}")
    if event["event"] == "end":
        _check(nodes, begun, 0.0)
        tail = nodes.log_tail(CLIENT)
        if not begun:  # the nodes fail for the same reason, but may take longer to say so
            raise ConfigurationError("node client ended at its start", tail)
        raise DataError("the client ended without a result", tail)
    return event


def _fail(session: Session, outcome: Event) -> NoReturn:
    """Raise the error that ended the calibration, with what is left to use."""
    text = str(outcome["error_msg"])
    bag = session.folder.bag  # a lost planner cannot report it
    if outcome.get("bag_folder") or (bag.is_dir() and any(bag.iterdir())):
        text += f"; everything measured so far is in {outcome.get('bag_folder') or bag}"
        if session.resume_command not in text:  # the planner may have named it
            text += f"; resume with: {session.resume_command}"
    text += f"; logs: {session.log_folder}"
    raise (ConfigurationError if outcome["error_code"] in _USAGE_ERRORS else DataError)(text)


class RunningSession:
    """Nodes and client of a session; ``events`` holds what the client reports, then ``end``."""

    def __init__(self, processes: Processes) -> None:
        self._processes = processes
        self.events: SimpleQueue[dict[str, Any]] = SimpleQueue()
        Thread(target=self._read, name="client reader", daemon=True).start()

    def ended(self) -> dict[str, int]:
        """Return the exit codes of nodes that have ended; those for people may end."""
        ended = self._processes.ended()
        return {n: code for n, code in ended.items() if n not in (CLIENT, *VIEWERS.values())}

    def deaths(self) -> list[str]:
        """Return how those processes ended that were killed or failed, in words."""
        return [
            _death(name, code, self.log_tail(name))
            for name, code in self._processes.ended().items()
            if code
        ]

    def cancel(self) -> None:
        """Ask the client to cancel its goal."""
        self._processes.signal(CLIENT, signal.SIGINT)

    def resume(self) -> None:
        """Tell the planner that the work that it waits for is done."""
        self._processes.tell(CLIENT, "resume")

    def log_tail(self, name: str) -> str:
        """Return the last lines of a process's log."""
        return self._processes.log_tail(name)

    def page_failure(self) -> str | None:
        """Return the last words of the operator's page if it has ended, else None."""
        name = VIEWERS[PAGE]
        ended = name in self._processes.ended()
        return self._processes.log_tail(name, _LINES) if ended else None

    def _read(self) -> None:
        stream = self._processes.children[CLIENT].stdout
        assert stream is not None
        for line in stream:
            self.events.put(json.loads(line))
        self.events.put({"event": "end"})


def _death(name: str, code: int, log: str) -> str:
    """Return how a process died, with the last line it wrote, for a person to read."""
    if code == -signal.SIGKILL:
        return f"{name} was killed (SIGKILL: out of memory?)"
    how = f"exit code {code}"
    if code < 0:
        how = signal.Signals(-code).name if -code in {*signal.Signals} else f"signal {-code}"
    return f"{name} ended ({how}): " + (log.splitlines() or ["it wrote nothing"])[-1]


@contextmanager
def run_processes(session: Session) -> Iterator[RunningSession]:
    """Start the nodes and the client of a session, and end them.

    The folder stays locked until the last of them is dead.
    """
    lock = FolderLock(session.folder.path)
    try:
        require_unchanged(session)
        write_atomically(session.folder.parameters, node_parameters(session.configuration))
        environment = node_environment(alone=session.configuration.simulated)
        with Processes(session.log_folder, environment, (lock.descriptor,)) as processes:
            for name in node_names(session):
                processes.start(name, node_command(session, name))
            processes.start(CLIENT, client_command(session), piped=True)
            yield RunningSession(processes)
    finally:
        lock.release()


def node_names(session: Session) -> list[str]:
    """Return the nodes that a session starts.

    These are those of every cell, those with a group, and the requested ones for people.
    """
    further = nodes_of_groups(session.configuration.given)
    return [*NODES, *further, *(VIEWERS[name] for name in session.shown_by)]


def node_command(session: Session, name: str) -> list[str]:
    """Return the command line of a node."""
    command = [*_start(session, node_module(name))]
    command += ["--params-file", str(session.folder.parameters)]
    if name == "recorder":
        # In quotes, so that a folder called 2024 does not become a number.
        command += ["-p", f"recorder.folder:={json.dumps(str(session.folder.path.parent))}"]
        command += ["-p", f"recorder.session:={json.dumps(session.folder.path.name)}"]
        if session.run:
            command += ["-p", f"recorder.run:={session.run}"]
    if name == "planner":
        command += ["-p", "restart_wait_s:=0.0"]  # these nodes are not started again
    if name in ("planner", "solver") and session.run:
        file = json.dumps(str(session.folder.continuation(session.run)))
        command += ["-p", f"continuation_file:={file}"]
    return command


def client_command(session: Session) -> list[str]:
    """Return the command line of the client that sends the goal."""
    file = json.dumps(str(session.folder.configuration))
    command = [
        *_start(session, "rotcal_ros.nodes.client.json_client"),
        "-p",
        f"configuration_file:={file}",
    ]
    if session.continuation is not None:
        command += ["-p", f"start_index:={session.continuation.start_index}"]
    return command


def _start(session: Session, module: str) -> list[str]:
    namespace = session.configuration.cell.namespace
    return [sys.executable, "-m", module, "--ros-args", "-r", f"__ns:={namespace}"]
