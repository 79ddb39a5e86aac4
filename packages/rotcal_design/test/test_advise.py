"""``rotcal plan advise``: what fits, by the plans that its commands begin."""

import json
import shlex

import pytest
from click.testing import CliRunner

from rotcal_design.advice import OWNED
from rotcal_ros.cli.main import rotcal
from rotcal_ros.foundation.units import ARCSEC, MICROMETRE
from rotcal_ros.methods import method_names, prepare_whole, read_configuration
from rotcal_ros.methods.dry_run import Prospect


def advised(*arguments, code=0, text=None):
    found = CliRunner().invoke(
        rotcal, ["plan", "advise", *map(str, arguments)], prog_name="rotcal", input=text
    )
    assert found.exit_code == code, found.stderr
    return found


def ways(*arguments, code=0):
    return json.loads(advised(*arguments, "--json", code=code).stdout)["ways"]


def test_every_instrument_serves_methods_that_there_are():
    for _, served in OWNED.values():
        assert {way.method for way in served} <= {*method_names(), "deviations"}


def test_what_may_be_owned_and_wanted_is_listed():
    listed = json.loads(advised("--json").stdout)
    assert listed["instruments"]["polygon"] == "polygon and autocollimator"
    assert listed["units"]["ECC"]["size"] == pytest.approx(ARCSEC)
    assert listed["units"]["EZC"] == {"size": MICROMETRE, "unit": "µm"}


def test_the_command_writes_the_set_up_that_was_predicted(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (best,) = ways("--own", "probe", "--want", "EZC=1", "--machine-um", 0.8)
    assert best["meets"]
    assert best["expanded"]["EZC"] <= 1.0 * MICROMETRE
    program, *words = shlex.split(best["command"])
    assert program == "rotcal"
    assert CliRunner().invoke(rotcal, words).exit_code == 0
    plan = prepare_whole(read_configuration(tmp_path / "table_balls.yaml"))
    assert plan.configuration.solver.sigma_centre_m == 0.8e-6
    drawn = Prospect.of(plan)
    assert best["expanded"]["EZC"] == pytest.approx(2.0 * drawn.std["EZC"])
    assert best["untested"] == list(drawn.untested)
    assert best["rests_on"]["solver.sigma_centre_m"] == 0.8e-6


def test_stated_deviations_have_the_stated_uncertainty_and_nothing_tests_them():
    if "deviations" not in method_names():
        pytest.skip("its package is not installed")
    found = ways("--own", "interferometer", "--want", "ECC=2", "--set", "solver.u_arcsec=0.5")
    known = next(way for way in found if way["method"] == "deviations")
    assert known["expanded"]["ECC"] == pytest.approx(1.0 * ARCSEC)
    assert known["seconds"] == pytest.approx(12 * 5.0 + 11 * 10.0, abs=0.1)  # readings and turns
    assert {"drift", "knock", "sign of readings"} <= {*known["untested"]}
    assert known["command"].startswith("rotcal solve deviations.csv")
    unstated = ways("--own", "interferometer", "--want", "ECC=2")
    assert "how sure these deviations are" in unstated[-1]["refused"]


def test_u_of_a_plate_grows_as_the_noise_of_the_machine():
    plates = [
        next(w for w in ways("--own", "cmm", "--want", "ECC=9", "--machine-um", um)
             if w["method"] == "ball_plate")
        for um in (0.2, 0.4)
    ]  # fmt: skip
    small, large = (plate["expanded"]["ECC"] for plate in plates)
    assert large == pytest.approx(2.0 * small, rel=1e-3)
    blind = ways("--own", "cmm", "--want", "ECC=9")
    assert "--machine-um" in blind[-1]["refused"]
    assert blind[0]["method"] == "table_balls"


def test_what_misses_the_goal_says_so_and_the_quickest_that_meets_it_is_taken():
    quick = ways("--own", "probe", "--want", "ECC=2")[0]
    sure = ways("--own", "probe", "--want", "ECC=1.3")[0]
    assert quick["seconds"] < sure["seconds"]
    assert quick["expanded"]["ECC"] > sure["expanded"]["ECC"]
    (late,) = ways("--own", "probe", "--want", "ECC=1.3", "--minutes", 5, code=1)
    assert not late["meets"]
    shown = advised("--own", "polygon", "--want", "ECC", "--want", "EZC=1", code=1)
    assert shown.stdout.splitlines()[1].startswith("polygon,angle_comparison,no,")
    assert shown.stdout.splitlines()[1].endswith(",not determined")
    assert "not tested for: drift" in shown.stderr


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--own", "level", "--want", "ECC=2"), "no method here takes level"),
        (("--own", "probe"), "--own probe --want ECC=2"),
        (("--own", "probe", "--want", "ECC=-1"), "such as ECC=2"),
        (("--own", "probe", "--want", "C=1"), "such as ECC=2"),
        (("--own", "probe", "--want", "ECC=2", "--set", "solver.length_std_m=1e-6"),
         "no method of these instruments has it"),
    ],
)  # fmt: skip
def test_what_cannot_be_answered_is_refused(arguments, words):
    assert words in advised(*arguments, code=2).stderr


def test_a_person_at_a_terminal_is_asked(monkeypatch):
    monkeypatch.setattr("click.testing._NamedTextIOWrapper.isatty", lambda _: True, raising=False)
    found = advised(text="polygon\nECC=1\n30\n0\n")
    assert "polygon and autocollimator" in found.stderr
    assert "rotcal new --method angle_comparison" in found.stdout + found.stderr
