"""``rotcal settings``: what can be set, with units, ranges and defaults."""

from __future__ import annotations

import shutil
import textwrap
from collections.abc import Iterator, Sequence
from dataclasses import MISSING
from itertools import chain
from typing import TYPE_CHECKING, Any, Final

import click

from rotcal_ros.cli.console import json_option, print_json
from rotcal_ros.cli.options import complete_plugins
from rotcal_ros.foundation import plugins

if TYPE_CHECKING:
    from rotcal_ros.foundation.settings import Declaration
    from rotcal_ros.methods.settings_reference import Section

WIDEST: Final = 99
"""Widest line in columns: longer ones are hard to read."""
NARROWEST: Final = 24
"""If fewer columns are left for a meaning, it goes below its setting."""
_HEADINGS: Final = ("setting", "unit", "default", "meaning")


@click.command()
@click.argument(
    "names",
    nargs=-1,
    metavar="[METHOD] [GROUP]...",
    shell_complete=complete_plugins(plugins.METHODS),
)
@click.option(
    "--all", "--expert", "everything", is_flag=True, help="Every setting, those for experts too."
)
@json_option
def command(names: tuple[str, ...], everything: bool, as_json: bool) -> int:
    """Print what to state first to measure with METHOD, and the names of what else can be set.

    With a GROUP (plan, solver, topics, ...), what its settings mean; the unit stands before the
    comma. Without METHOD, those of all methods; the name of a controller stands for its settings.
    Settings for experts, such as thresholds and
    waits, which need no change in ordinary use, are left out without --expert or --all.
    --json has every setting, and marks the ones to state first and those for experts.
    """
    methods = plugins.names(plugins.METHODS)
    method = names[0] if names and names[0] in methods else ""
    groups = names[1:] if method else names
    width = min(shutil.get_terminal_size().columns, WIDEST)
    if as_json:
        print_json({"groups": [_data(section) for section in _sections(method, groups)]})
        return 0
    if everything or groups:
        parts = [_lines(section, width, everything) for section in _sections(method, groups)]
    else:
        parts = [_first_lines(name, width) for name in ([method] if method else methods)]
    click.echo("\n".join(chain.from_iterable(parts)))
    return 0


def _sections(method: str, groups: Sequence[str]) -> tuple[Section, ...]:
    """Return ``groups``, or all groups where none is named, of a method or of all.

    Raises ConfigurationError, with the nearest name, for an unknown one.
    """
    from rotcal_ros.foundation.errors import ConfigurationError
    from rotcal_ros.methods.settings_reference import (
        all_sections,
        controller_section,
        method_sections,
    )

    controllers = () if method else plugins.names(plugins.CONTROLLERS)
    named = map(controller_section, (name for name in groups if name in controllers))
    sections = (*(method_sections(method) if method else all_sections()), *named)
    known = dict.fromkeys(section.group for section in sections if section.group)
    others = () if method else (*plugins.names(plugins.METHODS), *controllers)
    for name in groups:
        if name not in known:
            what = "group" if method else "method, group or controller"
            hint = plugins.name_hint(name, (*others, *known))
            raise ConfigurationError(f"no {what} {name!r:.80}{hint}")
    return tuple(section for section in sections if not groups or section.group in groups)


def _first_lines(method: str, width: int) -> Iterator[str]:
    """Yield what to state first for a method, then the names of what else can be set."""
    from rotcal_ros.methods.settings_reference import first_settings, unit_and_meaning

    sections = _sections(method, ())
    yield click.style(f"{method}: to measure a real table, state first", bold=True)
    yield ""
    rows = [_HEADINGS]
    for name, declared in first_settings(sections):
        unit, meaning = unit_and_meaning(declared)
        rows.append((name, unit, _default(declared), meaning))
    yield from _table(rows, width)
    yield ""
    names = {section.group: _other_names(section) for section in sections}
    yield f"and {sum(map(len, names.values()))} more: rotcal settings {method} GROUP"
    yield ""
    yield from _table(
        [(group, ", ".join(found)) for group, found in names.items() if found], width
    )
    yield ""
    experts = sum(len(section.rows(expert=True)) for section in sections)
    yield from _wrapped(f"and {experts} for experts: rotcal settings {method} --expert", width, 0)
    yield ""


