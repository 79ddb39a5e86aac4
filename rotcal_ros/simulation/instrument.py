"""What stands beside a simulated table: the machine and the instrument of a method."""

from __future__ import annotations

from typing import Protocol

from rotcal_ros.observations import Command, ProbeSample, TracerSample
from rotcal_ros.simulation.external_table import ExternalTable
from rotcal_ros.simulation.table import SimulatedTable

Table = SimulatedTable | ExternalTable


class Instrument(Protocol):
    """The machine beside the table with what it carries, on the cell's clock (ns)."""

    rest_ns: int
    """When the last ordered motion ends."""

    @property
    def frame(self) -> str:
        """Frame of its points."""

    @property
    def streams_lengths(self) -> bool:
        """Whether it delivers lengths besides points."""

    @property
    def pending(self) -> Command | None:
        """The order that has not been reported yet."""

    def order(self, now_ns: int, command: Command) -> None:
        """Carry out ``command``."""

    def report(self, after_ns: int, now_ns: int, table_rest_ns: int) -> tuple[ProbeSample, ...]:
        """Return the points that fall in ``after_ns`` < t <= ``now_ns``."""

    def unasked(self, now_ns: int) -> ProbeSample:
        """Return where it believes to be, as a point of kind UNKNOWN."""

    def lengths(self, now_ns: int) -> tuple[TracerSample, ...]:
        """Return the lengths since the call before; empty for an instrument without."""
