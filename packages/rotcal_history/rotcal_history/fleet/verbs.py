"""``rotcal reprocess``: many bags through capture and solver with one configuration."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any, Final

import click

from rotcal_ros.bags.unread_data import note_unread
from rotcal_ros.cli.console import json_option, path_type, print_json
from rotcal_ros.cli.options import complete_configurations
from rotcal_ros.foundation import plugins
from rotcal_ros.foundation.errors import DataError
from rotcal_ros.foundation.escapes import encodable
from rotcal_ros.report.terminal.console import progress, say

if TYPE_CHECKING:
    from rotcal_history.fleet.batch_solving import BagOutcome

HISTORY: Final = "history.db"
FOLDER: Final = "{folder}"
"""Stands in ``--serial`` for the name of the folder in which a bag lies."""


@click.command()
@click.argument("sources", nargs=-1, required=True, metavar="BAG|FOLDER|GLOB|LIST...")
@click.option(
    "--setup",
    type=path_type,
    required=True,
    shell_complete=complete_configurations,
    help="Configuration for all bags.",
)
@click.option(
    "-o",
    "--output",
    type=path_type,
    default=Path("out/reprocessed"),
    show_default=True,
    help="Folder for the history and cached results.",
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
    help="The history that gets the results; default: history.db in the folder of -o.",
)
@click.option(
    "--serial",
    default="",
    help="Serial number of bags that state none; {folder} is the name of the folder they lie in.",
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
    serial: str,
    verify_bytes: bool,
    as_json: bool,
) -> int:
    """Solve every bag that the arguments name, and add the results to a history of all tables.

    Bags may be local or remote (s3://..., through fsspec). A bag that was solved before with the
    same content and configuration is not solved again: an interruption costs only the bags being
    solved. In the history a result takes the place of an earlier one of the same measurement.
    One bad bag does not stop the rest; the exit code is then 1.
    """
    from rotcal_history.fleet.bag_search import find_bags
    from rotcal_history.fleet.batch_solving import BagJob
    from rotcal_history.fleet.workers import run_on_cluster, run_on_cores
    from rotcal_ros.foundation.machine_load import core_count
    from rotcal_ros.foundation.untrusted import require_no_secret
    from rotcal_ros.methods.configuration import read_configuration

    require_no_secret(scheduler or "", "--scheduler")
    keeper = plugins.extension(plugins.HISTORIES, "history", "a place for the results")
    configuration = read_configuration(setup)
    found = find_bags(sources)
    cache = (output / "cache").absolute()
    cache.mkdir(parents=True, exist_ok=True)
    jobs = (BagJob(bag, configuration, str(cache), verify_bytes) for bag in found)
    database = history or str(output.absolute() / HISTORY)
    with keeper.ParkHistory(database) as park:
        if scheduler:
            running = run_on_cluster(jobs, scheduler, time_limit_s)
        else:
            workers = min(workers or core_count(), len(found))
            running = run_on_cores(jobs, workers, time_limit_s)
        with closing(running):
            bags = _followed(running, len(found))
        _keep(bags, cache, serial, partial(keeper.keep_measurement, park))
    say(f"history: {park.place}")
    if as_json:
        bags.sort(key=lambda bag: (bag.start_ns is None, bag.start_ns or 0, bag.source))
        print_json({"bags": [bag.to_dict() for bag in bags], "history": park.place})
    return int(any(bag.error for bag in bags))


@dataclass
class _Bag:
    """What became of a bag; its result is in the cache under ``key``.

    ``error`` says why there is no result, or why it is not in the history. ``twin_of`` is the bag
    of the same session that counts for both. ``table`` and ``entry`` are those of the history.
    """

    source: str
    key: str
    session: str
    start_ns: int | None
    verdict: str = ""
    verdict_line: str = ""
    warnings: tuple[str, ...] = ()
    error: str = ""
    observations: int = 0
    table: str = ""
    entry: int | None = None
    twin_of: str = ""

    def to_dict(self) -> dict[str, Any]:
        """Return what is published of it."""
        own = ("key", "session", "start_ns", "observations")
        return {name: value for name, value in asdict(self).items() if name not in own}


def _followed(running: Iterable[BagOutcome], total: int) -> list[_Bag]:
    """Return the bags as they are done, under a progress bar; show bad ones at once."""
    bags, before, healed = list[_Bag](), 0, 0
    with progress("solving") as shown:
        for done in running:
            bag = _Bag(done.source, done.key, done.session, done.start_ns, error=done.error)
            if (result := done.deviations()) is not None:
                bag.verdict, bag.verdict_line = result.verdict, result.verdict_line.text
                bag.warnings = tuple(dict.fromkeys((*done.warnings, *result.warnings)))
                bag.observations = result.n_observations
            bags.append(bag)
            before, healed = before + done.cached, healed + done.healed
            shown(len(bags), total)
            if done.error:
                say(f"{done.source}: {done.error}")
            note_unread(f"{done.source}: {text}" for text in done.unread)
    bad = sum(bool(bag.error) for bag in bags)
    good = f"{len(bags) - bad} solved ({before} of them before)"
    say(f"{len(bags)} bags: {good}, {bad} without a result")
    if healed:
        say(f"{healed} kept results were damaged: computed again")
    return bags


def _keep(bags: Sequence[_Bag], cache: Path, serial: str, keep: Callable[..., Any]) -> None:
    """Add the results to the history; of the bags of one session that with most observations."""
    from rotcal_history.fleet.batch_solving import cached_result

    best: dict[str, _Bag] = {}
    good = [bag for bag in bags if not bag.error]
    for bag in sorted(good, key=lambda b: (-b.observations, len(b.warnings), b.source)):
        first = best.setdefault(bag.session or bag.source, bag)
        bag.twin_of = "" if first is bag else first.source
    with progress("adding to the history") as shown:
        for number, bag in enumerate(best.values(), 1):
            shown(number, len(best))
            folder = PurePosixPath(bag.source).parent.name
            try:
                result = cached_result(cache, bag.key)
                added = keep(result, serial.replace(FOLDER, folder), encodable(bag.source))
                bag.table, bag.entry = added.entry.title, added.entry.id
            except DataError as error:
                bag.error = f"not in the history: {error}"
                say(f"{bag.source}: {bag.error}")
