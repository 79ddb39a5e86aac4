"""``rotcal export``: files of every controller from a result, and why it refuses."""

import json
import time

import numpy as np
import pytest
from click.testing import CliRunner

from rotcal_ros.cli.main import rotcal
from rotcal_ros.compensation.controllers import controller_names
from rotcal_ros.foundation.circumstances import Circumstances
from rotcal_ros.foundation.identity import Identity
from rotcal_ros.foundation.protection import Protection
from rotcal_ros.foundation.results import Result
from rotcal_ros.foundation.units import ARCSEC

ANGLES = np.arange(24) * np.pi / 12


def deviation(angles):
    return 12.0 * ARCSEC * (np.sin(angles) + 0.3 * np.sin(3 * angles))


def write_result(path, verdict="ok", angles=ANGLES, protections=(), **circumstances):
    result = Result(
        method="tracer_multistation",
        angles=angles,
        deviations={"ECC": deviation(angles), "EZC": 1e-6 * np.cos(angles)},
        std={"ECC": np.full(len(angles), 1e-7), "EZC": np.full(len(angles), 1e-7)},
        covariance={},
        sigma0=1.0,
        dof=50,
        n_observations=100,
        verdict=verdict,
        protections=protections,
        circumstances=Circumstances(**circumstances),
    )
    path.write_text(result.to_json())
    return path


@pytest.fixture
def export(tmp_path):
    def run(*arguments, source=None):
        source = source or write_result(tmp_path / "result.json")
        out = ["--out", str(tmp_path / "files")]
        alone = {"--add-to", "measured", "volumetric"}
        word = [] if alone.intersection(map(str, arguments)) else ["--replace"]
        words = [*out, *word, *(str(a) for a in arguments if a != "measured")]
        return CliRunner().invoke(rotcal, ["export", str(source), *words])

    return run


@pytest.mark.parametrize("controller", controller_names())
def test_every_controller_gets_its_files(export, tmp_path, controller):
    stated = ("--set", "backlash_deg=0") if controller == "linuxcnc" else ()
    run = export("--to", controller, "--spacing", 10, "--accept-unverified", "--json", *stated)
    assert run.exit_code == 0, run.stderr
    told = json.loads(run.stdout)
    assert sorted(told["files"]) == sorted(str(p) for p in (tmp_path / "files").iterdir())
    facts = told["provenance"]
    assert facts["controller"] == controller
    assert facts["sources_sha256"].keys() == {"result.json"}
    assert facts["residual_arcsec"]["simulated"] < facts["residual_arcsec"]["before"]


def test_the_provenance_says_what_the_result_is_not_protected_against(export, tmp_path):
    protections = (Protection("drift", "not protected", ""), Protection("tilt", "harmless", ""))
    source = write_result(tmp_path / "result.json", protections=protections)
    line = "ok. Not tested for: drift"
    run = export("--to", "csv", source=source)
    assert run.exit_code == 0
    assert f"warning: the result is {line}" in run.stderr
    side = json.loads((tmp_path / "files" / "c_csv.provenance.json").read_text())
    assert (side["verdict"], side["verdict_line"]) == ("ok", line)
    assert side["warnings"][0] == f"the result is {line}"
    assert export("--to", "volumetric", source=source).exit_code == 0
    facts = json.loads((tmp_path / "files" / "c_volumetric.json").read_text())
    assert (facts["verdict_line"], facts["not_protected"]) == (line, ["drift"])
    protected = write_result(tmp_path / "other.json", protections=protections[1:])
    bare = export("--to", "csv", "--name", "other", source=protected)
    assert "the result is" not in bare.stderr


MACHINE = """[KINS]
KINEMATICS = trivkins coordinates=XC
[TRAJ]
ANGULAR_UNITS = degree
[JOINT_1]
TYPE = ANGULAR
MIN_LIMIT = 0
MAX_LIMIT = 360
MAX_ACCELERATION = 500
[JOINT_0]
TYPE = LINEAR
"""


def test_the_lines_of_a_linuxcnc_table_go_where_they_belong(export, tmp_path):
    machine = tmp_path / "mill.ini"
    machine.write_text(MACHINE)
    run = export("--to", "linuxcnc", "--spacing", 15, "--machine-ini", machine, "--json")
    assert run.exit_code == 0, run.stderr
    copy = (tmp_path / "files" / "mill.ini").read_text()
    lines = "COMP_FILE = c_linuxcnc.comp\nCOMP_FILE_TYPE = 1\n"
    assert copy == MACHINE.replace("[JOINT_0]", lines + "[JOINT_0]")
    assert machine.read_text() == MACHINE
    settings = json.loads(run.stdout)["provenance"]["settings"]
    assert (settings["joint"], settings["max_acceleration_deg_s2"]) == (1, 500.0)
    run = export("--to", "csv", "--machine-ini", machine)
    assert run.exit_code == 2
    assert "unknown setting 'machine_ini'" in run.stderr


