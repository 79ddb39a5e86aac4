"""Calibrates a cell from a script, without knowledge of ROS.

For example::

    with Calibrator("/cell") as calibrator:
        calibrator.wait_until_ready()
        calibrator.start(Path("cell.yaml"))
        while not calibrator.is_done():
            print(calibrator.feedback())
        print(calibrator.result().load().deviations)

What a script hears of a calibration and what it sends is plain data, made from messages and into
messages.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from action_msgs.msg import GoalStatus
from rclpy.action import ActionClient
from rotcal_msgs.action import Calibrate
from std_srvs.srv import Trigger

from rotcal_ros.foundation.errors import DataError, RotcalError
from rotcal_ros.foundation.machine_load import load_scaled_timeout
from rotcal_ros.foundation.node_state import NodeState, Why
from rotcal_ros.foundation.results import Result
from rotcal_ros.foundation.untrusted import cause_of, load_json, read_text
from rotcal_ros.methods import Configuration
from rotcal_ros.methods.configuration import configuration_text
from rotcal_ros.nodes.runtime.health import PLANNER, Health
from rotcal_ros.nodes.runtime.running import PeerNode, use_middleware

CANCEL_TIMEOUT_S: Final = 15.0
ANSWER_TIMEOUT_S: Final = 10.0
_GRACE_S: Final = 0.5
"""Time for a result that was still on its way when the planner left."""
_ON_ITS_WAY_S: Final = 0.1
"""Time for feedback that was still on its way when a pause ended."""


class CalibratorError(RotcalError):
    """The planner is not there or gives no answer."""


class GoalRefusedError(CalibratorError):
    """The planner does not accept the goal; the text says what it is doing."""


class Calibrator:
    """Sends goals to the planner of one cell, one after the other.

    It works only inside its calls; between them a script may do what it likes. The end of a
    ``with`` block cancels a running goal; :meth:`close` leaves it to the planner.
    ``args`` are arguments of ROS's command line. One object serves one thread.
    """

    def __init__(
        self, namespace: str = "/cell", *, name: str = "calibrator", args: Sequence[str] = ()
    ) -> None:
        use_middleware()
        self._peer = PeerNode(name, namespace, args)
        self.node = self._peer.node
        self._action = ActionClient(self.node, Calibrate, "calibrate")
        self._resume = self.node.create_client(Trigger, "resume")
        self.health = Health(self.node, None)
        self._handle: Any = None
        self._answer: Any = None
        self._feedback: Feedback | None = None
        self._outcome: Outcome | None = None
        self._deadline_s = math.inf

    @property
    def planner_state(self) -> NodeState:
        """The planner's state; UNKNOWN if it was never heard."""
        return self.health.node_state(PLANNER)

    def is_ready(self, timeout_s: float = 0.1) -> bool:
        """Wait this long for the planner; return whether it is there."""
        return self._peer.work_until(
            lambda: self._action.server_is_ready() and PLANNER in self.health.others, timeout_s
        )

    def listen(self, seconds: float) -> None:
        """Handle incoming messages for this time."""
        self._peer.work_until(lambda: False, seconds)

    def wait_until_ready(self, timeout_s: float = 30.0) -> None:
        """Wait for the planner; CalibratorError when it does not appear."""
        if not self.is_ready(timeout_s):
            place = self.node.get_namespace()
            raise CalibratorError(
                f"no planner appeared in {place} within {timeout_s:g} s: start the nodes (ros2 "
                f"launch rotcal_ros cell.launch.py namespace:={place}) in the same ROS_DOMAIN_ID"
            )

    def start(self, configuration: Path | str | Configuration = "", start_index: int = 0) -> None:
        """Begin a calibration at a step of its plan; return once the planner has taken the goal.

        A string with line breaks is YAML text, any other is the path of a file; with an empty one
        the planner uses its parameters. A configuration that cannot be used ends
        the calibration at once, see :meth:`result`. Raises GoalRefusedError while the planner is
        at work, ConfigurationError when the file cannot be read.
        """
        if self._running():
            raise CalibratorError("a calibration is running: wait for result() or call cancel()")
        goal = Calibrate.Goal(
            configuration=read_configuration_text(configuration), start_index=start_index
        )
        self.wait_until_ready()
        self._feedback, self._outcome, self._deadline_s = None, None, math.inf
        self._handle = self._answer = None
        handle = self._wait(self._action.send_goal_async(goal, feedback_callback=self._hear))
        if not handle.accepted:
            raise GoalRefusedError(f"the planner is {self.health.describe(PLANNER)}")
        self._handle, self._answer = handle, handle.get_result_async()

    def is_done(self, timeout_s: float = 0.1) -> bool:
        """Wait for the next feedback or the end; return whether the calibration has ended."""
        before = self._feedback
        self._peer.work_until(lambda: self._ended() or self._feedback is not before, timeout_s)
        return self._outcome is not None

    def feedback(self) -> Feedback | None:
        """Return the latest feedback; None before the first one after start or resume."""
        return self._feedback

    def cancel(self) -> None:
        """Ask the planner to end; :meth:`result` returns when the bag is closed."""
        if self._running():
            self._deadline_s = time.monotonic() + load_scaled_timeout(CANCEL_TIMEOUT_S)
            self._handle.cancel_goal_async()

    def resume(self) -> None:
        """Go on after a person's work is done; CalibratorError when nothing waits for it.

        Earlier feedback is forgotten, so that no instruction is carried out twice.
        """
        answer = self._wait(self._resume.call_async(Trigger.Request()))
        if not answer.success:
            raise CalibratorError(answer.message)
        self.listen(_ON_ITS_WAY_S)
        self._feedback = None

    def result(self, timeout_s: float = math.inf) -> Outcome:
        """Wait for the end of the calibration and return how it ended."""
        if not self._peer.work_until(self._ended, timeout_s):
            raise CalibratorError(
                f"no result within {timeout_s:g} s: the planner is "
                f"{self.health.describe(PLANNER)}; wait longer, or call cancel()"
            )
        assert self._outcome is not None
        return self._outcome

    def close(self) -> None:
        """Leave the cell; a calibration that runs goes on."""
        self._peer.close()

    def __enter__(self) -> Calibrator:
        return self

    def __exit__(self, *_error: object) -> None:
        with suppress(CalibratorError):
            if self._running():
                self.cancel()
                self.result(load_scaled_timeout(2 * CANCEL_TIMEOUT_S))
        self.close()

    def _running(self) -> bool:
        return self._answer is not None and self._outcome is None

    def _ended(self) -> bool:
        """Note the outcome once there is one; CalibratorError when nothing was started."""
        if self._answer is None:
            raise CalibratorError("no calibration was started: call start() first")
        if self._outcome is None:
            self._outcome = self._found()
        return self._outcome is not None

    def _found(self) -> Outcome | None:
        """Return how the goal ended, even if its planner was lost."""
        silent = bool(self.health.missing([PLANNER]))
        if silent:
            self._peer.work_until(self._answer.done, _GRACE_S)
        if self._answer.done():
            return Outcome.of(self._answer.result())
        lost = Calibrate.Result.NODE_LOST
        if silent:
            return Outcome(error_code=lost, error_msg=planner_lost_message(self._feedback))
        if time.monotonic() > self._deadline_s:
            return Outcome(error_code=lost, error_msg=self.no_answer())
        return None

    def no_answer(self) -> str:
        """Return the error that the planner gives no answer, with its state and who is heard."""
        heard = ", ".join(sorted(self.health.present())) or "no node at all"
        return f"no answer from the planner; it is {self.health.describe(PLANNER)}; heard: {heard}"

    def _hear(self, message: Any) -> None:
        self._feedback = Feedback.of(message.feedback)

    def _wait(self, future: Any) -> Any:
        """Return the answer of the planner to a request."""
        if not self._peer.work_until(future.done, load_scaled_timeout(ANSWER_TIMEOUT_S)):
            raise CalibratorError(self.no_answer())
        return future.result()


