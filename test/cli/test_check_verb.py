"""``rotcal check``: the verdict on an earlier result."""

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

from rotcal_ros.cli.main import rotcal

DATA = Path(__file__).parents[2] / "examples" / "data"
PLATE = DATA / "result_ball_plate.json"
TRACER = DATA / "result_tracer.json"


def run(*arguments):
    return CliRunner().invoke(rotcal, [str(argument) for argument in arguments])


def test_an_undecided_check_says_what_would_decide_it():
    ran = run("check", PLATE, TRACER, "--within", "0.7")
    assert ran.exit_code == 3
    last = ran.stderr.strip().splitlines()[-1]
    assert last.startswith("undecided: 0.345 arcsec at 240 deg needs U <= 0.431")
    needed = 2.0 * (0.7 - 0.345) / 1.645
    assert needed == pytest.approx(0.431, abs=1e-3)


def test_every_method_can_be_checked_in_its_own_unit(tmp_path):
    again = json.loads(PLATE.read_text())
    del again["raw_data"]  # as if it had been measured once more
    new = tmp_path / "again.json"
    new.write_text(json.dumps(again))
    ran = run("check", PLATE, new, "--within", "1", "--component", "EXC", "--align-order", "1")
    assert ran.exit_code == 0, ran.output
    assert "difference/µm,U (k = 2)/µm" in ran.stdout


def test_ageing_needs_the_months():
    ran = run("check", PLATE, TRACER, "--within", "2", "--ageing", "0.1")
    assert ran.exit_code == 2
    assert "--months" in ran.stderr
