"""``rotcal plan tracer``: which lengths reach a wanted uncertainty, and what no plan can beat."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from rotcal_ros.cli.console import json_option, path_type, print_json
from rotcal_ros.cli.goal_settings import goal_settings
from rotcal_ros.errors import ConfigurationError, PlanError
from rotcal_ros.report.terminal.console import progress, say
from rotcal_ros.units import DEGREE, MICROMETRE

if TYPE_CHECKING:
    from rotcal_ros.catalogue.configuration import Configuration
    from rotcal_ros.planning.tracer_design.ordering import OrderedDesign
    from rotcal_ros.planning.tracer_design.settings import TracerDesignSettings

TARGETS_FILE = "targets.csv"
PAIRS_FILE = "pairs.csv"
PLAN_FILE = "plan.yaml"


@click.command()
@click.argument("goal", type=path_type, metavar="[GOAL.yaml]", required=False)
@click.option("--need", metavar="ECC=ARCSEC", help="Wanted U(ECC), k = 2, rms over the angles.")
@click.option(
    "--like",
    type=path_type,
    metavar="CONFIG",
    help="Take table angles, mount and noise from this configuration, and write one like it.",
)
@click.option(
    "--set", "changes", multiple=True, metavar="NAME=VALUE", help="Change a setting of the goal."
)
@click.option("--plain", is_flag=True, help="The plain minimum, whose lengths check nothing.")
@click.option(
    "-o", "--output", type=path_type, metavar="FOLDER", help="Write targets, pairs and plan here."
)
@json_option
def command(
    goal: Path | None,
    need: str | None,
    like: Path | None,
    changes: tuple[str, ...],
    plain: bool,
    output: Path | None,
    as_json: bool,
) -> int:
    """Find few lengths of a laser tracer that reach a wanted uncertainty of ECC.

    Prints the plan's uncertainty, the bound that no plan can beat, and how well its lengths check
    each other. GOAL.yaml has settings by name: docs/settings.md lists them.
    """
    from rotcal_ros.planning.tracer_design.ordering import ordered_design

    pattern = _pattern(like)
    settings = goal_settings(pattern, goal, [*_needed(need), *changes])
    if output is not None and len(set(settings.target_std_m)) > 1:
        raise ConfigurationError(
            f"target_std_m {list(settings.target_std_m)}: a configuration has one number for all "
            "axes, and what it solves would not be what is planned: give three equal ones, or "
            "leave out -o"
        )
    if plain:
        settings = replace(settings, checked=False)
    with progress("plans") as shown:
        found = ordered_design(settings, progress=shown)
    data = found.to_dict()
    if output is not None:
        _write(output, found, pattern)
    if as_json:
        print_json(data)
    else:
        _print(data, settings)
    return 0


def _pattern(like: Path | None) -> Configuration | None:
    from rotcal_ros.catalogue import read_configuration

    if like is None:
        return None
    configuration = read_configuration(like)
    if configuration.method.name != "tracer_multistation":
        raise ConfigurationError(f"{like}: method {configuration.method.name} has no tracer")
    return configuration


def _needed(need: str | None) -> list[str]:
    """Return the change of settings that the wanted uncertainty is."""
    if need is None:
        return []
    name, _, limit = need.partition("=")
    if name.strip().upper() != "ECC":
        raise PlanError(f"--need {need}: expected ECC=ARCSEC, e.g. ECC=1.2")
    return [f"need_arcsec={limit}"]


def _write(folder: Path, found: OrderedDesign, pattern: Configuration | None) -> None:
    """Write targets, pairs in their order, and a configuration that measures them."""
    import yaml

    from rotcal_ros.catalogue.configuration import dump_configuration
    from rotcal_ros.catalogue.tracer.plan_tables import write_pairs, write_targets
    from rotcal_ros.files import write_atomically

    settings, scene, lengths = found.design.settings, found.design.scene, found.lengths
    folder.mkdir(parents=True, exist_ok=True)
    write_targets(folder / TARGETS_FILE, [tuple(p) for p in scene.targets.tolist()])
    pairs = zip(lengths.position.tolist(), lengths.target.tolist(), strict=True)
    write_pairs(folder / PAIRS_FILE, [*pairs])
    groups: dict[str, Any] = {}
    if pattern is not None:
        groups = dict(yaml.safe_load(pattern.text)["/**"]["ros__parameters"])
        groups.pop("method")
    groups["solver"] = {**groups.get("solver", {}), **_counted_on(settings)}
    groups["plan"] = {
        "table_angles_deg": [round(a / DEGREE, 12) for a in scene.table_angles.tolist()],
        "targets_file": TARGETS_FILE,
        "pairs_file": PAIRS_FILE,
    }
    write_atomically(folder / PLAN_FILE, dump_configuration("tracer_multistation", groups))
    say(f"written: {(folder / PLAN_FILE).absolute()}, {TARGETS_FILE}, {PAIRS_FILE}")


def _counted_on(settings: TracerDesignSettings) -> dict[str, Any]:
    """Return the settings of a solver that knows what the plan has counted on."""
    from rotcal_ros.planning.tracer_design.settings import SHARED

    known: dict[str, Any] = {
        "length_std_m": settings.length_std_m,
        "length_std_relative": settings.length_std_relative,
        "target_std_m": settings.target_std_m[0],
    }
    if settings.zero == SHARED:
        known["zero"] = "per_segment"
        known["slip_m"] = settings.slip_m
        known["rejection_significance"] = settings.rejection_significance
    if settings.circle_std_m is not None:
        known["circle_std_m"] = settings.circle_std_m
    if settings.circle_std_m is not None or settings.error_motion_std_m:
        known["error_motion_std_m"] = settings.error_motion_std_m
    return known


def _print(data: dict[str, Any], settings: TracerDesignSettings) -> None:
    rms, largest = data["expanded_rms_arcsec"], data["expanded_largest_arcsec"]
    click.echo(
        f"{data['lengths']} lengths from {data['stations']} stations to {data['targets']} targets"
    )
    click.echo(
        f"U(ECC), k = 2: {rms:.3f} arcsec rms, {largest:.3f} at the worst angle (wanted "
        f"{settings.need_arcsec:g} and {settings.largest_arcsec:g})"
    )
    click.echo(
        f"ideal plan, with fractions of lengths: {data['ideal']:.1f}; bound: no plan in this "
        f"volume, checked or not, has fewer than {data['bound']} (gap {100.0 * data['gap']:.1f} %)"
    )
    if data["checked_bound"]:
        click.echo(f"the wanted redundancy alone asks for {data['checked_bound']}")
    _print_order(data, settings.max_unseen)
    detectable, share = data["largest_detectable_m"], data["largest_undetected_in_u"]
    click.echo(
        f"smallest redundancy {data['smallest_redundancy']:.2f}, largest minimal detectable error "
        f"{_number(detectable, MICROMETRE)} um, largest effect of an undetected error "
        f"{_number(data['largest_undetected_arcsec'], 1.0)} arcsec, {_number(share, 1.0)} U"
    )
    if not settings.checked:
        say(
            "warning: this is the plain minimum, its lengths do not check each other: one wrong "
            "length spoils the result unseen"
        )


def _print_order(data: dict[str, Any], limit: float) -> None:
    unseen = data["unseen_std"]
    drift, knock = (_number(unseen[name], 1.0) for name in ("drift", "knock"))
    click.echo(
        f"expected time {data['time_s']:.0f} s in the order {data['order']}; unseen drift at most "
        f"{drift}, unseen knock {knock} standard uncertainties"
    )
    if any(value is None or value > limit for value in unseen.values()):
        say(
            f"warning: no order of these lengths shows every drift and knock before it causes "
            f"{limit:g} standard uncertainties"
        )


def _number(value: float | None, unit: float) -> str:
    """Return a number; of a length that nothing checks there is none."""
    return "any" if value is None else format(value / unit, ".3g")
