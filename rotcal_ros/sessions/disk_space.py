"""Whether the disk has room for the bag of a calibration: checked before the first motion."""

from __future__ import annotations

import shutil
from itertools import pairwise
from operator import attrgetter
from pathlib import Path
from typing import Final

from rotcal_ros.bags import names
from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.settings import declarations
from rotcal_ros.methods import Calibration, Configuration
from rotcal_ros.planning.choices import AS_LISTED

BYTES_PER_MESSAGE: Final = 100.0
"""Bytes of a reading in a bag, with its index; compression leaves about half of them."""
TABLE_HZ: Final = 100.0
TRACER_HZ: Final = 1000.0
"""Messages per second of real instruments, which no setting states."""


def require_space(calibration: Calibration, folder: Path, steps: int | None = None) -> None:
    """Raise ConfigurationError where the disk of ``folder`` has no room for the bag.

    ``steps`` are left to measure, all of the plan unless given. Settings of the recorder say how
    much of the disk is to stay free.
    """
    existing = next(path for path in (folder, *folder.parents) if path.exists())
    free = shutil.disk_usage(existing).free
    reserve = calibration.configuration.recorder.writer.min_free_bytes
    bag = expected_bytes(calibration, steps)
    if free < bag + reserve:
        raise ConfigurationError(
            f"the disk of {folder} has {free / 1e6:,.0f} MB free, {(bag + reserve) / 1e6:,.0f} MB "
            f"are needed: {bag / 1e6:,.0f} MB for the bag by steps and rates, and "
            f"{reserve / 1e6:,.0f} MB that stay free (recorder.writer.min_free_bytes): make room, "
            "or choose another --output"
        )


def expected_bytes(calibration: Calibration, steps: int | None = None) -> float:
    """Return how large the bag of ``steps`` (None: of the whole plan) may become, in bytes.

    0 for a policy that chooses: it is not known how few of the steps it will take.
    """
    configuration, plan = calibration.configuration, calibration.plan
    if configuration.planner.policy != AS_LISTED or not plan.steps:
        return 0.0
    angles = [step.table_angle for step in plan.steps]
    turns = sum(a != b for a, b in pairwise(angles))
    share = 1.0 if steps is None else steps / len(plan.steps)
    seconds = len(angles) * configuration.planner.step_s + turns * configuration.planner.turn_s
    return share * seconds * _messages_per_second(configuration) * BYTES_PER_MESSAGE


def _messages_per_second(configuration: Configuration) -> float:
    """Return how many readings a second the cell is expected to publish."""
    if configuration.simulated:
        rates = [
            declared.name
            for declared in declarations(type(configuration.simulation))
            if declared.name.endswith("rate_hz")
        ]
        return float(sum(attrgetter(name)(configuration.simulation) for name in rates))
    traced = names.TRACER_LENGTH in configuration.method.topics
    return TABLE_HZ + (TRACER_HZ if traced else 0.0)
