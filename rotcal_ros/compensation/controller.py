"""What a kind of controller provides: settings, a writer, a reader, and the control's own rule.

A controller is a frozen dataclass whose fields are the settings of one machine. Its reader reads
back what its writer wrote, and the rule shows what the real control would do with it: this
verifies a file before it counts as written. How to add one: ``docs/controllers.md``.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, Final, NamedTuple, Protocol

from rotcal_ros.compensation.table import CompensationTable
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.observations import Approach
from rotcal_ros.foundation.results import AxisLine
from rotcal_ros.foundation.settings import setting
from rotcal_ros.foundation.units import TURN

EVERY_TURN: Final = (-TURN, 2.0 * TURN)
"""Travel (rad) over which a control that wraps by itself is verified."""


@dataclass(frozen=True)
class Facts:
    """A controller in words, for people; every export repeats it.

    ``verified_on``: what files and rule were tried on.
    """

    title: str
    sign: str
    wrap: str
    unit: str
    source: str
    verified_on: str = "page only"


@dataclass(frozen=True)
class Lag:
    """What a control leaves over because its correction does not follow the table at once, rad.

    ``bound`` limits what remains when the axis has come to rest, ``simulated`` is what the
    control's rule leaves of it, ``notes`` are warnings for people.
    """

    bound: float = 0.0
    simulated: float = 0.0
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Located:
    """Where an axis is, for a controller: ``files`` by name, ``notes`` on what they leave.

    ``values`` are the parameters by name, in the unit of the controller. ``unverified``: what
    has not been confirmed on a real control.
    """

    files: Mapping[str, str]
    values: Mapping[str, float]
    source: str
    notes: tuple[str, ...] = ()
    unverified: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class ComponentErrors:
    """All measured deviations of a rotary axis over one turn, for volumetric compensation.

    ``angles`` (n,) rad ascend within a turn; ``deviations`` (n,) are actual - commanded by their
    ISO 230-1 names, EXC .. ECC, metres and radians, and repeat in every turn.
    """

    angles: Floats
    deviations: Mapping[str, Floats]


@dataclass(frozen=True)
class Volumetric:
    """Files of a volumetric compensation by name, ``notes`` on what they leave, as in Located."""

    files: Mapping[str, str]
    source: str
    notes: tuple[str, ...] = ()
    unverified: tuple[str, ...] = ()


class OwnSetting(NamedTuple):
    """What a control does with an axis beside its table, as every export of the table repeats it.

    ``name`` is the setting's in the control, ``effect`` what it does to the table, ``handled``
    what the export does about it, and what a person has to. Without a ``source`` it is from
    memory.
    """

    name: str
    effect: str
    handled: str
    source: str

    def describe(self) -> str:
        """Return it in one line."""
        doubt = "" if self.source else " (not confirmed by a page)"
        return f"{self.name}: {self.effect}{doubt}; {self.handled}"


class Comment(NamedTuple):
    """Where a file of a controller takes comments: its ending, the line, and how one looks."""

    suffix: str
    place: int
    form: str


class Rule(Protocol):
    """A table as a control has loaded it."""

    def correction(self, angle: Floats, approach: Approach) -> Floats:
        """Return the radians that the control adds to the command at ``angle`` (rad)."""


@dataclass(frozen=True)
class Controller(ABC):
    """One kind of controller; a subclass declares its settings, all of them with a default.

    ``position_resolution`` and ``value_resolution`` (rad) are the steps of the positions and of
    the values in a file, ``staircase`` says that the control does not interpolate between them.
    ``suffixes`` are the endings of the names of its files; without them files that were copied by
    hand are not recognised before the first change. ``own_settings`` are what else the control
    does with the axis; ``comment`` is None if the files have no comments.
    """

    facts: ClassVar[Facts]
    own_settings: ClassVar[tuple[OwnSetting, ...]] = ()
    comment: ClassVar[Comment | None] = None
    suffixes: ClassVar[tuple[str, ...]] = ()
    position_resolution: ClassVar[float] = 0.0
    value_resolution: ClassVar[float] = 0.0
    staircase: ClassVar[bool] = False

    @abstractmethod
    def write(self, table: CompensationTable, stem: str) -> dict[str, str]:
        """Return names, beginning with ``stem``, and texts of the files that hold ``table``.

        The first file is the table; the others say how it is to be read.
        Raises ConfigurationError when the controller cannot hold it.
        """

    @abstractmethod
    def read(self, files: Mapping[str, str]) -> Rule:
        """Return what the control makes of ``files``; BagError if they are damaged."""

    def resolution(self, table: CompensationTable) -> float:
        """Return the step (rad) of the values in the files of ``table``."""
        del table
        return self.value_resolution

    def commented(self, files: Mapping[str, str], lines: Iterable[str]) -> dict[str, str]:
        """Return ``files`` with ``lines`` as comments, if their form has comments.

        Reading them gives the same as before.
        """
        if self.comment is None:
            return dict(files)
        suffix, place, form = self.comment
        return insert_lines(files, suffix, place, [form.format(line) for line in lines])

    def marked(self, files: Mapping[str, str], text: str) -> dict[str, str]:
        """Return ``files`` with the mark ``text``, where whoever looks at the table sees it."""
        return self.commented(files, [text])

    def for_axis(self, axis: str) -> Controller:
        """Return the controller with the values for ``axis`` from the machine's own files.

        Raises ConfigurationError when they contradict the settings.
        """
        del axis
        return self

    def without_table(self, approach: Approach) -> float:
        """Return the radians that the control adds to the command as long as it has no table."""
        del approach
        return 0.0

    def replaced(self, table: CompensationTable) -> str:
        """Say in words what of :meth:`without_table` is in ``table``, and what of it is not."""
        del table
        return ""

    def require_stated(self, table: CompensationTable) -> None:
        """Raise ConfigurationError for what a person has to say before ``table`` is written.

        A node, which can ask nobody, says it as a warning.
        """
        del table

    def lag(self, rule: Rule, table: CompensationTable) -> Lag:
        """Return what remains because the correction lags behind the rows of ``table``.

        ``rule`` is what was read from the files of ``table``.
        """
        del rule, table
        return Lag()

    def not_in_use(self, axis: str, files: Mapping[str, str], folder: Path) -> tuple[str, ...]:
        """Return in words why the machine would not use ``files`` in ``folder`` as intended.

        Empty also if the settings do not name the machine's own files.
        """
        del axis, files, folder
        return ()

    def machine_files(self, axis: str, files: Mapping[str, str]) -> dict[str, str]:
        """Return copies of the machine's own files, changed so that it uses ``files``, by name."""
        del axis, files
        return {}

    def locate(self, lines: Sequence[AxisLine], stem: str, head: Sequence[str]) -> Located:
        """Return the parameters that say where axes are: the table's, and what tilts it.

        Names of files begin with ``stem``; comments may repeat ``head``. Raises
        ConfigurationError when the controller has no such parameters.
        """
        del lines, stem, head
        raise ConfigurationError(
            f"{self.facts.title}: no parameters are known for the place of an axis; 'csv' writes "
            "it for people"
        )

    def write_components(
        self, errors: ComponentErrors, stem: str, head: Sequence[str]
    ) -> Volumetric:
        """Return the files of a volumetric compensation by ``errors``.

        Names of files begin with ``stem``; comments repeat ``head``. Raises ConfigurationError
        when no public form is known.
        """
        del errors, stem, head
        raise self._without_components()

    def read_components(self, files: Mapping[str, str]) -> ComponentErrors:
        """Return what the control makes of its volumetric ``files``; BagError for damage."""
        del files
        raise self._without_components()

    def _without_components(self) -> ConfigurationError:
        return ConfigurationError(
            f"{self.facts.title}: no public form of its volumetric compensation is known; "
            "--to volumetric writes all deviations as CSV and JSON"
        )

    @property
    def travel(self) -> tuple[float, float]:
        """First and last angle (rad) for which the files hold."""
        return EVERY_TURN

    @property
    def row_spacings_deg(self) -> tuple[float, ...]:
        """Distances of rows that the control asks for; empty: whatever divides a turn."""
        return ()

    @property
    def one_direction(self) -> bool:
        """Whether one column serves both directions."""
        return False

    @property
    def unverified(self) -> tuple[str, ...]:
        """What has not yet been confirmed on a real control."""
        return ()

    @property
    def switch_on(self) -> str:
        """What switches the table on at this control, in words; empty if nothing has to."""
        return ""

    @property
    def busy_command(self) -> tuple[str, ...]:
        """Command that reports whether the machine is at work; see :mod:`.feed`; empty: none."""
        return ()


def insert_lines(
    files: Mapping[str, str], suffix: str, place: int, added: Sequence[str]
) -> dict[str, str]:
    """Return ``files`` with the lines ``added`` at ``place`` in those that end with ``suffix``."""
    texts = dict(files)
    for name in (name for name in files if name.endswith(suffix)):
        lines = files[name].splitlines(keepends=True)
        texts[name] = "".join([*lines[:place], *(f"{x}\n" for x in added), *lines[place:]])
    return texts


@dataclass(frozen=True)
class EveryTurnController(Controller):
    """A controller that does not wrap: rows are written for every turn of the table's travel."""

    first_turn: int = setting(0, doc="turn that the table begins with; 1 is 360 .. 720 deg")
    turns: int = setting(1, doc="number of turns that the table covers", minimum=1)

    @property
    def travel(self) -> tuple[float, float]:
        """First and last angle (rad) of the turns that are written."""
        return self.first_turn * TURN, (self.first_turn + self.turns) * TURN
