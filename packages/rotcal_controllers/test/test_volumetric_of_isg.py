"""All six deviations in the form of the ISG kernel, against the examples of its pages."""

import re
from dataclasses import replace
from datetime import datetime, timezone

import numpy as np
import pytest
from compensation_examples import even, result_of, wavy
from test_cli_export import export  # noqa: F401

from rotcal_controllers import isg_volumetric
from rotcal_ros.compensation.controllers import make_controller
from rotcal_ros.compensation.volumetric import prepare_volumetric
from rotcal_ros.foundation.errors import BagError, ConfigurationError, DataError
from rotcal_ros.foundation.units import ARCSEC

NOW = datetime(2026, 1, 2, tzinfo=timezone.utc)
EXAMPLE = """\
// The header contains the argument "X" and component errors.
X      EXX    EYX    EZX    EAX    EBX    ECX
0.0    0.02   0.01   0.07   0.00   0.0042 0.003
10.0   0.00   -0.1   0.01   0.00   0.0011 0.002
// Further records depending on X
"""
"""296429067: Component errors of the X axis; millimetres and radians."""
ANGLES = even(24)
SIX = {
    "EXC": 4e-6 * np.sin(ANGLES), "EYC": 3e-6 * np.cos(ANGLES) - 3e-6,
    "EZC": 1e-6 * np.sin(2 * ANGLES), "EAC": wavy(ANGLES, [(1, 2.0, 0.1)]),
    "EBC": wavy(ANGLES, [(1, 3.0, 0.7)]),
}  # fmt: skip


def prepared(result=None, name="twincat", accept_unverified=True, **settings):
    result = result or result_of(ANGLES, wavy(ANGLES) - wavy(0.0), **SIX)
    controller = make_controller(name, settings)
    return prepare_volumetric(
        result, name, controller, now=NOW, accept_unverified=accept_unverified
    )


def test_the_example_of_the_page_is_read():
    columns = isg_volumetric.parameters("x.csv", EXAMPLE)
    assert list(columns) == ["X", "EXX", "EYX", "EZX", "EAX", "EBX", "ECX"]
    assert columns["EYX"].tolist() == [0.01, -0.1]
    assert columns["EBX"].tolist() == [0.0042, 0.0011]
    with pytest.raises(BagError, match="expected one block"):
        isg_volumetric.parameters("x.csv", f"{EXAMPLE}#\nY EXY\n0 0\n")
    with pytest.raises(BagError, match="row 1: 6 columns, expected 7"):
        isg_volumetric.parameters("x.csv", EXAMPLE.replace("0.02   ", ""))
    with pytest.raises(BagError, match=r"columns X EXX .* expected C EXC EYC EZC EAC EBC ECC"):
        isg_volumetric.read({"x.csv": EXAMPLE})


def test_all_six_are_written_in_millimetres_radians_and_degrees():
    files, notes = prepared(axis_number=7)
    header, *rows = (x for x in files["c_twincat_volumetric.csv"].splitlines() if x[:2] != "//")
    assert header == "C EXC EYC EZC EAC EBC ECC"
    data = np.array([row.split() for row in rows], dtype=float)
    np.testing.assert_array_equal(data[:, 0], np.arange(0.0, 361.0, 15.0))
    ecc = wavy(ANGLES) - wavy(0.0)
    expected = [*(1e3 * SIX[n] for n in ("EXC", "EYC", "EZC")), SIX["EAC"], SIX["EBC"], ecc]
    np.testing.assert_allclose(data[:-1, 1:].T, expected, atol=6e-11)
    np.testing.assert_array_equal(data[-1, 1:], data[0, 1:])
    lines = files["c_twincat_volumetric.lis"].splitlines()
    assert lines[0] == "C 7"
    assert lines[-2:] == ["file[0] c_twincat_volumetric.csv", "file_format[0] ISG_CSV"]
    assert any("switch lr_param.ssfk of the axis off" in note for note in notes)
    # the chord of 4 um once a turn over 15 deg: 4 um (1 - cos 7.5 deg)
    (left,) = (float(re.search(r"up to (\S+) ", n)[1]) for n in notes if n.startswith("EXC:"))
    assert left == pytest.approx(4.0 * (1.0 - np.cos(np.deg2rad(7.5))), rel=0.05)


@pytest.mark.parametrize(
    ("before", "after", "words"),
    [
        ("C EXC EYC", "C EYC EXC", "expected C EXC EYC EZC EAC EBC ECC"),
        ("\n360.000000 0", "\n360.000000 1", "ascend over 360 deg and close there"),
        ("\n360.000000", "\n350.000000", "ascend over 360 deg and close there"),
        ("\n30.000000", "\n10.000000", "ascend over 360 deg and close there"),
    ],
)
def test_damage_is_named(before, after, words):
    files, _ = prepared()
    text = files["c_twincat_volumetric.csv"]
    assert before in text
    with pytest.raises(BagError, match=words):
        isg_volumetric.read({"x.csv": text.replace(before, after, 1)})


def test_what_was_not_measured_is_said_and_zero():
    files, notes = prepared(result_of(ANGLES, wavy(ANGLES) - wavy(0.0)))
    assert "not measured, so 0 in the file: EXC, EYC, EZC, EAC, EBC" in notes
    back = isg_volumetric.read(files)
    assert not np.any(back.deviations["EXC"])
    assert np.max(np.abs(back.deviations["ECC"])) > 5.0 * ARCSEC


def test_refusals():
    result = result_of(ANGLES, wavy(ANGLES) - wavy(0.0), **SIX)
    with pytest.raises(ConfigurationError, match="--accept-unverified"):
        prepared(result, accept_unverified=False)
    with pytest.raises(ConfigurationError, match="no public form of its volumetric"):
        prepared(result, "sinumerik")
    with pytest.raises(DataError, match="measure without a table"):
        prepared(replace(result, measured_on="b" * 64))
    few = ANGLES[:12]
    with pytest.raises(DataError, match="measure the full circle"):
        prepared(result_of(few, wavy(few) - wavy(0.0)))


def test_the_verb_writes_them(export, tmp_path):  # noqa: F811
    run = export("--to", "twincat", "--what", "volumetric", "--accept", "age",
                 "--accept-unverified")  # fmt: skip
    assert run.exit_code == 0, run.stderr
    assert any(path.suffix == ".csv" for path in (tmp_path / "files").iterdir())
