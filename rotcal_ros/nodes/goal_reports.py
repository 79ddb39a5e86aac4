"""What a planner tells about its goal, as plain records."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rotcal_ros.errors import DataError
from rotcal_ros.planning.plan import PAUSED
from rotcal_ros.results import Result


@dataclass(frozen=True, slots=True)
class Feedback:
    """How far a calibration has come; None is what nobody knows yet.

    ``accepted`` and ``rejected`` count attempts.
    """

    step: int
    total: int
    activity: str
    time_left_s: float | None
    current_std_rad: float | None
    accepted: int
    rejected: int

    @property
    def instruction(self) -> str:
        """What a person has to do before the calibration goes on; empty: nothing."""
        return self.activity.removeprefix(PAUSED) if self.activity.startswith(PAUSED) else ""


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

    def load(self) -> Result:
        """Return the result; DataError with the reason when there is none."""
        if not self.result_file:
            raise DataError(f"the calibration has no result: {self.error_msg}")
        try:
            text = Path(self.result_file).read_text(encoding="utf-8")
        except OSError as error:
            raise DataError(f"cannot read the result {self.result_file}: {error}") from error
        return Result.from_dict(json.loads(text))


def feedback_of(message: Any) -> Feedback:
    """Return the feedback of the action ``calibrate``."""
    return Feedback(
        step=message.step,
        total=message.total,
        activity=message.activity,
        time_left_s=_known(message.time_left),
        current_std_rad=_known(message.current_std),
        accepted=message.n_accepted,
        rejected=message.n_rejected,
    )


def outcome_of(message: Any, *, canceled: bool) -> Outcome:
    """Return the result of the action ``calibrate``."""
    values = {n: getattr(message, n) for n in Outcome.__slots__ if n != "canceled"}
    return Outcome(canceled=canceled, **{**values, "skipped_steps": tuple(message.skipped_steps)})


def _known(value: float) -> float | None:
    return value if math.isfinite(value) else None
