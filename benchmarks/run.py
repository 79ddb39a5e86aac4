"""Run the benchmarks and print a table; ``--json FILE`` writes the same rows as JSON.

usage: run.py [--json FILE] [--csv FILE] [NAME ...]

Every ``bench_<name>.py`` in this folder yields from ``rows()`` one dataclass per measurement.
Times mean little on another machine; ratios are measured side by side and mean something.
``--csv FILE`` writes the races among the rows as a table of docs/speed.md.
"""

import argparse
import csv
import importlib
import json
import os
import platform
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

# One thread each: the ratio shall compare the methods, not the number of cores.
os.environ.setdefault("OMP_NUM_THREADS", "1")
HERE = Path(__file__).parent


def measured(names: list[str]) -> Iterator[dict[str, Any]]:
    """Yield the rows of the named benchmarks as they are measured."""
    for name in names:
        for row in importlib.import_module(f"bench_{name}").rows():
            values = {k: None if v != v else v for k, v in asdict(row).items()}
            yield {"benchmark": name, **values}  # JSON has no NaN


def printed(value: Any) -> str:
    """Return a cell of the table."""
    if value is None:
        return "-"
    return f"{value:.3g}" if isinstance(value, float) else str(value)


def raced(row: dict[str, Any]) -> list[str]:
    """Return the cells of a race; empty where there is no peer, or nothing to compare."""
    times = [seconds(row["ours_s"]), seconds(row["opponent_s"])]
    ratio = "" if row["ratio"] is None else f"{row['ratio']:.2g}"
    apart = "" if row["difference"] is None else f"{row['difference']:.0e}"
    return [row["benchmark"].replace("_", " "), row["name"], *times, ratio, apart]


def seconds(value: float | None) -> str:
    """Return a time with three digits."""
    if value is None:
        return ""
    size, unit = next(x for x in ((1.0, "s"), (1e-3, "ms"), (1e-6, "us")) if value >= x[0])
    return f"{value / size:.3g} {unit}"


def main() -> None:
    """Measure, print, write."""
    known = sorted(path.stem.removeprefix("bench_") for path in HERE.glob("bench_*.py"))
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", default=known, metavar="NAME", help=", ".join(known))
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("--csv", type=Path, metavar="FILE")
    arguments = parser.parse_args()
    rows = []
    for row in measured(arguments.names):
        rows.append(row)
        cells = (f"{key} {printed(value)}" for key, value in row.items() if key != "name")
        print(f"{row['name']:<40}", *cells, sep="   ", flush=True)
    if arguments.json:
        machine = {"machine": platform.platform(), "python": platform.python_version()}
        arguments.json.parent.mkdir(parents=True, exist_ok=True)
        arguments.json.write_text(json.dumps({**machine, "rows": rows}, indent=1))
        print(f"written: {arguments.json.absolute()}")
    if arguments.csv:
        with arguments.csv.open("w", encoding="utf-8", newline="") as file:
            table = csv.writer(file, lineterminator="\n")
            table.writerow(["benchmark", "what", "ours", "peer", "peer / ours", "difference"])
            table.writerows(raced(row) for row in rows if "ours_s" in row)
        print(f"written: {arguments.csv.absolute()}")


if __name__ == "__main__":
    main()
