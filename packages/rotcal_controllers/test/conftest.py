"""Helpers of the core's tests: tables, live cells, verbs."""

import sys
from pathlib import Path

sys.path += [str(Path(__file__).parents[3] / "test" / f) for f in ("compensation", "nodes", "cli")]

from live_cell import cell, rotcal  # noqa: F401
