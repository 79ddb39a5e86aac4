"""A set-up for measurements of one's own: what it has to be given, and its text with comments."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Mapping
from dataclasses import MISSING, fields
from typing import Any, Final, TypeAlias

import yaml

from rotcal_ros.foundation import plugins
from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.identity import Instruments
from rotcal_ros.foundation.settings import Declaration, checked_value
from rotcal_ros.methods.configuration import (
    SIMULATION,
    parse_configuration,
    parsed_change,
    short_names,
)
from rotcal_ros.methods.method import find_method
from rotcal_ros.methods.settings_reference import method_sections
from rotcal_ros.planning.table_angles import ANGLE_SETTINGS

Known: TypeAlias = Mapping[str, Declaration]
"""All that a set-up can state, by its name."""

WIDEST: Final = 98
_WITHOUT_PLAN: Final = (
    "The table angles are those of the table. Where it has numbers of positions in their place, "
    "state table_positions, table_step_deg and table_start_deg."
)
START, STEP, POSITIONS, _ANGLES = (f"plan.{name}" for name in ANGLE_SETTINGS)
"""The last replaces the others. What a person does not state is left to the table."""
_GRID: Final = "plan.plate.grid"
AIR: Final = ("air.temperature_c", "air.pressure_pa", "air.humidity")
OF_THE_ITEM: Final = tuple(
    f"identity.{name}" for name in ("item", "serial", "place", "operator", "measured")
)
"""Asked for besides what a method has to be given first."""


def known_settings(method: str) -> Known:
    """Return all that a set-up of a method can state; ConfigurationError for no method."""
    sections = (s for s in method_sections(method) if s.group != SIMULATION)
    return {name: declared for section in sections for name, declared in section.settings()}


def values_of_tables(method: str) -> dict[str, Any]:
    """Return what a method has to be given because it reads a table."""
    names = short_names(find_method(method))
    return {names[name]: value for name, value in find_method(method).short_setup({}).items()}


def full_turn_settings(known: Known, positions: int) -> dict[str, Any]:
    """Return the settings of so many table angles, evenly over a turn."""
    if POSITIONS in known:
        return {POSITIONS: positions, STEP: 360.0 / positions}
    if _GRID in known:
        return {_GRID: positions}
    raise ConfigurationError("--positions: this method counts no table angles; use --set")


def given_value(method: str, known: Known, change: str) -> tuple[str, Any]:
    """Return name and value of a ``group.name=value``; ConfigurationError where it cannot be."""
    name, value = parsed_change(method, change)
    if name not in known:
        hint = plugins.name_hint(name, known)
        raise ConfigurationError(f"--set {change}: a set-up has no setting {name!r:.80}{hint}")
    return name, checked_value(value, known[name], name)


def check_together(method: str, known: Known, values: Mapping[str, Any]) -> None:
    """Raise ConfigurationError for values that cannot stand in one set-up; more may follow."""
    if not _lacking(known, values):
        parse_configuration(setup_text(method, known, values), "set-up")


def _lacking(known: Known, values: Mapping[str, Any]) -> list[str]:
    return [n for n, d in known.items() if d.default is MISSING and n not in values]


def first_asked(known: Known, values: Mapping[str, Any]) -> list[str]:
    """Return the settings that a plain table cannot be solved without having looked at."""
    replaced = (START, STEP, POSITIONS) if _ANGLES in values else ()
    return [
        name
        for name, declared in known.items()
        if declared.info.first and name.startswith(("plan.", "solver.")) and name not in replaced
    ]


def setup_text(method: str, known: Known, values: Mapping[str, Any]) -> str:
    """Return the text of a set-up, with the meaning of every setting above it.

    Raises ConfigurationError that lists the settings without default and value.
    """
    if missing := _lacking(known, values):
        raise ConfigurationError(f"{method} needs more: --set {'=... --set '.join(missing)}=...")
    return "\n".join(_lines(method, known, values)) + "\n"


def _lines(method: str, known: Known, values: Mapping[str, Any]) -> Iterator[str]:
    """Yield the lines of the set-up: plan and solver in short, then groups, identity last."""
    found = find_method(method)
    short = {full: last for last, full in short_names(found).items()}
    tree: dict[str, Any] = {}
    asked = first_asked(known, values)
    own = {START, STEP, POSITIONS} if _ANGLES in known else set()
    written = {*values, *(name for name in asked if name not in own), *AIR}
    for name in sorted(known, key=lambda n: (n not in short, n.startswith("identity."))):
        of_the_item = name.startswith("identity.") and name.count(".") == 1
        if name in written or of_the_item:
            place, (*groups, last) = tree, short.get(name, name).split(".")
            for part in groups:
                place = place.setdefault(part, {})
            place[last] = known[name].info.description, values.get(name, known[name].default)
    yield f"# {found.title}: a set-up for measurements of your own."
    yield f"# Units stand before the comma. All settings: rotcal settings {method} --all"
    yield f"method: {method}"
    if own and not values.keys() & {*own, _ANGLES}:
        yield from _comment(_WITHOUT_PLAN, "")
    yield from _branch(tree, "")
    if "instruments" not in tree["identity"]:
        yield "  # A certificate names the instruments, each with its last calibration:"
        yield from _comment(f"{', '.join(field.name for field in fields(Instruments))}.", "  ")
        yield "  # instruments:"
        yield "  #   machine: {maker: '', model: '', serial: '', calibrated: '', certificate: ''}"


def _branch(tree: Mapping[str, Any], indent: str) -> Iterator[str]:
    for name, node in tree.items():
        if isinstance(node, Mapping):
            yield from ("", f"{indent}{name}:") if not indent else (f"{indent}{name}:",)
            yield from _branch(node, f"{indent}  ")
            continue
        meaning, value = node
        yield from _comment(meaning, indent)
        in_a_list = yaml.safe_dump([value], default_flow_style=True, width=float("inf"))
        yield f"{indent}{name}: {in_a_list.strip()[1:-1]}"


def _comment(text: str, indent: str) -> list[str]:
    mark = f"{indent}# "
    return textwrap.wrap(
        text, WIDEST, initial_indent=mark, subsequent_indent=mark, break_on_hyphens=False
    )
