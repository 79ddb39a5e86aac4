"""``rotcal iso230``: accuracy and repeatability of positioning from repeated runs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from rotcal_ros.cli.console import json_option, path_type, print_json
from rotcal_ros.report.terminal.console import say

if TYPE_CHECKING:
    from rotcal_ros.evaluation.iso230 import BidirectionalRuns, Iso230


@click.command("iso230", short_help="Evaluate repeated bidirectional runs after ISO 230-2.")
@click.argument("source", type=path_type, metavar="RUNS")
@click.option(
    "-o", "--output", type=path_type, help="Draw the diagrams of the standard there (.svg)."
)
@json_option
def command(source: Path, output: Path | None, as_json: bool) -> int:
    """Evaluate RUNS: a table (.csv), or the result.json or bag of a plan with runs.

    The table has the columns angle_deg, run, direction (up or down), deviation_arcsec; every
    target is there once in every run and direction.
    """
    from rotcal_ros.evaluation.iso230 import iso230

    runs = _read(source)
    figures = iso230(runs)
    if output is not None:
        _draw(output, runs, figures)
    if as_json:
        print_json(figures.to_dict())
    else:
        from rotcal_ros.report.terminal.tables import print_iso230

        print_iso230(figures, runs.forward.shape[1])
    if output is not None:
        say(f"drawn: {output.absolute()}")
    return 0


def _read(source: Path) -> BidirectionalRuns:
    from rotcal_ros.evaluation.bidirectional import read_runs, require_runs
    from rotcal_ros.recordings.sources import read_result, read_text

    if source.suffix == ".csv":
        return read_runs(read_text(source), str(source))
    return require_runs(read_result(source), str(source))


def _draw(output: Path, runs: BidirectionalRuns, figures: Iso230) -> None:
    from rotcal_ros.files import write_atomically
    from rotcal_ros.report.iso230 import diagrams

    if output.suffix != ".svg":
        raise click.UsageError(f"cannot draw {output.name}: name a .svg file")
    write_atomically(output, diagrams(runs, figures))
