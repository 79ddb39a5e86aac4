"""A client of the action ``calibrate`` that speaks JSON lines, for programs without ROS.

It reads the configuration from a file, sends one goal and prints one JSON object per line:
``waiting``, ``alive``, ``page``, ``refused``, ``started``, ``feedback``, ``paused``,
``resumed``, ``warning``, ``result``. SIGINT or SIGTERM cancels the goal; the result is waited for.

``paused`` comes once for every piece of work that a person has to do; a line ``resume`` on
standard input, or the planner's service of that name, continues.
"""

from __future__ import annotations

import os
import select
import sys
import time
from dataclasses import asdict
from pathlib import Path
from typing import Final

from rotcal_msgs.action import Calibrate

from rotcal_ros.capture.rejections import reason_kind
from rotcal_ros.foundation.machine_load import WaitBudget, describe_load
from rotcal_ros.foundation.node_names import PAGE, VIEWERS
from rotcal_ros.nodes.client.calibrator import (
    Calibrator,
    CalibratorError,
    Feedback,
    GoalRefusedError,
    Outcome,
)
from rotcal_ros.nodes.runtime.beat_values import reported_warnings
from rotcal_ros.nodes.runtime.clocks import describe_clock_jumps
from rotcal_ros.nodes.runtime.health import BEAT_PERIOD_S, HEAR_PERIOD_S
from rotcal_ros.nodes.runtime.liveness import OtherSessionError, require_own_session
from rotcal_ros.nodes.runtime.running import EndRequest, print_event, run_and_exit

PERIOD_S: Final = 0.1
ALIVE_PERIOD_S: Final = 1.0
LISTEN_S: Final = 0.6
"""A client listens at least this long for nodes of another session: three beats."""
LAST_BEATS_S: Final = BEAT_PERIOD_S + 2 * HEAR_PERIOD_S
"""After the end of a goal every node has sent its last warnings by then."""
RESUME: Final = b"resume"
STDIN: Final = 0


class Client:
    """Sends one goal and reports on it until its result."""

    def __init__(self, calibrator: Calibrator, end: EndRequest) -> None:
        self._calibrator = calibrator
        self._end = end
        self._spoken_s = time.monotonic()
        self._listening = True
        self._page = ""
        self._shown: Feedback | None = None
        self._warned: set[str] = set()

    def run(self) -> None:
        """Wait for the planner, send the goal and follow it."""
        path = self._calibrator.node.declare_parameter("configuration_file", "").value
        start_index = self._calibrator.node.declare_parameter("start_index", 0).value
        timeout_s = self._calibrator.node.declare_parameter("server_timeout_s", 30.0).value
        print_event("waiting")
        try:
            if self._planner_came(timeout_s):
                self._calibrator.start(Path(path) if path else "", start_index)
                outcome = self._followed()
            else:
                outcome = Outcome(error_code=Calibrate.Result.CANCELED, error_msg="canceled")
        except (GoalRefusedError, OtherSessionError) as error:
            print_event("refused", reason=str(error))
            return
        except CalibratorError as error:
            outcome = Outcome(error_code=Calibrate.Result.NODE_LOST, error_msg=str(error))
        print_event("result", **asdict(outcome))

    def _planner_came(self, timeout_s: float) -> bool:
        """Wait for the planner; False if the client has to end, CalibratorError if none comes."""
        budget = WaitBudget(timeout_s)
        listen_until = time.monotonic() + LISTEN_S
        while True:
            self._calibrator.listen(PERIOD_S)
            ready = self._calibrator.is_ready(0.0) and time.monotonic() >= listen_until
            self._live()  # the beat that made it ready shows whose planner it is
            require_own_session(self._calibrator.health, os.environ)
            if ready or self._end:
                return not self._end
            if budget.is_over():
                raise CalibratorError(self._calibrator.no_answer())

    def _followed(self) -> Outcome:
        """Report on the goal until it ends."""
        print_event("started")
        canceling = done = False
        while not done:
            if self._end and not canceling:
                canceling = True
                self._calibrator.cancel()
            done = self._calibrator.is_done(PERIOD_S)
            self._show(self._calibrator.feedback())
            self._listen()
            self._warn()
            self._live()
        self._calibrator.listen(LAST_BEATS_S)  # a goal may end before the beat that says why
        self._warn()
        return self._calibrator.result()

    def _live(self) -> None:
        """Print that this client is alive, and once the address of the page."""
        if time.monotonic() - self._spoken_s > ALIVE_PERIOD_S:
            self._spoken_s = time.monotonic()
            print_event("alive", planner=self._calibrator.planner_state.describe())
        page = self._calibrator.health.node_state(VIEWERS[PAGE]).page
        if page and page != self._page:
            self._page = page
            print_event("page", address=page)

    def _warn(self) -> None:
        """Report each kind of warning once, and a jump that all nodes report only once."""
        health = self._calibrator.health
        jumps = ((text.partition(" at ")[0], text) for text in describe_clock_jumps(health))
        concerns = ((reason_kind(text), text) for text in reported_warnings(health))
        slow = [
            f"planner: no sign of it for {s:.1f} s: slow, not lost; {describe_load()}"
            for name, s in health.slow.items()
            if name == "planner"
        ]
        for kind, text in (*jumps, *concerns, *((reason_kind(t), t) for t in slow)):
            if kind not in self._warned:
                print_event("warning", text=text)
            self._warned.add(kind)

    def _show(self, feedback: Feedback | None) -> None:
        if feedback is None or feedback is self._shown:
            return
        before, self._shown = self._shown, feedback
        print_event("feedback", **asdict(feedback))
        instruction = feedback.instruction
        if instruction and (before is None or instruction != before.instruction):
            print_event("paused", instruction=instruction, doing=feedback.doing)

    def _listen(self) -> None:
        """Handle the lines on standard input until it ends."""
        try:
            if not self._listening or not select.select([STDIN], [], [], 0.0)[0]:
                return
            text = os.read(STDIN, 4096)
        except OSError:
            text = b""
        self._listening = bool(text)
        if RESUME in text:
            reason = ""
            try:
                self._calibrator.resume()
            except CalibratorError as error:
                reason = str(error)
            print_event("resumed", success=not reason, reason=reason)


def _work() -> None:
    end = EndRequest()
    with Calibrator("", name="calibrate_client", args=sys.argv) as calibrator:
        Client(calibrator, end).run()


def main() -> None:
    """Run the client until its goal has ended."""
    run_and_exit(_work)


if __name__ == "__main__":
    main()
