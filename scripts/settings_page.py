"""Writes docs/settings.md from the declarations of the settings.

usage: python scripts/settings_page.py [check]     check: only see whether the page is current
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import MISSING
from pathlib import Path
from typing import Any

from rotcal_ros.catalogue import find_method, method_names
from rotcal_ros.catalogue.configuration import GROUPS, SHARED_GROUPS, settings_classes
from rotcal_ros.planning.tracer_design.settings import TracerDesignSettings
from rotcal_ros.settings import Declaration, declarations

PAGE = Path(__file__).parents[1] / "docs" / "settings.md"
HEAD = """# Settings

A configuration is a ROS 2 parameter file: `/**: ros__parameters:` with the name of a `method` and
groups of settings. It is checked whole before anything moves. A setting that is not given keeps
its default; one in **bold** has to be given. The unit stands in the name and before the comma.
Lists hold values of the kind that is named.

On the command line: `--set GROUP.NAME=VALUE`. This page is written by
`python scripts/settings_page.py` from the declarations.
"""
GOAL = """## The goal of a tracer's plan

Of `rotcal plan tracer GOAL.yaml`: a file of its own, lines of NAME: VALUE without groups; `--set
NAME=VALUE` on the command line. See [planning](planning.md)."""
OWN_GROUPS = tuple(name for name in GROUPS if name not in SHARED_GROUPS)


def page() -> str:
    """Return the text of the page: the groups that all methods share, then those of each."""
    parts = [HEAD]
    for name, cls in SHARED_GROUPS.items():
        parts.append(_section(f"## {name}", name, cls))
    for method_name in method_names():
        method = find_method(method_name)
        parts.append(f"## {method.title}: `method: {method.name}`\n\nSee [{method.page}]"
                     f"({method.page}.md).\n")  # fmt: skip
        classes = settings_classes(method)
        parts += [_section(f"### {name} of {method.name}", name, classes[name])
                  for name in OWN_GROUPS]  # fmt: skip
    parts.append(_section(GOAL, "", TracerDesignSettings))
    return "\n".join(parts)


def _section(heading: str, group: str, cls: type[Any]) -> str:
    """Return heading, first line of the docstring, and one row for every setting."""
    summary = (cls.__doc__ or "").strip().splitlines()[0]
    rows = [*_rows(group, cls)]
    table = ["| setting | kind | default | range | meaning |", "| --- | --- | --- | --- | --- |"]
    return "\n".join([heading, "", summary, "", *table, *rows, ""])


def _rows(group: str, cls: type[Any]) -> Iterator[str]:
    for declared in declarations(cls):
        name = f"`{group}.{declared.name}`" if group else f"`{declared.name}`"
        cells = (
            f"**{name}**" if declared.default is MISSING else name,
            _kind(declared),
            _default(declared),
            _range(declared),
            declared.info.description.replace("|", "\\|"),
        )
        yield f"| {' | '.join(cells)} |"


def _kind(declared: Declaration) -> str:
    kind = {bool: "true or false", int: "whole", float: "number", str: "text"}[declared.kind]
    if declared.is_list:
        kind = f"list of {'' if declared.length is None else f'{declared.length} '}{kind}"
    return kind


def _default(declared: Declaration) -> str:
    if declared.default is MISSING:
        return "-"
    if declared.default is None:
        return "none"
    if isinstance(declared.default, bool):
        return str(declared.default).lower()
    if isinstance(declared.default, tuple):
        return "[" + ", ".join(_value(v) for v in declared.default) + "]"
    return _value(declared.default)


def _value(value: Any) -> str:
    if isinstance(value, str):
        return f"`{value}`" if value else "empty"
    return f"{value:g}" if isinstance(value, float) else str(value)


def _range(declared: Declaration) -> str:
    info = declared.info
    if info.choices:
        return ", ".join(f"`{choice}`" for choice in info.choices)
    if info.minimum is None and info.maximum is None:
        return ""
    low = "" if info.minimum is None else f"{info.minimum:g}"
    return f"{low} ..." if info.maximum is None else f"{low} ... {info.maximum:g}"


if __name__ == "__main__":
    text = page()
    if sys.argv[1:] == ["check"]:
        sys.exit(None if PAGE.read_text() == text else f"{PAGE} is old: write it again")
    PAGE.write_text(text)
