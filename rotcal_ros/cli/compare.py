"""``rotcal compare``: whether results of one table agree within their uncertainties."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from rotcal_ros.cli.console import NamedFile, json_option, path_type, print_json, write_drawing
from rotcal_ros.cli.options import (
    align_option,
    component_option,
    language_option,
    polygon_option,
    reference_option,
    reference_reader,
    remember_option,
    sheet_option,
)
from rotcal_ros.foundation.language import ENGLISH, use_language

if TYPE_CHECKING:
    from rotcal_ros.evaluation.compare import Comparison
    from rotcal_ros.foundation.curves.measured import MeasuredCurve
    from rotcal_ros.recordings.result_sources import References


@click.command()
@click.argument("sources", nargs=-1, required=True, type=path_type, metavar="A B [C ...] | FOLDER")
@polygon_option
@reference_option
@sheet_option
@remember_option
@component_option
@align_option
@click.option(
    "--truth",
    is_flag=True,
    help="Score the results in one FOLDER against the truth.json beside each.",
)
@click.option(
    "-o",
    "--output",
    type=NamedFile(".svg", ".html", bare=False),
    help="Draw the curves and E_n into this file: .svg or .html.",
)
@language_option
@json_option
def command(
    sources: tuple[Path, ...],
    polygon: Path | None,
    reference_std: float | None,
    changes: tuple[str, ...],
    remember: bool,
    component: str,
    align_order: int,
    truth: bool,
    output: Path | None,
    language: str,
    as_json: bool,
) -> int:
    """Compare results of one table pair by pair: result.json, bags, sessions, reference tables.

    A reference table has angles, deviations and, unless --reference-u states them, uncertainties,
    in any form: a workbook or a text. A file of several evaluations (rotcal solve --balls ... -o)
    counts as all of them. Correlations between results of the same data are taken into account.
    The offset, which no method can determine, is removed. The exit code is 1 if a pair disagrees
    by more than chance explains, judged by |E_n| at single angles and at all angles together.

    With --truth every result.json and result_NAME.json beside a truth.json in FOLDER or below is
    scored, for the open data set and for simulated sessions: errors, intervals that hold the
    truth, and verdicts. The exit code is 1 if one says ok, does not name what spoiled it, and is
    wrong by more than its U.
    """
    if truth:
        stated = reference_std is not None or (component, language) != ("ECC", ENGLISH.code)
        if len(sources) > 1 or any((polygon, output, align_order, changes, stated)):
            raise click.UsageError("--truth takes one FOLDER, and of the options --json alone")
        return _scored(sources[0], as_json=as_json)
    from rotcal_ros.evaluation.compare import compare_all

    if len(set(sources)) < len(sources):
        raise click.UsageError("give each result only once")
    curves = _read(
        sources,
        component,
        reference_reader(sources, reference_std, changes, polygon, remembers=remember),
    )
    if len(curves) < 2:
        raise click.UsageError("give at least two different results to compare")
    comparisons = compare_all(curves, align_order)
    if output is not None:
        from rotcal_ros.report.comparison import comparison_page, curves_and_errors

        shown = (curves, comparisons, component)
        page, figure = partial(comparison_page, *shown), partial(curves_and_errors, *shown)
        with use_language(language):
            write_drawing(output, {".svg": figure, ".html": page})
    if as_json:
        print_json(_plain(comparisons, component))
    else:
        from rotcal_ros.report.terminal.tables import print_comparisons

        print_comparisons(comparisons, component)
    return int(not all(c.agree for c in comparisons.values()))


def _scored(folder: Path, *, as_json: bool) -> int:
    from dataclasses import asdict

    from rotcal_ros.evaluation.truth_scores import leaderboard, score_folder

    scores = score_folder(folder)
    if as_json:
        rows = [asdict(row) for row in leaderboard(scores)]
        print_json({"scores": [asdict(score) for score in scores], "leaderboard": rows})
    else:
        from rotcal_ros.report.terminal.tables import print_leaderboard

        print_leaderboard(leaderboard(scores), [s.describe() for s in scores if s.misleads])
    return int(any(score.misleads for score in scores))


def _read(sources: tuple[Path, ...], component: str, how: References) -> dict[str, MeasuredCurve]:
    from rotcal_ros.recordings.result_sources import read_curves

    return {
        name: curve
        for source in sources
        for name, curve in read_curves(source, component, how).items()
    }


def _plain(comparisons: Mapping[tuple[str, str], Comparison], component: str) -> Mapping[str, Any]:
    """Return the machine-readable form, SI."""
    return {
        "component": component,
        "all_within_one": all(c.largest <= 1.0 for c in comparisons.values()),
        "agree": all(c.agree for c in comparisons.values()),
        "pairs": [
            {"first": a, "second": b, **comparison.to_dict()}
            for (a, b), comparison in comparisons.items()
        ],
    }
