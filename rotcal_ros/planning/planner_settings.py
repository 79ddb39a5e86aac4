"""The settings of the planner: group ``planner`` of a configuration."""

from __future__ import annotations

from dataclasses import dataclass

from rotcal_ros.foundation.settings import setting
from rotcal_ros.planning.policy_names import AS_LISTED, UNTIL_GOAL


@dataclass(frozen=True)
class PlannerSettings:
    """What the planner measures next, and how patient it is; times are of the wall clock."""

    policy: str = setting(
        AS_LISTED,
        doc="which step comes next: all of the plan in their order, or of the plan's steps those "
        "that are needed for the goal",
        choices=(AS_LISTED, UNTIL_GOAL),
    )
    goal_arcsec: float = setting(
        0.0,
        doc="arcsec, expanded uncertainty (k = 2) of ECC about its mean, root mean square over "
        "the table angles, at which until_goal stops; 0: not given",
        minimum=0.0,
        maximum=3600.0,
    )
    expected_std_m: float = setting(
        0.0,
        doc="m, standard deviation of a length that until_goal plans its first sweep with; 0: "
        "that of the solver",
        minimum=0.0,
        maximum=1e-2,
    )
    step_s: float = setting(
        5.0, doc="s, how long until_goal takes a step to be", minimum=0.001, maximum=3600.0
    )
    turn_s: float = setting(
        10.0, doc="s, how long until_goal takes a turn of the table to be", minimum=0.0,
        maximum=3600.0,
    )  # fmt: skip

    max_attempts: int = setting(
        3, doc="attempts at one step before it is skipped", minimum=1, maximum=100
    )
    max_failed_steps: int = setting(
        3,
        doc="steps that may fail running, all attempts used up, before the planner gives up; "
        "ten times as many where something stood in the beam; 0: it never does",
        minimum=0,
        maximum=100_000,
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
        2.0,
        doc="s, silence of an instrument after which it is waited for; it is lost where nobody "
        "publishes it any more, and after health.lost_after_s",
        minimum=0.1,
        maximum=3600.0,
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
