"""Settings of machines in the forms of public files, held against what a table assumes."""

from dataclasses import replace
from datetime import datetime, timezone

import numpy as np
import pytest
from compensation_examples import d4_table, two_ways
from controls_beside_the_core import twincat

from rotcal_ros.compensation.export import prepare_export
from rotcal_ros.compensation.writing import without_provenance
from rotcal_ros.foundation.errors import ConfigurationError

NOW = datetime(2026, 1, 2, tzinfo=timezone.utc)


def plain():
    """A table of one column, measured without another one."""
    table = two_ways(24)
    return replace(table, correction_reverse=table.correction_forward)


def exported(name, text, folder, table=None, **settings):
    """Export beside a machine's file with ``text``."""
    (path := folder / "machine.txt").write_text(text)
    settings = {"machine_file": str(path), **settings}
    return prepare_export(
        table or plain(), name, now=NOW, settings=settings, accept_unverified=True
    )


ARCHIVE = """%_N_INITIAL_INI
CHANDATA(1)
N10000 $MN_AXCONF_MACHAX_NAME_TAB[0]="X1"
N10000 $MN_AXCONF_MACHAX_NAME_TAB[4]="C1"
N32450 $MA_BACKLASH[0,AX1]=0.5
N32450 $MA_BACKLASH[0,AX5]=0.002
N32450 $MA_BACKLASH[1,AX5]=0
N32700 $MA_ENC_COMP_ENABLE[0,AX1]=1
N32700 $MA_ENC_COMP_ENABLE[0,AX5]=0
N32720 $MA_CEC_MAX_SUM[AX5]=1
N41310 $SN_CEC_TABLE_WEIGHT[0]=1
N41310 $SN_CEC_TABLE_WEIGHT[1]=1
M17
"""
C1 = {"axis_name": "C1"}


def test_a_backlash_of_a_sinumerik_is_read_of_the_axis_and_its_measuring_system(tmp_path):
    done = exported("sinumerik", ARCHIVE, tmp_path, **C1)
    (acts,) = (text for text in done.warnings if "MD32450" in text)
    assert "MD32450 BACKLASH[0] of AX5 = 0.002 deg acts beside the table" in acts
    second = exported("sinumerik", ARCHIVE, tmp_path, measuring_system=1, **C1)
    assert not any("MD32450" in text for text in second.warnings)
    assert without_provenance(done.files) == without_provenance(
        exported("sinumerik", ARCHIVE, tmp_path, backlash_deg=0.002, **C1).files
    )
    with pytest.raises(ConfigurationError, match=r"0\.002 deg in the machine's file and was 0 "):
        exported("sinumerik", ARCHIVE, tmp_path, backlash_deg=0.0, **C1)
    without = ARCHIVE.replace("N32450 $MA_BACKLASH[0,AX5]=0.002\n", "")
    assert any("is not in the machine's file" in text
               for text in exported("sinumerik", without, tmp_path, **C1).warnings)  # fmt: skip


def test_a_table_in_force_on_a_sinumerik_that_was_not_measured_on_is_refused(tmp_path):
    locked = ARCHIVE.replace("ENABLE[0,AX5]=0", "ENABLE[0,AX5]=1")
    with pytest.raises(ConfigurationError, match=r"ENC_COMP_ENABLE\[0\] of AX5 is 1"):
        exported("sinumerik", locked, tmp_path, **C1)
    on_top = replace(d4_table(), adds_to="a" * 64, measured_on="a" * 64)
    exported("sinumerik", locked, tmp_path, on_top, **C1)
    # the lock is of ENC_COMP alone
    exported("sinumerik", locked, tmp_path, tables="cec", **C1)


