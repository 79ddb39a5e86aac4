"""``rotcal plan check``: the fewest lengths or balls that check an earlier result."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click

from rotcal_design.goal import goal_settings
from rotcal_design.settings import LEAST_REDUNDANCY
from rotcal_ros.cli.console import json_option, path_type, print_json
from rotcal_ros.cli.options import make_check_rule, rule_options, set_option
from rotcal_ros.foundation import plugins
from rotcal_ros.foundation.components import COVERAGE_FACTOR
from rotcal_ros.foundation.dates import today
from rotcal_ros.foundation.errors import PlanError
from rotcal_ros.foundation.files import write_atomically
from rotcal_ros.foundation.protection import TOLERABLE
from rotcal_ros.foundation.units import ARCSEC, DEGREE
from rotcal_ros.report.terminal.columns import Column, print_table, print_words
from rotcal_ros.report.terminal.console import progress, say

if TYPE_CHECKING:
    from rotcal_design.check_balls import BallCheckPlan
    from rotcal_design.check_plan import CheckPlan
    from rotcal_ros.foundation.results import Result

EXPECTED: Final = "expected.json"
"""The curve of a history that is checked, beside the plan."""


@click.command("check")
@click.argument("earlier", type=path_type, metavar="EARLIER|SERIAL")
@click.option(
    "--setup",
    type=path_type,
    required=True,
    help="Configuration of the laser tracer or the ball plate (.yaml).",
)
@rule_options
@click.option(
    "--from-history",
    "database",
    metavar="FILE|URL",
    help="Check what this history expects of the table SERIAL, in place of a result.",
)
@click.option("--axis", default="", help="Axis of a table --from-history, such as C.")
@click.option("--at", "day", metavar="DAY", help="Day of the check --from-history, 2026-03-31.")
@click.option(
    "--every",
    type=click.IntRange(min=1),
    metavar="N",
    default=1,
    show_default=True,
    help="Check only every N-th angle; the others stay unknown.",
)
@click.option(
    "--candidates",
    type=path_type,
    help="Places for the reflector (target,x_m,y_m,z_m); default: those of --volume, else of "
    "the configuration's block.",
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
    help="Set or change a setting of --volume.",
)
@click.option(
    "--least-redundancy",
    type=click.FloatRange(0.0, 0.9),
    default=LEAST_REDUNDANCY,
    show_default=True,
    help="Least redundancy of each length; 0: none needs to be checked by others.",
)
@set_option
@click.option("-o", "--output", type=path_type, help="Folder for configuration and its tables.")
@json_option
def check(
    earlier: Path,
    output: Path | None,
    as_json: bool,
    database: str | None,
    axis: str,
    day: str | None,
    **asked: Any,
) -> int:
    """Plan the fewest lengths of a laser tracer that check the EARLIER result (ECC), or balls.

    Of a ball plate these are the fewest CMM positions at which all its balls are measured.

    A table that has only aged as stated will be found still valid with a probability of 1 less
    the risk of a false alarm. The folder of -o is ready for 'rotcal run FOLDER/check.yaml', and
    what it measures for 'rotcal check EARLIER NEW' with the same options.

    With --from-history it is the curve that the history predicts for a day, with its
    covariance, so that --ageing is not needed. It is written beside the plan, as expected.json.
    Without --within the plan decides whether the table is still within its tolerance.
    """
    expected = None
    if database is not None:
        keeper = plugins.extension(plugins.HISTORIES, "history", "a plan from a history")
        day = day or today()
        expected, room = keeper.expected(database, str(earlier), axis, day)
        if asked["within"] is None and room <= 0.0:
            raise PlanError(
                f"no tolerance is left on {day} of what the history expects of {earlier}: "
                "calibrate it, or give --within"
            )
        asked["within"] = asked["within"] or room / ARCSEC
    elif axis or day:
        raise click.UsageError("--axis and --at belong to --from-history")
    plan = _check_plan(earlier, expected, **asked)
    if as_json:
        print_json(plan.to_dict())
    else:
        _print_plan(plan, asked["every"], asked["least_redundancy"])
    if output is not None:
        say(f"written: {plan.write(output).absolute()}")
        if expected is not None:
            write_atomically(output / EXPECTED, expected.to_json())
            within = f"--within {asked['within']:.6g}"
            say(f"then: rotcal check {output / EXPECTED} NEW {within}")
    return 0


def _check_plan(
    earlier: Path,
    expected: Result | None,
    *,
    setup: Path,
    candidates: Path | None,
    volume: Path | None,
    limits: tuple[str, ...],
    changes: tuple[str, ...],
    every: int,
    least_redundancy: float,
    **rule: Any,
) -> CheckPlan | BallCheckPlan:
    """Return the plan that the options ask for; ``rule`` are those of :func:`rule_options`."""
    from rotcal_design.check_balls import plan_ball_check
    from rotcal_design.check_plan import plan_check
    from rotcal_ros.foundation.curves.measured import measured_curve
    from rotcal_ros.methods import changed, read_configuration
    from rotcal_ros.methods.ball_plate.solver.result import METHOD
    from rotcal_ros.methods.tracer.table import read_targets
    from rotcal_ros.recordings.result_sources import read_curve

    configuration = changed(read_configuration(setup), changes)
    curve = measured_curve(expected) if expected is not None else read_curve(earlier, "ECC")
    if configuration.method.name == METHOD:
        if candidates or volume or limits or every > 1:
            raise click.UsageError(
                "--candidates, --volume, --volume-set and --every are for a laser tracer"
            )
        return plan_ball_check(configuration, curve, make_check_rule(ARCSEC, **rule))
    room = goal_settings(configuration, volume, limits) if volume or limits else None
    with progress("targets") as shown:
        return plan_check(
            configuration,
            curve,
            make_check_rule(ARCSEC, **rule),
            every=every,
            offered=() if candidates is None else read_targets(candidates),
            room=room,
            least_redundancy=least_redundancy,
            progress=shown,
        )


def _print_plan(plan: CheckPlan | BallCheckPlan, every: int, least_redundancy: float) -> None:
    from rotcal_design.check_plan import CheckPlan

    print_table(
        [
            Column("angle/deg", plan.angles / DEGREE, ".4f"),
            Column("lengths" if isinstance(plan, CheckPlan) else "balls", plan.at_each_angle),
            Column(
                f"U (k = {COVERAGE_FACTOR:g})/arcsec", COVERAGE_FACTOR * plan.std / ARCSEC, ".3f"
            ),
            Column("valid up to/arcsec", plan.acceptance / ARCSEC, ".3f"),
        ]
    )
    if isinstance(plan, CheckPlan):
        _print_checks(plan, every, least_redundancy)
    else:
        print_words(
            f"{plan.at_each_angle.sum()} ball centres at {len(plan.positions)} CMM positions (of "
            f"{len(plan.angles)}), {plan.seconds / 60.0:.1f} min"
        )
    print_words(
        f"a table that has only aged as stated is found within {plan.rule.limit / ARCSEC:.4g} "
        f"arcsec with a probability of at least {100 * plan.assurance:.3g} %"
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
    if max(plan.unseen.drift, plan.unseen.knock) > TOLERABLE:
        print_words(
            f"warning: no order of these lengths shows every drift and knock before it causes "
            f"{TOLERABLE:g} standard uncertainties"
        )
    if every > 1:
        unknown = f"{every - 1} of {every} angles"
        print_words(f"nothing will be known of {unknown} of the earlier result")
    if least_redundancy < LEAST_REDUNDANCY:
        print_words(
            "warning: some lengths are hardly checked: an error in one of them may reverse "
            "the verdict"
        )
