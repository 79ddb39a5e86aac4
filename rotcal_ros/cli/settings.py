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
from rotcal_ros.cli.options import installed
from rotcal_ros.foundation import plugins

if TYPE_CHECKING:
    from rotcal_ros.foundation.settings import Declaration
    from rotcal_ros.methods.settings_reference import Section

WIDEST: Final = 99
"""Widest line in columns: longer ones are hard to read."""
NARROWEST: Final = 24
"""If fewer columns are left for a meaning, it goes below its setting."""
_HEADINGS: Final = ("setting", "unit", "default", "meaning")
_TIE: Final = "\N{NO-BREAK SPACE}"


@click.command()
@click.argument(
    "names",
    nargs=-1,
    metavar="[METHOD] [GROUP]...",
    shell_complete=installed(plugins.METHODS),
)
@click.option("--all", "everything", is_flag=True, help="Every setting, its kind and range.")
@json_option
def command(names: tuple[str, ...], everything: bool, as_json: bool) -> int:
    """Print what to state first to measure with METHOD; with --all, every setting.

    With a GROUP (plan, solver, topics, ...), every setting of that group; the unit stands before
    the comma of the meaning. Without METHOD, those of all methods. --json always has every
    setting, and marks the ones to state first. docs/settings.md has the same content: both come
    from the declarations that configurations are checked against.
    """
    methods = plugins.names(plugins.METHODS)
    method = names[0] if names and names[0] in methods else ""
    groups = names[1:] if method else names
    width = min(shutil.get_terminal_size().columns, WIDEST)
    if as_json:
        print_json({"groups": [_data(section) for section in _sections(method, groups)]})
        return 0
    if everything or groups:
        parts = [_lines(section, width) for section in _sections(method, groups)]
    else:
        parts = [_first_lines(name, width) for name in ([method] if method else methods)]
    click.echo("\n".join(chain.from_iterable(parts)))
    return 0


def _sections(method: str, groups: Sequence[str]) -> tuple[Section, ...]:
    """Return ``groups``, or all groups where none is named, of a method or of all.

    Raises ConfigurationError, with the nearest name, for an unknown one.
    """
    from rotcal_ros.foundation.errors import ConfigurationError
    from rotcal_ros.methods.settings_reference import all_sections, method_sections

    sections = method_sections(method) if method else all_sections()
    known = dict.fromkeys(section.group for section in sections if section.group)
    others = () if method else plugins.names(plugins.METHODS)
    for name in groups:
        if name not in known:
            what = "group" if method else "method or group"
            hint = plugins.nearest(name, (*others, *known))
            raise ConfigurationError(f"no {what} {name!r:.80}{hint}")
    return tuple(section for section in sections if not groups or section.group in groups)


def _first_lines(method: str, width: int) -> Iterator[str]:
    """Yield what to state first for a method, then what else can be set."""
    from rotcal_ros.methods.settings_reference import (
        first_settings,
        method_sections,
        unit_and_meaning,
    )

    sections = method_sections(method)
    first = dict(first_settings(sections))
    yield click.style(f"{method}: to measure a real table, state first", bold=True)
    yield ""
    rows = []
    for name, declared in first.items():
        unit, meaning = unit_and_meaning(declared)
        rows.append((name, unit, _default(declared), meaning))
    yield from _table([_HEADINGS, *rows], width)
    yield ""
    others = {
        section.group: sum(name not in first for name, _ in section.settings())
        for section in sections
    }
    yield f"and {sum(others.values())} more: rotcal settings {method} --all"
    yield f"those of a group: rotcal settings {method} GROUP"
    counts = ", ".join(f"{group}{_TIE}{count}" for group, count in others.items() if count)
    yield from (line.replace(_TIE, " ") for line in _wrapped(counts, width, 2))
    yield ""


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


def _lines(section: Section, width: int) -> Iterator[str]:
    """Yield heading, summary and settings of a group, no line wider than ``width``."""
    from rotcal_ros.methods.settings_reference import kind_in_words, range_in_words

    of = f" of {section.method}" if section.method else ""
    yield click.style(f"{section.group or 'goal of a plan'}{of}", bold=True)
    yield from _wrapped(section.summary, width, 0)
    yield ""
    for name, declared in section.settings():
        limits = range_in_words(declared)
        default = _default(declared)
        if declared.default is not MISSING:
            default = f"default {default}"
        facts = [kind_in_words(declared), default, *([limits] if limits else ())]
        yield f"  {click.style(name, bold=True)}"
        for text in ("; ".join(facts), declared.info.description):
            yield from _wrapped(text, width, 6)
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
        "kind": kind_in_words(declared),
        "unit": unit_and_meaning(declared)[0],
        "required": required,
        "default": None if required else declared.default,
        "minimum": declared.info.minimum,
        "maximum": declared.info.maximum,
        "choices": declared.info.choices,
        "meaning": declared.info.description,
    }
