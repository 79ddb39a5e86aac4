"""What people see first of a result: two marks, which answer two questions.

*Measurement*: may the numbers be believed (ok, suspect, failed)? *Tolerance*: is the table as it
was agreed (within, beyond, undecided)? A good measurement of a bad table is ok and beyond. Page,
report and terminal show the marks of this module and no others.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from rotcal_ros.evaluation.conformity import decide, tolerance_of
from rotcal_ros.evaluation.withheld import withheld
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.components import unit_of
from rotcal_ros.foundation.identity import Identity
from rotcal_ros.foundation.results import Result

WITHIN: Final = "within"
BEYOND: Final = "beyond"
UNDECIDED: Final = "undecided"
COLOURS: Final[Mapping[str, str]] = {
    "ok": "green",
    "partly": "yellow",
    "suspect": "red",
    "failed": "red",
    WITHIN: "green",
    UNDECIDED: "yellow",
    BEYOND: "red",
}
"""The colour of every kind of mark; pages have shades of them in their style sheets."""


@dataclass(frozen=True, slots=True)
class Mark:
    """One answer: ``name`` is measurement or tolerance, ``kind`` one of COLOURS.

    ``words`` begin with the answer. The kind of an ok that does not cover everything is "partly".
    """

    name: str
    kind: str
    words: str

    @property
    def colour(self) -> str:
        """The colour at a terminal."""
        return COLOURS[self.kind]

    @property
    def line(self) -> str:
        """The mark as one line."""
        return f"{self.name}: {self.words}"


def marks(result: Result, doubt: str | None = None) -> tuple[Mark, ...]:
    """Return the marks of a result; no second one where no tolerance is agreed.

    ``doubt`` says why no uncertainty may be stated, empty where it may; None asks the result.
    """
    covered = bool(result.protections) and not result.unprotected
    about = measurement(result.verdict, result.verdict_line, covered=covered)
    doubt = withheld(result) if doubt is None else doubt
    against = tolerance(result.deviations, result.std, result.circumstances.identity, doubt)
    return (about,) if against is None else (about, against)


def measurement(verdict: str, verdict_line: str, *, covered: bool) -> Mark:
    """Return the mark of a verdict; ``covered``: nothing could have spoiled it without a trace."""
    kind = "partly" if verdict == "ok" and not covered else verdict
    return Mark("measurement", kind, verdict_line)


def tolerance(
    deviations: Mapping[str, Floats], std: Mapping[str, Floats], identity: Identity, doubt: str
) -> Mark | None:
    """Return the mark of deviations (SI, by component) with their standard uncertainties.

    None where no tolerance is agreed for any of them. One component beyond is beyond, whatever
    the others are. Where U may not be stated (``doubt``) nothing is decided.
    """
    agreed = {name: limit for name in deviations if (limit := tolerance_of(name, identity))}
    if not agreed:
        return None
    if doubt:
        return Mark("tolerance", UNDECIDED, f"undecided, because U is not stated ({_all(agreed)})")
    found = {name: decide(deviations[name], std[name], agreed[name]) for name in agreed}
    kind = next((k for k in (BEYOND, UNDECIDED) if k in found.values()), WITHIN)
    named = {name: limit for name, limit in agreed.items() if found[name] == kind}
    return Mark("tolerance", kind, f"{kind} {_all(named)}")


def _all(agreed: Mapping[str, float]) -> str:
    """Return components with their tolerances: "±2 arcsec (EAC, ECC), ±3 µm (EZC)"."""
    by_limit: dict[str, list[str]] = {}
    for name, limit in agreed.items():
        unit, label = unit_of(name)
        by_limit.setdefault(f"±{limit / unit:g} {label}", []).append(name)
    return ", ".join(f"{limit} ({', '.join(names)})" for limit, names in by_limit.items())
