"""Live cells that end with their test."""

import sys
from pathlib import Path

from live_cell import cell, rotcal  # noqa: F401

sys.path.append(str(Path(__file__).parents[1] / "compensation"))
