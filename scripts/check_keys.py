#!/usr/bin/env python3
"""Resolve the keys of a workspace as rosdep would; refuse what bloom refuses.

    check_keys.py SRC

The keys are looked up in scripts/rosdep_keys.txt, so that no network is needed. Ends with exit
code 1 and a line for each key that is not known, and for each that pip alone can install.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from pathlib import Path

from catkin_pkg.package import parse_package

KEYS = Path(__file__).with_name("rosdep_keys.txt")


def known_keys() -> dict[str, list[str]]:
    """Return key -> what it is made of."""
    lines = (line.split() for line in KEYS.read_text().splitlines() if not line.startswith("#"))
    return {key: rest for key, *rest in lines}


def wrong(source: Path, environment: dict[str, str]) -> tuple[list[str], list[str]]:
    """Return the packages of a workspace, and what is wrong with their keys.

    As colcon, rosdep and bloom do it: none looks inside a package for another one.
    """
    found = [parse_package(path) for path in sorted(_manifests(source))]
    own, known, faults = {package.name for package in found}, known_keys(), list[str]()
    for package in found:
        package.evaluate_conditions(environment)
        kinds = (
            package.buildtool_depends, package.build_depends, package.build_export_depends,
            package.exec_depends, package.test_depends,
        )  # fmt: skip
        asked = {d.name for depends in kinds for d in depends if d.evaluated_condition}
        for key in sorted(asked - own):
            if key not in known:
                faults.append(f"{package.name}: no rosdep key {key!r}")
            elif known[key][0] == "pip" and environment.get("ROTCAL_PIP") != "1":
                faults.append(f"{package.name}: {key} is of pip alone, which bloom refuses")
    return sorted(own), faults


def _manifests(folder: Path) -> Iterator[Path]:
    """Yield the manifest of a package, or those of the packages below a folder that is none."""
    if (folder / "package.xml").exists():
        yield folder / "package.xml"
    else:
        for below in filter(Path.is_dir, folder.iterdir()):
            yield from _manifests(below)


def main() -> int:
    """Check a workspace and say what is wrong."""
    own, faults = wrong(Path(sys.argv[1]), dict(os.environ))
    for fault in faults:
        print(f"check_keys: {fault}", file=sys.stderr)
    print(f"keys of {', '.join(own) or 'no package'}: {'wrong' if faults else 'all known'}")
    return bool(faults) or not own


if __name__ == "__main__":
    sys.exit(main())