@pytest.mark.parametrize(
    ("line", "other", "words"),
    [
        ("WEIGHT[1]=1", "WEIGHT[1]=0.5", r"CEC_TABLE_WEIGHT\[1\] is 0\.5"),
        ("MAX_SUM[AX5]=1", "MAX_SUM[AX5]=0.0001", "CEC_MAX_SUM of AX5 is 0.0001 deg"),
        ("[0,AX5]=0.002", "[0,AX5]=x", "is 'x', expected a number"),
        ("[0,AX5]=0.002", "[0,AX5]=inf", "is 'inf', expected a number"),
        ('[4]="C1"', '[4]="B1"', "no machine axis C1: set axis_name to one of AX1, AX5, B1, X1"),
    ],
)
def test_what_would_change_a_cec_table_is_refused(tmp_path, line, other, words):
    assert line in ARCHIVE
    exported("sinumerik", ARCHIVE, tmp_path, tables="cec", **C1)
    with pytest.raises(ConfigurationError, match=words):
        exported("sinumerik", ARCHIVE.replace(line, other), tmp_path, tables="cec", **C1)


PUNCHED = """%
N01800Q1P00000000
N01825Q1A1P3000A4P3000
N01851Q1A1P7A4P3
N01852Q1A1P7A4P0
N03605Q1A1P00000001A4P00000000
%
"""


def test_a_backlash_of_a_fanuc_is_read_of_its_axis(tmp_path):
    done = exported("fanuc", PUNCHED, tmp_path, axis_number=4)
    assert any("1851 of axis 4 = 3 detection units acts" in text for text in done.warnings)
    none = exported("fanuc", PUNCHED.replace("A4P3\n", "A4P0\n"), tmp_path, axis_number=4)
    assert not any("1851" in text for text in none.warnings)
    with pytest.raises(ConfigurationError, match="is 3 detection units in the machine's file and"):
        exported("fanuc", PUNCHED, tmp_path, axis_number=4, backlash_units=2)
    rapid = PUNCHED.replace("P00000000\nN01825", "P00010000\nN01825").replace(
        "A4P0\nN036", "A4P9\nN036"
    )
    assert any("1852 = 9 acts in rapid" in text
               for text in exported("fanuc", rapid, tmp_path, axis_number=4).warnings)  # fmt: skip


def test_slots_for_the_other_way_of_3605_are_refused(tmp_path):
    with pytest.raises(
        ConfigurationError, match="3605#0 of axis 4 is 0, and the slots are of dir"
    ):
        exported("fanuc", PUNCHED, tmp_path, two_ways(24), axis_number=4, directions="each")
    with pytest.raises(ConfigurationError, match=r"3605#0 of axis 1 is 1.*set the bit to 0"):
        exported("fanuc", PUNCHED, tmp_path, axis_number=1)


LIST = """# as in the example of the page
getriebe[0].lose          1000  #0,1 um backlash
lr_param.anwahl_losekomp  1     #Positive direction
lr_param. n_backlash_cyc  10    #Number of filter cycles
"""


def test_a_backlash_of_twincat_is_read_and_in_a_list_of_both_directions(tmp_path):
    done = exported("twincat", LIST, tmp_path)
    rule, at = twincat(without_provenance(done.files)), np.arange(0.0, 360.0, 15.0)
    assert rule(at, True) - rule(at, False) == pytest.approx(0.1, abs=1e-9)  # 1000 x 0.0001 deg
    off = exported("twincat", LIST.replace("losekomp  1", "losekomp  0"), tmp_path)
    assert "neg" not in without_provenance(off.files)["c_twincat.lis"].split("table[0]")[1][:40]
    stated = exported("twincat", LIST, tmp_path, backlash_deg=0.0)
    assert without_provenance(stated.files) == without_provenance(off.files)
    with pytest.raises(ConfigurationError, match="is negative"):
        exported("twincat", LIST.replace("1000", "-1000"), tmp_path)
    with pytest.raises(ConfigurationError, match="expected lines"):
        exported("twincat", LIST.splitlines()[1], tmp_path)


@pytest.mark.parametrize("name", ["sinumerik", "fanuc"])
def test_a_file_of_another_kind_is_refused_in_a_line(name, tmp_path):
    with pytest.raises(ConfigurationError, match=r"machine\.txt: no "):
        exported(name, "G0 X0\nM30\n", tmp_path)
