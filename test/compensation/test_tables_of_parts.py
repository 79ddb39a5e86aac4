"""A table of parts whose zeros nothing joins is fed to nobody: by export, bridge or hand."""

from dataclasses import replace
from datetime import datetime, timezone

import numpy as np
import pytest
from test_feed import Cell
from two_groups import ALTERNATING, ARCSEC, GRID, plate_problem

import rotcal_ros as rc
from rotcal_ros.compensation.export import prepare_export
from rotcal_ros.compensation.table import table_from_result
from rotcal_ros.compensation.volumetric import volumetric_files
from rotcal_ros.evaluation.combination import CombinationInput
from rotcal_ros.evaluation.joint import combine
from rotcal_ros.foundation.errors import DataError
from rotcal_ros.methods.ball_plate.solver import solve

NOW = datetime(2026, 1, 1, tzinfo=timezone.utc)
SIX = replace(solve(plate_problem()), measured_on="none")
WHAT = "the offset between the odd and even table positions is not measured"
HOW = r"mirror, tracer, autocollimator with polygon.*joined by 'rotcal combine'"
REFUSAL = f"{WHAT}.*{HOW}"


def linked():
    twelve = solve(plate_problem(range(GRID), seed=3))
    both = {"six": SIX, "twelve": twelve}
    return combine([CombinationInput.of(n, r) for n, r in both.items()]).result


def test_export_says_what_links_the_groups():
    """It wrote files, 'at most 0.384 arcsec after compensation', with 4 arcsec in them."""
    table = table_from_result(SIX)
    assert WHAT in table.open_zeros
    for verdict in ("suspect", "ok"):  # whatever a verdict says
        with pytest.raises(DataError, match=REFUSAL):
            prepare_export(replace(table, verdict=verdict), "csv", now=NOW)
    with pytest.raises(DataError, match=REFUSAL):
        volumetric_files(SIX, "c")


def test_no_table_is_made_for_software_of_ones_own():
    with pytest.raises(DataError, match=REFUSAL):
        rc.make_table(SIX)
    with pytest.raises(DataError, match=REFUSAL):
        rc.make_table(linked(), reverse=SIX)


def test_the_bridge_refuses_it_and_forgets_the_table_before(tmp_path):
    cell = Cell(tmp_path)
    feed, now_ns = cell.feed(), cell.clock()
    feed.take(replace(table_from_result(linked()), measured_on="none"), now_ns)
    assert feed.offer is not None
    feed.forget()
    with pytest.raises(DataError, match=REFUSAL):
        feed.take(table_from_result(SIX), now_ns)
    assert feed.offer is None


def test_what_was_joined_is_exported_and_takes_the_deviation_away():
    table = replace(table_from_result(linked()), measured_on="none")
    export = prepare_export(table, "csv", now=NOW)
    left = ALTERNATING - ALTERNATING[0] + table.correction_forward
    assert np.abs(left).max() < 0.02 * ARCSEC
    assert export.residual.before > 3.9 * ARCSEC


def test_the_hash_of_a_table_covers_its_open_zeros():
    table = table_from_result(SIX)
    assert replace(table, open_zeros="").table_hash != table.table_hash


def test_a_forward_and_a_reverse_run_with_open_zeros_are_refused_both():
    table = table_from_result(SIX, reverse=SIX)
    assert table.open_zeros.count(WHAT) == 1
