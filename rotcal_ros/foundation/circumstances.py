"""The circumstances of a result: item and people, time, temperature, number of steps.

They follow from the configuration and the observations that count, live and offline alike.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, Final

from rotcal_ros.foundation.dates import day_of, time_of
from rotcal_ros.foundation.identity import Identity
from rotcal_ros.foundation.records import record

SIMULATED: Final = "SIMULATED"
"""The mark on everything that comes from a simulation."""
NOTHING_MEASURED: Final = f"{SIMULATED}: no instrument measured this"


@dataclass(frozen=True, slots=True)
class Range:
    """Mean and extremes of a quantity over the observations that count."""

    mean: float
    lowest: float
    highest: float

    @classmethod
    def of(cls, values: Collection[float | None]) -> Range | None:
        """Return the range of the values that are not None; None without any."""
        given = [value for value in values if value is not None]
        return cls(sum(given) / len(given), min(given), max(given)) if given else None


@dataclass(frozen=True, slots=True)
class StepCounts:
    """Numbers of steps.

    ``planned``: in the plan, for a policy those offered; ``used``: observed and accepted;
    ``skipped``: not measured or given up, 0 if a policy chooses; ``retried``: accepted after one
    or more rejected attempts.
    """

    planned: int
    used: int
    skipped: int
    retried: int


@dataclass(frozen=True, slots=True)
class Circumstances:
    """Circumstances of a measurement.

    ``simulated``: no instrument measured, a simulation did. Times are nanoseconds since 1970 of
    the machine's clock, None if a table has none: then ``identity.measured`` may state the day;
    ``temperature_c`` degrees Celsius, ``pressure_pa`` of the air, ``humidity`` relative, 0 to 1:
    what was captured, else what the configuration states. ``refraction`` says in words who
    corrects the lengths for the index of refraction of the air; empty without lengths.
    """

    simulated: bool = False
    axis: str = ""
    identity: Identity = field(default_factory=Identity)
    begun_ns: int | None = None
    ended_ns: int | None = None
    temperature_c: Range | None = None
    pressure_pa: Range | None = None
    humidity: Range | None = None
    refraction: str = ""
    counts: StepCounts | None = None

    @property
    def days(self) -> tuple[str, str] | None:
        """The first and the last day, as 2026-03-31; None: not known.

        In UTC by the clock of the machine, else the local day that the identity states.
        """
        if self.begun_ns is None:
            stated = self.identity.measured[:10]
            return (stated, stated) if stated else None
        ended = self.begun_ns if self.ended_ns is None else self.ended_ns
        return day_of(self.begun_ns), day_of(ended)

    @property
    def from_ns(self) -> int:
        """When it began, ns since 1970; of a stated day its first moment in UTC; 0: not known."""
        if self.begun_ns is not None or self.days is None:
            return self.begun_ns or 0
        return time_of(self.days[0])

    def to_dict(self) -> dict[str, Any]:
        """Return what is known in plain types, as in result.json."""
        data = asdict(self) | {"identity": self.identity.to_dict()}
        return {k: v for k, v in data.items() if v not in (None, "", {})}

    @classmethod
    def joined(cls, parts: Sequence[Circumstances]) -> Circumstances:
        """Return the circumstances of a combined result: what all statements agree on.

        It begins with the first measurement whose time is known, and ends with the last.
        """
        axes = {part.axis for part in parts} - {""}
        begun = [part.begun_ns for part in parts if part.begun_ns is not None]
        ended = [part.ended_ns for part in parts if part.ended_ns is not None]
        return cls(
            simulated=any(part.simulated for part in parts),
            axis=axes.pop() if len(axes) == 1 else "",
            identity=Identity.joined([part.identity for part in parts]),
            begun_ns=min(begun, default=None),
            ended_ns=max(ended) if ended and len(ended) == len(parts) else None,
        )

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Circumstances:
        """Rebuild them from :meth:`to_dict`; raises ValueError or ConfigurationError."""
        identity = Identity.from_dict(data.get("identity", {}))
        return record(cls, {**data, "identity": identity}, "circumstances")
