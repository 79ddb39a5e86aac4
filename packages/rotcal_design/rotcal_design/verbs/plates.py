"""``rotcal plan plate`` and ``plan effort``: where balls stand, and how many it takes."""

from __future__ import annotations

from math import isfinite
from typing import TYPE_CHECKING, Any, get_args

import click

from rotcal_design.verbs.options import numbers, positive, whole_numbers
from rotcal_ros.cli.console import json_option, print_json
from rotcal_ros.cli.options import shown_option
from rotcal_ros.cli.plan import describe_order, order_dict, touch_option
from rotcal_ros.foundation.components import COMPONENTS, COVERAGE_FACTOR, unit_of
from rotcal_ros.foundation.errors import PlanError
from rotcal_ros.foundation.protection import TOLERABLE
from rotcal_ros.foundation.results import json_value
from rotcal_ros.foundation.units import ARCSEC, HOUR, MICROMETRE
from rotcal_ros.methods.ball_plate.settings import EXPANSION
from rotcal_ros.report.terminal.columns import Column, column_of, print_table, print_words
from rotcal_ros.report.terminal.console import progress

if TYPE_CHECKING:
    from rotcal_design.ball_plate.ball_layout import BallLayout
    from rotcal_design.ball_plate.order_forecast import OrderForecast, UnitEffect
    from rotcal_ros.methods.ball_plate.measuring_order import BallPlan, Kinematics

grid_option = click.option(
    "--grid", type=click.IntRange(min=3), required=True, help="Table positions in a turn."
)
sigma_option = shown_option(
    "--sigma-um",
    type=positive,
    default=0.05,
    help="um, standard deviation (k = 1) of a ball centre along each axis.",
)
radius_option = shown_option(
    "--radius-m", type=positive, default=0.185, help="m, radius of the ball circle."
)
gap_option = click.option(
    "--min-gap", type=click.IntRange(min=1), default=1, help="Grid steps between neighbours."
)
seed_option = click.option("--seed", type=int, default=0, help="Seed of the exchange search.")


@click.command()
@grid_option
@click.option("--balls", type=click.IntRange(min=4), required=True, help="Number of balls.")
@gap_option
@click.option("--subset-of", metavar="STEPS", help="Choose among these grid steps, e.g. 0,8,12.")
@shown_option(
    "--weights",
    metavar="ECC,XY,TILT,Z",
    default="1,1,1,1",
    help="Weights of the mean variances of ECC, EXC and EYC, EAC and EBC, EZC.",
)
@seed_option
@click.option("--starts", type=click.IntRange(min=1), default=40, help="Exchange searches.")
@sigma_option
@radius_option
@shown_option(
    "--material", type=click.Choice(list(EXPANSION)), default="steel", help="Of the plate."
)
@shown_option(
    "--warming-k", type=positive, default=0.5, help="K, by which the plate warms over the run."
)
@touch_option
@json_option
def plate(
    grid: int,
    balls: int,
    min_gap: int,
    subset_of: str | None,
    weights: str,
    seed: int,
    starts: int,
    sigma_um: float,
    radius_m: float,
    material: str,
    warming_k: float,
    touches: int,
    as_json: bool,
) -> int:
    """Find the ball steps with the smallest predicted uncertainty.

    Tries all layouts where they can be enumerated (up to rotation and reflection), otherwise
    exchanges one ball at a time from many starts. The gap is the distance to a bound that no
    layout can beat. For every measuring order it predicts what a drift of the CMM, a knock of the
    plate and its growth with the temperature would do, and from which size they are found.
    """
    from rotcal_design.ball_plate.ball_layout import plan_plate
    from rotcal_design.ball_plate.order_forecast import forecast_order
    from rotcal_ros.methods.ball_plate.measuring_order import Kinematics

    with progress("layouts") as shown:
        layout = plan_plate(
            grid,
            balls,
            min_gap=min_gap,
            subset_of=None if subset_of is None else whole_numbers(subset_of, "--subset-of"),
            weights=numbers(weights, "--weights"),
            seed=seed,
            starts=starts,
            progress=shown,
        )
    sigma = sigma_um * MICROMETRE
    std = layout.predicted_std(sigma, radius_m)
    orders = _orders(layout, radius_m, Kinematics(touches_per_ball=touches))
    forecasts = {name: forecast_order(rows, sigma, radius_m) for name, rows in orders.items()}
    if as_json:
        by_name = {
            n: order_dict(o) | forecast_dict(forecasts[n], material, warming_k)
            for n, o in orders.items()
        }
        facts = ("score", "bound", "gap", "optimal", "evaluated")
        named = {name: getattr(layout, name) for name in facts}
        print_json({
            "grid": grid, "ball_steps": list(layout.steps), **named, "predicted_std": std,
            "orders": by_name,
        })  # fmt: skip
        return 0
    _print_layout(layout, std)
    for name, rows in orders.items():
        click.echo(f"\n{describe_order(name, rows)}")
        click.echo("\n".join(forecast_lines(forecasts[name], material, warming_k)))
    return 0


