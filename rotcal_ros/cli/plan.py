"""``rotcal plan``: the order of a ball plate's plan, what any could hide, and what it adds."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click

from rotcal_ros.cli.console import json_option, path_type, print_json
from rotcal_ros.cli.options import complete_configurations, set_option, shown_option
from rotcal_ros.foundation import plugins
from rotcal_ros.foundation.components import COMPONENTS, COVERAGE_FACTOR, SHOWN_IN, unit_of
from rotcal_ros.foundation.errors import ConfigurationError, DataError
from rotcal_ros.foundation.units import DEGREE
from rotcal_ros.report.terminal.columns import Column, print_table, print_words

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rotcal_ros.evaluation.joint import JointInput, JointPlan
    from rotcal_ros.foundation.observations import Observation
    from rotcal_ros.methods import Calibration
    from rotcal_ros.methods.ball_plate.measuring_order import BallPlan

NOISE_SEED: Final = 1
"""Seed of the noise with which a plan is measured; what is found does not depend on it."""
touch_option = shown_option(
    "--touches", type=click.IntRange(min=1), default=15, help="Touch points per ball."
)


class PlanGroup(click.Group):
    """What the core plans, and what extensions do: theirs is loaded when it is asked for."""

    def list_commands(self, context: click.Context) -> list[str]:
        """Return all names in alphabetical order."""
        return sorted({*super().list_commands(context), *plugins.names(plugins.PLANS)})

    def get_command(self, context: click.Context, name: str) -> click.Command | None:
        """Return ours, else that of an extension; one that cannot be loaded says so."""
        found = super().get_command(context, name)
        if found is not None or name not in plugins.names(plugins.PLANS):
            return found
        try:
            plan: click.Command = plugins.load(plugins.PLANS, name, "plan")
        except ConfigurationError as error:
            return click.Command(name, callback=partial(_refuse, error), help=str(error))
        return plan

    def resolve_command(
        self, context: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Find the plan; an unknown one fails with the name that was meant, or what to install."""
        name, known = args[0], self.list_commands(context)
        if not name.startswith("-") and name not in known:
            context.fail(f"no plan {name!r}{plugins.name_hint(name, known, plugins.PLANS)}")
        return super().resolve_command(context, args)


def _refuse(error: ConfigurationError) -> None:
    raise error


@click.group(cls=PlanGroup)
def command() -> None:
    """Plan what to measure, in what order, what it could hide, and what another would add."""


@command.command()
@click.argument(
    "configuration", type=path_type, metavar="CONFIG", shell_complete=complete_configurations
)
@touch_option
@shown_option("--touch-s", type=float, default=2.0, help="s, one touch point.")
@shown_option("--settle-s", type=float, default=1.0, help="s, wait after a turn.")
@shown_option("--table-deg-s", type=float, default=11.0, help="deg/s, table's speed.")
@json_option
def order(
    configuration: Path,
    touches: int,
    touch_s: float,
    settle_s: float,
    table_deg_s: float,
    as_json: bool,
) -> int:
    """Print the measuring order of a ball plate configuration with its predicted duration."""
    from rotcal_ros.methods import prepare_whole
    from rotcal_ros.methods.ball_plate.measuring_order import Kinematics
    from rotcal_ros.methods.ball_plate.plan import measuring_order
    from rotcal_ros.methods.configuration import read_configuration

    prepared = prepare_whole(read_configuration(configuration))
    settings = prepared.configuration.plan
    kinematics = Kinematics(
        table_velocity=table_deg_s * DEGREE,
        settle=settle_s,
        touch=touch_s,
        touches_per_ball=touches,
    )
    rows = measuring_order(settings, kinematics)
    steps = [
        {"step": s.index, "table_deg": round(s.table_angle / DEGREE, 9), "ball_step": s.target}
        for s in prepared.plan.steps
    ]
    if as_json:
        print_json({**order_dict(rows), "steps": steps})
        return 0
    click.echo("step,table_deg,ball_step")
    for s in steps:
        click.echo(f"{s['step']},{s['table_deg']},{s['ball_step']}")
    click.echo(describe_order(settings.order, rows), err=True)
    return 0


