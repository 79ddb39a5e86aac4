"""``--set reading.NAME=VALUE``: what a bag may ask for while it is read."""

from __future__ import annotations

from typing import Any

import click
import yaml

from rotcal_ros.bags.reading_limits import ReadingLimits
from rotcal_ros.errors import ConfigurationError
from rotcal_ros.settings import load

_GROUP = "reading"


def _limits(
    context: click.Context, option: click.Parameter, changes: tuple[str, ...]
) -> ReadingLimits:
    """Return the limits with the changes; raises ConfigurationError for what cannot be set."""
    values: dict[str, Any] = {}
    for change in changes:
        name, equals, value = change.partition("=")
        group, dot, setting = name.partition(".")
        if group != _GROUP or not dot or not equals:
            raise ConfigurationError(f"--set {change}: expected {_GROUP}.NAME=VALUE")
        try:
            values[setting] = yaml.safe_load(value)
        except yaml.YAMLError as error:
            raise ConfigurationError(f"--set {change}: no value: {error}") from None
    return load(ReadingLimits, values, f"--set: {_GROUP}")


limits_option = click.option(
    "--set",
    "limits",
    multiple=True,
    callback=_limits,
    metavar="reading.NAME=VALUE",
    help="Change a limit of reading; docs/settings.md has them.",
)
