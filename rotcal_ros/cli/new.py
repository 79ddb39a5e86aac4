"""``rotcal new``: writes a set-up for one's own measurements, with all that has to be stated."""

from __future__ import annotations

import shlex
from dataclasses import MISSING
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from rotcal_ros.cli.console import NamedFile, path_type
from rotcal_ros.cli.options import complete_plugins, set_option
from rotcal_ros.foundation import plugins
from rotcal_ros.foundation.errors import BagError, ConfigurationError, RotcalError
from rotcal_ros.report.terminal.console import say, tell

if TYPE_CHECKING:
    from rotcal_ros.methods.new_setup import Known


@click.command()
@click.argument("table", type=path_type, required=False, metavar="[TABLE]")
@click.option(
    "--method", shell_complete=complete_plugins(plugins.METHODS), help="How it is measured."
)
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
    table: Path | None,
    method: str | None,
    positions: int | None,
    changes: tuple[str, ...],
    yes: bool,
    output: Path,
) -> int:
    """Write a set-up for measurements of your own, and say what comes next.

    The columns of TABLE say how it was measured, where they fit one method alone.
    What is not given here is asked for; Enter takes the value in brackets. The file has a comment
    on every line and is read back as every verb reads it. Nothing is overwritten. It has no group
    'simulation', so that what is solved with it counts as measured.
    """
    from rotcal_ros.foundation.files import write_durably
    from rotcal_ros.methods import method_names, new_setup, prepare, read_configuration
    from rotcal_ros.methods.method import DEFAULT

    if output.exists():
        raise BagError(f"{output} exists and is not overwritten; name another file with -o")
    if method is None and table is not None:
        method = _method_of(table)
    if method is None:
        kinds = click.Choice(method_names())
        method = DEFAULT if yes else click.prompt("method", type=kinds, default=DEFAULT, err=True)
    known = new_setup.known_settings(method)
    values = new_setup.values_of_tables(method)
    values |= dict(new_setup.given_value(method, known, change) for change in changes)
    if positions is not None:
        values = {**new_setup.full_turn_settings(known, positions), **values}
    if not yes:
        _ask(method, known, values)
    write_durably(output, new_setup.setup_text(method, known, values))
    say(f"set-up: {output.absolute()}")
    try:
        prepare(read_configuration(output))
    except RotcalError:
        say("it cannot be used yet: change it there")
        raise
    say("next, with the table of your measurements:")
    solved = shlex.quote(str(table or "measurements.csv"))
    tell(f"rotcal solve {solved} --setup {shlex.quote(str(output))}")
    return 0


def _method_of(table: Path) -> str:
    """Return the only method whose columns a table has; ConfigurationError for several or none."""
    from rotcal_ros.methods.fitting import fitting_methods

    found = fitting_methods(table)
    if len(found) == 1:
        return found[0].name
    ways = " or ".join(f"--method {each.name} ({each.title})" for each in found)
    raise ConfigurationError(
        f"{table}: how it was measured its columns do not say: state it by {ways or '--method'}"
    )


def _ask(method: str, known: Known, values: dict[str, Any]) -> None:
    """Ask for what has to be stated and is not in ``values``, and put it there."""
    from rotcal_ros.methods.new_setup import OF_THE_ITEM, POSITIONS, STEP, first_asked

    for name in (*first_asked(known, values), *OF_THE_ITEM):
        if name in values:
            continue
        if name == STEP and POSITIONS not in values:
            values |= _answer(method, known, values, POSITIONS)
            values.setdefault(POSITIONS, known[POSITIONS].default)
            even = 360.0 / values[POSITIONS]
            values |= {STEP: even} | _answer(method, known, values, STEP, f"{even:g}")
        else:
            values |= _answer(method, known, values, name)


def _answer(
    method: str, known: Known, values: dict[str, Any], name: str, default: str = ""
) -> dict[str, Any]:
    """Return what a person says to a setting; nothing: the default, or another one, is good.

    What cannot stand beside the ``values`` so far is asked for again.
    """
    from rotcal_ros.methods.new_setup import check_together, given_value
    from rotcal_ros.methods.settings_reference import default_in_words

    declared = known[name]
    required = declared.default is MISSING

    def read(text: str) -> dict[str, Any]:
        try:
            found = dict([given_value(method, known, f"{name}={text}")]) if text else {}
            check_together(method, known, {**values, **found})
            return found
        except ConfigurationError as error:
            raise click.UsageError(str(error)) from error

    shown = "" if required else f" [{default or default_in_words(declared)}]"
    return click.prompt(
        f"{name}: {declared.info.description}{shown}",
        default=None if required else "",
        show_default=False,
        value_proc=read,
        err=True,
    )
