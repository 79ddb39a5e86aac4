"""Puts what the controllers say of themselves into their page, for the site of `make docs`."""

from __future__ import annotations

import re
from collections.abc import Iterator

from rotcal_ros.compensation.controllers import controller_names, make_controller
from rotcal_ros.foundation.settings import declarations
from rotcal_ros.methods.settings_reference import default_in_words, range_in_words

TABLE = "<!-- `make docs` puts the table of all controllers here -->"
HEAD = """| controller | setting | what it does to the table | what is done | source |
| --- | --- | --- | --- | --- |
"""


def filled(page: str) -> str:
    """Return the page with the facts of each controller below its words, and their settings.

    Raises ValueError for a controller without a section, and without the place of their table.
    """
    if TABLE not in page:
        raise ValueError(f"controllers.md has no line {TABLE}")
    for name in controller_names():
        section = re.compile(rf"(^## [^\n]+ \(`{name}`\)\n.*?)(?=^## )", re.DOTALL | re.MULTILINE)
        page, found = section.subn(lambda words, of=name: words[1] + _facts(of) + "\n", page)
        if found != 1:
            raise ValueError(f"controllers.md has {found} sections of {name}")
    return page.replace(TABLE, HEAD + "".join(_rows()))


def _facts(name: str) -> str:
    controller = make_controller(name)
    facts = controller.facts
    lines = [
        f"* sign: {facts.sign}",
        f"* wrap: {facts.wrap}",
        f"* resolution: {facts.unit}",
        f"* source: {facts.source}",
        f"* verified on: {facts.verified_on}",
        f"* not verified: {'; '.join(controller.unverified) or 'nothing'}",
    ]
    settings = [
        f"| `{one.name}` | {default_in_words(one)} | {range_in_words(one)} |"
        f" {one.info.description} |"
        for one in declarations(type(controller))
    ]
    if settings:
        lines += ["", "| setting | default | range | meaning |", "| --- | --- | --- | --- |"]
    return "\n".join([*lines, *settings]) + "\n"


def _rows() -> Iterator[str]:
    """Yield what else each control does with an axis."""
    for name in controller_names():
        for own in make_controller(name).own_settings:
            source = own.source or "*from memory*"
            yield f"| `{name}` | {own.name} | {own.effect} | {own.handled} | {source} |\n"
