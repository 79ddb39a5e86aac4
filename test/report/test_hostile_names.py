"""Names that command terminals, spreadsheets, formulas and parsers, through every output."""

import csv
import io
import json
import re
import sys
from datetime import datetime, timezone
from pathlib import Path
from xml.etree import ElementTree

import pytest

import rotcal_ros as rc
from rotcal_ros.compensation.controllers import controller_names
from rotcal_ros.compensation.export import prepare_export
from rotcal_ros.compensation.table import table_from_result
from rotcal_ros.compensation.writing import PROVENANCE
from rotcal_ros.foundation.circumstances import Circumstances
from rotcal_ros.foundation.errors import BagError, ConfigurationError, RotcalError
from rotcal_ros.foundation.escapes import printable, printable_lines, table_cell
from rotcal_ros.foundation.files import write_atomically
from rotcal_ros.foundation.identity import Identity
from rotcal_ros.foundation.settings import check_ros_name
from rotcal_ros.methods.figures import style
from rotcal_ros.page import app
from rotcal_ros.recordings.result_sources import ResultSource
from rotcal_ros.report.page import report_result
from rotcal_ros.report.terminal.columns import Column, TitledTable, print_tables, print_words
from rotcal_ros.report.terminal.console import say, tell

DATA = Path(__file__).parents[2] / "examples" / "data"
BELL = "\x1b]0;owned\x07\x1b[31mred"
NAMES = {
    "terminal": BELL,
    "line": "good\nverdict ok: all is well\r\n",
    "formula": "=cmd|' /C calc'!A0",
    "mathtext": r"$\frac{1}{$ x_^ $",
    "formula of TeX": r"$\alpha_1^2$",
    "markup": "[red]x[/red] [/] <b>&amp;</b> {{ 7*7 }} %s {0}",
    "direction": "a\u202egnp.exe\u2066",
    "longest": "n" * 255,
    "separators": "a\u2028b\u2029c\x85d\x0ce",
    "no character": "a\uffff\ufffe\U0010ffff",
}
ALL = "".join(NAMES.values())
every_name = pytest.mark.parametrize("name", NAMES.values(), ids=NAMES)


def unseen(text):
    """Return what of a text has no sign of its own, line ends and tabs apart."""
    return {c for c in text if not c.isprintable() and c not in "\n\t\xa0\u202f\u200c\u200d"}


def named(name):
    """Return a result all of whose texts are ``name``."""
    texts = dict.fromkeys(
        ("item", "maker", "model", "serial", "place", "operator", "laboratory", "customer",
         "laboratory_address", "customer_address", "customer_number", "certificate_number"), name,
    )  # fmt: skip
    identity = Identity.from_dict(
        {**texts, "laboratory_country": "DE", "received": "2026-03-01",
         "laboratory_email": "a@b.c",
         "instruments": {"ball_plate": {"serial": name, "maker": name, "certificate": name,
                                        "calibrated": "2026-01-01"}}}
    )  # fmt: skip
    circumstances = Circumstances(axis="C", identity=identity, begun_ns=10**18, ended_ns=10**18)
    data = rc.read_result(DATA / "result_ball_plate.json").to_dict()
    data |= {"circumstances": circumstances.to_dict(), "warnings": [name]}
    data["details"] |= {"note": name, name: 1.0}
    return rc.Result.from_dict(json.loads(json.dumps(data)))


@pytest.mark.slow
@pytest.mark.parametrize("name", [ALL], ids=["all"])
def test_the_report_shows_it_escaped(tmp_path, name):
    page = tmp_path / "report.html"
    report_result(ResultSource(named(name), {name: "0" * 64}), page)
    text = page.read_bytes().decode("utf-8")
    assert not unseen(text)
    assert "<b>&amp;</b>" not in text


DRAWN = {
    **{kind: [name] for kind, name in NAMES.items()},
    "terminal": [r"\x1b]0;owned\x07\x1b[31mred"],
    "line": ["good", r"verdict ok: all is well\r"],
    "direction": [r"a\u202egnp.exe\u2066"],
    "longest": ["n" * 59 + "…" + "n" * 59],
    "separators": [r"a\u2028b\u2029c\x85d\x0ce"],
    "no character": [r"a\uffff\ufffe\U0010ffff"],
}
"""The lines in which a figure shows each name."""


