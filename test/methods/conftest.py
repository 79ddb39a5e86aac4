"""The other solutions of the problems, and one small measurement, for the tests of the folder."""

import sys
from pathlib import Path

import pytest

# The other solutions live beside the benchmarks.
sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))


@pytest.fixture(scope="session")
def measured():
    """Return calibration and observations of the small plate."""
    from plate_cell import measure, small

    calibration = small()
    return calibration, measure(calibration)
