"""Names of points by a pattern, and the output of a measuring machine in DMIS."""

import numpy as np
import pytest

from rotcal_ros.foundation.errors import BagError, ConfigurationError, UndecidedError
from rotcal_ros.foundation.table_columns import SheetSettings
from rotcal_ros.foundation.table_forms import remember, remembered
from rotcal_ros.foundation.table_reading import Known
from rotcal_ros.methods.fitting import fitting_methods
from rotcal_tables import dmis
from rotcal_tables.sheets.reading import READER

HEADERS = (("position", "ball", "x_m", "y_m", "z_m"),)
PLANNED = {"position": Known(tuple(range(3))), "ball": Known(tuple(range(2)))}
POINTS = [(p, n, 100.0 + p, 200.0 + n, 0.25 * p * n) for p in (1, 2, 3) for n in (1, 2)]
PATTERN = "P{position}_N{ball}"


def csv(folder, name="P{}_N{}", head="Point,X [mm],Y [mm],Z [mm],Group"):
    rows = [f"{name.format(p, n)},{x},{y},{z},tracker 1" for p, n, x, y, z in POINTS]
    (path := folder / "points.csv").write_text("\n".join([head, *rows]) + "\n")
    return path


def output(name="P{}_N{}", units="UNITS/MM,ANGDEC"):
    lines = ["FILNAM/'table.qif',5.3", "$$ of a table", units]
    for p, n, x, y, z in POINTS:
        label = name.format(p, n)
        lines += [
            f"OUTPUT/F({label}),T(POS1)",
            f"F({label})=FEAT/SPHERE,OUTER,CART,100,200,0,30",
            f"FA({label})=FEAT/SPHERE,OUTER,CART,{x:.4f},{y:.4f},{z:.4f},30.0011",
            "TA(POS1)=TOL/POS,3D,0.05,INTOL",
        ]
    return "\r\n".join([*lines, "ENDFIL", ""])


def read(path, **settings):
    return READER.read(path, HEADERS, SheetSettings(**settings), lambda: PLANNED)


def rows(reading):
    return np.array([list(map(float, cells)) for _, cells in reading.table.lines])


EXPECTED = np.array([(p - 1, n - 1, x / 1e3, y / 1e3, z / 1e3) for p, n, x, y, z in POINTS])


def test_what_names_of_points_mean_is_asked_and_then_read(tmp_path):
    path = csv(tmp_path)
    with pytest.raises(UndecidedError, match="6 names as P1_N1 seem to say") as asked:
        read(path)
    question = asked.value.question
    assert question.setting == "sheet.names"
    assert [value for value, _ in question.answers] == [PATTERN, "P{ball}_N{position}"]
    assert question.answers[0][1] == "P1_N1 is position 1, ball 1"
    assert rows(read(path, names=PATTERN)) == pytest.approx(EXPECTED)


def test_the_answer_is_remembered_for_tables_with_that_head(tmp_path):
    settings = SheetSettings(names=PATTERN)
    found = READER.read(csv(tmp_path), HEADERS, settings, lambda: PLANNED)
    assert found.form_head == ("Point", "X [mm]", "Y [mm]", "Z [mm]", "Group")
    remember(tmp_path / "points.csv", found.form_head, settings)
    assert remembered(tmp_path / "points.csv", SheetSettings()) == settings


@pytest.mark.parametrize("name", ["P{} N{}", "pos {}: ball {}", "S1.P{}.B{}"])
def test_names_of_other_forms_have_patterns_too(tmp_path, name):
    pattern = name.format("{position}", "{ball}")
    assert rows(read(csv(tmp_path, name), names=pattern)) == pytest.approx(EXPECTED)


def test_a_pattern_that_is_none_is_refused(tmp_path):
    for pattern in ("P3_N2", "P{places}_N{ball}", "{ball}_{ball}"):
        with pytest.raises(ConfigurationError, match=r"sheet\.names: .*expected a name with col"):
            read(csv(tmp_path), names=pattern)


def test_the_output_of_a_measuring_machine_is_actual_places_in_its_unit(tmp_path):
    (path := tmp_path / "out.dmo").write_text(output(), newline="")
    with pytest.raises(UndecidedError) as asked:
        read(path)
    assert asked.value.question.setting == "sheet.names"
    assert rows(read(path, names=PATTERN)) == pytest.approx(EXPECTED)
    path.write_text(output(units="UNITS/INCH,ANGDEC"), newline="")
    inches = EXPECTED * [1.0, 1.0, 25.4, 25.4, 25.4]
    assert rows(read(path, names=PATTERN)) == pytest.approx(inches)


def test_what_dmis_leaves_open_is_refused():
    assert dmis.read("name,x,y,z\nP1,1,2,3\n") is None
    # as a public program's sample has it: no OUTER, and a name in another language
    sample = "UNITS/MM,ANGDEC\nFA(Esfera_10)=FEAT/SPHERE,CART,1.5,-2.25,3,27.5\n"
    assert dmis.read(sample)[1:] == [("Esfera_10", "1.5", "-2.25", "3")]
    with pytest.raises(BagError, match="no UNITS/ with one of"):
        dmis.read(sample.partition("\n")[2])
    with pytest.raises(BagError, match="the place of Esfera_10 is not Cartesian"):
        dmis.read(sample.replace("CART", "POL"))
    assert dmis.read(sample.replace("3,27.5", "3.5,27.5"))[1][3] == "3.5"
    second = "FA(B)=FEAT/SPHERE,CART,1,2,3,27.5\n"
    assert len(dmis.read(f"{sample}UNITS/MM\n{second}")) == 3
    with pytest.raises(BagError, match="UNITS/ changes, MM and INCH"):
        dmis.read(f"{sample}UNITS/INCH\n{second}")
    for system in ("D(PART)=TRANS/XORIG,10", "RECALL/D(PART)"):
        assert len(dmis.read(f"{system}\n{sample}{second}")) == 3
        with pytest.raises(BagError, match="changes the coordinate system between features"):
            dmis.read(f"{sample}{system}\n{second}")


def test_a_list_of_points_without_a_head_is_stated_by_numbers(tmp_path):
    lines = csv(tmp_path).read_text().splitlines()[1:]
    bare = [" ".join(line.split(",")[:4]) for line in lines]
    (path := tmp_path / "points.txt").write_text("// a program and its frame\n" + "\n".join(bare))
    columns = tuple(f"{axis}=#{k}" for k, axis in enumerate("xyz", start=2))
    assert rows(read(path, names=PATTERN, columns=columns, length_unit="mm")) == pytest.approx(
        EXPECTED
    )


def test_names_are_asked_of_methods_alone_whose_values_stand_beside_them(tmp_path):
    rows = "".join(f"P{p}_B{b},{p}.1,{b}.2,3.0\n" for p in range(4) for b in range(3))
    (path := tmp_path / "t.csv").write_text("Name,X [mm],Y [mm],Z [mm]\n" + rows)
    fitting = {method.name for method in fitting_methods(path)}
    assert {"table_balls", "ball_plate"} <= fitting
    assert fitting.isdisjoint({"angle_comparison", "deviations"})
