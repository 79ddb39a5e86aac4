"""The settings that are declared here are those of the page of settings."""

import numpy as np
import pytest
from settings_page import assert_documented, rows

from rotcal_ros.foundation.settings import load
from rotcal_ros.planning.settings import CellSettings, PlannerSettings
from rotcal_ros.planning.table_angles import TableAngleSettings, table_angles


@pytest.mark.parametrize(
    ("cls", "group", "method", "count"),
    [
        (CellSettings, "cell", "", 11),
        (PlannerSettings, "planner", "", 13),
        (TableAngleSettings, "plan", "plane_mirror", 4),
        (TableAngleSettings, "plan", "tracer_multistation", 4),
    ],
)
def test_defaults_and_ranges_are_those_of_the_page(cls, group, method, count):
    assert assert_documented(cls, group, method) == count
    assert load(cls, {}, "nothing given") == cls()


def test_the_usual_angles_are_those_of_the_page():
    assert assert_documented(TableAngleSettings, "plan", "plane_mirror") == 4
    page = rows("plane_mirror")
    start, step, count = (
        float(page[f"plan.table_{name}"].default)
        for name in ("start_deg", "step_deg", "positions")
    )
    expected = np.radians(start + step * np.arange(count))
    np.testing.assert_allclose(table_angles(TableAngleSettings()), expected)
