"""What a check of a cell finds, line by line: the form that nodes write and the terminal shows."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Final, Literal

State = Literal["good", "doubt", "missing", "open", "note"]
BAD: Final = ("missing",)
"""Lines without which nothing can be measured."""


@dataclass(frozen=True)
class CheckLine:
    """One thing that was looked at.

    ``part`` groups the lines of a table, a probe, a tracer ...; ``found`` is what was found of
    ``name``; ``todo`` what a person should do about it, empty where there is nothing. ``state``
    missing: nothing can be measured; doubt: it looks wrong; open: it cannot be known here; note:
    for information. ``rate_hz`` and ``stamp_offset_s`` (stamp less time of arrival) are those of
    a stream; None: there is none.
    """

    part: str
    name: str
    state: State
    found: str
    todo: str = ""
    rate_hz: float | None = None
    stamp_offset_s: float | None = None


@dataclass(frozen=True)
class DriverCheck:
    """What a check says of a driver before ``rotcal run`` starts it, by its group's settings.

    ``brings``: the streams that it will publish, and the orders that it will obey. ``look``: the
    line of its device, given whether its node is here and whether the cell is simulated; None: no
    line. ``ears``: what hears the table behind it, made of a node and a configuration; None:
    nothing is.
    """

    brings: Callable[[Any], Sequence[str]]
    look: Callable[[Any, bool, bool], CheckLine] | None = None
    ears: Callable[[Any, Any], Any] | None = None


@dataclass(frozen=True)
class CellReport:
    """All lines of a check; ``place`` says where was listened, ``seconds`` how long.

    ``moved``: the table was turned for it.
    """

    namespace: str
    place: str
    seconds: float
    lines: tuple[CheckLine, ...]
    domains: tuple[int, ...] = ()
    moved: bool = False

    @property
    def complete(self) -> bool:
        """Whether nothing is missing."""
        return not any(line.state in BAD for line in self.lines)

    def to_dict(self) -> dict[str, Any]:
        """Return plain types for JSON."""
        return {"complete": self.complete, **asdict(self), "todo": list(self.todos())}

    def todos(self) -> tuple[str, ...]:
        """Return what to do next, each once, what is missing before what is doubtful."""
        of_state = ([x.todo for x in self.lines if x.state == s] for s in ("missing", "doubt"))
        return tuple(dict.fromkeys(todo for todos in of_state for todo in todos if todo))
