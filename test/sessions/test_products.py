"""What a finished calibration leaves beside its bag, and what it says when it leaves it out."""

from dataclasses import replace
from types import SimpleNamespace

import pytest
from two_groups import GRID, plate_problem

from rotcal_ros.foundation.session_folder import SessionFolder
from rotcal_ros.methods.ball_plate.solver import solve
from rotcal_ros.sessions.products import write_products


def session_with(folder, result, **groups):
    """A session as far as its products look at it: a real cell whose result is there.

    ``groups``: those of packages in its configuration.
    """
    place = SessionFolder(folder)
    place.result.write_text(result.to_json())
    cell = SimpleNamespace(axis="C")
    configuration = SimpleNamespace(
        simulated=False, cell=cell, given=frozenset(groups), of_packages=groups
    )
    return SimpleNamespace(folder=place, configuration=configuration)


@pytest.mark.parametrize("measured_on", ["none", "unknown"])
def test_two_groups_are_not_exported_at_the_end_of_a_run(tmp_path, measured_on):
    """Controller files were written by itself, with 4 arcsec between odd and even positions."""
    told = []
    six = replace(solve(plate_problem()), measured_on=measured_on)
    paths = write_products(session_with(tmp_path, six), report=False, tell=told.append)
    assert set(paths) == {"bag", "result"}
    assert not (tmp_path / "compensation").exists()
    (why,) = told
    assert why.startswith("no compensation files: the offset between the odd and even table")
    assert "joined by 'rotcal combine'" in why


def test_a_whole_result_is_exported(tmp_path):
    told = []
    twelve = replace(solve(plate_problem(range(GRID))), measured_on="none")
    paths = write_products(session_with(tmp_path, twelve), report=False, tell=told.append)
    assert told == []
    assert "compensation" in paths
