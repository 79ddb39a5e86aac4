"""The sample bags of ``test/bags``, for many of them."""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parents[2] / "bags"))
