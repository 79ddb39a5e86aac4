"""``rotcal plan tracer``: few lengths of a laser tracer that reach a required uncertainty."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np

from rotcal_design.goal import goal_settings
from rotcal_design.settings import SHARED
from rotcal_ros.cli.console import json_option, path_type, print_json
from rotcal_ros.foundation.errors import ConfigurationError, PlanError
from rotcal_ros.foundation.units import MICROMETRE
from rotcal_ros.report.terminal.console import progress, say

if TYPE_CHECKING:
    from rotcal_design.settings import TracerDesignSettings
    from rotcal_design.tracer.ordering import OrderedDesign
    from rotcal_ros.methods.configuration import Configuration

PLAN_FILE = "plan.yaml"


@click.command("tracer")
@click.argument("goal", type=path_type, metavar="[GOAL.yaml]", required=False)
@click.option("--need", metavar="ECC=ARCSEC", help="Required U(ECC), k = 2, rms over the angles.")
@click.option(
    "--like",
    type=path_type,
    metavar="CONFIG",
    help="Take table angles, mount and noise from this configuration, and write one like it.",
)
@click.option(
    "--set", "changes", multiple=True, metavar="NAME=VALUE", help="Change a setting of the goal."
)
@click.option(
    "--confidence",
    type=click.FloatRange(0.5, 0.99),
    help="Probability with which the result's own U meets the goal.  [default: 0.9]",
)
@click.option("--plain", is_flag=True, help="The plain minimum, whose lengths check nothing.")
@click.option(
    "-o", "--output", type=path_type, metavar="FOLDER", help="Write targets, pairs and plan here."
)
@json_option
def tracer(
    goal: Path | None,
    need: str | None,
    like: Path | None,
    changes: tuple[str, ...],
    confidence: float | None,
    plain: bool,
    output: Path | None,
    as_json: bool,
) -> int:
    """Find few lengths of a laser tracer that reach a required uncertainty of ECC.

    Prints the uncertainty that results will state (taken from simulated measurements of the plan),
    what it assumes, the bound that no plan can beat, how well the lengths check each other, and
    what the protection against drift costs.

    GOAL.yaml has settings by name: docs/planning.md names them.
    """
    from rotcal_design.tracer.ordering import ordered_design

    pattern = _pattern(like)
    settings = goal_settings(pattern, goal, [*_needed(need), *changes])
    if output is not None and len(set(settings.target_std_m)) > 1:
        raise ConfigurationError(
            f"target_std_m {list(settings.target_std_m)}: a configuration has one number for all "
            "axes, so that it would solve something else than planned: give three equal ones, or "
            "leave out -o"
        )
    if plain:
        settings = replace(settings, checked=False)
    if confidence is not None:
        settings = replace(settings, confidence=confidence)
    with progress("plans") as shown:
        found = ordered_design(settings, progress=shown)
    data = found.to_dict()
    if output is not None:
        _write_plan(output, found, pattern)
    if as_json:
        print_json(data)
    else:
        _print_tracer(data, settings)
    return 0


def _pattern(like: Path | None) -> Configuration | None:
    from rotcal_ros.methods import read_configuration

    if like is None:
        return None
    configuration = read_configuration(like)
    if configuration.method.name != "tracer_multistation":
        raise ConfigurationError(f"{like}: method {configuration.method.name} has no tracer")
    return configuration


def _needed(need: str | None) -> list[str]:
    """Return the required uncertainty as a change of settings."""
    if need is None:
        return []
    name, _, limit = need.partition("=")
    if name.strip().upper() != "ECC" or not limit.strip():
        raise PlanError(f"--need {need}: expected ECC=ARCSEC, e.g. ECC=1.2")
    return [f"need_arcsec={limit}"]


def _write_plan(folder: Path, found: OrderedDesign, pattern: Configuration | None) -> None:
    """Write targets, pairs in their order, and a configuration that measures them."""
    from rotcal_ros.foundation.files import write_atomically
    from rotcal_ros.methods.configuration import dump_configuration, raw_groups
    from rotcal_ros.methods.tracer.table import write_plan_files

    settings, scene, lengths = found.design.settings, found.design.scene, found.lengths
    groups: dict[str, Any] = {}
    if pattern is not None:
        _, groups = raw_groups(pattern.text, pattern.source)
    solver = dict(groups.get("solver", {}))
    for name in ("circle_std_m", "error_motion_std_m"):  # of the plan alone
        solver.pop(name, None)
    groups["solver"] = {**solver, **_counted_on(settings, pattern)}
    pairs = np.column_stack([lengths.position, lengths.target])
    groups["plan"] = plan = write_plan_files(folder, scene.table_angles, scene.targets, pairs)
    write_atomically(folder / PLAN_FILE, dump_configuration("tracer_multistation", groups))
    say(
        f"written: {(folder / PLAN_FILE).absolute()}, {plan['targets_file']}, {plan['pairs_file']}"
    )


def _counted_on(settings: TracerDesignSettings, pattern: Configuration | None) -> dict[str, Any]:
    """Return the settings of a solver with the assumptions of the plan."""
    known: dict[str, Any] = {
        "variant": "joint",
        "datum": "prior",
        "zero": "per_station",
        "length_std_m": settings.length_std_m,
        "length_std_relative": settings.length_std_relative,
        "target_std_m": settings.target_std_m[0],
        "rejection_significance": settings.rejection_significance,
    }
    if pattern is not None and settings.length_std_m == pattern.planner.expected_std_m:
        known["length_std_m"] = pattern.solver.length_std_m  # the readings' scatter adds to it
    if settings.zero == SHARED:
        known["zero"] = "per_segment"
        known["slip_m"] = settings.slip_m
    if settings.circle_std_m is not None:
        known["circle_std_m"] = settings.circle_std_m
    if settings.error_motion is not None:
        known["error_motion_std_m"] = settings.error_motion
    return known


def _assumed(settings: TracerDesignSettings) -> str:
    """Return what the promise rests on, in words."""
    motion = settings.error_motion
    if motion is None:
        table = (
            "a table without error motion, which is not stated, so that the solver estimates it "
            "(error_motion_std_m states it, for fewer lengths)"
        )
    elif motion:
        table = f"error motion of the table {motion / MICROMETRE:.3g} um (k = 1)"
    else:
        table = "a table without error motion, stated as 0"
    if settings.circle_std_m is not None:
        table += f", stations on a circle to {settings.circle_std_m / MICROMETRE:.3g} um"
    relative = settings.length_std_relative
    growing = f" and {relative * 1e6:.3g} um/m" if relative else ""
    mount = ", ".join(f"{value:g}" for value in settings.mount_m)
    return (
        f"assumed: a length {settings.length_std_m / MICROMETRE:.3g} um{growing} (k = 1, readings "
        f"and all), a target {max(settings.target_std_m) / MICROMETRE:.3g} um, the tracer at "
        f"{mount} m; {table}"
    )


def _print_tracer(data: dict[str, Any], settings: TracerDesignSettings) -> None:
    click.echo(
        f"{data['lengths']} lengths from {data['stations']} stations to {data['targets']} targets"
    )
    click.echo(
        f"U(ECC), k = 2, that results state: with a probability of {100 * data['confidence']:g} % "
        f"at most {_number(data['promised_rms_arcsec'], 1.0, '.3f')} arcsec rms, "
        f"{_number(data['promised_largest_arcsec'], 1.0, '.3f')} at the worst angle (wanted "
        f"{settings.need_arcsec:g} and {settings.largest_arcsec:g}); median "
        f"{_number(data['expanded_rms_arcsec'], 1.0, '.3f')} and "
        f"{_number(data['expanded_largest_arcsec'], 1.0, '.3f')}"
    )
    click.echo(
        f"of {data['runs']} simulated runs {100 * data['met']:.1f} % end ok and meet the goal; "
        f"{100 * data['suspected']:.1f} % are sound but not called ok, which more lengths do not "
        "change: they count as missed, and are to be measured again"
    )
    click.echo(_assumed(settings))
    click.echo(
        f"ideal plan, with fractions of lengths: {data['ideal']:.1f}; bound: no plan in this "
        f"volume, checked or not, has fewer than {data['bound']} (gap {100.0 * data['gap']:.1f} %)"
    )
    if data["checked_bound"]:
        click.echo(f"the wanted redundancy alone takes {data['checked_bound']}")
    _print_order_of_lengths(data, settings)
    detectable, share = data["largest_detectable_m"], data["largest_undetected_in_u"]
    click.echo(
        f"smallest redundancy {data['smallest_redundancy']:.2f}, largest minimal detectable error "
        f"{_number(detectable, MICROMETRE)} um, largest effect of an undetected error "
        f"{_number(data['largest_undetected_arcsec'], 1.0)} arcsec, {_number(share, 1.0)} U"
    )
    if not settings.checked:
        say(
            "warning: this is the plain minimum, whose lengths do not check each other: "
            f"an error of any size stays unseen in {data['unchecked']} of {data['lengths']}, and "
            "one wrong length spoils the result; it is not planned to keep the promise, and "
            f"{100 * data['met']:.0f} % of simulated results have a verdict ok and meet the goal"
        )


def _print_order_of_lengths(data: dict[str, Any], settings: TracerDesignSettings) -> None:
    limit = settings.max_unseen
    unseen, hidden = data["unseen_std"], data["quickest_unseen_std"]
    drift, knock = (_number(unseen[name], 1.0) for name in ("drift", "knock"))
    click.echo(
        f"expected time {data['time_s']:.0f} s, {data['lengths_s']:.0f} s for the lengths and "
        f"{data['turns_s']:.0f} s for turns, in the order {data['order']}; unseen drift at most "
        f"{drift}, unseen knock {knock} standard uncertainties"
    )
    checks = (
        f"so that each has a redundancy of {settings.min_redundancy:g}, an undetected error does "
        f"at most {settings.max_undetected:g} U, and the promise is kept"
        if settings.checked
        else "for whole lengths and the promise"
    )
    click.echo(
        f"what protection costs: {data['lengths'] - data['bound']} lengths more than the bound, "
        f"{checks}; {data['time_s'] - data['quickest_s']:.0f} s more than the quickest order "
        f"({data['quickest_s']:.0f} s), in which a drift may do "
        f"{_number(hidden['drift'], 1.0)}, a knock {_number(hidden['knock'], 1.0)} standard "
        f"uncertainties unseen (allowed {limit:g})"
    )
    if any(value is None or value > limit for value in unseen.values()):
        say(
            f"warning: no order of these lengths shows every drift and knock before it causes "
            f"{limit:g} standard uncertainties"
        )


def _number(value: float | None, unit: float, digits: str = ".3g") -> str:
    """Return a number; what nothing checks has none."""
    return "any" if value is None else format(value / unit, digits)
