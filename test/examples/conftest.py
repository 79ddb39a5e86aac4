"""The example package and the helpers of other packages' tests are importable, not installed."""

import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
sys.path[:0] = [str(ROOT / "examples" / "own_method"), str(ROOT / "test" / "evaluation")]
