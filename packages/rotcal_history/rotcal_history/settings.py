"""The settings of the history: group ``history`` of a configuration."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar, Final, Literal

from rotcal_ros.foundation.language import noted
from rotcal_ros.foundation.settings import expert, setting

CUTTING: Final = (noted("encoder"), noted("bearing"), noted("repair"))
"""Events after which a table is another one; after all others its curve may have jumped."""
EVENTS: Final = (*CUTTING, noted("crash"), noted("adjustment"), noted("other"))
DOCUMENTS: Final = (noted("check"), noted("report"), noted("table"))
"""Kinds of entries that are files beside a result: a quick check, a report, a table in force."""
LONGEST_DAYS: Final = 36_525.0
"""A hundred years: no table is forecast for longer."""
Chart = Literal["shewhart", "cusum", "ewma", "t2"]
Basis = Literal["stated", "own", "model"]
"""What the limits of a chart follow from: stated uncertainties, own scatter, fitted model."""


@dataclass(frozen=True)
class HistorySettings:
    """Where the results of a table are kept, and until when they are believed.

    With this group in a configuration, ``rotcal run`` adds its result to the history.
    """

    database: str = setting(
        "history.db",
        doc="file of the history (SQLite), or postgresql://USER@HOST/NAME; a password belongs "
        "into PGPASSFILE",
    )
    promise: float = expert(
        0.95,
        doc="probability with which a table is within its tolerance on the day it is due",
        minimum=0.5,
        maximum=0.9999,
    )
    interval_days: float = expert(
        365.0,
        doc="days, interval of a table of which too little is known for a forecast",
        minimum=1.0,
        maximum=LONGEST_DAYS,
    )
    longest_days: float = expert(
        1825.0, doc="days, longest interval of any table", minimum=1.0, maximum=LONGEST_DAYS
    )
    common_share: ClassVar[
        Annotated[
            float,
            "nobody knows it; half a variance is least wrong if it is none or all of it",
        ]
    ] = 0.5
    period_s: float = expert(
        60.0, doc="s, time between two looks of the node calibration_status", minimum=1.0
    )
