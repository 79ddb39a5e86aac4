"""Controllers' tables of a golden result are written as they were, and read when in force.

Each folder of ``exported`` is what a command of `test_golden.EXPORTED`, with --replace, wrote for
1.0.0. They stay as they are.
"""

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from test_golden import EXPORTED as COMMANDS

from rotcal_ros.cli.main import rotcal
from rotcal_ros.compensation.controllers import controller_names
from rotcal_ros.compensation.earlier_export import read_earlier
from rotcal_ros.foundation.observations import Approach
from rotcal_ros.foundation.results import Result

GOLDEN = Path(__file__).parent
RESULT = GOLDEN / "table_balls" / "table" / "result.json"
EXPORTED = GOLDEN / "exported"
each_controller = pytest.mark.parametrize(
    "controller",
    [
        pytest.param(
            folder.name,
            marks=pytest.mark.skipif(
                folder.name not in controller_names(), reason="of a package that is not there"
            ),
        )
        for folder in sorted(EXPORTED.iterdir())
    ],
)


def held(folder):
    """Return name -> content of the files in a folder, but when they were written."""
    found = {path.name: path.read_text() for path in sorted(folder.iterdir())}
    (side,) = (name for name in found if name.endswith(".provenance.json"))
    content = json.loads(found[side])
    del content["written"]
    return found | {side: content}


@each_controller
def test_a_table_is_written_as_it_was(controller, tmp_path, monkeypatch):
    monkeypatch.chdir(GOLDEN)
    run = CliRunner().invoke(rotcal, [*COMMANDS[controller], "--replace", "-o", str(tmp_path)])
    assert run.exit_code == 0, run.output
    assert held(tmp_path) == held(EXPORTED / controller)


@each_controller
def test_a_table_in_force_takes_off_what_was_measured(controller):
    result = Result.from_dict(json.loads(RESULT.read_text()))
    table = read_earlier(EXPORTED / controller, controller, "C")
    measured = result.deviations["ECC"] - result.deviations["ECC"][0]
    corrections = [table.correction(result.angles, a) for a in Approach]
    added = np.mean([correction - correction[0] for correction in corrections], axis=0)
    assert np.ptp(measured) > 5.0 * table.stated
    np.testing.assert_allclose(added, -measured, rtol=0.0, atol=2.0 * table.stated)
