"""What a script hears of a calibration, and what it sends: plain data from and for messages."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from action_msgs.msg import GoalStatus
from rotcal_msgs.action import Calibrate

from rotcal_ros.foundation.errors import DataError
from rotcal_ros.foundation.node_state import Why
from rotcal_ros.foundation.results import Result
from rotcal_ros.foundation.untrusted import load_json, read_text, why
from rotcal_ros.methods import Configuration
from rotcal_ros.methods.configuration import configuration_text


@dataclass(frozen=True, slots=True)
class Feedback:
    """The progress of a calibration; None is what is not known yet.

    ``activity`` says in words what is done now, ``doing`` as a code; ``instruction`` what a person
    has to do before it goes on, empty: nothing.
    ``accepted`` and ``rejected`` count attempts, ``left`` the steps that are expected to be left.
    ``uncertainty_rad`` (k = 2) now and ``goal_rad`` are those of a policy that has a
    goal.
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


def planner_lost(last: Feedback | None) -> str:
    """Say that the planner is lost, and how to go on after its ``last`` feedback."""
    text = "node planner is lost"
    if last is None or not last.accepted:
        return text
    return f"{text}; start it again, then continue with start_index {last.step}"


@dataclass(frozen=True, slots=True)
class Outcome:
    """How a calibration ended: ``error_code`` 0 means with a result, see docs/interfaces.md.

    ``bag_folder`` and ``result_file`` are absolute paths, empty where there is none. The verdict
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
            raise DataError(f"the calibration has no result: {self.error_msg}")
        try:
            return Result.from_dict(load_json(read_text(Path(self.result_file))))
        except (OSError, ValueError) as error:
            raise DataError(f"cannot read the result {self.result_file}: {why(error)}") from error


def text_of(configuration: Path | str | Configuration) -> str:
    """Return the YAML text of a configuration, however it is given."""
    if isinstance(configuration, Configuration):
        return configuration.text
    if isinstance(configuration, str) and ("\n" in configuration or not configuration):
        return configuration
    return configuration_text(Path(configuration))


def _known(value: float) -> float | None:
    return value if math.isfinite(value) else None
