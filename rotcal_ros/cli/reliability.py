"""``rotcal plan reliability``: what error in one observation a plan could hide, and its effect."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from rotcal_ros.cli.completion import configurations
from rotcal_ros.cli.console import json_option, path_type, print_json
from rotcal_ros.foundation.errors import DataError
from rotcal_ros.foundation.units import MICROMETRE
from rotcal_ros.report.terminal.columns import Column, print_table, print_words

if TYPE_CHECKING:
    from rotcal_ros.foundation.observations import Observation
    from rotcal_ros.methods import Calibration

SEED = 1
"""Of the noise with which the plan is measured; redundancies do not depend on it."""


@click.command()
@click.argument("configuration", type=path_type, metavar="CONFIG", shell_complete=configurations)
@click.option(
    "--set", "changes", multiple=True, metavar="GROUP.NAME=VALUE", help="Change a setting."
)
@click.option(
    "--alpha",
    type=click.FloatRange(1e-9, 0.5),
    default=0.001,
    show_default=True,
    help="Significance of the test of one observation.",
)
@click.option(
    "--power",
    type=click.FloatRange(0.5, 0.999999),
    default=0.8,
    show_default=True,
    help="Probability that an error of the size shown is found.",
)
@click.option(
    "--worst",
    type=click.IntRange(min=1),
    default=8,
    show_default=True,
    help="How many observations to list; each is solved again.",
)
@json_option
def command(
    configuration: Path,
    changes: tuple[str, ...],
    alpha: float,
    power: float,
    worst: int,
    as_json: bool,
) -> int:
    """Print the smallest error in one observation of a plan that would be found (Baarda).

    The observations are listed by what a slightly smaller error, which may stay unseen, would do
    to the deviations, in their standard uncertainties.
    """
    from rotcal_ros.evaluation.reliability import effects_on_deviations, reliability
    from rotcal_ros.methods import changed, prepare_whole, read_configuration

    calibration = prepare_whole(changed(read_configuration(configuration), changes)).of_distances
    observations = _predicted(calibration)
    result = calibration.solve(observations)
    if result.residuals is None:
        raise DataError(f"the method {result.method} gives no residuals, and so no reliability")
    found = reliability(result.residuals, alpha, power)
    which = found.worst(worst)
    effects = effects_on_deviations(calibration, observations, result, found, which)
    data = found.to_dict(worst, effects)
    if as_json:
        print_json(data)
    else:
        _print(data)
    return 0


def _predicted(calibration: Calibration) -> tuple[Observation, ...]:
    """Return observations of the plan with their stated noise, exact ones where none is known."""
    if calibration.method.disturbances is None:
        return calibration.nominal_observations()
    return calibration.measured({}, SEED).observations


def _print(data: dict[str, Any]) -> None:
    print_words(
        f"{data['n_observations']} observations, mean redundancy {data['mean_redundancy']:.2f}, "
        f"{data['n_unchecked']} checked by no other",
        f"smallest error found with {100.0 * data['power']:g} % (alpha {data['alpha']:g}), and "
        "what it does to the deviations:",
    )
    worst = data["worst"]
    print_table(
        [
            Column("position", [row["table_index"] for row in worst]),
            Column("target", [row["target"] for row in worst]),
            Column("redundancy", [row["redundancy"] for row in worst], ".3f"),
            _size("error/um", [row.get("detectable_m") for row in worst], MICROMETRE),
            _size("error/std", [row["detectable_std"] for row in worst]),
            _size("effect/std", [row["effect_std"] for row in worst]),
        ]
    )


def _size(heading: str, values: list[float | None], unit: float = 1.0) -> Column:
    """Return a column of sizes; an observation that nothing checks has none."""
    return Column(heading, ["any" if v is None else v / unit for v in values], ".3f")
