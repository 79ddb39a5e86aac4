"""Lets the tests use scipy's formulation of the problems, which lives beside the benchmark."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[3] / "benchmarks"))
