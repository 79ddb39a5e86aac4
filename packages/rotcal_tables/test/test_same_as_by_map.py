"""What the core reads by a map of columns, this package reads the same, to the last bit."""

from __future__ import annotations

from pathlib import Path

import pytest

from rotcal_ros.foundation.table_columns import SheetSettings
from rotcal_ros.foundation.table_forms import ColumnMap
from rotcal_ros.foundation.table_reading import Known
from rotcal_tables.sheets.reading import READER

LENGTHS = (("position", "target", "length_m"), ("position", "target", "length_m", "segment"))
BALLS = (("position", "ball_step", "x_m", "y_m", "z_m"),)
MIRROR = (("position", "tracker_station", "kind", "nest", "x_m", "y_m", "z_m", "time_s"),)
DEVIATIONS = (
    ("angle_rad", "deviation_rad", "u_rad"), ("angle_rad", "deviation_rad", "expanded_rad"),
    ("angle_rad", "deviation_rad"),
)  # fmt: skip
KNOWN = {"position": Known((0, 1, 2)), "target": Known((0, 1)), "ball_step": Known((0, 5, 30))}


@pytest.mark.parametrize(
    ("headers", "text", "settings"),
    [
        (LENGTHS, "length_mm,target,note,position\n312.5,1,x,0\n-1e-3,0,y,2\n", {}),
        (LENGTHS, "Length [MM],Target,Position,Segment\n.1,1,1,0\n7,2,2,0\n3,1,3,1\n", {}),
        (LENGTHS, "Pos,Ziel,Weg\n0,0,0.1\n1,1,12.3456789012345678\n",
         {"columns": ("position=Pos", "target=ziel", "length=WEG"), "length_unit": "in"}),
        (LENGTHS, "position,target,Weg,Weg\n1,0,2,3\n2,1,1,4\n",
         {"columns": ("length=#4",), "length_unit": "ft", "counted_from": "1"}),
        (BALLS, "z_um,position,ball_step,x_mm,y [m]\n1,0,0,2,3\n1,1,5,2,3\n1,2,30,2,3\n", {}),
        (BALLS, "position,Kugel,x,y,z\n1,1,1,1,1\n2,2,2,2,2\n3,3,3,3,3\n",
         {"columns": ("ball_step=Kugel",), "length_unit": "mm"}),
        (MIRROR, "position,tracker_station,kind,nest,x,y,z,time [ms]\n,A,nest,1,1,2,3,1.5\n"
                 "0,A,direct,,1,2,3,2\n1,B,mirrored,,1,2,3,3\n2,B,direct,,1,2,3,4\n",
         {"length_unit": "um"}),
        (DEVIATIONS, "angle_deg,deviation_arcsec,u_arcsec\n0,1.5,.1\n30,-2,.1\n", {}),
        (DEVIATIONS, "U,Fehler,angle_gon\n.1,1,0\n.1,2,30\n",
         {"columns": ("expanded=U", "deviation=Fehler"), "reading_unit": "urad"}),
    ],
)  # fmt: skip
def test_a_map_of_columns_means_the_same(tmp_path: Path, headers, text, settings) -> None:
    (tmp_path / "t.csv").write_text(text, "utf-8")
    by_map, by_us = (
        reader.read(tmp_path / "t.csv", headers, SheetSettings(**settings), lambda: KNOWN)
        for reader in (ColumnMap(), READER)
    )
    assert by_map.table == by_us.table
    assert by_map.columns == by_us.columns
    assert by_map.form_head == by_us.form_head
    assert (by_map.form, by_map.remarks, by_map.aside) == (by_us.form, by_us.remarks, by_us.aside)
