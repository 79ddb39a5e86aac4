"""``rotcal new``: writes a set-up for one's own measurements, with all that has to be stated."""

from __future__ import annotations

import shlex
import textwrap
from collections.abc import Iterator, Mapping
from dataclasses import MISSING, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeAlias

import click

from rotcal_ros.cli.console import NamedFile
from rotcal_ros.cli.options import installed, set_option
from rotcal_ros.foundation import plugins
from rotcal_ros.foundation.errors import BagError, ConfigurationError, RotcalError
from rotcal_ros.report.terminal.console import say, tell

if TYPE_CHECKING:
    from rotcal_ros.foundation.settings import Declaration

    Known: TypeAlias = Mapping[str, Declaration]

WIDEST: Final = 98
_START, _STEP, _POSITIONS = "plan.table_start_deg", "plan.table_step_deg", "plan.table_positions"
_ANGLES: Final = "plan.table_angles_deg"
"""Replaces the three above."""
_GRID: Final = "plan.plate.grid"
_AIR: Final = ("air.temperature_c", "air.pressure_pa", "air.humidity")
_ASKED: Final = tuple(
    f"identity.{name}" for name in ("item", "serial", "place", "operator", "measured")
)
"""Asked for besides what a method has to be told first."""


@click.command()
@click.option("--method", shell_complete=installed(plugins.METHODS), help="How it is measured.")
@click.option(
    "--positions",
    type=click.IntRange(min=2),
    metavar="N",
    help="Number of table angles, evenly over a turn.",
)
@set_option
@click.option("-y", "--yes", is_flag=True, help="Ask nothing; what is not given has its default.")
@click.option(
    "-o",
    "--output",
    type=NamedFile(".yaml", ".yml"),
    default="setup.yaml",
    show_default=True,
    help="The file to write.",
)
def command(
    method: str | None,
    positions: int | None,
    changes: tuple[str, ...],
    yes: bool,
    output: Path,
) -> int:
    """Write a set-up for measurements of your own, and say what comes next.

    What is not given here is asked for; Enter takes the value in brackets. The file has a comment
    on every line and is read back as every verb reads it. Nothing is overwritten. It has no group
    'simulation', so that what is solved with it counts as measured.
    """
    from rotcal_ros.foundation.files import write_durably
    from rotcal_ros.methods import find_method, method_names, prepare, read_configuration
    from rotcal_ros.methods.configuration import short_names
    from rotcal_ros.methods.method import DEFAULT

    if output.exists():
        raise BagError(f"{output} exists and is not overwritten; name another file with -o")
    if method is None:
        kinds = click.Choice(method_names())
        method = DEFAULT if yes else click.prompt("method", type=kinds, default=DEFAULT, err=True)
    known = _known(method)
    of_tables = find_method(method).short_setup({})
    names = short_names(find_method(method))
    values = {names[name]: value for name, value in of_tables.items()}
    values |= dict(_given(method, known, change) for change in changes)
    if positions is not None:
        values = {**_turn(known, positions), **values}
    if not yes:
        _ask(method, known, values)
    missing = [n for n, d in known.items() if d.default is MISSING and n not in values]
    if missing:
        raise click.UsageError(f"{method} needs more: --set {'=... --set '.join(missing)}=...")
    write_durably(output, "\n".join(_lines(method, known, values)) + "\n")
    say(f"set-up: {output.absolute()}")
    try:
        prepare(read_configuration(output))
    except RotcalError:
        say("it cannot be used yet: change it there")
        raise
    say("next, with the table of your measurements:")
    tell(f"rotcal solve measurements.csv --setup {shlex.quote(str(output))}")
    return 0


def _known(method: str) -> Known:
    """Return all that a set-up can state, by its name; ConfigurationError for no method."""
    from rotcal_ros.methods.configuration import SIMULATION
    from rotcal_ros.methods.settings_reference import method_sections

    sections = (s for s in method_sections(method) if s.group != SIMULATION)
    return {name: declared for section in sections for name, declared in section.settings()}


