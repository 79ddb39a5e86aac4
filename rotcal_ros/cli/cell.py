"""``rotcal cell``: somebody's own cell, looked at before it is calibrated."""

from __future__ import annotations

from pathlib import Path

import click

from rotcal_ros.cli.completion import configurations
from rotcal_ros.cli.console import json_option, path_type, print_json
from rotcal_ros.report.terminal.console import say


@click.group()
def command() -> None:
    """Look at a live cell: what is there, what is missing, what would happen."""


@command.command()
@click.argument(
    "configuration", required=False, type=path_type, metavar="[CONFIG]",
    shell_complete=configurations,
)  # fmt: skip
@click.option("--namespace", default="", help="ROS namespace; default: that of CONFIG, or /cell.")
@click.option(
    "--time",
    "seconds",
    default=5.0,
    show_default=True,
    type=click.FloatRange(1.0, 3600.0),
    help="Seconds to listen.",
)
@json_option
def check(configuration: Path | None, namespace: str, seconds: float, as_json: bool) -> int:
    """Listen to the cell of CONFIG and say line by line what is there and what is missing.

    Nothing is moved and nothing needs to run but the cell. With CONFIG its plan is gone through,
    too: the first order, whether everything is in reach, and the time. The exit code is 0 where
    nothing is missing, otherwise 1, with what to do next.
    """
    from rotcal_ros.sessions.cell_check import check_cell
    from rotcal_ros.sessions.environment import require_ros

    require_ros()
    if not as_json:
        say(f"listening for {seconds:g} s; nothing is moved, Ctrl-C ends it")
    report = check_cell(configuration, namespace, seconds)
    if as_json:
        print_json(report.to_dict())
    else:
        from rotcal_ros.report.terminal.cell import print_cell

        print_cell(report)
    return 0 if report.complete else 1
