"""A client of the action ``calibrate`` that speaks JSON lines, for programs without ROS.

It reads the configuration from a file, sends one goal and prints one JSON object per line:
``waiting``, ``alive``, ``refused``, ``started``, ``feedback``, ``paused``, ``resumed``,
``result``. SIGINT or SIGTERM cancels the goal; the result is waited for.

``paused`` comes once for every work that a person has to do; a line ``resume`` on standard input,
or the planner's service of that name, goes on.
"""

from __future__ import annotations

import json
import math
import os
import select
import sys
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

from action_msgs.msg import GoalStatus
from rclpy.action import ActionClient
from rclpy.node import Node
from rclpy.task import Future
from rotcal_msgs.action import Calibrate
from std_srvs.srv import Trigger

from rotcal_ros.nodes.health import Health
from rotcal_ros.nodes.running import run_node
from rotcal_ros.planning.plan import PAUSED

CANCEL_TIMEOUT_S: Final = 15.0
PERIOD_S: Final = 0.1
ALIVE_PERIOD_S: Final = 1.0
PLANNER_TIMEOUT_S: Final = 5.0
"""Silence of the planner after which nothing is expected of it; the client is in no hurry."""
RESUME: Final = b"resume"
STDIN: Final = 0


class Client(Node):
    """Sends one goal and reports on it until its result."""

    def __init__(self) -> None:
        super().__init__("calibrate_client")
        path = self.declare_parameter("configuration_file", "").value
        self._configuration = Path(path).read_text(encoding="utf-8") if path else ""
        self._start_index = self.declare_parameter("start_index", 0).value
        timeout = self.declare_parameter("server_timeout_s", 30.0).value
        self._deadline = time.monotonic() + timeout
        self._spoken_s = time.monotonic()
        self._handle: Any = None
        self._sent = False
        self._done = False
        self._canceling = False
        self._listening = True
        self._instruction = ""
        self._client = ActionClient(self, Calibrate, "calibrate")
        self._resume = self.create_client(Trigger, "resume")
        self._health = Health(self, None, timeout_s=PLANNER_TIMEOUT_S)
        self.create_timer(PERIOD_S, self._health.guarded(self._watch))
        _say("waiting")

    def finished(self) -> bool:
        """Return whether there is nothing more to report."""
        return self._done

    def begin_stop(self) -> None:
        """Cancel the goal and wait for its result."""
        self._canceling = True
        self._deadline = time.monotonic() + CANCEL_TIMEOUT_S
        if self._handle is not None:
            self._handle.cancel_goal_async()
        elif not self._sent:
            self._finish("result", error_code=Calibrate.Result.CANCELED, error_msg="canceled")

    def stopped(self) -> bool:
        """Return whether the result is here."""
        return self._done

    def _watch(self) -> None:
        """Send the goal once the server is there; give up when it is not or falls silent."""
        if self._done:
            return
        self._listen()
        if time.monotonic() - self._spoken_s > ALIVE_PERIOD_S:
            self._spoken_s = time.monotonic()
            _say("alive", planner=self._planner_state())
        if not self._sent and self._client.server_is_ready() and self._planner_state():
            self._send()
        elif self._sent and self._health.missing(["planner"]):
            self._fail(Calibrate.Result.NODE_LOST, "node planner fell silent")
        elif (self._handle is None or self._canceling) and time.monotonic() > self._deadline:
            state = self._planner_state() or "silent"
            self._fail(Calibrate.Result.NODE_LOST, f"no answer from the planner; it is {state}")

    def _listen(self) -> None:
        """Take what stands on standard input; after its end nothing more is expected."""
        try:
            if not self._listening or not select.select([STDIN], [], [], 0.0)[0]:
                return
            text = os.read(STDIN, 4096)
        except OSError:
            text = b""
        self._listening = bool(text)
        if RESUME in text:
            self._resume.call_async(Trigger.Request()).add_done_callback(
                lambda future: _say("resumed", success=future.result().success,
                                    reason=future.result().message)
            )  # fmt: skip

    def _planner_state(self) -> str:
        return self._health.state("planner")

    def _send(self) -> None:
        self._sent = True
        goal = Calibrate.Goal(configuration=self._configuration, start_index=self._start_index)
        future = self._client.send_goal_async(goal, feedback_callback=self._feedback)
        future.add_done_callback(self._answered)

    def _answered(self, future: Future) -> None:
        handle = future.result()
        if not handle.accepted:
            self._finish("refused", reason=f"the planner is {self._planner_state()}")
            return
        self._handle = handle
        _say("started")
        handle.get_result_async().add_done_callback(self._ended)
        if self._canceling:
            handle.cancel_goal_async()

    def _feedback(self, message: Any) -> None:
        feedback = message.feedback
        _say(
            "feedback",
            step=feedback.step,
            total=feedback.total,
            activity=feedback.activity,
            time_left_s=_known(feedback.time_left),
            current_std_rad=_known(feedback.current_std),
            accepted=feedback.n_accepted,
            rejected=feedback.n_rejected,
        )
        paused = feedback.activity.startswith(PAUSED)
        instruction = feedback.activity.removeprefix(PAUSED) if paused else ""
        if instruction and instruction != self._instruction:
            _say("paused", instruction=instruction)
        self._instruction = instruction

    def _ended(self, future: Future) -> None:
        answer = future.result()
        result = answer.result
        self._finish(
            "result",
            canceled=answer.status == GoalStatus.STATUS_CANCELED,
            error_code=result.error_code,
            error_msg=result.error_msg,
            bag_folder=result.bag_folder,
            result_file=result.result_file,
            verdict=result.verdict,
            n_used=result.n_used,
            n_rejected=result.n_rejected,
            skipped_steps=list(result.skipped_steps),
        )

    def _fail(self, code: int, text: str) -> None:
        self._finish("result", error_code=code, error_msg=text)

    def _finish(self, event: str, **values: Any) -> None:
        _say(event, **values)
        self._done = True


def _known(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _say(event: str, **values: Any) -> None:
    """Print one line; the reader may be gone already."""
    with suppress(BrokenPipeError):
        sys.stdout.write(json.dumps({"event": event, **values}) + "\n")
        sys.stdout.flush()


def make() -> Node:
    """Return the node."""
    return Client()


def main(args: Sequence[str] | None = None) -> None:
    """Run the client until its goal has ended."""
    sys.exit(run_node(make, args))


if __name__ == "__main__":
    main()
