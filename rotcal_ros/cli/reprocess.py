"""``rotcal reprocess``: many bags through capture and solver with one configuration."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import click

from rotcal_ros.cli.completion import configurations
from rotcal_ros.cli.console import json_option, path_type, print_json
from rotcal_ros.report.terminal.console import progress, say, tell
from rotcal_ros.session_folder import OVERVIEW, RESULTS_TABLE

if TYPE_CHECKING:
    from rotcal_ros.recordings.many import Job, Outcome


@click.command()
@click.argument("sources", nargs=-1, required=True, metavar="BAG|FOLDER|GLOB|LIST...")
@click.option(
    "--setup",
    type=path_type,
    required=True,
    shell_complete=configurations,
    help="Configuration for all bags.",
)
@click.option(
    "-o",
    "--output",
    type=path_type,
    default=Path("out/reprocessed"),
    show_default=True,
    help="Folder for table, overview page and what need not be repeated.",
)
@click.option("--workers", type=click.IntRange(min=1), help="Processes; default: all cores.")
@click.option("--scheduler", metavar="tcp://...", help="Use the workers of a Dask cluster.")
@json_option
def command(
    sources: tuple[str, ...],
    setup: Path,
    output: Path,
    workers: int | None,
    scheduler: str | None,
    as_json: bool,
) -> int:
    """Solve every bag that the arguments name, and show the trend of each table over time.

    Bags may be local or remote (s3://..., through fsspec). What was solved before with the same
    content and configuration is not solved again. One bad bag does not stop the rest; the exit
    code is then 1.
    """
    from rotcal_ros.catalogue.configuration import read_configuration
    from rotcal_ros.recordings.many import Job, find_bags
    from rotcal_ros.recordings.workers import on_all_cores, on_cluster
    from rotcal_ros.report.many import in_time, write_overview, write_table

    configuration = read_configuration(setup)
    bags = find_bags(sources)
    cache = (output / "cache").absolute()
    cache.mkdir(parents=True, exist_ok=True)
    jobs = [Job(bag, configuration, str(cache)) for bag in bags]
    running = on_cluster(jobs, scheduler) if scheduler else on_all_cores(jobs, workers)
    outcomes = in_time(_followed(running, jobs))
    table, overview = output.absolute() / RESULTS_TABLE, output.absolute() / OVERVIEW
    write_table(outcomes, table)
    write_overview(outcomes, configuration.text, overview)
    bad = [outcome for outcome in outcomes if outcome.error]
    if as_json:
        bags_done = [_summary(outcome) for outcome in outcomes]
        print_json({"bags": bags_done, "table": str(table), "overview": str(overview)})
    else:
        repeated = sum(outcome.cached for outcome in outcomes)
        click.echo(
            f"{len(outcomes)} bags: {len(outcomes) - len(bad)} solved ({repeated} of them "
            f"before), {len(bad)} without a result"
        )
        tell(f"table:        {table}")
        tell(f"overview:     {overview}")
    return int(bool(bad))


def _followed(running: Iterator[Outcome], jobs: list[Job]) -> list[Outcome]:
    """Collect the outcomes under a progress bar; show bad bags at once."""
    outcomes = []
    with progress("solving") as shown:
        for outcome in running:
            outcomes.append(outcome)
            shown(len(outcomes), len(jobs))
            if outcome.error:
                say(f"{outcome.source}: {outcome.error}")
    return outcomes


def _summary(outcome: Outcome) -> dict[str, object]:
    result = outcome.deviations()
    return {
        "source": outcome.source,
        "table": outcome.table,
        "verdict": result.verdict if result else None,
        "verdict_line": result.verdict_line if result else None,
        "warnings": list(result.warnings) if result else [],
        "error": outcome.error,
        "cached": outcome.cached,
    }
