"""``rotcal uncertainty``: propagates noise by Monte Carlo, to check the solver's covariance."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from rotcal_ros.cli.console import json_option, path_type, print_json
from rotcal_ros.cli.options import set_option, setup_options
from rotcal_ros.foundation.circumstances import NOTHING_MEASURED
from rotcal_ros.report.terminal.console import print_reading, progress, say

if TYPE_CHECKING:
    from rotcal_ros.methods.method import Measurements
    from rotcal_ros.recordings.inputs import MeasurementInput


@click.command()
@click.argument("source", type=path_type, metavar="BAG|TABLE|CONFIG")
@setup_options
@set_option
@click.option(
    "--trials",
    type=click.IntRange(min=2),
    default=100_000,
    show_default=True,
    help="Largest number of trials; they end sooner when all figures are stable.",
)
@click.option(
    "--digits",
    type=click.IntRange(1, 4),
    default=2,
    show_default=True,
    help="Digits of the standard uncertainty that have to be stable.",
)
@click.option("--seed", type=click.IntRange(min=0), default=1, show_default=True)
@click.option("--workers", type=click.IntRange(min=1), help="Processes; default: one per core.")
@json_option
def command(
    source: Path,
    setup: Path | None,
    targets: Path | None,
    changes: tuple[str, ...],
    trials: int,
    digits: int,
    seed: int,
    workers: int | None,
    as_json: bool,
) -> int:
    """Propagate the stated noise through the solver by Monte Carlo, after JCGM 101.

    With a BAG, or a TABLE and --setup, the trials scatter about what was measured; with a CONFIG
    (.yaml) about the plan's nominal geometry, before anything is measured. The figures depend only
    on the seed and the number of trials, not on the workers. The exit code is 1 if the trials
    contradict the solver's uncertainty.
    """
    from rotcal_ros.evaluation.monte_carlo import propagate_measurement
    from rotcal_ros.foundation.machine_load import core_count
    from rotcal_ros.recordings.inputs import MeasurementInput

    measured = _read(MeasurementInput(source, setup, targets, changes, announce=print_reading))
    with progress("trials") as shown:
        both = propagate_measurement(
            measured,
            trials=trials,
            digits=digits,
            seed=seed,
            workers=workers or core_count(),
            progress=shown,
        )
    if as_json:
        print_json(both.to_dict())
    else:
        from rotcal_ros.report.terminal.tables import print_uncertainty

        print_uncertainty(both)
    return int(bool(both.warnings))


def _read(given: MeasurementInput) -> Measurements:
    """Return what was measured, or for a configuration the nominal observations of its plan."""
    if given.path.suffix not in (".yaml", ".yml"):
        measured = given.read()
        if measured.configuration.simulated:
            say(NOTHING_MEASURED)
        return measured
    from rotcal_ros.methods import changed, prepare_whole, read_configuration
    from rotcal_ros.methods.measurements import PlannedMeasurements

    if given.setup is not None or given.targets is not None:
        raise click.UsageError("--setup and --targets belong to a table or a bag")
    configuration = changed(read_configuration(given.path), given.changes)
    calibration = prepare_whole(configuration).of_distances
    return PlannedMeasurements(calibration, calibration.nominal_observations())
