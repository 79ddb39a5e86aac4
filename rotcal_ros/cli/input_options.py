"""Options for what belongs to a bag or a table: its set-up, its targets, changes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import click

from rotcal_ros.cli.completion import configurations
from rotcal_ros.cli.console import path_type

Function = TypeVar("Function", bound=Callable[..., Any])

set_option = click.option(
    "--set", "changes", multiple=True, metavar="GROUP.NAME=VALUE", help="Change a setting."
)


def setup_options(function: Function) -> Function:
    """Add ``--setup`` and ``--targets``."""
    function = click.option(
        "--targets", type=path_type, help="Target positions of a tracer table."
    )(function)
    return click.option(
        "--setup",
        type=path_type,
        shell_complete=configurations,
        help="Configuration; a table needs it, a bag brings its own.",
    )(function)