@click.command()
@grid_option
@click.option(
    "--need",
    metavar="COMPONENT=LIMIT",
    required=True,
    help="Required expanded uncertainty (k = 2), um or arcsec, e.g. ECC=0.05.",
)
@gap_option
@click.option("--most-balls", type=click.IntRange(min=5), help="Largest number of balls.")
@seed_option
@sigma_option
@radius_option
@touch_option
@json_option
def effort(
    grid: int,
    need: str,
    min_gap: int,
    most_balls: int | None,
    seed: int,
    sigma_um: float,
    radius_m: float,
    touches: int,
    as_json: bool,
) -> int:
    """Print how many balls and CMM positions an uncertainty needs, the least work first."""
    from rotcal_design.ball_plate.ball_layout import required_effort
    from rotcal_ros.methods.ball_plate.measuring_order import Kinematics, plan_measurement

    component, limit = _need(need)
    ways = required_effort(
        grid,
        component,
        limit * unit_of(component)[0],
        sigma=sigma_um * MICROMETRE,
        radius=radius_m,
        min_gap=min_gap,
        most_balls=most_balls,
        seed=seed,
    )
    rows = []
    for way in ways:
        steps = list(way.layout.steps)
        order = plan_measurement(
            grid, steps, positions=list(way.positions), radius=radius_m,
            kinematics=Kinematics(touches_per_ball=touches),
        )  # fmt: skip
        rows.append(
            {
                "balls": len(steps),
                "cmm_positions": len(way.positions),
                "centres": way.centres,
                "duration_s": order.duration,
                "expanded": way.expanded,
                "ball_steps": steps,
                "positions": list(way.positions),
            }
        )
    if as_json:
        print_json({"component": component, "coverage": COVERAGE_FACTOR, "ways": rows})
    else:
        _print_effort(component, limit, rows)
    return 0


def _orders(layout: BallLayout, radius: float, kinematics: Kinematics) -> dict[str, BallPlan]:
    """Return the measurement of a layout in every known order."""
    from rotcal_ros.methods.ball_plate.measuring_order import Order, plan_measurement

    steps = list(layout.steps)
    return {
        name: plan_measurement(
            layout.grid, steps, order=name, radius=radius, kinematics=kinematics
        )
        for name in get_args(Order)
    }


def _print_layout(layout: BallLayout, std: dict[str, float]) -> None:
    click.echo(f"ball_steps: [{', '.join(map(str, layout.steps))}]   # of {layout.grid}")
    how = "proven optimal" if layout.optimal else "best found"
    click.echo(
        f"{how} of {layout.evaluated} layouts, {100.0 * layout.gap:.1f} % above the proven bound"
    )
    click.echo("predicted standard deviation (k = 1, rms over the table positions):")
    for name, value in std.items():
        unit, label = unit_of(name)
        click.echo(f"  {name}  {value / unit:.4f} {label}")


