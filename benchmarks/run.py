"""Run the benchmarks and print a table; ``--json FILE`` writes the same rows as JSON.

usage: run.py [--json FILE] [NAME ...]

Every ``bench_<name>.py`` in this folder yields from ``rows()`` one dataclass per measurement.
Times mean little on another machine; ratios are measured side by side and mean something.
"""

import argparse
import importlib
import json
import os
import platform
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

from rotcal_ros import __version__

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


def main() -> None:
    """Measure, print, write."""
    known = sorted(path.stem.removeprefix("bench_") for path in HERE.glob("bench_*.py"))
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", default=known, metavar="NAME", help=", ".join(known))
    parser.add_argument("--json", type=Path, metavar="FILE")
    arguments = parser.parse_args()
    rows = []
    for row in measured(arguments.names):
        rows.append(row)
        cells = (f"{key} {printed(value)}" for key, value in row.items() if key != "name")
        print(f"{row['name']:<40}", *cells, sep="   ", flush=True)
    if arguments.json:
        stated = {
            "version": f"rotcal_ros {__version__}",
            "machine": f"{platform.system()}, {platform.machine()}, {os.cpu_count()} cores",
            "python": platform.python_version(),
        }
        arguments.json.parent.mkdir(parents=True, exist_ok=True)
        arguments.json.write_text(json.dumps({**stated, "rows": rows}, indent=1) + "\n")
        print(f"written: {arguments.json.absolute()}")


if __name__ == "__main__":
    main()
