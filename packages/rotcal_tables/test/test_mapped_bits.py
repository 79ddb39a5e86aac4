"""The sample lengths in another form give the same bits, and the verb says how they were read."""

import json
import shutil

import pytest
from test_tables_as_input import DATA, TRACER, run, solved

pytestmark = pytest.mark.usefixtures("without_figures")


@pytest.fixture
def lengths(tmp_path):
    """Copy the sample lengths, and their targets beside them."""
    for name in ("targets.csv", "lengths.csv"):
        shutil.copy(DATA / name, tmp_path)
    return tmp_path / "lengths.csv"


@pytest.mark.parametrize(
    ("separator", "encoding", "words"),
    [
        (";", "utf-8", "text in utf-8, semicolons"),
        ("\t", "utf-8", "tabs"),
        (",", "utf-16", "text in utf-16, commas"),
    ],
)
def test_another_form_gives_the_same_bits_and_is_told(lengths, separator, encoding, words):
    expected = solved(lengths, "--setup", TRACER)
    lengths.write_bytes(lengths.read_text().replace(",", separator).encode(encoding))
    done = run("solve", lengths, "--setup", TRACER, "--json")
    assert done.exit_code == 0, done.stderr
    assert json.loads(done.stdout)["deviations"] == expected["deviations"]
    assert words in done.stderr
    assert "length_m = 'length_m'" in done.stderr


def test_explain_says_what_is_left_out_of_a_table_and_solves_nothing(lengths):
    text = lengths.read_text().replace("position,target,length_m", "Pos,Target,Length [m],By")
    first, *rows = text.splitlines()
    lengths.write_text("\n".join([first, *(f"{row},me" for row in rows), "Mean,,0.4,"]))
    done = run("solve", lengths, "--setup", TRACER, "--explain")
    assert (done.exit_code, done.stderr) == (0, "")
    for words in ("'Length [m]'", "not needed: By", f"row {len(rows) + 2} left out", "(Mean)"):
        assert words in done.stdout
    assert "deviations" not in done.stdout
