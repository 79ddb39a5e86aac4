"""``rotcal combine``: the best estimate of one table from several results."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from rotcal_ros.cli.console import json_option, path_type, result_option, show_result
from rotcal_ros.cli.options import (
    polygon_option,
    reference_option,
    reference_reader,
    remember_option,
    sheet_option,
)

if TYPE_CHECKING:
    from rotcal_ros.evaluation.component_groups import Enlargement


@click.command()
@click.argument("sources", nargs=-1, required=True, type=path_type, metavar="A B [C ...]")
@result_option
@click.option(
    "--enlarge",
    # The names of ENLARGEMENTS, whose module takes a second to load; a test compares them.
    type=click.Choice(("birge", "mandel-paule", "none")),
    default="birge",
    show_default=True,
    help="What enlarges the uncertainties when the inputs contradict each other.",
)
@polygon_option
@reference_option
@sheet_option
@remember_option
@json_option
def command(
    sources: tuple[Path, ...],
    output: Path | None,
    enlarge: Enlargement,
    polygon: Path | None,
    reference_std: float | None,
    changes: tuple[str, ...],
    remember: bool,
    as_json: bool,
) -> int:
    """Combine results of one table: result.json, bags, sessions, reference tables.

    Generalised least squares with all covariances; the zero of every input is unknown. Inputs that
    rest on the same observations count once. If inputs contradict each other (chi-square), the
    uncertainties are enlarged and the verdict is suspect; it is suspect too if they agree better
    than independent measurements would. An input with the verdict failed is refused. The exit code
    is 0 for the verdict ok and 1 for suspect.
    """
    from rotcal_ros.evaluation.joint import combine
    from rotcal_ros.recordings.result_sources import read_measured

    how = reference_reader(sources, reference_std, changes, polygon, remembers=remember)
    combined = combine([read_measured(source, how) for source in sources], enlarge)
    if not as_json:
        from rotcal_ros.report.terminal.tables import print_group_agreement

        print_group_agreement(combined.groups)
    return show_result(combined.result, output, as_json=as_json)
