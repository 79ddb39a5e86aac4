"""``rotcal uncertainty``: the noise propagated by Monte Carlo, beside the solver's covariance."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from rotcal_ros.cli.completion import configurations
from rotcal_ros.cli.console import json_option, path_type, print_json
from rotcal_ros.report.terminal.console import progress

if TYPE_CHECKING:
    from rotcal_ros.catalogue.method import Measurements


@click.command()
@click.argument("source", type=path_type, metavar="BAG|TABLE|CONFIG")
@click.option(
    "--setup",
    type=path_type,
    shell_complete=configurations,
    help="Configuration of a table; default: the one in the bag.",
)
@click.option("--targets", type=path_type, help="Target positions of a tracer table.")
@click.option(
    "--trials",
    type=click.IntRange(min=2),
    default=100_000,
    show_default=True,
    help="Most trials; they end sooner when all figures are stable.",
)
@click.option(
    "--digits",
    type=click.IntRange(1, 4),
    default=2,
    show_default=True,
    help="Significant digits of the standard uncertainty that shall be stable.",
)
@click.option("--seed", type=click.IntRange(min=0), default=1, show_default=True)
@click.option("--workers", type=click.IntRange(min=1), help="Processes; default: one per core.")
@json_option
def command(
    source: Path,
    setup: Path | None,
    targets: Path | None,
    trials: int,
    digits: int,
    seed: int,
    workers: int | None,
    as_json: bool,
) -> int:
    """Propagate the stated noise through the solver by Monte Carlo, after JCGM 101.

    BAG, TABLE (.csv, with --setup): about what was measured. CONFIG (.yaml): about the plan's
    nominal geometry, before anything is measured. Seed and number of trials alone decide the
    figures, not the workers. The exit code is 1 when the trials contradict the solver's
    uncertainty.
    """
    from rotcal_ros.evaluation.propagated import propagated
    from rotcal_ros.recordings.workers import usable_cores

    measured = _read(source, setup, targets)
    with progress("trials") as shown:
        both = propagated(
            measured,
            trials=trials,
            digits=digits,
            seed=seed,
            workers=workers or usable_cores(),
            progress=shown,
        )
    if as_json:
        print_json(both.to_dict())
    else:
        from rotcal_ros.report.terminal.tables import print_uncertainty

        print_uncertainty(both)
    return int(bool(both.warnings))


def _read(source: Path, setup: Path | None, targets: Path | None) -> Measurements:
    """Return what was measured, or for a configuration the nominal observations of its plan."""
    from rotcal_ros.catalogue.measurements import PlannedMeasurements, read_measurements
    from rotcal_ros.catalogue.setup_file import read_setup

    if source.suffix.lower() == ".csv":
        if setup is None:
            raise click.UsageError("a table needs its set-up: --setup SETUP.yaml")
        return read_measurements(source, read_setup(setup), targets)
    if source.suffix in (".yaml", ".yml"):
        from rotcal_ros.catalogue import prepare
        from rotcal_ros.catalogue.configuration import read_configuration

        if setup is not None:
            raise click.UsageError("--setup belongs to a table or a bag, not to a configuration")
        calibration = prepare(read_configuration(source))
        return PlannedMeasurements(calibration, calibration.nominal_observations())
    from rotcal_ros.recordings.replay import read_recording

    configuration = None if setup is None else read_setup(setup)
    recording = read_recording(source, configuration=configuration)
    return PlannedMeasurements(recording.calibration, recording.observations, recording.sha256)
