"""The other solutions of the problems, and one small measurement, for the tests of the folder."""

import sys
from pathlib import Path

import pytest

# The other solutions live beside the benchmarks; scenes of a method in its folder.
sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))
sys.path.extend(str(Path(__file__).parent / method) for method in ("plane_mirror", "tracer"))


@pytest.fixture(scope="session")
def measured():
    """Return calibration and observations of the small plate."""
    from plate_cell import measure, small

    calibration = small()
    return calibration, measure(calibration)
