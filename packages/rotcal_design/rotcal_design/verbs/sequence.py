"""``rotcal plan sequence``: the order in which the lengths of a tracer plan are measured."""

from __future__ import annotations

from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click
import numpy as np

from rotcal_ros.cli.console import NamedFile, json_option, path_type, print_json
from rotcal_ros.cli.options import complete_configurations, set_option
from rotcal_ros.cli.plan import NOISE_SEED
from rotcal_ros.foundation.errors import ConfigurationError, PlanError
from rotcal_ros.foundation.protection import TOLERABLE
from rotcal_ros.foundation.units import NANOSECOND
from rotcal_ros.report.terminal.columns import Column, print_table, print_words
from rotcal_ros.report.terminal.console import progress

if TYPE_CHECKING:
    from rotcal_ros.methods import Calibration
    from rotcal_ros.methods.tracer.policy.sequence import MeasuringOrder
    from rotcal_ros.planning.sequence_time import TimeModel

ATTEMPTS: Final = 3
"""Attempts at each step, before it is left."""


@click.command("sequence")
@click.argument(
    "configuration", type=path_type, metavar="CONFIG", shell_complete=complete_configurations
)
@set_option
@click.option(
    "--cell",
    is_flag=True,
    help="Use the times of the simulated cell instead of --turn-s and --length-s.",
)
@click.option("--turn-s", type=float, default=10.0, show_default=True, help="s, one rotation.")
@click.option("--length-s", type=float, default=5.0, show_default=True, help="s, one length.")
@click.option(
    "--limit",
    type=click.FloatRange(min=0.0, min_open=True),
    default=TOLERABLE,
    show_default=True,
    help="Standard uncertainties that an unseen drift or knock may cause.",
)
@click.option("--clock", is_flag=True, help="Also time CONFIG as listed, in the simulated cell.")
@click.option("--seed", type=int, default=0, show_default=True, help="Of the search.")
@click.option(
    "-o", "--output", type=NamedFile(".csv"), help="Write the pairs in the best order to a file."
)
@json_option
def sequence(
    configuration: Path,
    changes: tuple[str, ...],
    cell: bool,
    turn_s: float,
    length_s: float,
    limit: float,
    clock: bool,
    seed: int,
    output: Path | None,
    as_json: bool,
) -> int:
    """Find the quickest order of a tracer plan in which drifts and knocks would be seen."""
    from rotcal_ros.methods import changed, prepare_whole, read_configuration
    from rotcal_ros.methods.tracer.simulation import cell_time
    from rotcal_ros.methods.tracer.table import write_pairs
    from rotcal_ros.planning.sequence_time import constant_time_model

    calibration = prepare_whole(changed(read_configuration(configuration), changes))
    if calibration.method.name != "tracer_multistation":
        raise ConfigurationError(
            f"{configuration}: only plans of a laser tracer have such orders; name one of these"
        )
    model = constant_time_model(turn_s, length_s)
    if cell:
        model = cell_time(calibration.configuration)
    ways = _measuring_orders(calibration, model, limit, seed)
    best = best_order(ways, limit)
    steps = calibration.plan.steps
    if output is not None:
        pairs = [(steps[row].table_position, steps[row].target) for row in best.order.tolist()]
        write_pairs(output, pairs)
    data: dict[str, Any] = {
        "lengths": len(steps),
        "listed_s": model.seconds(steps),
        "bound_s": best.bound,
        "best": best.name,
        "orders": [
            {
                "order": way.name,
                "seconds": way.seconds,
                "unseen_std": {} if way.forecast is None else way.forecast.to_dict(),
            }
            for way in ways
        ],
    }
    if clock:
        data["clock_s"] = cell_seconds(calibration)
    if as_json:
        print_json(data)
    else:
        _print_sequence(data)
    return 0


def _measuring_orders(
    calibration: Calibration, model: TimeModel, limit: float, seed: int
) -> tuple[MeasuringOrder, ...]:
    """Return the competing orders of the plan's lengths."""
    from rotcal_ros.methods.tracer.method import problem
    from rotcal_ros.methods.tracer.policy.sequence import SequenceForecast, measuring_orders

    plan = calibration.plan
    position, target = (
        np.array([getattr(step, name) for step in plan.steps], dtype=np.int64)
        for name in ("table_position", "target")
    )
    costs = model.costs(np.array(plan.table_angles), np.array(plan.targets), position, target)
    noisy = calibration.measured({}, NOISE_SEED).observations
    forecast = SequenceForecast(problem(calibration.configuration, plan, noisy))
    with progress("orders") as shown:
        return measuring_orders(
            position, target, costs, forecast, limit=limit, seed=seed, progress=shown
        )


def best_order(ways: tuple[MeasuringOrder, ...], limit: float = TOLERABLE) -> MeasuringOrder:
    """Return the quickest order whose unseen drift and knock stay within ``limit`` (std).

    Raises PlanError, with the best that there is, when none does.
    """
    from rotcal_ros.methods.tracer.policy.sequence import least_hidden

    best = least_hidden(ways, limit)
    if best.worst <= limit:
        return best
    raise PlanError(
        f"no order of these lengths shows every drift and knock before it causes {limit:g} "
        f"standard uncertainties; the best ({best.name}) leaves {best.worst:.2g}: measure more "
        "lengths, or allow it"
    )


def cell_seconds(calibration: Calibration, tick_s: float = 0.01) -> float:
    """Return the cell's time (s) from the end of the first step to that of the last.

    Every step is ordered as soon as the one before is decided, up to ATTEMPTS times; the cell's
    time is cut into ticks.
    """
    from rotcal_ros.methods.simulated_run import simulated_run

    run = simulated_run(calibration, attempts=ATTEMPTS, slice_s=tick_s)
    ends = {event.step: event.time_ns for event in run if event.observed}
    return (max(ends.values()) - min(ends.values())) * NANOSECOND


def _print_sequence(data: dict[str, Any]) -> None:
    print_words(
        f"{data['lengths']} lengths: {data['listed_s']:.0f} s as listed, no order takes less than "
        f"{data['bound_s']:.0f} s"
    )
    if "clock_s" in data:
        print_words(f"the simulated cell takes {data['clock_s']:.1f} s for it as listed")
    orders = data["orders"]
    unseen = {
        name: [
            "any" if (u := row["unseen_std"].get(name)) is None or not isfinite(u) else u
            for row in orders
        ]
        for name in ("drift", "knock")
    }
    print_table(
        [
            Column("order", [row["order"] for row in orders]),
            Column("time/s", [row["seconds"] for row in orders], ".1f"),
            *(Column(f"unseen {name} (std)", cells, ".2f") for name, cells in unseen.items()),
            Column("taken", ["yes" * (row["order"] == data["best"]) for row in orders]),
        ]
    )