def test_a_linuxcnc_table_over_three_revolutions_subtracts_the_deviation(export, tmp_path):
    arguments = "--to", "linuxcnc", "--spacing", 15, "--revolutions", "-1:2"
    asked = export(*arguments)
    assert asked.exit_code == 2
    assert "BACKLASH of the joint is not known" in asked.stderr
    assert "--set backlash_deg=DEG, 0 for none" in asked.stderr
    assert not (tmp_path / "files").exists()
    run = export(*arguments, "--set", "backlash_deg=0")
    assert run.exit_code == 0, run.stderr
    rows = np.loadtxt(tmp_path / "files" / "c_linuxcnc.comp")
    np.testing.assert_allclose(rows[:, 0], np.arange(-360, 721, 15))
    expected = -np.rad2deg(deviation(np.deg2rad(rows[:, 0])))
    np.testing.assert_allclose(rows[:, 1], expected, atol=1e-9)


def test_all_that_was_measured_as_a_volumetric_table(export, tmp_path):
    assert export("--to", "volumetric", "--axis", "B").exit_code == 0
    text = (tmp_path / "files" / "b_volumetric.csv").read_text()
    assert text.startswith("angle_rad,EZC_m,u_EZC_m,ECC_rad,u_ECC_rad\n")


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["--to", "bosch"], 2, "unknown controller 'bosch'"),
        (["--to", "linuxcnc", "--spacing", 1], 2, "360 rows x 1 turns"),
        (["--to", "csv", "--spacing", 0], 2, "spacing 0 deg"),
        (["--to", "csv", "--revolutions", "0:2"], 2, "unknown setting 'first_turn'"),
        (["--to", "linuxcnc", "--revolutions", "2:1"], 2, "LAST above FIRST"),
        (["--to", "linuxcnc", "--set", "turns"], 2, "expected NAME=VALUE"),
        (["--to", "linuxcnc", "--set", "turns=two"], 2, "linuxcnc.turns: expected int"),
        (["--to", "csv", "--name", "../table"], 2, "do not leave the output folder"),
        (["--to", "csv", "--axis", "c"], 2, "axis name 'c'"),
    ],
)
def test_what_cannot_be_is_refused_and_nothing_is_written(
    export, tmp_path, arguments, code, words
):
    run = export(*arguments)
    assert run.exit_code == code
    assert words in run.stderr
    assert not (tmp_path / "files").exists()


def test_a_volumetric_table_says_which_table_was_in_force(export, tmp_path):
    source = write_result(tmp_path / "r.json")
    data = json.loads(source.read_text()) | {"measured_on": "a" * 64}
    source.write_text(json.dumps(data))
    done = export("--to", "volumetric", source=source)
    words = (
        "measured with table aaaaaaaaaaaa in force: the deviations are what it leaves uncorrected"
    )
    assert words in done.stderr
    facts = json.loads((tmp_path / "files" / "c_volumetric.json").read_text())
    assert facts["measured_on"] == "a" * 64
    assert words in facts["warnings"]


@pytest.mark.parametrize(
    "option",
    [
        ["--spacing", "10"], ["--reference", "0"], ["--harmonics", "3"], ["--replace"],
        ["--add-to", "."], ["--revolutions", "0:3"], ["--set", "resolution=1"],
    ],
)  # fmt: skip
def test_what_a_volumetric_table_would_not_heed_is_refused(export, tmp_path, option):
    done = export("--to", "volumetric", *option)
    assert done.exit_code == 2
    assert f"{option[0]}: no use for a volumetric table" in done.stderr
    assert not (tmp_path / "files").exists()


@pytest.mark.parametrize("verdict", ["suspect", "failed"])
@pytest.mark.parametrize("controller", ["csv", "volumetric"])
def test_a_bad_verdict_is_not_fed(export, tmp_path, verdict, controller):
    source = write_result(tmp_path / "bad.json", verdict=verdict)
    run = export("--to", controller, source=source)
    assert run.exit_code == 3
    assert f"'{verdict}'" in run.stderr
    assert not (tmp_path / "files").exists()


def test_deviations_that_do_not_close_are_refused(export, tmp_path):
    angles = np.append(ANGLES, 2 * np.pi - 1e-12)
    source = write_result(tmp_path / "open.json", angles=angles)
    data = json.loads(source.read_text())
    data["deviations"]["ECC"][-1] += 5 * ARCSEC
    source.write_text(json.dumps(data))
    run = export("--to", "csv", source=source)
    assert run.exit_code == 3
    assert "do not close" in run.stderr


def test_nothing_is_overwritten(export, tmp_path):
    assert export("--to", "csv").exit_code == 0
    before = (tmp_path / "files" / "c_csv.csv").read_bytes()
    again = export("--to", "csv", "--spacing", 30)
    assert again.exit_code == 2
    assert "exists already" in again.stderr
    assert (tmp_path / "files" / "c_csv.csv").read_bytes() == before


