"""``rotcal settings``: what can be set, with units, ranges and defaults."""

from __future__ import annotations

import shutil
import textwrap
from collections.abc import Iterator
from dataclasses import MISSING
from typing import TYPE_CHECKING, Any, Final

import click

from rotcal_ros.cli.console import json_option, print_json
from rotcal_ros.cli.options import method_names

if TYPE_CHECKING:
    from rotcal_ros.foundation.settings import Declaration
    from rotcal_ros.methods.settings_reference import Section

WIDEST: Final = 99
"""Columns: longer lines are hard to read."""
_INDENTED: Final[dict[str, Any]] = {
    "initial_indent": " " * 6,
    "subsequent_indent": " " * 6,
    "break_on_hyphens": False,
}


@click.command()
@click.argument("method", required=False, shell_complete=method_names)
@click.option("--group", metavar="NAME", help="Only this group: plan, solver, capture, ...")
@json_option
def command(method: str | None, group: str | None, as_json: bool) -> int:
    """Print every setting of METHOD with its unit, range and default; without METHOD, of all.

    The unit stands before the comma of the meaning. The same as docs/settings.md, written from the
    declarations that configurations are checked against.
    """
    from rotcal_ros.foundation.errors import ConfigurationError
    from rotcal_ros.foundation.plugins import nearest
    from rotcal_ros.methods.settings_reference import all_sections, method_sections

    sections = all_sections() if method is None else method_sections(method)
    if group is not None:
        known = [section.group for section in sections]
        sections = tuple(section for section in sections if section.group == group)
        if not sections:
            raise ConfigurationError(f"no group {group!r}{nearest(group, dict.fromkeys(known))}")
    if as_json:
        print_json({"groups": [_data(section) for section in sections]})
    else:
        width = min(shutil.get_terminal_size().columns, WIDEST)
        click.echo("\n".join(line for section in sections for line in _lines(section, width)))
    return 0


def _lines(section: Section, width: int) -> Iterator[str]:
    """Yield heading, summary and settings of a group, no line wider than ``width``."""
    from rotcal_ros.methods.settings_reference import kind_in_words, range_in_words

    of = f" of {section.method}" if section.method else ""
    yield click.style(f"{section.group or 'goal of a plan'}{of}", bold=True)
    yield from textwrap.wrap(section.summary, width, break_on_hyphens=False)
    yield ""
    for name, declared in section.settings():
        limits = range_in_words(declared)
        facts = [kind_in_words(declared), _default(declared), *([limits] if limits else ())]
        yield f"  {click.style(name, bold=True)}"
        for text in ("; ".join(facts), declared.info.description):
            yield from textwrap.wrap(text, width, **_INDENTED)
    yield ""


def _default(declared: Declaration) -> str:
    from rotcal_ros.methods.settings_reference import default_in_words

    missing = declared.default is MISSING
    return "must be given" if missing else f"default {default_in_words(declared)}"


def _data(section: Section) -> dict[str, Any]:
    return {
        "group": section.group,
        "method": section.method,
        "summary": section.summary,
        "settings": [_setting(name, declared) for name, declared in section.settings()],
    }


def _setting(name: str, declared: Declaration) -> dict[str, Any]:
    from rotcal_ros.methods.settings_reference import kind_in_words

    required = declared.default is MISSING
    return {
        "name": name,
        "kind": kind_in_words(declared),
        "required": required,
        "default": None if required else declared.default,
        "minimum": declared.info.minimum,
        "maximum": declared.info.maximum,
        "choices": declared.info.choices,
        "meaning": declared.info.description,
    }
