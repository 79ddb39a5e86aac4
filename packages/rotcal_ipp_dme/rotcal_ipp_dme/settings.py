"""The settings of a machine behind I++ DME: group ``dme`` of a configuration."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from rotcal_ros.foundation.settings import expert, setting

AUTO: Final = "auto"
GOTO_R: Final = "goto_r"
ALIGN_PART: Final = "align_part"
PORT: Final = 1294
"""The port that I++ DME reserves."""


@dataclass(frozen=True)
class DmeSettings:
    """A coordinate measuring machine with a rotary table, behind I++ DME (VDMA 8722)."""

    host: str = setting("127.0.0.1", doc="host name or IP address of the DME server")
    port: int = setting(PORT, doc="TCP port of the DME server", minimum=1, maximum=65_535)
    tool: str = expert("", doc="tool to change to at the start; empty: the one that is active")
    home: bool = setting(
        False,
        doc="home the machine at the start if it is not homed; it then moves, so somebody must "
        "stand beside it",
    )
    coordinate_system: str = expert(
        "MachineCsy",
        doc="coordinate system of the plan's positions; it must not turn with the table",
        choices=("MachineCsy", "MoveableMachineCsy"),
    )
    turn_by: str = expert(
        AUTO,
        doc="how the table is turned: by GoTo(R()), by AlignPart(), or as the server's version "
        "demands (AlignPart before 2.0)",
        choices=(AUTO, GOTO_R, ALIGN_PART),
    )
    table_zero_deg: float = setting(
        0.0, doc="deg, the machine's angle R at which the table's angle is 0"
    )
    table_reversed: bool = setting(False, doc="R increases clockwise, seen from above the table")
    overshoot_deg: float = expert(
        2.0, doc="deg, by which the table passes an angle to approach it from the other side",
        minimum=1e-3, maximum=90.0,
    )  # fmt: skip
    settle_s: float = expert(
        1.0,
        minimum=1e-3,
        maximum=600.0,
        doc="s, wait from the end of a motion to the first point; the speed of the table is "
        "averaged over it",
    )
    clearance_m: float = expert(
        0.05, doc="m, height above the balls at which the tip travels", minimum=1e-4, maximum=1.0
    )
    approach_m: float = expert(
        0.002, doc="m, distance from a ball at which the probing motion begins", minimum=1e-5,
        maximum=0.1,
    )  # fmt: skip
    search_m: float = expert(
        0.003,
        minimum=1e-5,
        maximum=0.1,
        doc="m, how far behind the nominal surface of a ball the probe searches for it",
    )
    tip_radius_m: float = expert(
        0.0, doc="m, radius of the probe tip; 0: ask the server for it", minimum=0.0, maximum=0.1
    )
    point_std_um: float = expert(
        0.5, doc="um, standard deviation of a point along each axis", minimum=1e-4, maximum=1e3
    )
    report_period_s: float = expert(
        0.2,
        minimum=0.0,
        maximum=60.0,
        doc="s, time between reports while the machine moves, at least 0.1; 0: none",
    )
    idle_period_s: float = expert(
        0.5,
        minimum=0.01,
        maximum=60.0,
        doc="s, time between questions for the machine's position while it has no order",
    )
    reply_timeout_s: float = expert(
        5.0,
        minimum=0.05,
        maximum=600.0,
        doc="s, longest time until a command is acknowledged, and until one that moves nothing "
        "is done",
    )
    motion_timeout_s: float = expert(
        120.0,
        minimum=0.05,
        maximum=86_400.0,
        doc="s, longest time until a command that moves is done",
    )