@pytest.mark.parametrize(
    ("content", "code", "words"),
    [(b"{", 2, "is not JSON"), (b"{}", 3, "not a rotcal result"), (b"[1]", 3, "not a rotcal")],
)
def test_what_is_no_result(export, tmp_path, content, code, words):
    source = tmp_path / "other.json"
    source.write_bytes(content)
    run = export("--to", "csv", source=source)
    assert run.exit_code == code
    assert words in run.stderr


def test_a_missing_file_is_named(export, tmp_path):
    run = export("--to", "csv", source=tmp_path / "nothing.json")
    assert run.exit_code == 2
    assert "nothing.json" in run.stderr


DAY_NS = 86_400 * 10**9


@pytest.mark.parametrize("controller", ["csv", "volumetric"])
@pytest.mark.parametrize(
    ("word", "arguments", "known", "words"),
    [
        ("axis", ["--axis", "B"], {"axis": "C"}, "axis C was measured and the export"),
        (
            "serial",
            ["--serial", "4711"],
            {"identity": Identity(serial="9999")},
            "serial number 9999 was measured and the export (--axis, --serial) has 4711",
        ),
        ("age", [], {"begun_ns": 366 * DAY_NS}, "days old, at most 30 are accepted"),
    ],
)
def test_what_contradicts_the_machine_is_refused_unless_its_word_is_given(
    export, tmp_path, controller, word, arguments, known, words
):
    if word == "age":
        known = {"begun_ns": time.time_ns() - known["begun_ns"], "ended_ns": time.time_ns()}
    source = write_result(tmp_path / "result.json", **known)
    run = export("--to", controller, *arguments, source=source)
    assert run.exit_code == 3
    assert words in run.stderr
    assert f"--accept {word}" in run.stderr
    assert not (tmp_path / "files").exists()
    run = export("--to", controller, *arguments, "--accept", word, source=source)
    assert run.exit_code == 0, run.stderr
    assert f"accepted by a person ({word})" in run.stderr
    letter = "b" if word == "axis" else "c"
    assert {path.name[0] for path in (tmp_path / "files").iterdir()} == {letter}


def test_the_largest_age_can_be_set(export, tmp_path):
    begun_ns = time.time_ns() - 366 * DAY_NS
    source = write_result(tmp_path / "result.json", begun_ns=begun_ns, ended_ns=begun_ns)
    assert export("--to", "csv", "--max-age", 400, source=source).exit_code == 0
    assert export("--to", "csv", "--accept", "agee", source=source).exit_code == 2


@pytest.mark.parametrize("controller", ["csv", "volumetric"])
def test_a_result_without_a_date_does_not_pass_for_young(export, tmp_path, controller):
    words = "warning: it is not known how many days ago this was measured, at most 30 are accepted"
    ran = export("--to", controller)
    assert ran.exit_code == 0
    assert words in ran.stderr
    dated = {"begun_ns": time.time_ns() - DAY_NS, "ended_ns": time.time_ns()}
    source = write_result(tmp_path / "dated.json", **dated)
    assert words not in export("--to", controller, "--name", "dated", source=source).stderr


def test_what_is_added_to_has_the_same_item(tmp_path):
    """The table of 4711 is in force; what 9999 left on top of one is not added to it."""
    first = write_result(tmp_path / "one.json", identity=Identity(serial="4711"), axis="C")
    words = ["export", str(first), "--to", "csv", "--replace", "--out", str(tmp_path / "one")]
    assert CliRunner().invoke(rotcal, words).exit_code == 0
    other = write_result(tmp_path / "other.json", identity=Identity(serial="9999"), axis="C")
    words = ["export", str(other), "--to", "csv", "--out", str(tmp_path / "other")]
    run = CliRunner().invoke(rotcal, [*words, "--add-to", str(tmp_path / "one")])
    assert run.exit_code == 3
    assert f"9999 was measured and the table in {tmp_path / 'one'} has 4711" in run.stderr
    same = write_result(tmp_path / "same.json", identity=Identity(serial="4711"), axis="C")
    words = ["export", str(same), "--to", "csv", "--out", str(tmp_path / "same")]
    run = CliRunner().invoke(rotcal, [*words, "--add-to", str(tmp_path / "one")])
    assert run.exit_code == 3  # the same deviation again: the first table does not act
    assert "it is inactive, or on the wrong axis" in run.stderr


def test_a_small_letter_is_no_axis_and_no_contradiction_to_accept(export, tmp_path):
    source = write_result(tmp_path / "result.json", axis="C")
    run = export("--to", "csv", "--axis", "c", "--accept", "axis", source=source)
    assert run.exit_code == 2
    assert "axis name 'c': expected a capital letter" in run.stderr
    assert not (tmp_path / "files").exists()
