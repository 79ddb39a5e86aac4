"""Options that several verbs share, and what the shell offers at the Tab key.

One line in the shell's configuration turns completion on: docs/command_line.md. This module is
loaded before every verb, so it imports nothing that takes time.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeVar

import click
from click.shell_completion import CompletionItem

from rotcal_ros.cli.console import path_type
from rotcal_ros.foundation import plugins
from rotcal_ros.foundation.components import COMPONENTS
from rotcal_ros.foundation.language import ENGLISH, language_codes
from rotcal_ros.foundation.units import ARCSEC

if TYPE_CHECKING:
    from rotcal_ros.foundation.table_columns import SheetSettings
    from rotcal_ros.foundation.table_reading import Reading
    from rotcal_ros.planning.check_rule import CheckRule
    from rotcal_ros.recordings.result_sources import References

Function = TypeVar("Function", bound=Callable[..., Any])

shown_option = partial(click.option, show_default=True)
language_option = click.option(
    "--language",
    type=click.Choice(language_codes()),
    default=ENGLISH.code,
    help="Language of the report; names, and what a person wrote, stay as they are.",
)
set_option = click.option(
    "--set", "changes", multiple=True, metavar="GROUP.NAME=VALUE", help="Change a setting."
)


targets_option: Final = click.option(
    "--targets", type=path_type, help="Target positions of a tracer table."
)


def setup_options(function: Function) -> Function:
    """Add ``--setup`` and ``--targets``."""
    function = targets_option(function)
    return click.option(
        "--setup",
        type=path_type,
        shell_complete=complete_configurations,
        help="Configuration; needed for a table, a bag has its own.",
    )(function)


component_option: Final = click.option(
    "--component",
    type=click.Choice(COMPONENTS),
    default="ECC",
    show_default=True,
    help="The deviation to compare.",
)
align_option: Final = click.option(
    "--align-order",
    type=click.IntRange(0, 12),
    default=0,
    show_default=True,
    help="Harmonics removed besides the offset; 1 for radial deviations of different origins.",
)
reference_option: Final = click.option(
    "--reference-u",
    "reference_std",
    type=click.FloatRange(min=0.0),
    metavar="ARCSEC",
    callback=lambda _context, _option, given: None if given is None else given * ARCSEC,
    help="Standard uncertainty (k = 1) of reference tables, and of a polygon's faces, that state "
    "none; 0: exact.",
)


polygon_option: Final = click.option(
    "--polygon",
    type=path_type,
    help="Table of calibrated face errors, subtracted from every reference table.",
)


sheet_option: Final = click.option(
    "--set",
    "changes",
    multiple=True,
    metavar="sheet.NAME=VALUE",
    help="How a table is read, where it can be read in two ways.",
)
explain_option: Final = click.option(
    "--explain", is_flag=True, help="Say how a table is understood, and stop."
)


remember_option: Final = click.option(
    "--remember",
    is_flag=True,
    help="Keep what --set sheet.NAME=VALUE says in a file beside the table, for all tables with "
    "this head.",
)


def reading_announcer(*, explain: bool, remembers: bool = False) -> Callable[[Reading], object]:
    """Return what prints how a table was understood: in one line, or all for ``--explain``.

    ``remembers``: what was stated of the table is kept beside it.
    """
    from rotcal_ros.report.terminal.console import print_reading, say, tell

    def announce(reading: Reading) -> None:
        from rotcal_ros.foundation.table_columns import AS_IT_STANDS
        from rotcal_ros.foundation.table_forms import remember

        if explain:
            tell(*reading.lines())
        else:
            print_reading(reading)
        if remembers and reading.form and reading.stated != AS_IT_STANDS:
            file = remember(reading.table.path, reading.form_head, reading.stated)
            say(f"remembered in {file} for tables with this head")

    return announce


def sheet_settings(changes: Sequence[str]) -> SheetSettings:
    """Return what ``--set sheet.NAME=VALUE`` says of a table."""
    from rotcal_ros.foundation.settings import settings_from_changes
    from rotcal_ros.foundation.table_columns import SheetSettings
    from rotcal_ros.foundation.untrusted import load_yaml

    return settings_from_changes(SheetSettings, "sheet", changes, load_yaml)


def reference_reader(
    sources: Iterable[Path],
    reference_std: float | None,
    changes: Sequence[str],
    polygon: Path | None = None,
    *,
    remembers: bool = False,
) -> References:
    """Return how reference tables are read by these options.

    Raises UsageError for a ``polygon`` without a reference table among ``sources``.
    """
    from rotcal_ros.foundation.table_forms import of_tables
    from rotcal_ros.foundation.tables import is_table
    from rotcal_ros.recordings.result_sources import References

    announce = reading_announcer(explain=False, remembers=remembers)
    sheet, tables = sheet_settings(changes), [*filter(is_table, sources)]
    own = of_tables([*tables, *([polygon] if polygon else [])], sheet)
    found = References(reference_std, None, sheet, announce, own)
    if polygon is None:
        return found
    if not tables:
        raise click.UsageError("--polygon needs a reference table, and none is given")
    return replace(found, polygon=found.faces(polygon))


_risk = click.FloatRange(0.0, 0.5, min_open=True, max_open=True)

_RULE_OPTIONS = (
    click.option(
        "--within",
        type=click.FloatRange(0.0, min_open=True),
        help="arcsec or um: by how much the earlier curve may be off at any angle; can only be "
        "left out for a plan --from-history, which takes what the tolerance leaves.",
    ),
    shown_option(
        "--ageing",
        type=click.FloatRange(0.0),
        default=0.0,
        help="arcsec or um per month, usual change of an angle (k = 1).",
    ),
    shown_option(
        "--months",
        type=click.FloatRange(0.0),
        default=0.0,
        help="Months since the earlier measurement.",
    ),
    shown_option(
        "--miss",
        type=_risk,
        default=0.05,
        help="Risk of 'still valid' although some angle is off by more.",
    ),
    shown_option(
        "--false-alarm",
        type=_risk,
        default=0.05,
        help="Risk of 'changed' although the table only aged as stated.",
    ),
)


def rule_options(function: Function) -> Function:
    """Add ``--within``, ``--ageing``, ``--months``, ``--miss`` and ``--false-alarm``."""
    for option in reversed(_RULE_OPTIONS):
        function = option(function)
    return function


def make_check_rule(
    unit: float,
    *,
    within: float | None,
    ageing: float,
    months: float,
    miss: float,
    false_alarm: float,
) -> CheckRule:
    """Return the rule that these options state; ``unit`` (m or rad) is that of limit and ageing.

    The usual change grows in proportion to the time.
    """
    from rotcal_ros.planning.check_rule import CheckRule

    if within is None:
        raise click.UsageError("give --within: by how much the earlier curve may be off")
    if ageing > 0.0 and months == 0.0:
        raise click.UsageError("--ageing is per month: give the number of months with --months")
    return CheckRule(within * unit, miss, false_alarm, ageing * months * unit)


FOLDER: Final = "config"
"""Where configurations are usually kept."""
SUFFIX: Final = ".yaml"


def complete_configurations(
    _context: click.Context, _parameter: click.Parameter, typed: str
) -> list[CompletionItem]:
    """Offer the configurations that begin with ``typed``; if there are none, files."""
    folder = Path(typed) if typed.endswith("/") else Path(typed).parent
    begin = "" if typed.endswith("/") else Path(typed).name
    here = [path for path in _seen(folder) if path.name.startswith(begin)]
    found = [str(path) for path in here if path.suffix == SUFFIX and path.is_file()]
    if folder == Path() and FOLDER.startswith(typed):
        found += [str(path) for path in _seen(Path(FOLDER)) if path.suffix == SUFFIX]
    return [CompletionItem(path) for path in found] or [CompletionItem(typed, type="file")]


def complete_plugins(
    group: str, *others: str
) -> Callable[[click.Context, click.Parameter, str], list[CompletionItem]]:
    """Return what offers the plug-ins of a group, and ``others``."""

    def offered(
        _context: click.Context, _parameter: click.Parameter, typed: str
    ) -> list[CompletionItem]:
        names = (*plugins.names(group), *others)
        return [CompletionItem(name) for name in names if name.startswith(typed)]

    return offered


def _seen(folder: Path) -> list[Path]:
    """Return what is in a folder and not hidden; nothing if the folder cannot be read."""
    try:
        return sorted(path for path in folder.iterdir() if not path.name.startswith("."))
    except OSError:
        return []
