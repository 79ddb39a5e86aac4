"""Writes which package beside the core brings which names, from what is installed.

usage: python scripts/package_index.py     after `make setup`, when a package offers a new name
"""

from __future__ import annotations

import json
from collections import defaultdict
from importlib.metadata import distribution
from pathlib import Path

from rotcal_ros.foundation.plugins import INDEX

PACKAGES = Path(__file__).resolve().parents[1] / "packages"
PREFIX = "rotcal_ros."


def index() -> dict[str, dict[str, list[str]]]:
    """Return package -> group of entry points -> names."""
    found: dict[str, dict[str, list[str]]] = {}
    for folder in sorted(PACKAGES.glob("*/setup.py")):
        groups: defaultdict[str, list[str]] = defaultdict(list)
        for point in distribution(folder.parent.name).entry_points:
            if point.group.startswith(PREFIX):
                groups[point.group].append(point.name)
        found[folder.parent.name] = {group: sorted(groups[group]) for group in sorted(groups)}
    return found


if __name__ == "__main__":
    INDEX.write_text(json.dumps(index(), indent=2) + "\n", encoding="utf-8")
