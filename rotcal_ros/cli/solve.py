"""``rotcal solve``: solves a recorded bag or a plain table for the deviations, without ROS."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from rotcal_ros.cli.console import (
    VERDICT_EXIT_CODES,
    json_option,
    path_type,
    print_json,
    result_option,
    show_result,
)
from rotcal_ros.cli.options import (
    complete_configurations,
    explain_option,
    reading_announcer,
    remember_option,
    set_option,
    targets_option,
)
from rotcal_ros.foundation.errors import DataError
from rotcal_ros.report.terminal.console import progress, say, tell

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rotcal_ros.evaluation.ways import Evaluation
    from rotcal_ros.methods.method import Measurements
    from rotcal_ros.recordings.inputs import MeasurementInput
    from rotcal_ros.recordings.replay import Recording


@click.command()
@click.argument(
    "sources", nargs=-1, required=True, type=path_type, metavar="BAG|TABLE|RESULT [...]"
)
@click.option(
    "--setup",
    "setups",
    multiple=True,
    type=path_type,
    shell_complete=complete_configurations,
    help="Configuration; needed for a table, a bag has its own. Of several, one for each table "
    "or one for each source, in their order.",
)
@targets_option
@set_option
@remember_option
@click.option(
    "--from",
    "taken_from",
    type=click.Choice(["streams", "observations"]),
    default="streams",
    show_default=True,
    help="Capture the raw streams again, or use the recorded observations.",
)
@click.option("--namespace", default="", help="Cell to solve, when the bag holds several.")
@click.option(
    "--balls",
    multiple=True,
    metavar="STEPS",
    help="Ball plate: evaluate these balls only, e.g. 0,12,28,37,50,58; 'all' for all.",
)
@click.option(
    "--coarser",
    multiple=True,
    type=click.IntRange(min=1),
    help="Ball plate: evaluate every n-th step of the grid only.",
)
@click.option(
    "--groups",
    type=click.Choice(["together", "separate"]),
    help="Ball plate: groups of table positions that no ball connects are solved separately, each "
    "with its own zero, or refused (together); default: as the set-up says.",
)
@result_option
@explain_option
@json_option
def command(
    sources: tuple[Path, ...],
    setups: tuple[Path, ...],
    targets: Path | None,
    changes: tuple[str, ...],
    remember: bool,
    taken_from: Any,
    namespace: str,
    balls: tuple[str, ...],
    coarser: tuple[int, ...],
    groups: str | None,
    output: Path | None,
    explain: bool,
    as_json: bool,
) -> int:
    """Solve BAG (a folder, .mcap or .db3 file) or TABLE (a workbook or text, and --setup).

    The bag's raw streams go through the same capture and solver as in the live run, so the
    result is the same to the last bit. A cut-off or damaged bag is read as far as possible.
    --balls and --coarser may be given several times: the same data are then evaluated in all
    combinations and compared with the first; --groups holds for all of them.

    Several sources, measured on the same table by any methods, are solved together: one curve of
    each deviation, one verdict, and a test of the instruments against each other. Beside them a
    RESULT (a JSON file) stands for observations that are not at hand; rotcal combine joins results
    alone. The exit code is 0 for the verdict ok and 1 for suspect or failed.
    """
    from rotcal_ros.recordings.inputs import MeasurementInput

    announce = reading_announcer(explain=explain, remembers=remember)
    if len(sources) > 1 and (targets or changes or balls or coarser or groups):
        raise click.UsageError(
            "--targets, --set, --balls, --coarser and --groups are for one source: of several "
            "state it in their set-ups (--setup); a table of targets is found beside its table"
        )
    inputs = [
        MeasurementInput(source, setup, targets, changes, taken_from, namespace, announce)
        for source, setup in zip(sources, _setups(sources, setups), strict=True)
    ]
    if len(inputs) > 1 and not explain:
        return _show_together(inputs, output, as_json)
    with progress("reading") as shown:
        every = [each.read(shown) for each in inputs if each.path.suffix != ".json"]
    if explain:
        return 0
    if not every:
        raise click.UsageError(
            f"{sources[0]} is a result, solved already: `rotcal report` shows it, and `rotcal "
            "combine` joins it to other results; beside bags and tables it is solved with them"
        )
    (source,), (data,) = sources, every
    if not (balls or coarser or groups):
        return show_result(data.solve(), output, as_json=as_json)
    from rotcal_ros.evaluation.ways import setting_combinations

    separate = None if groups is None else groups == "separate"
    evaluations = _evaluated(data, source, setting_combinations(balls, coarser, separate=separate))
    if len(evaluations) == 1:
        return show_result(evaluations[0].result, output, as_json=as_json)
    return _show_evaluations(evaluations, output, as_json)


def _setups(sources: Sequence[Path], setups: Sequence[Path]) -> list[Path | None]:
    """Return the set-up of each source: one for each, or one for each table; UsageError."""
    from rotcal_ros.foundation.tables import is_table

    if len(setups) == len(sources):
        return [*setups]
    tables = [is_table(source) for source in sources]
    if setups and sum(tables) != len(setups):
        raise click.UsageError(
            f"{len(setups)} set-ups (--setup) for {len(sources)} sources, {sum(tables)} of them "
            "tables: give one for each source, or one for each table"
        )
    given = iter(setups)
    return [next(given, None) if table else None for table in tables]


def _show_together(inputs: Sequence[MeasurementInput], output: Path | None, as_json: bool) -> int:
    """Solve several sources together and show the result."""
    from rotcal_ros.evaluation.joint import solve_together
    from rotcal_ros.recordings.result_sources import read_instrument

    with progress("reading") as shown:
        instruments = [read_instrument(each, shown) for each in inputs]
    found = solve_together(instruments)
    if not as_json:
        from rotcal_ros.report.terminal.tables import print_group_agreement

        print_group_agreement(found.groups)
    return show_result(found.result, output, as_json=as_json)


def _evaluated(
    data: Recording | Measurements, source: Path, wanted: tuple[tuple[str, ...], ...]
) -> tuple[Evaluation, ...]:
    """Evaluate the data of a ball plate in the ``wanted`` ways."""
    from rotcal_ros.evaluation.ways import evaluate
    from rotcal_ros.methods.measurements import PlannedMeasurements
    from rotcal_ros.recordings.replay import Recording

    if not (
        isinstance(data, Recording | PlannedMeasurements)
        and hasattr(data.configuration.solver, "balls")
    ):
        raise DataError(
            f"{source}: --balls, --coarser and --groups are for the data of a ball plate"
        )
    evaluations = evaluate(data.calibration, data.observations, wanted)
    if isinstance(data, PlannedMeasurements):
        return evaluations
    return tuple(replace(e, result=data.with_warnings(e.result)) for e in evaluations)


def _show_evaluations(
    evaluations: tuple[Evaluation, ...], output: Path | None, as_json: bool
) -> int:
    """Print or write several evaluations side by side; the exit code is the worst one's."""
    from rotcal_ros.evaluation.ways import describe_evaluations
    from rotcal_ros.foundation.files import write_atomically

    for warning in dict.fromkeys(w for e in evaluations for w in e.result.warnings):
        say(f"warning: {warning}")
    data = {"evaluations": [evaluation.to_dict() for evaluation in evaluations]}
    if output is not None:
        write_atomically(output, json.dumps(data, indent=1, allow_nan=False) + "\n")
        say(f"results written to {output.absolute()}")
    if as_json:
        print_json(data)
    else:
        tell(*describe_evaluations(evaluations))
    return max(VERDICT_EXIT_CODES[evaluation.result.verdict] for evaluation in evaluations)
