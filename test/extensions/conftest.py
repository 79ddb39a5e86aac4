"""Live cells for the nodes of extensions, tables for their controllers: their tests' helpers."""

import sys
from pathlib import Path

sys.path += [str(Path(__file__).parents[1] / folder) for folder in ("nodes", "compensation")]

from live_cell import cell, rotcal  # noqa: F401