@dataclass(frozen=True, slots=True)
class Feedback:
    """The progress of a calibration; None: not known yet.

    ``activity`` says in words what is being done, ``doing`` as a code. ``instruction`` is what a
    person has to do before it goes on; empty: nothing.
    ``accepted`` and ``rejected`` count attempts, ``left`` is the expected number of further steps.
    ``uncertainty_rad`` (k = 2, at present) and ``goal_rad`` belong to a policy that has a goal.
    """

    step: int
    total: int
    activity: str
    time_left_s: float | None
    current_std_rad: float | None
    accepted: int
    rejected: int
    doing: Why = Why.UNKNOWN
    instruction: str = ""
    left: int = 0
    uncertainty_rad: float | None = None
    goal_rad: float | None = None

    @classmethod
    def of(cls, heard: Calibrate.Feedback) -> Feedback:
        """Return what a message says."""
        return cls(
            step=heard.step,
            total=heard.total,
            activity=heard.activity,
            time_left_s=_known(heard.time_left),
            current_std_rad=_known(heard.current_std),
            accepted=heard.n_accepted,
            rejected=heard.n_rejected,
            doing=Why(heard.doing),
            instruction=heard.instruction,
            left=heard.left,
            uncertainty_rad=_known(heard.uncertainty),
            goal_rad=_known(heard.goal),
        )


def planner_lost_message(last: Feedback | None) -> str:
    """Say that the planner is lost, and how to go on after its ``last`` feedback."""
    text = "node planner is lost"
    if last is None or not last.accepted:
        return text
    return f"{text}; start it again, then continue with start_index {last.step}"


@dataclass(frozen=True, slots=True)
class Outcome:
    """How a calibration ended; ``error_code`` 0: with a result (see docs/interfaces.md).

    ``bag_folder`` and ``result_file`` are absolute paths, empty if there is none. The verdict
    is ok, suspect or failed. ``skipped_steps`` were given up after all attempts.
    """

    canceled: bool = False
    error_code: int = 0
    error_msg: str = ""
    bag_folder: str = ""
    result_file: str = ""
    verdict: str = ""
    n_used: int = 0
    n_rejected: int = 0
    skipped_steps: tuple[int, ...] = ()

    @classmethod
    def of(cls, answer: Any) -> Outcome:
        """Return the answer of an action server, with its status."""
        values = {n: getattr(answer.result, n) for n in cls.__slots__ if n != "canceled"}
        values["skipped_steps"] = tuple(answer.result.skipped_steps)
        return cls(canceled=answer.status == GoalStatus.STATUS_CANCELED, **values)

    def load(self) -> Result:
        """Return the result; DataError with the reason when there is none."""
        if not self.result_file:
            raise DataError(f"the calibration has no result: {self.error_msg}; solve its bag")
        try:
            return Result.from_dict(load_json(read_text(Path(self.result_file))))
        except (OSError, ValueError) as error:
            raise DataError(
                f"cannot read the result {self.result_file}: {cause_of(error)}"
            ) from error


def read_configuration_text(configuration: Path | str | Configuration) -> str:
    """Return the YAML text of a configuration, given as text or as a file."""
    if isinstance(configuration, Configuration):
        return configuration.text
    if isinstance(configuration, str) and ("\n" in configuration or not configuration):
        return configuration
    return configuration_text(Path(configuration))


def _known(value: float) -> float | None:
    return value if math.isfinite(value) else None
