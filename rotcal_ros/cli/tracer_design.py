"""``rotcal plan tracer``: which lengths reach a wanted uncertainty, and what no plan can beat."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from rotcal_ros.cli.console import json_option, path_type, print_json
from rotcal_ros.errors import ConfigurationError, PlanError
from rotcal_ros.report.terminal.console import progress, say
from rotcal_ros.units import DEGREE, MICROMETRE

if TYPE_CHECKING:
    from rotcal_ros.catalogue.configuration import Configuration
    from rotcal_ros.planning.sequence_choice import MeasuringOrder
    from rotcal_ros.planning.tracer_design.design import TracerDesign
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
    each other. GOAL.yaml has settings by name: docs/planning.md lists them.
    """
    from rotcal_ros.planning.tracer_design.design import design
    from rotcal_ros.planning.tracer_design.ordering import quickest_order

    pattern = _pattern(like)
    settings = _settings(goal, pattern, need, changes)
    if plain:
        settings = replace(settings, checked=False)
    with progress("plans") as shown:
        found = design(settings, progress=shown)
    if output is not None and settings.repeats > 1:
        raise PlanError("a plan measures each pair once: set repeats to 1 to write it")
    order = quickest_order(found) if settings.repeats == 1 else None
    data = found.to_dict()
    if order is not None:
        data["time_s"] = order.seconds
    if output is not None and order is not None:
        _write(output, found, order, pattern)
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


def _settings(
    goal: Path | None, pattern: Configuration | None, need: str | None, changes: tuple[str, ...]
) -> TracerDesignSettings:
    """Return the settings: of the pattern, then of the file, then of the command line."""
    import yaml

    from rotcal_ros.planning.tracer_design.settings import TracerDesignSettings
    from rotcal_ros.settings import load

    values = {} if pattern is None else _of_pattern(pattern)
    if goal is not None:
        try:
            values.update(yaml.safe_load(goal.read_text()) or {})
        except (OSError, ValueError, yaml.YAMLError) as error:
            raise ConfigurationError(f"{goal}: no settings by name: {error}") from error
    if need is not None:
        name, _, limit = need.partition("=")
        if name.strip().upper() != "ECC":
            raise PlanError(f"--need {need}: expected ECC=ARCSEC, e.g. ECC=1.2")
        values["need_arcsec"] = yaml.safe_load(limit)
    for change in changes:
        name, equals, value = change.partition("=")
        if not equals:
            raise ConfigurationError(f"--set {change}: expected NAME=VALUE")
        values[name.strip()] = yaml.safe_load(value)
    return load(TracerDesignSettings, values, "goal" if goal is None else str(goal))


def _of_pattern(pattern: Configuration) -> dict[str, Any]:
    """Return what a configuration of the method tells of a goal's settings."""
    plan, solver, simulation = pattern.plan, pattern.solver, pattern.simulation
    angles = ("table_start_deg", "table_step_deg", "table_positions", "table_angles_deg")
    noise = ("length_std_m", "length_std_relative", "rejection_significance")
    return {
        **{name: getattr(plan, name) for name in angles},
        **{name: getattr(solver, name) for name in noise},
        "target_std_m": (solver.target_std_m,) * 3,
        "error_motion_std_m": solver.error_motion_std_m or 0.0,
        "mount_m": simulation.tracer.mount_m,
        "axis_m": simulation.table.axis_offset_m[:2],
    }


def _write(
    folder: Path, found: TracerDesign, order: MeasuringOrder, pattern: Configuration | None
) -> None:
    """Write targets, pairs in their order, and a configuration that measures them."""
    import yaml

    from rotcal_ros.catalogue.configuration import dump_configuration
    from rotcal_ros.catalogue.tracer.plan_tables import write_pairs, write_targets
    from rotcal_ros.files import write_atomically

    settings = found.settings
    folder.mkdir(parents=True, exist_ok=True)
    lengths = found.lengths[order.order]
    write_targets(folder / TARGETS_FILE, [tuple(p) for p in found.scene.targets.tolist()])
    pairs = zip(lengths.position.tolist(), lengths.target.tolist(), strict=True)
    write_pairs(folder / PAIRS_FILE, [*pairs])
    groups: dict[str, Any] = {}
    if pattern is None:
        groups["solver"] = {
            "length_std_m": settings.length_std_m,
            "length_std_relative": settings.length_std_relative,
            "target_std_m": max(settings.target_std_m),
        }
    else:
        groups = dict(yaml.safe_load(pattern.text)["/**"]["ros__parameters"])
        groups.pop("method")
    groups["plan"] = {
        "table_angles_deg": [round(a / DEGREE, 12) for a in found.scene.table_angles.tolist()],
        "targets_file": TARGETS_FILE,
        "pairs_file": PAIRS_FILE,
    }
    write_atomically(folder / PLAN_FILE, dump_configuration("tracer_multistation", groups))
    say(f"written: {(folder / PLAN_FILE).absolute()}, {TARGETS_FILE}, {PAIRS_FILE}")


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
    if "time_s" in data:
        click.echo(f"expected time {data['time_s']:.0f} s")
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


def _number(value: float | None, unit: float) -> str:
    """Return a number; of a length that nothing checks there is none."""
    return "any" if value is None else format(value / unit, ".3g")
