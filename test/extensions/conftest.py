"""Live cells for the nodes of extensions, tables for their controllers: helpers of those rooms."""

import sys
from pathlib import Path

sys.path += [str(Path(__file__).parents[1] / room) for room in ("nodes", "compensation")]

from live_cell import cell, rotcal  # noqa: F401
