"""What a kind of controller brings: settings, a writer, a reader, and the control's own rule.

A controller is a frozen dataclass whose fields are the settings of one machine. What its writer
wrote its reader reads back, and the rule shows what the real control would do with it: that is
what proves a file before it is called done. How to add one: ``docs/compensation.md``.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Final, Protocol

from rotcal_ros.arrays import Floats
from rotcal_ros.compensation.table import CompensationTable
from rotcal_ros.curves.interpolation import TURN
from rotcal_ros.observations import Approach

EVERY_TURN: Final = (-TURN, 2.0 * TURN)
"""Travel (rad) over which a control that wraps by itself is proven."""


@dataclass(frozen=True)
class Facts:
    """A controller in words, for people; every export repeats it."""

    title: str
    sign: str
    wrap: str
    unit: str
    source: str


class Rule(Protocol):
    """A table as a control has loaded it."""

    def correction(self, angle: Floats, approach: Approach) -> Floats:
        """Return the radians that the control adds to the command at ``angle`` (rad)."""


@dataclass(frozen=True)
class Controller(ABC):
    """One kind of controller; a subclass declares its settings, all of them with a default.

    ``position_resolution`` (rad) is the step of the positions in a file, ``staircase`` tells that
    the control does not interpolate between them.
    """

    facts: ClassVar[Facts]
    position_resolution: ClassVar[float] = 0.0
    staircase: ClassVar[bool] = False

    @abstractmethod
    def write(self, table: CompensationTable, stem: str) -> dict[str, str]:
        """Return names, beginning with ``stem``, and texts of the files that hold ``table``.

        Raises ConfigurationError when the controller cannot hold it.
        """

    @abstractmethod
    def read(self, files: Mapping[str, str]) -> Rule:
        """Return what the control makes of ``files``; BagError when they are damaged."""

    @abstractmethod
    def resolution(self, table: CompensationTable) -> float:
        """Return the step (rad) of the values in the files of ``table``."""

    @property
    def travel(self) -> tuple[float, float]:
        """First and last angle (rad) for which the files hold."""
        return EVERY_TURN

    @property
    def one_direction(self) -> bool:
        """Whether one column serves both directions."""
        return False

    @property
    def unverified(self) -> tuple[str, ...]:
        """What nobody has confirmed yet on a real control."""
        return ()
