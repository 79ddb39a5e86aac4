"""Helpers of the core's tests: a browser, the language of pages."""

import sys
from pathlib import Path

sys.path += [str(Path(__file__).parents[3] / "test" / folder) for folder in ("page", "cli")]
