"""Prints the page of the settings, from their declarations; `make docs` puts it into the site."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import MISSING

from rotcal_ros.foundation.settings import Declaration, all_constants
from rotcal_ros.methods import find_method, method_names
from rotcal_ros.methods.settings_reference import (
    Section,
    all_sections,
    default_in_words,
    first_settings,
    goal_sections,
    kind_in_words,
    method_sections,
    own_sections,
    range_in_words,
    reading_section,
    shared_sections,
    unit_and_meaning,
)

BAR = "\\|"
HEAD = """# Settings

A configuration is a YAML file: the name of a `method` and groups of settings, at the top or, as in
a ROS 2 parameter file, below `/**: ros__parameters:`. It is checked completely before anything
moves. A setting that is not given keeps its default; one in **bold** has to be given. The unit
stands in the name and before the comma. Lists hold values of the kind that is named. A default
*none* is a setting that is not given, in YAML `null`. A `*` in a name stands for one of the words
with which the meaning ends.

On the command line: `--set GROUP.NAME=VALUE`; `rotcal settings METHOD` prints what to state first
and the names of the others, `rotcal settings METHOD GROUP` what those of a group mean, `--expert`
those [for experts](#for-experts) too.
"""
FIRST = """## What to state first

To measure a real table, state these, or see that their defaults are right, and begin with the
configuration of your method in `config/`. Everything else has a default. Streams with other names,
units or clocks: group [topics](#topics).
"""
GOAL = """## The goal of a tracer's plan

Of `rotcal plan tracer GOAL.yaml`: a file of its own, lines of NAME: VALUE without groups; `--set
NAME=VALUE` on the command line. See [planning](planning.md)."""

READING = """## The limits of reading

Of `rotcal bag info`, `check` and `repair`, and of whatever else is given a bag and takes `--set`
(`solve`, `report`, `uncertainty`), on the command line alone. See
[recording](recording.md#checking-and-repairing)."""
EXPERTS = """## For experts

These need no change in ordinary use: thresholds, waits and rates, what a simulated machine is
like and what goes wrong in it. In a file they stand in their groups, like all others.
"""

CONSTANTS = """## No longer settings

Earlier versions let these be set. They are constants now, for the reason given. A file or a bag
that states this value is read; one that states another is refused: leave it out.

| name | value | why |
| --- | --- | --- |
"""


def page() -> str:
    """Return the text: what comes first, what all methods share, each method, for experts."""
    parts = [HEAD, FIRST, *(_first(name) for name in method_names())]
    parts += [_section(f"## {shared.group}", shared) for shared in shared_sections()]
    for name in method_names():
        method = find_method(name)
        parts.append(f"## {method.title}: `method: {name}`\n\nSee [{method.page}]"
                     f"({method.page}.md).\n")  # fmt: skip
        parts += [_section(f"### {own.group} of {name}", own) for own in own_sections(name)]
    parts += [_section(GOAL, goal) for goal in goal_sections()]
    parts += [_section(READING, reading_section()), EXPERTS]
    parts += [_experts(section) for section in (*shared_sections(), *goal_sections())]
    for name in method_names():
        parts.append(f"## For experts: `method: {name}`\n")
        parts += map(_experts, own_sections(name))
    return "\n".join(filter(None, [*parts, CONSTANTS + "\n".join(_constants())])) + "\n"


def _constants() -> list[str]:
    """Return a row for what was a setting once, each only once."""
    rows = (
        _row(_code(f"{section.group or 'goal'}.{name}"), str(constant.value), constant.reason)
        for section in all_sections()
        for name, constant in all_constants(section.cls)
    )
    return list(dict.fromkeys(rows))


def _first(method: str) -> str:
    """Return the short table of a method: one row for every setting to state first."""
    rows = ["| setting | unit | default | meaning |", "| --- | --- | --- | --- |"]
    for name, declared in first_settings(method_sections(method)):
        unit, meaning = unit_and_meaning(declared)
        rows.append(_row(_name(name, declared), unit, default_in_words(declared, _code), meaning))
    return "\n".join([f"### First of {method}", "", *rows, ""])


def _section(heading: str, section: Section, *, expert: bool = False) -> str:
    """Return heading, summary and a row for every setting, those for experts or all others.

    Empty where there are none.
    """
    rows = section.rows(expert=expert)
    table = ["| setting | kind | default | range | meaning |", "| --- | --- | --- | --- | --- |"]
    whole = "\n".join([heading, "", section.summary, "", *table, *_rows(rows), ""])
    return whole if rows else ""


def _experts(section: Section) -> str:
    of = f" of {section.method}" if section.method else ""
    name = section.group or "goal of a plan"
    return _section(f"### {name}{of}, for experts", section, expert=True)


def _rows(rows: Iterable[tuple[str, Declaration]]) -> Iterator[str]:
    for name, declared in rows:
        yield _row(
            _name(name, declared),
            kind_in_words(declared),
            default_in_words(declared, _code),
            range_in_words(declared, _code),
            declared.info.description,
        )


def _row(*cells: str) -> str:
    *others, text = cells
    return f"| {' | '.join((*others, text.replace('|', BAR)))} |"


def _name(name: str, declared: Declaration) -> str:
    return f"**{_code(name)}**" if declared.default is MISSING else _code(name)


def _code(text: str) -> str:
    return f"`{text}`"


if __name__ == "__main__":
    print(page(), end="")
