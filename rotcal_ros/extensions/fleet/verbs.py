"""``rotcal reprocess``: many bags through capture and solver with one configuration."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import click

from rotcal_ros.bags.unread_data import note_unread
from rotcal_ros.cli.console import json_option, path_type, print_json
from rotcal_ros.cli.options import configurations
from rotcal_ros.foundation.errors import DataError
from rotcal_ros.report.terminal.console import progress, say, tell

if TYPE_CHECKING:
    from rotcal_ros.extensions.fleet.batch_solving import BagOutcome
    from rotcal_ros.extensions.fleet.results_dataset import ResultsDataset
    from rotcal_ros.foundation.results import Result


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
    help="Folder for table, overview page and cached results.",
)
@click.option("--workers", type=click.IntRange(min=1), help="Processes; default: all cores.")
@click.option("--scheduler", metavar="tcp://...", help="Use the workers of a Dask cluster.")
@click.option(
    "--time-limit",
    "time_limit_s",
    type=click.FloatRange(min=1.0),
    default=3600.0,
    show_default=True,
    metavar="SECONDS",
    help="A bag that takes longer is ended and set aside.",
)
@click.option(
    "--history",
    metavar="FILE|URL",
    help="Also add every result to this history of all tables.",
)
@click.option(
    "--verify-bytes",
    is_flag=True,
    help="Identify a bag by all its bytes, not by size, time and last bytes: reads every bag "
    "completely.",
)
@json_option
def command(
    sources: tuple[str, ...],
    setup: Path,
    output: Path,
    workers: int | None,
    scheduler: str | None,
    time_limit_s: float,
    history: str | None,
    verify_bytes: bool,
    as_json: bool,
) -> int:
    """Solve every bag that the arguments name, and show the trend of each table over time.

    Bags may be local or remote (s3://..., through fsspec). A bag that was solved before with the
    same content and configuration is not solved again, and results are kept as they come: an
    interruption costs only the bags being solved. One bad bag does not stop the rest; the exit
    code is then 1.
    """
    from rotcal_ros.extensions.fleet.bag_search import find_bags
    from rotcal_ros.extensions.fleet.batch_solving import Job
    from rotcal_ros.extensions.fleet.overview import OVERVIEW, write_overview
    from rotcal_ros.extensions.fleet.results_dataset import RESULTS_TABLE, ResultsDataset
    from rotcal_ros.extensions.fleet.workers import on_all_cores, on_cluster
    from rotcal_ros.foundation.machine_load import cores
    from rotcal_ros.methods.configuration import read_configuration

    configuration = read_configuration(setup)
    bags = find_bags(sources)
    cache = (output / "cache").absolute()
    cache.mkdir(parents=True, exist_ok=True)
    jobs = (Job(bag, configuration, str(cache), verify_bytes) for bag in bags)
    table, overview = output.absolute() / RESULTS_TABLE, output.absolute() / OVERVIEW
    with ResultsDataset(table) as dataset:
        if dataset.broken:
            say(f"{dataset.broken} parts of {table} were damaged: they are written again")
        if scheduler:
            running = on_cluster(jobs, scheduler, time_limit_s)
        else:
            workers = min(workers or cores(), len(bags))
            running = on_all_cores(jobs, workers, time_limit_s)
        with closing(running):
            tally = _followed(running, len(bags), dataset, history)
    write_overview(table, configuration.text, overview)
    if as_json:
        _print_json(table, overview)
    else:
        _print(tally, table, overview)
    return int(bool(tally.bad))


@dataclass
class _Tally:
    """Counts of bags by outcome; ``aside`` are those that no worker survived or finished."""

    bags: int = 0
    repeated: int = 0
    healed: int = 0
    bad: int = 0
    aside: list[str] = field(default_factory=list)

    def count(self, outcome: BagOutcome) -> None:
        self.bags += 1
        self.repeated += outcome.cached
        self.healed += outcome.healed
        self.bad += bool(outcome.error)
        if outcome.set_aside:
            self.aside.append(f"{outcome.source}: {outcome.error}")


def _followed(
    running: Iterable[BagOutcome], total: int, dataset: ResultsDataset, history: str | None
) -> _Tally:
    """Keep the outcomes as they come, under a progress bar; show bad bags at once."""
    tally = _Tally()
    with progress("solving") as shown:
        for outcome in running:
            dataset.add(outcome)
            tally.count(outcome)
            shown(tally.bags, total)
            if outcome.error:
                say(f"{outcome.source}: {outcome.error}")
            note_unread(f"{outcome.source}: {text}" for text in outcome.unread)
            if history is not None and (result := outcome.deviations()) is not None:
                _keep(result, history, outcome.source)
    return tally


def _keep(result: Result, history: str, source: str) -> None:
    """Add a result to a history; one that says too little of itself is told and left out."""
    from rotcal_ros.foundation import plugins

    results = plugins.extension(plugins.HISTORIES, "history", "a history")
    try:
        results.keep(result, history)
    except DataError as error:
        say(f"{source} is not in the history: {error}")


def _print(tally: _Tally, table: Path, overview: Path) -> None:
    tell(
        f"{tally.bags} bags: {tally.bags - tally.bad} solved ({tally.repeated} of them before), "
        f"{tally.bad} without a result"
    )
    if tally.healed:
        tell(f"{tally.healed} kept results were damaged: computed again")
    for text in tally.aside:
        tell(text)
    tell(f"table:        {table}")
    tell(f"overview:     {overview}")


def _print_json(table: Path, overview: Path) -> None:
    """Print one object per bag, as the dataset has it, in order of recording."""
    from rotcal_ros.extensions.fleet.overview import bags_by_table, connected

    with connected(table) as connection:
        bags = sorted(
            bags_by_table(connection),
            key=lambda b: (b.start_ns is None, b.start_ns or 0, b.source),
        )
    rows = [
        {
            "source": bag.source,
            "table": bag.table,
            "verdict": bag.verdict,
            "verdict_line": bag.line,
            "warnings": list(bag.warnings),
            "error": bag.error,
            "twin_of": bag.twin_of,
            "alarm": bag.alarm or "",
        }
        for bag in bags
    ]
    print_json({"bags": rows, "table": str(table), "overview": str(overview)})
