"""The results of many bags: one Parquet table, one overview page with the trend over time."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import numpy as np

from rotcal_ros.components import COMPONENTS, COVERAGE_FACTOR, unit_of
from rotcal_ros.errors import ConfigurationError
from rotcal_ros.figures import style
from rotcal_ros.files import replace_atomically, write_atomically
from rotcal_ros.recordings.many import Outcome
from rotcal_ros.report import trust
from rotcal_ros.report.template import render


def write_table(outcomes: Sequence[Outcome], path: Path) -> None:
    """Write one row per bag, angle and component as Parquet; SI, deviation = actual - commanded.

    A bag without a result has one row with its error and nothing else.
    """
    try:
        import pyarrow as pa
        import pyarrow.parquet as parquet
    except ImportError as error:
        raise ConfigurationError(
            "the Parquet table needs pyarrow: pip install 'rotcal_ros[many]'"
        ) from error
    schema = pa.schema(
        [
            ("source", pa.string()),
            ("table", pa.string()),
            ("key", pa.string()),
            ("start", pa.timestamp("ns", tz="UTC")),
            ("verdict", pa.string()),
            ("verdict_line", pa.string()),
            ("error", pa.string()),
            ("sigma0", pa.float64()),
            ("n_observations", pa.int64()),
            ("n_rejected", pa.int64()),
            ("component", pa.string()),
            ("angle_rad", pa.float64()),
            ("deviation", pa.float64()),
            ("std", pa.float64()),
        ]
    )
    rows = [row for outcome in outcomes for row in _rows(outcome)]
    table = pa.Table.from_pylist(rows, schema)
    replace_atomically(path, lambda temporary: parquet.write_table(table, temporary))


def write_overview(outcomes: Sequence[Outcome], configuration_text: str, path: Path) -> None:
    """Write the page: the trend of every component over time, and one row per bag."""
    known = {name for o in outcomes if o.result for name in o.result["deviations"]}
    text = render(
        "overview",
        rows=[_summary(outcome) for outcome in outcomes],
        figures=[(name, _trend(outcomes, name)) for name in COMPONENTS if name in known],
        bad=sum(bool(outcome.error) for outcome in outcomes),
        configuration_text=configuration_text,
    )
    write_atomically(path, text)


def in_time(outcomes: Sequence[Outcome]) -> list[Outcome]:
    """Return the outcomes in order of recording; those without a time at the end."""
    return sorted(outcomes, key=lambda o: (o.start_ns is None, o.start_ns or 0, o.source))


def _rows(outcome: Outcome) -> list[dict[str, Any]]:
    common: dict[str, Any] = {
        "source": outcome.source,
        "table": outcome.table,
        "key": outcome.key,
        "start": outcome.start_ns,
        "error": outcome.error or None,
    }
    result = outcome.deviations()
    if result is None:
        return [common]
    common |= {
        "verdict": result.verdict,
        "verdict_line": result.verdict_line,
        "sigma0": result.sigma0,
        "n_observations": result.n_observations,
        "n_rejected": len(result.rejected),
    }
    return [
        {**common, "component": name, "angle_rad": angle, "deviation": deviation, "std": std}
        for name in result.components
        for angle, deviation, std in np.column_stack(
            [result.angles, result.deviations[name], result.std[name]]
        ).tolist()
    ]


def _summary(outcome: Outcome) -> dict[str, Any]:
    result = outcome.deviations()
    ranges, warnings, begin = [], outcome.warnings, ""
    if result is not None:
        warnings = tuple(dict.fromkeys((*warnings, *result.warnings)))
        for name in result.components:
            factor, unit = unit_of(name)
            ranges.append(f"{name} {np.ptp(result.deviations[name]) / factor:.3g} {unit}")
    if outcome.start_ns is not None:
        start = datetime.fromtimestamp(outcome.start_ns / 1e9, timezone.utc)
        begin = f"{start:%Y-%m-%d %H:%M:%S}"
    return {
        "source": outcome.source,
        "table": outcome.table,
        "start": begin,
        "verdict": "no result" if result is None else result.verdict_line,
        "standing": "no" if result is None else trust.standing(result),
        "span": ", ".join(ranges),
        "notes": [outcome.error] if outcome.error else warnings,
    }


@style.styled
def _trend(outcomes: Sequence[Outcome], name: str) -> str:
    """Draw the range of one component over time with its uncertainty (k = 2), table by table."""
    factor, unit = unit_of(name)
    (axes,) = style.grid(height=2.8)
    for table in sorted({outcome.table for outcome in outcomes}):
        points = [
            (outcome.start_ns, result.deviations[name], result.std[name])
            for outcome in outcomes
            if outcome.table == table and outcome.start_ns is not None
            if (result := outcome.deviations()) is not None and name in result.deviations
        ]
        if points:
            times = np.array([p[0] for p in points], dtype="datetime64[ns]")
            spans = [np.ptp(p[1]) / factor for p in points]
            bands = [COVERAGE_FACTOR * float(p[2].max()) / factor for p in points]
            axes.errorbar(times, spans, bands, fmt="o-", markersize=4, capsize=2, label=table)
    axes.set_ylabel(f"{name}, range / {unit}")
    axes.set_ylim(bottom=0)
    return style.svg(axes)