@command.command()
@click.argument(
    "configuration", type=path_type, metavar="CONFIG", shell_complete=complete_configurations
)
@set_option
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
def reliability(
    configuration: Path,
    changes: tuple[str, ...],
    alpha: float,
    power: float,
    worst: int,
    as_json: bool,
) -> int:
    """Print the smallest error in one observation of a plan that would be found (Baarda).

    The observations are sorted by what a slightly smaller error, which may stay unseen, would do
    to the deviations, in their standard uncertainties. Below them: U of the plan, and what its
    readings could not show; of two circles also what one more setting would bring.
    """
    from rotcal_ros.evaluation.reliability import effects_on_deviations
    from rotcal_ros.evaluation.reliability import reliability as reliability_of
    from rotcal_ros.methods import changed, prepare_whole, read_configuration
    from rotcal_ros.methods.dry_run import prospects

    calibration = prepare_whole(changed(read_configuration(configuration), changes)).of_distances
    expected = list(prospects(calibration))
    observations = _predicted_observations(calibration)
    result = calibration.solve(observations)
    if result.residuals is None:
        raise DataError(f"the method {result.method} gives no residuals, and so no reliability")
    found = reliability_of(result.residuals, alpha, power)
    which = found.worst(worst)
    effects = effects_on_deviations(calibration, observations, result, found, which)
    data = found.to_dict(worst, effects)
    if as_json:
        print_json({**data, "prospects": [each.to_dict() for each in expected]})
    else:
        _print_reliability(data)
        print_words(*(each.describe(expected[0]) for each in expected))
    return 0


@command.command()
@click.argument(
    "configuration", type=path_type, metavar="CONFIG", shell_complete=complete_configurations
)
@set_option
@click.option(
    "--runs",
    type=click.IntRange(min=10),
    default=20,
    show_default=True,
    help="Simulated measurements of each size; of few no error may be known (inf).",
)
@click.option(
    "--effect", "effects", multiple=True, help="Only this effect; several times for several."
)
@json_option
def power(
    configuration: Path,
    changes: tuple[str, ...],
    runs: int,
    effects: tuple[str, ...],
    as_json: bool,
) -> int:
    """Print from which size on the verdict notices each effect, and what it does until then.

    Every effect that could spoil the plan is added to simulated measurements of it, larger and
    larger, until 95 % of the verdicts are no longer ok: this takes minutes. The exit code is 1
    where an effect may do more than 2 standard uncertainties unnoticed, and the verdict line does
    not name it.
    """
    from rotcal_ros.evaluation.power import PowerBench, power_rows
    from rotcal_ros.methods import changed, prepare_whole, read_configuration

    bench = PowerBench(prepare_whole(changed(read_configuration(configuration), changes)), runs)
    rows = power_rows(bench, lambda row: click.echo(", ".join(row.cells()), err=True), effects)
    line, alarms = bench.plain(0).verdict_line, bench.false_alarms()
    if as_json:
        si = {d.effect: d.unit_si for d in bench.listed()}
        found = [row.to_dict(si[row.effect]) for row in rows]
        print_json({"runs": runs, "false_alarms": alarms, "verdict_line": line, "effects": found})
    else:
        heads = ("effect", "treatment", "size", "error/std", "named")
        cells = zip(*(row.cells() for row in rows), strict=True)
        print_table([Column(head, list(c)) for head, c in zip(heads, cells, strict=True)])
        print_words(
            *(f"{row.effect}: {row.what}" for row in rows),
            f"without any effect {alarms} of {runs} verdicts are not ok; verdict line: {line}",
        )
    return int(any(row.misleads for row in rows))


@command.command()
@click.argument("additions", nargs=-1, required=True, metavar="METHOD|CONFIG [...]")
@click.option(
    "--to",
    "present",
    multiple=True,
    type=path_type,
    metavar="BAG|RESULT|CONFIG",
    help="What there is already, or is planned as well; several times for several.",
)
@json_option
def add(additions: tuple[str, ...], present: tuple[Path, ...], as_json: bool) -> int:
    """Print what each addition would add to a table's calibration, before it is measured.

    For every METHOD (with its default settings) or CONFIG: the time that its plan takes, and the
    largest expanded uncertainty (k = 2) of each deviation when it is solved together with what
    there is (--to). A star: its zeros stay open between parts.
    """
    from rotcal_ros.evaluation.joint import predicted_together
    from rotcal_ros.methods.dry_run import DryRun

    have = [_present(path, NOISE_SEED + 2 + k) for k, path in enumerate(present)]
    rows = [("as it is", 0.0, predicted_together(have))] if have else []
    for name in additions:
        calibration = _planned(name)
        seconds, _ = DryRun(calibration, calibration.plan.table_angles[0]).time_estimate()
        more = _expected(f"addition {name}", calibration, NOISE_SEED + 1)
        rows.append((name, seconds, predicted_together([*have, more])))
    if as_json:
        found = [
            {"plan": name, "duration_s": seconds, "std": dict(e.std), "open": list(e.open)}
            for name, seconds, e in rows
        ]
        print_json({"additions": found})
    else:
        _print_additions(rows)
    return 0


