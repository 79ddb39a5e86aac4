"""Plans of a laser tracer: ``rotcal plan tracer``, ``plan sequence`` and ``plan check``."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click
import numpy as np

from rotcal_ros.cli.console import NamedFile, json_option, path_type, print_json
from rotcal_ros.cli.options import configurations, rule_of, rule_options, set_option
from rotcal_ros.foundation.components import COVERAGE_FACTOR
from rotcal_ros.foundation.errors import ConfigurationError, PlanError
from rotcal_ros.foundation.protection import TOLERABLE
from rotcal_ros.foundation.units import ARCSEC, DEGREE, MICROMETRE
from rotcal_ros.foundation.untrusted import load_yaml, read_text, why
from rotcal_ros.report.terminal.columns import Column, print_table, print_words
from rotcal_ros.report.terminal.console import progress, say

if TYPE_CHECKING:
    from rotcal_ros.methods import Calibration
    from rotcal_ros.methods.configuration import Configuration
    from rotcal_ros.methods.tracer.check_plan import CheckPlan
    from rotcal_ros.methods.tracer.design.ordering import OrderedDesign
    from rotcal_ros.methods.tracer.design.sequence import MeasuringOrder
    from rotcal_ros.methods.tracer.design.settings import TracerDesignSettings
    from rotcal_ros.planning.sequence_time import TimeModel

TARGETS_FILE = "targets.csv"
PAIRS_FILE = "pairs.csv"
PLAN_FILE = "plan.yaml"
LEAST_REDUNDANCY: Final = 0.25
"""As in rotcal_ros.methods.tracer.design.check_lengths, which takes long to load."""
NOISE_SEED: Final = 1
"""Seed of the noise with which a plan is simulated; the plan does not depend on it."""


@click.command("tracer")
@click.argument("goal", type=path_type, metavar="[GOAL.yaml]", required=False)
@click.option("--need", metavar="ECC=ARCSEC", help="Wanted U(ECC), k = 2, rms over the angles.")
@click.option(
    "--like",
    type=path_type,
    metavar="CONFIG",
    help="Take table angles, mount and noise from this configuration, and write a similar one.",
)
@click.option(
    "--set", "changes", multiple=True, metavar="NAME=VALUE", help="Change a setting of the goal."
)
@click.option(
    "--confidence",
    type=click.FloatRange(0.5, 0.99),
    help="Probability with which the result's own U meets the goal.  [default: 0.95]",
)
@click.option(
    "--plain", is_flag=True, help="The plain minimum, whose lengths do not check each other."
)
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
    """Find few lengths of a laser tracer that reach a wanted uncertainty of ECC.

    Prints the uncertainty that results will state, by simulated measurements of the plan, what
    that assumes, the bound that no plan can beat, how well its lengths check each other, and what
    protection against drift costs.

    GOAL.yaml has settings by name: docs/settings.md lists them.
    """
    from rotcal_ros.methods.tracer.design.ordering import ordered_design

    pattern = _pattern(like)
    settings = goal_settings(pattern, goal, [*_needed(need), *changes])
    if output is not None and len(set(settings.target_std_m)) > 1:
        raise ConfigurationError(
            f"target_std_m {list(settings.target_std_m)}: a configuration has one number for all "
            "axes, so it would not solve what was planned: give three equal ones, or leave out -o"
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
    """Return the wanted uncertainty as a change of settings."""
    if need is None:
        return []
    name, _, limit = need.partition("=")
    if name.strip().upper() != "ECC":
        raise PlanError(f"--need {need}: expected ECC=ARCSEC, e.g. ECC=1.2")
    return [f"need_arcsec={limit}"]


def _write_plan(folder: Path, found: OrderedDesign, pattern: Configuration | None) -> None:
    """Write targets, pairs in their order, and a configuration that measures them."""
    from rotcal_ros.foundation.files import write_atomically
    from rotcal_ros.foundation.untrusted import load_yaml
    from rotcal_ros.methods.configuration import dump_configuration
    from rotcal_ros.methods.tracer.table import write_pairs, write_targets

    settings, scene, lengths = found.design.settings, found.design.scene, found.lengths
    folder.mkdir(parents=True, exist_ok=True)
    write_targets(folder / TARGETS_FILE, [tuple(p) for p in scene.targets.tolist()])
    pairs = zip(lengths.position.tolist(), lengths.target.tolist(), strict=True)
    write_pairs(folder / PAIRS_FILE, [*pairs])
    groups: dict[str, Any] = {}
    if pattern is not None:
        groups = dict(load_yaml(pattern.text, pattern.source)["/**"]["ros__parameters"])
        groups.pop("method")
    solver = dict(groups.get("solver", {}))
    for name in (
        "circle_std_m",
        "error_motion_std_m",
    ):  # of the plan alone
        solver.pop(name, None)
    groups["solver"] = {**solver, **_counted_on(settings, pattern)}
    groups["plan"] = {
        "table_angles_deg": [round(a / DEGREE, 12) for a in scene.table_angles.tolist()],
        "targets_file": TARGETS_FILE,
        "pairs_file": PAIRS_FILE,
    }
    write_atomically(folder / PLAN_FILE, dump_configuration("tracer_multistation", groups))
    say(f"written: {(folder / PLAN_FILE).absolute()}, {TARGETS_FILE}, {PAIRS_FILE}")


def _counted_on(settings: TracerDesignSettings, pattern: Configuration | None) -> dict[str, Any]:
    """Return the settings of a solver with the assumptions of the plan."""
    from rotcal_ros.methods.tracer.design.settings import SHARED

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
        known["length_std_m"] = (
            pattern.solver.length_std_m
        )  # the scatter of the readings adds to it
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
            "a table without error motion; as none is stated, the solver estimates it "
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
        f"{settings.need_arcsec:g} and {settings.largest_arcsec:g}); in the middle "
        f"{_number(data['expanded_rms_arcsec'], 1.0, '.3f')} and "
        f"{_number(data['expanded_largest_arcsec'], 1.0, '.3f')}"
    )
    click.echo(
        f"of {data['runs']} simulated runs {100 * data['met']:.1f} % end ok and meet the goal; "
        f"{100 * data['suspected']:.1f} % are sound but not called ok, which more lengths would "
        "not change: they count as missed, and have to be measured again"
    )
    click.echo(_assumed(settings))
    click.echo(
        f"ideal plan, with fractional lengths: {data['ideal']:.1f}; bound: no plan in this "
        f"volume, checked or not, has fewer than {data['bound']} (gap {100.0 * data['gap']:.1f} %)"
    )
    if data["checked_bound"]:
        click.echo(f"the wanted redundancy alone needs {data['checked_bound']}")
    _print_order_of_lengths(data, settings)
    detectable, share = data["largest_detectable_m"], data["largest_undetected_in_u"]
    click.echo(
        f"smallest redundancy {data['smallest_redundancy']:.2f}, largest minimal detectable error "
        f"{_number(detectable, MICROMETRE)} um, largest effect of an undetected error "
        f"{_number(data['largest_undetected_arcsec'], 1.0)} arcsec, {_number(share, 1.0)} U"
    )
    if not settings.checked:
        say(
            "warning: this is the plain minimum, its lengths do not check each other: "
            f"an error of any size stays unseen in {data['unchecked']} of {data['lengths']}, and "
            "one wrong length spoils the result; it does not try to keep the promise, and "
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
        f"that each has a redundancy of {settings.min_redundancy:g}, that an undetected error "
        f"does at most {settings.max_undetected:g} U, and the promise"
        if settings.checked
        else "whole lengths and the promise"
    )
    click.echo(
        f"what protection costs: {data['lengths'] - data['bound']} lengths more than the bound, "
        f"for {checks}; {data['time_s'] - data['quickest_s']:.0f} s more than the quickest order "
        f"({data['quickest_s']:.0f} s), in which a drift may do "
        f"{_number(hidden['drift'], 1.0)}, a knock {_number(hidden['knock'], 1.0)} standard "
        f"uncertainties unseen (max_unseen {limit:g})"
    )
    if any(value is None or value > limit for value in unseen.values()):
        say(
            f"warning: no order of these lengths shows every drift and knock before it causes "
            f"{limit:g} standard uncertainties"
        )


def _number(value: float | None, unit: float, digits: str = ".3g") -> str:
    """Return a number as text; what nothing checks has none."""
    return "any" if value is None else format(value / unit, digits)


@click.command("sequence")
@click.argument("configuration", type=path_type, metavar="CONFIG", shell_complete=configurations)
@click.option("--set", "changes", multiple=True, metavar="GROUP.NAME=VALUE", help="Change it.")
@click.option(
    "--cell",
    is_flag=True,
    help="Use the times of the simulated cell of CONFIG; otherwise the two below.",
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
@click.option("--clock", is_flag=True, help="Also time CONFIG, unchanged, in the simulated cell.")
@click.option("--seed", type=int, default=0, show_default=True, help="Of the search.")
@click.option(
    "-o",
    "--output",
    type=NamedFile(".csv"),
    help="Write the pairs in the best order into this file.",
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
    from rotcal_ros.methods.tracer.design.sequence import best_order
    from rotcal_ros.methods.tracer.table import write_pairs
    from rotcal_ros.methods.tracer.timing import cell_run, cell_time, plan_seconds
    from rotcal_ros.planning.sequence_time import stated_time

    calibration = prepare_whole(changed(read_configuration(configuration), changes))
    if calibration.method.name != "tracer_multistation":
        raise ConfigurationError(f"{configuration}: only plans of a laser tracer have such orders")
    model = stated_time(turn_s, length_s)
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
        "listed_s": plan_seconds(model, steps),
        "bound_s": best.bound,
        "best": best.name,
        "orders": [_order_to_dict(way) for way in ways],
    }
    if clock:
        data["clock_s"] = cell_run(calibration).seconds
    if as_json:
        print_json(data)
    else:
        _print_sequence(data)
    return 0


def _measuring_orders(
    calibration: Calibration, model: TimeModel, limit: float, seed: int
) -> tuple[MeasuringOrder, ...]:
    """Return the orders of the plan's lengths that compete."""
    from rotcal_ros.methods.tracer.calibration import problem
    from rotcal_ros.methods.tracer.design.sequence import SequenceForecast, measuring_orders

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


