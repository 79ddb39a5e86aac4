"""Fuzz what reads the input of others, for as long as you like: see CONTRIBUTING.md.

Prints the cases of each target; what breaks a property goes into a folder, input and cause.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "test" / "fuzz"))

from fuzzing import Finding, broken, keep, run
from targets import TARGETS


def main() -> int:
    """Fuzz, or read one input again; return 1 when anything was found."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=60.0, help="in all")
    parser.add_argument("--seed", type=int, default=int(time.time()))
    parser.add_argument("--targets", default=",".join(TARGETS))
    parser.add_argument("--findings", type=Path, default=Path("out/fuzz"))
    parser.add_argument("--again", type=Path, help="read this finding again, in this process")
    given = parser.parse_args()
    if given.again:
        return _again(given.again)
    names = [name for name in given.targets.split(",") if name]
    print(f"seed {given.seed}, {given.seconds:g} s, {len(names)} targets")
    found: list[Finding] = []
    for name in names:
        count, new = run(name, given.seed, given.seconds / len(names))
        kinds = Counter(finding.what[:100] for finding in new)
        print(f"{name:14} {count:8} cases, {len(new)} findings")
        for what, times in kinds.most_common(8):
            print(f"    {times} x {what}")
        found += new
    for finding in found:
        keep(finding, given.findings)
    if found:
        print(f"inputs and causes: {given.findings}")
    return int(bool(found))


def _again(path: Path) -> int:
    target = TARGETS[path.absolute().parent.name]
    place = path.with_name("again")
    place.mkdir(exist_ok=True)
    finding = broken(target, path.read_bytes(), place)
    print("it holds" if finding is None else finding.trace or finding.what)
    return int(finding is not None)


if __name__ == "__main__":
    raise SystemExit(main())
