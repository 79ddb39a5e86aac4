"""``rotcal check``: whether an earlier result is still valid, from a quick new measurement."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click

from rotcal_ros.cli.console import json_option, path_type, print_json
from rotcal_ros.cli.options import (
    align_option,
    component_option,
    make_check_rule,
    reference_option,
    reference_reader,
    remember_option,
    rule_options,
    sheet_option,
)
from rotcal_ros.foundation.components import unit_of

if TYPE_CHECKING:
    from rotcal_ros.evaluation.quick_check import CheckVerdict

EXIT_CODES: Final[Mapping[CheckVerdict, int]] = {"still valid": 0, "changed": 1, "undecided": 3}


@click.command()
@click.argument("earlier", type=path_type)
@click.argument("new", type=path_type)
@rule_options
@reference_option
@sheet_option
@remember_option
@component_option
@align_option
@json_option
def command(
    earlier: Path,
    new: Path,
    reference_std: float | None,
    changes: tuple[str, ...],
    remember: bool,
    component: str,
    align_order: int,
    as_json: bool,
    **asked: Any,
) -> int:
    """Judge by a NEW measurement whether the EARLIER curve still describes the table.

    Both are a result.json, bag, session or reference table, of any method. The verdict is
    'still valid' if every measured angle is within the limit less a guard band, 'changed' if the
    table moved by more than uncertainty and ageing explain, else 'undecided'. The exit code is 0,
    1 or 3. 'rotcal plan check' plans what a tracer has to measure for it.
    """
    from rotcal_ros.evaluation.quick_check import quick_check
    from rotcal_ros.recordings.result_sources import read_curve

    unit, label = unit_of(component)
    how = reference_reader((earlier, new), reference_std, changes, remembers=remember)
    curves = [read_curve(path, component, how) for path in (earlier, new)]
    check = quick_check(
        curves[0], curves[1], make_check_rule(unit, **asked), align_order, unit, label
    )
    if as_json:
        print_json({"component": component, **check.to_dict()})
    else:
        from rotcal_ros.report.terminal.tables import print_check

        print_check(check, component)
    return EXIT_CODES[check.verdict]
