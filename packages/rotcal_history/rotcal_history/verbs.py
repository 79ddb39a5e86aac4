"""``rotcal history``: the results of all tables, what has changed, and what is due."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from datetime import datetime, timezone
from functools import wraps
from itertools import groupby
from math import hypot
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, get_args

import click

from rotcal_history.settings import (
    DOCUMENTS,
    EVENTS,
    Basis,
    Chart,
    HistorySettings,
)
from rotcal_ros.cli.console import NamedFile, json_option, path_type, print_json
from rotcal_ros.cli.options import language_option, shown_option
from rotcal_ros.foundation.components import COMPONENTS, COVERAGE_FACTOR, unit_of
from rotcal_ros.foundation.dates import day_of, time_of, today
from rotcal_ros.foundation.errors import ConfigurationError, DataError, RotcalError
from rotcal_ros.foundation.files import remove_durably, write_atomically, write_durably
from rotcal_ros.report.terminal.columns import Column, print_table, print_words
from rotcal_ros.report.terminal.console import progress, say, tell

if TYPE_CHECKING:  # what takes a second to load is imported where it is used
    from rotcal_history.database import HistoryEntry, ParkHistory
    from rotcal_history.outlook import DeviationOutlook, Outlook

VARIABLE: Final = "ROTCAL_HISTORY"
ENTRY_NUMBER: Final = click.IntRange(1, (1 << 63) - 1)
OF_TABLE: Final = {
    "Table": "title", "Last": "last", "Verdict": "verdict_line", "Trend": "trend", "Due": "due",
    "Why": "reason",
}  # fmt: skip
OF_ENTRY: Final = {
    "Entry": "id", "Date": "day", "Kind": "kind", "What": "what", "By": "added_by", "Why": "why",
    "State": "state",
}  # fmt: skip


def _settings(_context: click.Context, _option: click.Parameter, given: Any) -> HistorySettings:
    from rotcal_ros.foundation.settings import settings_from_changes
    from rotcal_ros.foundation.untrusted import load_yaml

    return settings_from_changes(HistorySettings, "history", given, load_yaml)


serial_option: Final = click.option(
    "--serial", default="", help="Serial number of a result that does not state it."
)
axis_option: Final = click.option("--axis", default="", help="Axis, such as C.")
why_option: Final = click.option("--why", default="", help="What happened, for people.")


def asked(function: Callable[..., Any]) -> Callable[..., Any]:
    """Give a verb the options of database and settings as one argument ``settings``."""

    @click.option(
        "--database",
        metavar="FILE|URL",
        help="The history: a file, or postgresql://USER@HOST/NAME; default: ROTCAL_HISTORY, else "
        "history.db.",
    )
    @click.option(
        "--set",
        "settings",
        multiple=True,
        metavar="history.NAME=VALUE",
        callback=_settings,
        help="Change a setting, such as history.promise=0.99: see `rotcal settings history`.",
    )
    @wraps(function)
    def verb(*args: Any, database: str | None, settings: HistorySettings, **kwargs: Any) -> Any:
        parent = click.get_current_context().parent
        given = (database, parent and parent.params.get("database"), os.environ.get(VARIABLE))
        chosen = next(filter(None, given), settings.database)
        return function(*args, settings=replace(settings, database=chosen), **kwargs)

    return verb


@click.group(invoke_without_command=True)
@asked
@json_option
@click.pass_context
def command(context: click.Context, settings: HistorySettings, as_json: bool) -> int:
    """Keep the results of all tables, and say what has changed and what is due.

    Without a further word: the tables of the park, those that need somebody first.
    """
    if context.invoked_subcommand:
        if settings != HistorySettings(database=settings.database):
            raise click.UsageError("--set belongs behind the verb that it is for")
        return 0
    views = _park(settings)
    if as_json:
        print_json({"tables": [_plain(view) for view in views]})
        return 0
    _print(OF_TABLE, sorted(views, key=lambda o: (not o.urgent, o.due_ns, o.title)))
    tables = "1 table" if len(views) == 1 else f"{len(views)} tables"
    print_words(f"{tables}, {sum(bool(o.urgent) for o in views)} to look at")
    return 0


@command.command()
@click.argument("sources", nargs=-1, required=True, type=path_type, metavar="RESULT...")
@serial_option
@axis_option
@click.option("--measured", default="", help="Day of a result without a date, as 2026-03-31.")
@why_option
@click.option(
    "--as", "kind", type=click.Choice(DOCUMENTS), help="Add files of this kind; needs --serial."
)
@asked
@json_option
def add(
    sources: tuple[Path, ...], measured: str, kind: str | None, as_json: bool, **asked: Any
) -> int:
    """Add results: result.json, bags, sessions with their reports; none of them twice.

    A result says by identity.serial and cell.axis which table it is of; --serial and --axis state
    it for those that do not. With --as, files of any form are kept beside the results: a quick
    check, a report, a table in force. If one of several is refused, the others are added; the
    exit code is then 1.
    """
    from rotcal_history.adding import add_sources

    done, refused, settings = [], list[RotcalError](), asked.pop("settings")
    given = {**asked, "measured_ns": time_of(measured) if measured else 0}
    with _open(settings, must_exist=False) as history, progress("adding") as shown:
        known = sorted({item.serial for item in history.items(valid=False)})
        if asked["serial"] and known and asked["serial"] not in known:
            say(
                f"warning: this history has no table {asked['serial']!r} yet, only "
                f"{', '.join(known[:10])}: if that is a slip, `rotcal history correct` moves it"
            )
        for number, came in enumerate(add_sources(history, sources, given, kind), 1):
            shown(number, len(sources))
            if isinstance(came, RotcalError):
                if len(sources) == 1:
                    raise came
                refused.append(came)
                say(f"not added: {came}")
            else:
                done += came
                say("\n".join(each.describe() for each in came))
    if as_json:
        entries = [{"new": each.new, **_facts(each.entry)} for each in done]
        print_json({"entries": entries, "refused": [str(error) for error in refused]})
    if refused:
        say(f"{len(refused)} of {len(sources)} were not added; what is added once stays so")
    return int(bool(refused))


@command.command()
@click.argument("serial")
@click.argument("what", type=click.Choice(EVENTS))
@axis_option
@click.option("--date", "day", required=True, help="When it happened, as 2026-03-31.")
@why_option
@asked
def event(serial: str, what: str, axis: str, day: str, why: str, settings: HistorySettings) -> int:
    """Note what happened to the table SERIAL.

    After another encoder, another bearing or a repair it is another table: earlier results do not
    describe it. After a crash, an adjustment or something else its curve may have jumped.
    """
    with _open(settings) as history:
        item = history.item(serial, axis)
        say(history.add_event(item, what, time_of(day), why).describe())
    return 0


@command.command()
@click.argument("number", type=ENTRY_NUMBER, metavar="ENTRY")
@click.option("--serial", default="", help="The serial number that it should have had.")
@click.option("--axis", default="", help="The axis that it should have had.")
@click.option("--withdraw", is_flag=True, help="It counts for no table.")
@click.option("--why", required=True, help="The reason, which is kept.")
@asked
def correct(
    number: int, serial: str, axis: str, withdraw: bool, why: str, settings: HistorySettings
) -> int:
    """Put another entry in place of ENTRY, which stays: for another table, or for none."""
    if withdraw == bool(serial or axis):
        raise click.UsageError("give --serial or --axis, or --withdraw")
    with _open(settings) as history:
        say(history.correct(number, why, serial=serial, axis=axis).describe())
    return 0


@command.command()
@click.argument("serial")
@axis_option
@click.option(
    "--entry", "number", type=ENTRY_NUMBER, help="Write this entry to --output, as it was."
)
@click.option("-o", "--output", type=path_type, help="File for the content of --entry.")
@asked
@json_option
def show(
    serial: str, axis: str, number: int | None, output: Path | None, as_json: bool, **asked: Any
) -> int:
    """Show all entries of the table SERIAL, what has changed, and when it is due."""
    from rotcal_history.outlook import all_outlooks

    if (number is None) != (output is None):
        raise click.UsageError("--entry and --output belong together")
    settings = asked["settings"]
    with _open(settings) as history:
        item = history.item(serial, axis)
        if number is not None and output is not None:
            entry = history.entry(number)
            if (entry.serial, entry.axis) != (item.serial, item.axis):
                raise DataError(
                    f"entry {number} is of {entry.title}, not of {item.title}: name that table"
                )
            try:
                write_durably(output, entry.content)
            except FileExistsError as error:  # or a link, whatever it leads to
                raise ConfigurationError(
                    f"{output} exists and is not overwritten: name another file"
                ) from error
            except OSError:
                remove_durably(output)  # a part of it
                raise
            say(f"{entry.kind} {entry.what}: {output.absolute()}")
            return 0
        entries = history.of_item(item, valid=False)
        known = next((o for o in all_outlooks(history, settings) if o.title == item.title), None)
    if as_json:
        outlook = None if known is None else _plain(known)
        print_json({"entries": [_facts(e) for e in entries], "outlook": outlook})
        return 0
    _print(OF_ENTRY, entries)
    if known is not None:
        _print_outlook(known, settings.database)
    return 0


@command.command()
@click.argument("serial")
@axis_option
@shown_option("--component", type=click.Choice(COMPONENTS), default="ECC", help="Deviation.")
@shown_option(
    "--chart", type=click.Choice(get_args(Chart)), default="shewhart", help="Control chart."
)
@shown_option(
    "--limits",
    "basis",
    type=click.Choice(get_args(Basis)),
    default="stated",
    help="From stated uncertainties, the scatter of the series itself, or the fitted model.",
)
@click.option(
    "-o", "--output", type=NamedFile(".svg", bare=False), required=True, help="The figure, .svg."
)
@asked
def plot(serial: str, axis: str, component: str, output: Path, **asked: Any) -> int:
    """Draw one deviation of the table SERIAL over time, its forecast, and a control chart."""
    from rotcal_history.charts import chart_and_forecast
    from rotcal_history.outlook import DAY_NS, deviation_series
    from rotcal_history.trend import fit_trend

    settings: HistorySettings = asked["settings"]
    with _open(settings) as history:
        curves = deviation_series(history, history.item(serial, axis), component, settings)
    until = curves.campaigns[-1].measured_ns + round(2 * settings.interval_days * DAY_NS)
    drawn = chart_and_forecast(
        curves, fit_trend(curves.series), until, asked["chart"], asked["basis"]
    )
    write_atomically(output, drawn)
    say(f"drawn: {output.absolute()}")
    return 0


@command.command()
@click.option("--before", default="", help="Day, as 2026-03-31; default: tomorrow.")
@click.option("--ics", type=NamedFile(".ics"), help="Also write the dates as an iCalendar.")
@click.option("--mail", is_flag=True, help="Print the text of an e-mail.")
@asked
@json_option
def due(
    before: str, ics: Path | None, mail: bool, settings: HistorySettings, as_json: bool
) -> int:
    """Show which tables are due before a day; the exit code is 1 if there are any."""
    from rotcal_history.exchange import due_calendar, reminder_mail
    from rotcal_history.outlook import DAY_NS

    limit = time_of(before) if before else time_of(today()) + DAY_NS
    day, views = day_of(limit), sorted(_park(settings), key=lambda o: (o.due_ns, o.title))
    found = [o for o in views if o.due_ns < limit]
    if ics is not None:
        write_atomically(ics, due_calendar(found, datetime.now(timezone.utc)))
        say(f"calendar: {ics.absolute()}")
    if as_json:
        print_json({"before": day, "tables": [_plain(view) for view in found]})
    elif mail:
        tell(*reminder_mail(found, day).splitlines())
    elif found:
        _print(OF_TABLE, found)
    else:
        say(f"no table is due before {day}")
    return int(bool(found))


@command.command()
@asked
@json_option
def check(settings: HistorySettings, as_json: bool) -> int:
    """Verify every hash, reference and forecast; the exit code is 1 if anything was changed."""
    from rotcal_history.outlook import changed_forecasts

    with _open(settings) as history:
        wrong = history.check()
        wrong += [] if wrong else changed_forecasts(history, settings)
    if as_json:
        print_json({"wrong": wrong})
    else:
        tell(*wrong or ["all entries are as they were added"])
    return int(bool(wrong))


@command.command("export")
@click.argument("folder", type=path_type)
@asked
def export_verb(folder: Path, settings: HistorySettings) -> int:
    """Write the history as Parquet: entries, to import them elsewhere, and deviations."""
    from rotcal_history.exchange import export_history

    with _open(settings) as history:
        say(f"{export_history(history, folder)} entries: {folder.absolute()}")
    return 0


@command.command("import")
@click.argument("folder", type=path_type)
@asked
def import_verb(folder: Path, settings: HistorySettings) -> int:
    """Add the entries of an export; those that are there already stay as they are."""
    from rotcal_history.exchange import restore_history

    with _open(settings, must_exist=False) as history:
        new, old = restore_history(history, folder)
    say(f"{new} entries added, {old} were there already")
    return 0


@command.command()
@shown_option("-o", "--output", type=path_type, default=Path("out/park"), help="Folder for it.")
@language_option
@asked
def page(output: Path, language: str, settings: HistorySettings) -> int:
    """Write the page of the park: a row for each table, and a page behind it."""
    from rotcal_history.page import write_park
    from rotcal_ros.foundation.language import use_language

    outlooks = _park(settings)
    with _open(settings) as history, use_language(language):
        say(f"page: {write_park(history, outlooks, output, today()).absolute()}")
    return 0


@command.command()
@asked
def metrics(settings: HistorySettings) -> int:
    """Print due dates and findings for monitoring, in the text format of Prometheus."""
    from rotcal_history.exchange import prometheus_metrics as of_all

    click.echo(of_all(_park(settings)), nl=False)
    return 0


def _open(settings: HistorySettings, *, must_exist: bool = True) -> ParkHistory:
    from rotcal_history.database import ParkHistory

    return ParkHistory(settings.database, must_exist=must_exist)


def _park(settings: HistorySettings) -> list[Outlook]:
    from rotcal_history.outlook import all_outlooks

    with _open(settings) as history, progress("looking at the tables") as shown:
        return all_outlooks(history, settings, shown)


def _plain(view: Outlook) -> dict[str, Any]:
    return asdict(view) | {"trend": view.trend}


def _facts(entry: HistoryEntry) -> dict[str, Any]:
    return {name: value for name, value in asdict(entry).items() if name != "content"}


def _print(columns: Mapping[str, str], rows: Sequence[Any]) -> None:
    """Print a table of what rows say under these names, by heading."""
    found = {head: [getattr(row, name) for row in rows] for head, name in columns.items()}
    print_table([Column(head, values) for head, values in found.items()])


def _print_outlook(known: Outlook, database: str) -> None:
    print_words(f"due {known.due}: {known.reason}")
    print_words(*(found.words for found in known.findings))
    for view in known.deviations:
        print_words(*_lines(view), *view.notes)
    if any(d.component == "ECC" and d.tolerance and d.rate is not None for d in known.deviations):
        day = max(known.due, today())
        where = f"--from-history {database} --at {day}"
        print_words(
            f"fewest lengths for the next time: rotcal plan check {known.serial} {where} "
            "--setup SETUP -o FOLDER"
        )


def _lines(view: DeviationOutlook) -> Iterator[str]:
    """Yield what is known of one deviation."""
    unit, label = unit_of(view.component)
    yield view.trend if view.rate is not None else f"{view.component}: no drift known"
    if orders := ", ".join(_orders(view, unit)):
        yield f"{view.component}, change per year by order / {label}: {orders}"
    if view.probability is not None:
        yield f"{view.component} is within its tolerance with {100.0 * view.probability:.1f} %"
    if view.intervals_days:
        days = (f"{name} {days:.0f} days" for name, days in view.intervals_days)
        yield f"{view.component}, next interval: {', '.join(days)}"
    if view.per_kelvin is not None:
        value, std = (number / unit for number in view.per_kelvin)
        yield f"{view.component}: {value:+.2g} ± {COVERAGE_FACTOR * std:.2g} {label}/K"


def _orders(view: DeviationOutlook, unit: float) -> Iterator[str]:
    """Yield how much each harmonic changes in a year, whatever its phase."""
    for order, found in groupby(view.harmonics, lambda each: each[0]):
        _, rates, stds = zip(*found, strict=True)
        spread = COVERAGE_FACTOR * hypot(*stds) / len(stds) ** 0.5
        yield f"{order}: {hypot(*rates) / unit:.2g} ± {spread / unit:.2g}"
