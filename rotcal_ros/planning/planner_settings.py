"""The settings of the planner: group ``planner`` of a configuration."""

from __future__ import annotations

from dataclasses import dataclass

from rotcal_ros.settings import setting


@dataclass(frozen=True)
class PlannerSettings:
    """How patient the planner is; all times are seconds of the wall clock."""

    max_attempts: int = setting(
        3, doc="attempts at one step before it is skipped", minimum=1, maximum=100
    )
    preflight_timeout_s: float = setting(
        15.0, doc="s, time for all nodes and topics to appear", minimum=0.1, maximum=3600.0
    )
    step_timeout_s: float = setting(
        60.0, doc="s, from an order to its observation", minimum=0.1, maximum=86_400.0
    )
    receipt_timeout_s: float = setting(
        10.0,
        doc="s, from an observation to the recorder's receipt that it is on disk",
        minimum=0.1,
        maximum=3600.0,
    )
    stream_timeout_s: float = setting(
        2.0, doc="s, silence of an instrument after which it is lost", minimum=0.1, maximum=3600.0
    )
    join_steps: int = setting(
        8,
        doc="done steps that a resumed plan measures again, to find the zero of the lengths",
        minimum=1,
        maximum=1000,
    )
    solve_timeout_s: float = setting(
        120.0, doc="s, time for the final solution", minimum=1.0, maximum=86_400.0
    )
