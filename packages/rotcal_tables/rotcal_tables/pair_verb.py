"""``rotcal pairs``: commanded and actual angles of a bag as a table of deviations."""

from __future__ import annotations

from pathlib import Path

import click

from rotcal_ros.foundation.errors import BagError
from rotcal_ros.foundation.files import write_atomically
from rotcal_ros.foundation.table_columns import ANGLE, COUNTS, UNITS
from rotcal_ros.report.terminal.console import say, tell
from rotcal_tables.pairs import END_MARGIN, TopicField, find_rests, table_lines

_UNITS = tuple(unit for unit in UNITS[ANGLE] if unit not in ("dms", "m:s"))


@click.command()
@click.argument("bag", type=click.Path(path_type=Path))
@click.option("--commanded", required=True, metavar="TOPIC:FIELD", help="Commanded angle.")
@click.option("--actual", required=True, metavar="TOPIC:FIELD", help="Actual angle, or counts.")
@click.option("--commanded-unit", required=True, type=click.Choice(_UNITS), help="Its unit.")
@click.option("--actual-unit", required=True, type=click.Choice(_UNITS), help="Its unit.")
@click.option("--joint", default="", help="Joint, where a message holds several.")
@click.option(
    "--rest",
    type=click.FloatRange(min=0.01),
    default=1.0,
    show_default=True,
    help="s, time for which a command has to stand; the end of it is read.",
)
@click.option(
    "--period",
    type=click.FloatRange(min=0.0),
    default=0.0,
    help="By how much the actual angle jumps where it wraps, in its unit; 0: by a turn, or asked.",
)
@click.option(
    "--as-stated",
    is_flag=True,
    help="Commanded and actual are not exchanged, though they look so.",
)
@click.option("-o", "--output", type=click.Path(path_type=Path), required=True, help="CSV file.")
def command(
    bag: Path, commanded: str, actual: str, commanded_unit: str, actual_unit: str, joint: str,
    rest: float, period: float, as_stated: bool, output: Path,
) -> int:  # fmt: skip
    """Write commanded and actual angles of a bag as a table, one row for each rest.

    The table goes to ``rotcal solve`` or ``rotcal export`` as deviations that are known already.
    """
    if output.exists():
        raise BagError(f"{output} exists and is not overwritten; name another file with -o")
    if not period and actual_unit != COUNTS:
        period = float(360 * UNITS[ANGLE]["deg"] / UNITS[ANGLE][actual_unit])
    read = find_rests(
        bag, TopicField.of(commanded, joint), TopicField.of(actual, joint), rest, period
    )
    for line in read.remarks:
        say(f"left out: {line}")
    if not read.found:
        raise BagError(
            f"{bag}: the commanded angle never stood for {rest:g} s with the table at rest: see "
            "what was left out, or lower --rest"
        )
    if not as_stated:
        read.require_order()
    if early := max(each.early for each in read.found):
        lead = (1 + early) * END_MARGIN * rest
        say(f"the actual angle moves up to {lead:.2g} s before the command")
    write_atomically(
        output, "\n".join([*table_lines(read.found, commanded_unit, actual_unit), ""])
    )
    tell(f"{output}: {len(read.found)} rests")
    return 0
