"""The goal of a tracer's plan: its settings from a configuration, a file of their own, words."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rotcal_design.settings import PER_STATION, SHARED, TracerDesignSettings
from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.settings import load
from rotcal_ros.foundation.untrusted import load_yaml, read_errors_as, read_text

if TYPE_CHECKING:
    from rotcal_ros.methods.configuration import Configuration


def goal_settings(
    pattern: Configuration | None, goal: Path | None, changes: Iterable[str]
) -> TracerDesignSettings:
    """Return the settings: of the pattern, then of the file, then ``changes`` as NAME=VALUE.

    Raises ConfigurationError, with the place, for unknown ones.
    """
    values = {} if pattern is None else _of_pattern(pattern)
    if goal is not None:
        values.update(_of_file(goal))
    for change in changes:
        name, equals, value = change.partition("=")
        if not equals:
            raise ConfigurationError(f"{change}: expected NAME=VALUE")
        values[name.strip()] = load_yaml(value, change)
    return load(TracerDesignSettings, values, "goal" if goal is None else str(goal))


def _of_file(goal: Path) -> dict[str, Any]:
    """Return the settings by name that the file of a goal holds."""
    with read_errors_as(goal, ConfigurationError, "the goal "):
        values = load_yaml(read_text(goal), str(goal))
    if not isinstance(values, dict | None):
        raise ConfigurationError(f"{goal}: expected lines of NAME: VALUE, found {values!r:.60}")
    if values and "/**" in values:
        raise ConfigurationError(
            f"{goal} is the configuration of a calibration; expected: settings of a goal by name; "
            "'rotcal plan tracer --like' plans one like it"
        )
    return values or {}


def _of_pattern(pattern: Configuration) -> dict[str, Any]:
    """Return what a configuration of the method says about a goal's settings."""
    plan, solver, simulation = pattern.plan, pattern.solver, pattern.simulation
    angles = ("table_start_deg", "table_step_deg", "table_positions", "table_angles_deg")
    noise = ("length_std_relative", "rejection_significance", "slip_m")
    return {
        **{name: getattr(plan, name) for name in angles},
        **{name: getattr(solver, name) for name in noise},
        "length_std_m": pattern.planner.expected_std_m or solver.length_std_m,
        "target_std_m": (solver.target_std_m,) * 3,
        "error_motion_std_m": solver.error_motion_std_m,
        "circle_std_m": solver.circle_std_m,
        "zero": SHARED if solver.zero == "per_segment" else PER_STATION,
        "mount_m": simulation.tracer.mount_m,
        "axis_m": simulation.table.axis_offset_m[:2],
    }