def _order_to_dict(way: MeasuringOrder) -> dict[str, Any]:
    unseen = {} if way.forecast is None else way.forecast.to_dict()
    return {"order": way.name, "seconds": way.seconds, "unseen_std": unseen}


def _print_sequence(data: dict[str, Any]) -> None:
    print_words(
        f"{data['lengths']} lengths: {data['listed_s']:.0f} s as listed, no order in less than "
        f"{data['bound_s']:.0f} s"
    )
    if "clock_s" in data:
        print_words(f"the simulated cell takes {data['clock_s']:.1f} s for it as listed")
    orders = data["orders"]
    unseen = {
        name: [_size_or_any(row["unseen_std"].get(name)) for row in orders]
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


def _size_or_any(value: float | None) -> float | str:
    return "any" if value is None or not isfinite(value) else value


@click.command("check")
@click.argument("earlier", type=path_type)
@click.option(
    "--setup", type=path_type, required=True, help="Configuration of the laser tracer (.yaml)."
)
@rule_options
@click.option(
    "--every",
    type=click.IntRange(min=1),
    metavar="N",
    default=1,
    show_default=True,
    help="Check only every N-th angle; nothing will be known of the others.",
)
@click.option(
    "--candidates",
    type=path_type,
    help="Places for the reflector: target,x_m,y_m,z_m. Else --volume, or the block.",
)
@click.option(
    "--volume",
    type=path_type,
    metavar="GOAL.yaml",
    help="Where the reflector may go and what is in the way, as for 'rotcal plan tracer'.",
)
@click.option(
    "--volume-set",
    "limits",
    multiple=True,
    metavar="NAME=VALUE",
    help="The same settings, by name.",
)
@click.option(
    "--least-redundancy",
    type=click.FloatRange(0.0, 0.9),
    default=LEAST_REDUNDANCY,
    show_default=True,
    help="Smallest redundancy of a length; 0 checks nothing.",
)
@set_option
@click.option("-o", "--output", type=path_type, help="Folder for configuration and its tables.")
@json_option
def check(earlier: Path, output: Path | None, as_json: bool, **asked: Any) -> int:
    """Plan the fewest lengths of a laser tracer that check the EARLIER result (ECC).

    A table that has only aged as stated will be found still valid with a probability of 1 less
    the risk of a false alarm. The folder of -o is ready for 'rotcal run FOLDER/check.yaml', and
    its result for 'rotcal check EARLIER NEW' with the same options.
    """
    plan = _check_plan(earlier, **asked)
    if as_json:
        print_json(plan.to_dict())
    else:
        _print_angles(plan)
        _print_checks(plan, asked["every"], asked["least_redundancy"])
    if output is not None:
        say(f"written: {plan.write(output).absolute()}")
    return 0


def _check_plan(
    earlier: Path,
    *,
    setup: Path,
    candidates: Path | None,
    volume: Path | None,
    limits: tuple[str, ...],
    changes: tuple[str, ...],
    every: int,
    least_redundancy: float,
    **rule: Any,
) -> CheckPlan:
    """Return the plan that the options ask for; ``rule`` are those of :func:`rule_options`."""
    from rotcal_ros.methods import changed, read_configuration
    from rotcal_ros.methods.tracer.check_plan import plan_check
    from rotcal_ros.methods.tracer.table import read_targets
    from rotcal_ros.recordings.result_sources import read_curve

    configuration = changed(read_configuration(setup), changes)
    room = goal_settings(configuration, volume, limits) if volume or limits else None
    with progress("targets") as shown:
        return plan_check(
            configuration,
            read_curve(earlier, "ECC", None),
            rule_of(ARCSEC, **rule),
            every=every,
            offered=() if candidates is None else read_targets(candidates),
            room=room,
            least_redundancy=least_redundancy,
            progress=shown,
        )


def _print_angles(plan: CheckPlan) -> None:
    lengths = np.bincount(plan.pairs[:, 0], minlength=len(plan.angles))
    print_table(
        [
            Column("angle/deg", plan.angles / DEGREE, ".4f"),
            Column("lengths", lengths),
            Column(
                f"U (k = {COVERAGE_FACTOR:g})/arcsec", COVERAGE_FACTOR * plan.std / ARCSEC, ".3f"
            ),
            Column("valid up to/arcsec", plan.acceptance / ARCSEC, ".3f"),
        ]
    )


def _print_checks(plan: CheckPlan, every: int, least_redundancy: float) -> None:
    print_words(
        f"{len(plan.pairs)} lengths to {len(plan.targets)} targets (offered: {plan.offered}), "
        f"smallest redundancy {plan.least_redundancy:.2f}"
    )
    print_words(
        f"{plan.seconds / 60.0:.1f} min by the simulated cell's clock; unseen drift at most "
        f"{plan.unseen.drift:.2g}, unseen knock {plan.unseen.knock:.2g} standard uncertainties"
    )
    if every > 1:
        unknown = f"{every - 1} of {every} angles"
        print_words(f"nothing will be known of {unknown} of the earlier result")
    if least_redundancy < LEAST_REDUNDANCY:
        print_words(
            "warning: some lengths are hardly checked: an error in one of them may change the "
            "verdict"
        )
    print_words(
        f"a table that has only aged as stated is found within {plan.rule.limit / ARCSEC:.4g} "
        f"arcsec with a probability of at least {100 * plan.assurance:.3g} %"
    )


def goal_settings(
    pattern: Configuration | None, goal: Path | None, changes: Iterable[str]
) -> TracerDesignSettings:
    """Return the settings from pattern, file and ``changes`` (NAME=VALUE); the last counts.

    Raises ConfigurationError, with the place, for unknown ones.
    """
    from rotcal_ros.foundation.settings import load
    from rotcal_ros.methods.tracer.design.settings import TracerDesignSettings

    values = {} if pattern is None else _of_pattern(pattern)
    if goal is not None:
        values.update(_of_file(goal))
    for change in changes:
        name, equals, value = change.partition("=")
        if not equals:
            raise ConfigurationError(f"{change}: expected NAME=VALUE")
        values[name.strip()] = load_yaml(value, change)
    return load(TracerDesignSettings, values, "goal" if goal is None else str(goal))


def _of_file(goal: Path) -> dict[str, Any]:
    """Return the settings by name that the file of a goal holds."""
    try:
        values = load_yaml(read_text(goal), str(goal))
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigurationError(f"cannot read the goal {goal}: {why(error)}") from error
    if not isinstance(values, dict | None):
        raise ConfigurationError(f"{goal}: expected lines NAME: VALUE, found {values!r:.60}")
    if values and "/**" in values:
        raise ConfigurationError(
            f"{goal} is the configuration of a calibration; expected the settings of a goal by "
            "name; 'rotcal plan tracer --like' plans a similar one"
        )
    return values or {}


def _of_pattern(pattern: Configuration) -> dict[str, Any]:
    """Return the settings of a goal that a configuration of the method states."""
    from rotcal_ros.methods.tracer.design.settings import PER_STATION, SHARED

    plan, solver, simulation = pattern.plan, pattern.solver, pattern.simulation
    angles = ("table_start_deg", "table_step_deg", "table_positions", "table_angles_deg")
    noise = ("length_std_relative", "rejection_significance", "slip_m")
    return {
        **{name: getattr(plan, name) for name in angles},
        **{name: getattr(solver, name) for name in noise},
        "length_std_m": pattern.planner.expected_std_m or solver.length_std_m,
        "target_std_m": (solver.target_std_m,) * 3,
        "error_motion_std_m": solver.error_motion_std_m,
        "circle_std_m": solver.circle_std_m,
        "zero": SHARED if solver.zero == "per_segment" else PER_STATION,
        "mount_m": simulation.tracer.mount_m,
        "axis_m": simulation.table.axis_offset_m[:2],
    }
