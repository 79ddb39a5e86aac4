"""``--set reading.NAME=VALUE``: what a bag may ask for while it is read."""

from __future__ import annotations

import click

from rotcal_ros.bags.reading_limits import ReadingLimits, changed_limits


def _limits(
    context: click.Context, option: click.Parameter, changes: tuple[str, ...]
) -> ReadingLimits:
    return changed_limits(changes)


limits_option = click.option(
    "--set",
    "limits",
    multiple=True,
    callback=_limits,
    metavar="reading.NAME=VALUE",
    help="Change a limit of reading; docs/settings.md has them.",
)
