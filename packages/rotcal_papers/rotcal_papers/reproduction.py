"""What a paper's reproduction holds, and how it becomes a page and a JSON file.

A claim is a sentence or a number of the paper. Beside it stands what its own numbers, its own
equations, or a simulation of its experiment give, how that was computed, and what it is worth.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from importlib.resources import files
from pathlib import Path
from typing import Any, Final, Literal, TypeAlias

import yaml

from rotcal_ros import __version__
from rotcal_ros.foundation.files import write_atomically
from rotcal_ros.foundation.records import record
from rotcal_ros.methods.figures import Figure
from rotcal_ros.report import template

Values: TypeAlias = Mapping[str, float]
Finding = Literal["follows", "does not follow", "not shown"]
"""Whether a claim follows from what the paper prints; *not shown*: too little is printed."""
SCHEMA: Final = 1
render = partial(template.render, package="rotcal_papers")


@dataclass(frozen=True, slots=True)
class Paper:
    """What a paper is called and where it stands; ``doi`` empty: not known to us."""

    title: str
    journal: str
    doi: str = ""


@dataclass(frozen=True, slots=True)
class Claim:
    """What a paper says ``where``, and what becomes of it.

    ``printed`` and ``recomputed`` are in ``unit``; None where the claim is no number. ``how`` says
    how it was computed again, ``worth`` what the claim means for somebody who relies on it.
    """

    where: str
    statement: str
    how: str
    worth: str
    finding: Finding
    printed: float | None = None
    recomputed: float | None = None
    unit: str = ""

    def shown(self, value: float | None) -> str:
        """Return a ``value`` of this claim with its unit, as a table has it."""
        return "" if value is None else f"{value:.4g} {self.unit}".strip()


@dataclass(frozen=True, slots=True)
class _StatedClaim:
    """A claim as it stands in the file of a paper; ``recomputed`` names a value.

    It follows where that differs from what is printed by at most ``within``; or from the
    ``target`` where the paper prints no such number.
    """

    where: str
    statement: str
    how: str
    worth: str
    finding: Finding | None = None
    printed: float | None = None
    recomputed: str | None = None
    target: float | None = None
    within: float | None = None
    unit: str = ""

    def judged(self, values: Values) -> Claim:
        """Return the claim with its numbers from ``values``, and their finding."""
        found = None if self.recomputed is None else float(values[self.recomputed])
        finding = self.finding
        wanted = self.printed if self.target is None else self.target
        if self.within is not None and found is not None and wanted is not None:
            near = abs(wanted - found) <= self.within
            finding = "follows" if near else "does not follow"
        assert finding is not None, self.statement
        texts = (
            self.where,
            self.statement,
            self.how.format(**values),
            self.worth.format(**values),
        )
        return Claim(*texts, finding, self.printed, found, self.unit)


@dataclass(frozen=True, slots=True)
class _Words:
    """The file of a paper: its claims, and what else is said of it."""

    paper: Paper
    summary: str
    claims: tuple[_StatedClaim, ...]
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class PrintedTable:
    """A table in the form of the paper: ``rows`` begin with their names."""

    title: str
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]

    @classmethod
    def of(
        cls, title: str, head: tuple[str, ...], formats: Sequence[str], rows: Iterable[Any]
    ) -> PrintedTable:
        """Return a table whose columns are written in these ``formats``."""
        written = (map(format, row, formats) for row in rows)
        return cls(title, head, tuple(tuple(cells) for cells in written))


@dataclass(frozen=True)
class Reproduction:
    """One paper, computed again. ``values``: numbers of the page by their names, for programs."""

    name: str
    paper: Paper
    summary: str
    claims: tuple[Claim, ...]
    notes: tuple[str, ...]
    tables: tuple[PrintedTable, ...]
    figures: tuple[Figure, ...]
    values: Values

    @classmethod
    def of(
        cls, name: str, values: Values, tables: Iterable[PrintedTable], figures: Iterable[Figure]
    ) -> Reproduction:
        """Return the reproduction of the paper ``name``, in the words of its file."""
        text = (files(__package__) / "templates" / f"{name}.yaml").read_text(encoding="utf-8")
        words = record(_Words, yaml.safe_load(text), name)
        return cls(
            name,
            words.paper,
            words.summary.format(**values),
            tuple(claim.judged(values) for claim in words.claims),
            tuple(note.format(**values) for note in words.notes),
            tuple(tables),
            tuple(figures),
            values,
        )

    def to_json(self) -> str:
        """Return all but the figures as JSON."""
        data = {
            "schema": SCHEMA,
            "name": self.name,
            "rotcal_ros": __version__,
            "paper": asdict(self.paper),
            "summary": self.summary,
            "claims": [asdict(claim) for claim in self.claims],
            "tables": [asdict(table) for table in self.tables],
            "notes": list(self.notes),
            "values": dict(self.values),
        }
        return json.dumps(data, indent=1, allow_nan=False) + "\n"

    def write(self, folder: Path) -> tuple[Path, Path]:
        """Write the page and the JSON file into ``folder``, and return where they are."""
        folder.mkdir(parents=True, exist_ok=True)
        page, data = folder / f"{self.name}.html", folder / f"{self.name}.json"
        write_atomically(page, render("paper", found=self))
        write_atomically(data, self.to_json())
        return page, data
