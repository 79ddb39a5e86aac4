"""Live cells for the nodes of extensions, as for those of ``test/nodes``."""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parents[1] / "nodes"))

from live_cell import cell, rotcal  # noqa: F401