def _given(method: str, known: Known, change: str) -> tuple[str, Any]:
    """Return name and value of a ``group.name=value``; ConfigurationError where it cannot be."""
    from rotcal_ros.foundation.settings import checked_value
    from rotcal_ros.methods.configuration import parsed_change

    name, value = parsed_change(method, change)
    if name not in known:
        hint = plugins.nearest(name, known)
        raise ConfigurationError(f"--set {change}: a set-up has no setting {name!r:.80}{hint}")
    return name, checked_value(value, known[name], name)


def _turn(known: Known, positions: int) -> dict[str, Any]:
    """Return the settings of so many table angles, evenly over a turn."""
    if _POSITIONS in known:
        return {_POSITIONS: positions, _STEP: 360.0 / positions}
    if _GRID in known:
        return {_GRID: positions}
    raise click.UsageError("--positions: this method counts no table angles; use --set")


def _ask(method: str, known: Known, values: dict[str, Any]) -> None:
    """Ask for what has to be stated and is not in ``values``, and put it there."""
    for name in (*_first(known, values), *_ASKED):
        if name in values:
            continue
        if name == _STEP and _POSITIONS not in values:
            values |= _answer(method, known, _POSITIONS)
            values.setdefault(_POSITIONS, known[_POSITIONS].default)
            even = 360.0 / values[_POSITIONS]
            values |= {_STEP: even} | _answer(method, known, _STEP, f"{even:g}")
        else:
            values |= _answer(method, known, name)


def _answer(method: str, known: Known, name: str, default: str = "") -> dict[str, Any]:
    """Return what a person says to a setting; nothing: the default, or another one, is good."""
    from rotcal_ros.methods.settings_reference import default_in_words

    declared = known[name]
    required = declared.default is MISSING

    def read(text: str) -> dict[str, Any]:
        try:
            return dict([_given(method, known, f"{name}={text}")]) if text else {}
        except ConfigurationError as error:
            raise click.UsageError(str(error)) from error

    shown = "" if required else f" [{default or default_in_words(declared)}]"
    found: dict[str, Any] = click.prompt(
        f"{name}: {declared.info.description}{shown}",
        default=None if required else "",
        show_default=False,
        value_proc=read,
        err=True,
    )
    return found


def _first(known: Known, values: Mapping[str, Any]) -> list[str]:
    """Return the settings that a plain table cannot be solved without having looked at."""
    replaced = (_START, _STEP, _POSITIONS) if _ANGLES in values else ()
    return [
        name
        for name, declared in known.items()
        if declared.info.first and name.startswith(("plan.", "solver.")) and name not in replaced
    ]


def _lines(method: str, known: Known, values: Mapping[str, Any]) -> Iterator[str]:
    """Yield the lines of the set-up: plan and solver in short, then groups, identity last."""
    from rotcal_ros.foundation.identity import Instruments
    from rotcal_ros.methods import find_method
    from rotcal_ros.methods.configuration import short_names

    found = find_method(method)
    short = {full: last for last, full in short_names(found).items()}
    tree: dict[str, Any] = {}
    written = {*values, *_first(known, values), *_AIR}
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
    yield from _branch(tree, "")
    if "instruments" not in tree["identity"]:
        yield "  # A certificate names the instruments, each with its last calibration:"
        yield f"  # {', '.join(field.name for field in fields(Instruments))}."
        yield "  # instruments:"
        yield "  #   machine: {maker: '', model: '', serial: '', calibrated: '', certificate: ''}"


def _branch(tree: Mapping[str, Any], indent: str) -> Iterator[str]:
    """Yield settings with their meaning above them, and groups of them."""
    import yaml

    for name, node in tree.items():
        if isinstance(node, Mapping):
            yield from ("", f"{indent}{name}:") if not indent else (f"{indent}{name}:",)
            yield from _branch(node, f"{indent}  ")
            continue
        meaning, value = node
        mark = f"{indent}# "
        yield from textwrap.wrap(
            meaning, WIDEST, initial_indent=mark, subsequent_indent=mark, break_on_hyphens=False
        )
        in_a_list = yaml.safe_dump([value], default_flow_style=True, width=float("inf"))
        yield f"{indent}{name}: {in_a_list.strip()[1:-1]}"