@pytest.mark.parametrize("kind", NAMES)
def test_a_figure_draws_it_as_it_is(kind):
    """As label of a curve, of an axis, of ticks and as a note; letters instead of their shapes."""
    name = NAMES[kind]

    @style.house_style
    def drawn():
        import matplotlib as mpl

        mpl.rcParams["svg.fonttype"] = "none"
        (ax,) = style.grid()
        ax.plot([0.0, 1.0], [0.0, 1.0], label=name)
        ax.set_ylabel(name)
        ax.annotate(name, (0.5, 0.5))
        ax.set_xticks([0.0, 1.0], [name, name])
        return style.svg(ax)

    root = ElementTree.fromstring(drawn().encode("utf-8"))
    texts = ["".join(text.itertext()) for text in root.iterfind(".//{*}text")]
    assert not unseen("".join(texts))
    for line in DRAWN[kind]:
        assert texts.count(line) >= (3 if kind == "longest" else 5), texts


@every_name
def test_a_terminal_is_not_commanded(capsys, monkeypatch, name):
    table = TitledTable([Column("name", [name]), Column(name, [name])], name, name)
    for at_terminal in (False, True):
        monkeypatch.setattr(sys.stdout, "isatty", lambda at=at_terminal: at)
        print_tables([table], "key")
        print_words(name, f"warning: {name}")
        say(name)
        tell(name, f"{name}: well")
    out, err = capsys.readouterr()
    out = re.sub(r"\x1b\[[01]m", "", out)  # our own headings are bold
    assert not unseen(out + err)
    assert "verdict ok: all is well" not in out.splitlines()
    if name == NAMES["markup"]:
        assert "[red]x[/red]" in out


def test_a_cell_is_no_formula_of_a_spreadsheet(capsys):
    print_tables(
        [TitledTable([Column("name", list(NAMES.values())), Column("x/m", [-1.5] * len(NAMES))])]
    )
    cells = list(csv.reader(io.StringIO(capsys.readouterr().out)))
    assert all(not re.match(r"[=+@\t\r-]", row[0]) for row in cells)
    assert {row[1] for row in cells[1:]} == {"-1.5"}
    assert table_cell("-3") == "'-3"


@pytest.mark.parametrize("controller", controller_names())
def test_no_line_of_a_controller_comes_from_a_name(controller):
    def files(result):
        table = table_from_result(result)
        now = datetime(2026, 1, 1, tzinfo=timezone.utc)
        return prepare_export(table, controller, now=now, accept_unverified=True).files

    try:
        found, plain = files(named(ALL)), files(named("plain"))
    except RotcalError:
        pytest.skip("the example's table is nothing for this controller")
    assert not any(unseen(text.replace("\r\n", "\n")) for text in found.values())
    own = [file for file in found if not file.endswith(PROVENANCE)]
    assert [found[file] for file in own] == [plain[file] for file in own]
    side = next(text for file, text in found.items() if file.endswith(PROVENANCE))
    assert json.loads(side)["item"].startswith(ALL)


@every_name
def test_an_error_is_one_line(name):
    text = str(BagError(f"{name} is no bag"))
    assert not unseen(text)
    assert "\n" not in text


@every_name
def test_the_operators_page_gets_it_escaped(name):
    sent = json.loads(app._event("state", {"item": name, name: [name]})["data"])
    assert not unseen("".join([*sent, sent["item"]]))


@every_name
def test_it_is_no_name_in_ros_unless_it_is_one(name):
    if name != NAMES["longest"]:
        with pytest.raises(ConfigurationError):
            check_ros_name(name, "topic")


@pytest.mark.parametrize("text", ["a\ud800", "a\0b"])
def test_what_no_message_can_hold_is_no_setting(text):
    with pytest.raises(ConfigurationError, match="is not valid text"):
        Identity.from_dict({"item": text})


def test_halves_of_characters_are_escaped():
    assert printable("x\udcff") == r"x\udcff"
    assert printable_lines("a\tb\nc\x00") == "a\tb\nc\\x00"


def test_a_name_of_255_bytes_can_be_written(tmp_path):
    path = tmp_path / ("n" * 255)
    write_atomically(path, "text")
    assert path.read_text() == "text"
