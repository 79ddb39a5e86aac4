"""What the export and the feed do with these controllers, beyond what they do with every one."""

from datetime import datetime, timezone

import numpy as np
import pytest
from compensation_examples import TAU, even, result_of, wavy
from controls_beside_the_core import OURS
from test_chosen_rows import curve
from test_feed import Cell, table_of

from rotcal_ros.compensation.bridge_settings import BridgeSettings
from rotcal_ros.compensation.controllers import make_controller
from rotcal_ros.compensation.export import prepare_export
from rotcal_ros.compensation.feed import Feed
from rotcal_ros.compensation.held_table import hash_in_force
from rotcal_ros.compensation.table import table_from_result
from rotcal_ros.foundation.errors import ConfigurationError, DataError
from rotcal_ros.foundation.units import ARCSEC

NOW = datetime(2026, 1, 2, tzinfo=timezone.utc)


def test_verified_controllers_are_those_with_a_documented_file():
    names = OURS
    plain = {name for name in names if not make_controller(name).unverified}
    assert plain == {"sinumerik", "pmac", "twincat", "encoder_lut"}


def test_a_staircase_that_makes_it_worse_is_not_written():
    """Rows every 120 degrees mistake four waves a turn for one and add to them."""
    angles = even(72)
    table = table_from_result(result_of(angles, wavy(angles, [(4, 20.0, 0.0)])))
    with pytest.raises(DataError, match="spacing is too coarse"):
        prepare_export(table, "fanuc", now=NOW, spacing=TAU / 3, accept_unverified=True)


def test_a_control_that_starts_at_zero_gets_even_rows_by_itself():
    angles = np.deg2rad(np.sort(np.append(np.arange(3.0, 360.0, 9.0), [10.0, 200.0])))
    result = result_of(angles, curve(angles) - curve(angles[0]), 0.5 * ARCSEC)
    table = table_from_result(result)
    done = prepare_export(table, "sinumerik", now=NOW)
    assert np.ptp(np.diff(done.table.angles)) < 1e-9
    assert done.residual.interpolation <= 2.0 * table.largest_std / 3.0


def test_files_copied_by_hand_are_seen_whatever_the_settings(tmp_path):
    """Rows every 7 degrees are nothing for this control; the file that lies there is."""
    (tmp_path / "c_sinumerik.ini").write_text("M17\n")
    settings = BridgeSettings(
        controller="sinumerik", spacing_deg=7.0, controller_folder=str(tmp_path)
    )
    held = Feed(settings, "C", lambda: 1).in_force()
    assert held == hash_in_force({"c_sinumerik.ini": "M17\n"})


@pytest.mark.parametrize("name", ["heidenhain", "fagor"])
def test_what_is_not_verified_has_to_be_accepted(tmp_path, name):
    cell = Cell(tmp_path)
    with pytest.raises(ConfigurationError, match="--accept-unverified"):
        cell.feed(controller=name).take(table_of(), 1)
    assert cell.feed(controller=name, accept_unverified=True).take(table_of(), 1)