def _print_effort(component: str, limit: float, rows: list[dict[str, Any]]) -> None:
    unit, label = unit_of(component)
    print_words(f"for U({component}) <= {limit:g} {label} (k = 2), the least work first:")
    print_table(
        [
            Column("balls", [row["balls"] for row in rows]),
            Column("CMM positions", [row["cmm_positions"] for row in rows]),
            Column("centres", [row["centres"] for row in rows]),
            column_of("hours", [row["duration_s"] for row in rows], HOUR, ".1f"),
            column_of(f"U/{label}", [row["expanded"] for row in rows], unit, ".4f"),
            Column("ball steps", [" ".join(map(str, row["ball_steps"])) for row in rows]),
        ]
    )


def _need(text: str) -> tuple[str, float]:
    """Return component and limit of 'ECC=0.05'."""
    component, _, value = text.partition("=")
    limit = numbers(value, "--need")
    if len(limit) != 1:
        raise PlanError(f"--need {text}: expected COMPONENT=LIMIT, e.g. ECC=0.05")
    return component.strip().upper(), limit[0]


_WORDS = {"drift": "CMM drifts in", "shift": "plate shifted along", "turn": "plate turned about"}


def forecast_lines(forecast: OrderForecast, material: str, warming_k: float) -> list[str]:
    """Return the table of an order: errors by one unit, and the size from which it is found.

    And those of a plate of ``material`` that warms by ``warming_k``.
    """
    names = "".join(f"{name:>9s}" for name in COMPONENTS)
    labels = "".join(f"{unit_of(name)[1]:>9s}" for name in COMPONENTS)
    lines = [
        f"  {'largest error by':29s}{names}   found from     error then",
        f"  {'':29s}{labels}   (95 %)         (std)",
    ]
    for effect in forecast.effects:
        unit, label = (ARCSEC, "arcsec") if effect.kind == "turn" else (MICROMETRE, "um")
        lines.append(_line(effect, f"{_WORDS[effect.kind]} {effect.axis}, 1 {label}", unit, label))
    warmed = f"{material} plate warms by {warming_k:g} K"
    lines.append(_line(forecast.growth, warmed, EXPANSION[material], "K", warming_k))
    lines.append(
        f"  unseen at worst: drift {_std(forecast.drift_unseen)}, knock "
        f"{_std(forecast.knock_unseen)}"
    )
    return lines


def _line(effect: UnitEffect, name: str, unit: float, label: str, size: float = 1.0) -> str:
    """Return the line of an effect of ``size`` in its ``unit``."""
    errors = "".join(f"{size * unit * effect.error[n] / unit_of(n)[0]:9.3f}" for n in COMPONENTS)
    found = f"{effect.found_from / unit:.3f} {label}" if isfinite(effect.found_from) else "never"
    unseen = f"{effect.unseen:.2f}" if isfinite(effect.unseen) else "unbounded"
    return f"  {name:29s}{errors}   {found:13s}  {unseen}"


def _std(error: float) -> str:
    if not isfinite(error):
        return "without bound (not protected)"
    return f"{error:.2f} standard deviations" + (" (not protected)" if error > TOLERABLE else "")


def forecast_dict(forecast: OrderForecast, material: str, warming_k: float) -> dict[str, Any]:
    """Return the forecast in SI; None where nothing is found, or nothing bounds an error."""
    growth, grown = forecast.growth, EXPANSION[material] * warming_k
    found: dict[str, Any] = json_value({
        "growth": {
            "material": material,
            "warming_k": warming_k,
            "error": {name: grown * error for name, error in growth.error.items()},
            "found_from_k": growth.found_from / EXPANSION[material],
            "unseen_std": growth.unseen,
        },
        "unseen_std": {"drift": forecast.drift_unseen, "knock": forecast.knock_unseen},
        "effects": [
            {
                "kind": effect.kind,
                "axis": effect.axis,
                "error_per_unit": effect.error,
                "found_from": effect.found_from,
                "unseen_std": effect.unseen,
            }
            for effect in forecast.effects
        ],
    })  # fmt: skip
    return found