def _planned(name: str) -> Calibration:
    """Return the plan of a configuration, or of a method with its default settings."""
    from rotcal_ros.methods import method_names, parse_configuration, prepare_whole
    from rotcal_ros.methods.configuration import read_configuration

    if name in method_names():
        text = f"/**: {{ros__parameters: {{method: {name}}}}}"
        return prepare_whole(parse_configuration(text, name))
    if not (path := Path(name)).exists():
        raise ConfigurationError(
            f"{name} is neither the file of a configuration nor one of the methods "
            f"{', '.join(method_names())}; give one of these"
        )
    return prepare_whole(read_configuration(path))


def _expected(name: str, calibration: Calibration, seed: int) -> JointInput:
    """Return what a plan would give as an instrument; what it reads does not matter."""
    from rotcal_ros.evaluation.joint import JointInput

    alone = calibration.of_distances
    observations = _predicted_observations(alone, seed)
    model = alone.model_of_curves(observations)
    if model is None:
        return JointInput(name, alone.solve(observations))
    return JointInput(name, alone.without_solution(observations, model), model)


def _present(path: Path, seed: int) -> JointInput:
    """Return what there is: a result, a bag, or a configuration that is planned."""
    from rotcal_ros.recordings.inputs import MeasurementInput
    from rotcal_ros.recordings.result_sources import read_instrument

    if path.suffix in (".yaml", ".yml") and path.is_file():
        return _expected(str(path), _planned(str(path)), seed)
    return read_instrument(MeasurementInput(path))


def _print_additions(rows: Sequence[tuple[str, float, JointPlan]]) -> None:
    components = [c for c in COMPONENTS if any(c in found.std for _, _, found in rows)]
    columns = [Column("plan", [name for name, _, _ in rows])]
    columns.append(Column("time/min", [seconds / 60.0 for _, seconds, _ in rows], ".0f"))
    for c in components:
        unit, label = unit_of(c)
        cells = [
            f"{COVERAGE_FACTOR * found.std[c] / unit:.3g}{'*' * (c in found.open)}"
            if c in found.std
            else ""
            for _, _, found in rows
        ]
        columns.append(Column(f"U({c})/{label}", cells))
    print_table(columns, "largest U (k = 2), solved together with what there is")


def _predicted_observations(
    calibration: Calibration, seed: int = NOISE_SEED
) -> tuple[Observation, ...]:
    """Return observations of the plan with their stated noise; exact ones if none is known."""
    if calibration.method.disturbances is None:
        return calibration.nominal_observations()
    return calibration.measured({}, seed).observations


def _print_reliability(data: dict[str, Any]) -> None:
    print_words(
        f"{data['n_observations']} observations, mean redundancy {data['mean_redundancy']:.2f}, "
        f"{data['n_unchecked']} checked by no other",
        f"smallest error that is found with a probability of {100.0 * data['power']:g} % (alpha "
        f"{data['alpha']:g}), and what it does to the deviations:",
    )
    worst = data["worst"]
    print_table(
        [
            Column("position", [row["table_index"] for row in worst]),
            Column("target", [row["target"] for row in worst]),
            Column("redundancy", [row["redundancy"] for row in worst], ".3f"),
            *(
                _sizes(f"error/{label.replace('µ', 'u')}", [row[name] for row in worst], factor)
                for unit, (factor, label) in SHOWN_IN.items()
                if worst and (name := f"detectable_{unit}") in worst[0]
            ),
            _sizes("error/std", [row["detectable_std"] for row in worst]),
            _sizes("effect/std", [row["effect_std"] for row in worst]),
        ]
    )


def _sizes(heading: str, values: list[float | None], unit: float = 1.0) -> Column:
    """Return a column of sizes; an observation that nothing checks has none."""
    return Column(heading, ["any" if v is None else v / unit for v in values], ".3f")


def order_dict(rows: BallPlan) -> dict[str, Any]:
    """Return what a measuring order takes, for JSON."""
    return {
        "centres": len(rows.ball_step),
        "duration_s": rows.duration,
        "table_travel_rad": rows.table_travel,
        "reversals": rows.reversals,
    }


def describe_order(name: str, rows: BallPlan) -> str:
    """Return what the measuring order of that name takes, in words."""
    return (
        f"order {name}: {len(rows.ball_step)} balls, {rows.duration / 3600.0:.1f} h, table travel "
        f"{rows.table_travel / DEGREE / 360.0:.1f} turns, {rows.reversals} reversals"
    )
