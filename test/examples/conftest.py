"""The example package is importable by the tests of its parts, without being installed."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2] / "examples" / "own_method"))
