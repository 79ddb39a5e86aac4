"""``rotcal iso230``: accuracy and repeatability of positioning from repeated runs."""

from __future__ import annotations

from pathlib import Path

import click

from rotcal_ros.cli.console import NamedFile, json_option, path_type, print_json, write_drawing
from rotcal_ros.cli.options import (
    explain_option,
    reading_announcer,
    remember_option,
    sheet_option,
    sheet_settings,
)
from rotcal_ros.foundation.units import ARCSEC


@click.command()
@click.argument("source", type=path_type, metavar="RUNS")
@click.option(
    "-o",
    "--output",
    type=NamedFile(".svg", bare=False),
    help="Draw the diagrams of the standard into this file (.svg).",
)
@click.option(
    "--device",
    type=click.FloatRange(min=0.0),
    metavar="ARCSEC",
    help="Standard uncertainty (k = 1) of the measuring device at a target, the same in all runs.",
)
@sheet_option
@remember_option
@explain_option
@json_option
def command(
    source: Path,
    output: Path | None,
    device: float | None,
    changes: tuple[str, ...],
    remember: bool,
    explain: bool,
    as_json: bool,
) -> int:
    """Evaluate RUNS: a table, or the result.json or bag of a plan with runs.

    The table, a workbook or a text in any form, has the table angle, run, direction (up or down)
    and deviation; without run and direction the order of the rows gives them. Every target occurs
    once in every run and direction. Every figure comes with its uncertainty: from the scatter of
    the runs, and from errors that all runs share. A result or bag knows the latter; for a table
    --device states them.
    """
    from rotcal_ros.evaluation.iso230 import add_device_uncertainty, iso230
    from rotcal_ros.recordings.result_sources import read_repeated_runs

    runs = read_repeated_runs(
        source, sheet_settings(changes), reading_announcer(explain=explain, remembers=remember)
    )
    if explain:
        return 0
    if device is not None:
        runs = add_device_uncertainty(runs, device * ARCSEC)
    figures = iso230(runs)
    if output is not None:
        from rotcal_ros.report.iso230 import draw_runs

        write_drawing(output, {".svg": lambda: draw_runs(runs, figures)})
    if as_json:
        print_json(figures.to_dict())
    else:
        from rotcal_ros.report.terminal.tables import print_iso230

        print_iso230(figures, runs.forward.shape[1])
    return 0
