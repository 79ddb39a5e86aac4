"""One small measurement for all tests of the folder."""

import pytest
from plate_cell import measure, small


@pytest.fixture(scope="session")
def measured():
    """Return calibration and observations of the small plate."""
    calibration = small()
    return calibration, measure(calibration)