def _other_names(section: Section) -> list[str]:
    """Return the names in a group of what need not be stated first and is not for experts."""
    prefix = f"{section.group}."
    rows = section.rows(expert=False)
    return [name.removeprefix(prefix) for name, declared in rows if not declared.info.first]


def _table(rows: Sequence[tuple[str, ...]], width: int) -> Iterator[str]:
    """Yield rows as lines, none wider than ``width``; their last column is broken at blanks."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)][:-1]
    for *cells, last in rows:
        padded = (cell.ljust(size) for cell, size in zip(cells, widths, strict=True))
        begin = f"  {'  '.join(padded)}  "
        if width - len(begin) < NARROWEST:
            yield begin.rstrip()
            yield from _wrapped(last, width, 6)
        else:
            first, *others = textwrap.wrap(last, width - len(begin), break_on_hyphens=False)
            yield begin + first
            yield from (" " * len(begin) + line for line in others)


def _lines(section: Section, width: int, everything: bool) -> Iterator[str]:
    """Yield heading, summary and settings of a group, no line wider than ``width``."""
    of = f" of {section.method}" if section.method else ""
    experts = section.rows(expert=True)
    yield click.style(f"{section.group or 'goal of a plan'}{of}", bold=True)
    yield from _wrapped(section.summary, width, 0)
    yield ""
    yield from _described(section.rows(expert=False), width)
    if experts and everything:
        yield "for experts"
        yield ""
        yield from _described(experts, width)
    elif experts:
        place = f"{section.method} {section.group}".strip()
        yield f"and {len(experts)} for experts: rotcal settings {place} --expert"
        yield ""


def _described(rows: Sequence[tuple[str, Declaration]], width: int) -> Iterator[str]:
    """Yield name, kind, default, range and meaning of settings, and a blank line after them."""
    from rotcal_ros.methods.settings_reference import kind_in_words, range_in_words

    for name, declared in rows:
        limits = range_in_words(declared)
        default = _default(declared)
        if declared.default is not MISSING:
            default = f"default {default}"
        facts = [kind_in_words(declared), default, *([limits] if limits else ())]
        yield f"  {click.style(name, bold=True)}"
        for text in ("; ".join(facts), declared.info.description):
            yield from _wrapped(text, width, 6)
    if rows:
        yield ""


def _wrapped(text: str, width: int, indent: int) -> list[str]:
    """Return ``text`` in lines of ``width`` columns, of which ``indent`` are blank."""
    blank = " " * indent
    return textwrap.wrap(
        text, width, initial_indent=blank, subsequent_indent=blank, break_on_hyphens=False
    )


def _default(declared: Declaration) -> str:
    from rotcal_ros.methods.settings_reference import default_in_words

    return "must be given" if declared.default is MISSING else default_in_words(declared)


def _data(section: Section) -> dict[str, Any]:
    return {
        "group": section.group,
        "method": section.method,
        "summary": section.summary,
        "settings": [_setting(name, declared) for name, declared in section.settings()],
    }


def _setting(name: str, declared: Declaration) -> dict[str, Any]:
    from rotcal_ros.methods.settings_reference import kind_in_words, unit_and_meaning

    required = declared.default is MISSING
    return {
        "name": name,
        "first": declared.info.first,
        "expert": declared.info.expert,
        "kind": kind_in_words(declared),
        "unit": unit_and_meaning(declared)[0],
        "required": required,
        "default": None if required else declared.default,
        "minimum": declared.info.minimum,
        "maximum": declared.info.maximum,
        "choices": declared.info.choices,
        "meaning": declared.info.description,
    }
