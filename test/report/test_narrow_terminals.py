"""Tables at a narrow terminal: nothing is cut; in a pipe: CSV, and words on standard error."""

import contextlib
import csv
import io
import json
import math
import os
import pty
import re
import subprocess
import sys
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from rotcal_ros.evaluation.monte_carlo import PropagatedResult, Propagation
from rotcal_ros.foundation.results import Result
from rotcal_ros.report.terminal.columns import Column, split_columns
from rotcal_ros.report.terminal.tables import print_result, print_uncertainty

DATA = Path(__file__).parents[2] / "examples" / "data"
CONFIG = Path(__file__).parents[2] / "config"
TRACER, PLATE = DATA / "result_tracer.json", DATA / "result_ball_plate.json"
VERBS = {
    "solve": ("solve", DATA / "ball_plate_bag"),
    "compare": ("compare", TRACER, PLATE),
    "combine": ("combine", TRACER, PLATE),
    "check": ("check", PLATE, TRACER, "--within", "3"),
    "iso230": ("iso230", DATA / "runs.csv"),
    "uncertainty": (
        "uncertainty", DATA / "balls.csv", "--setup", DATA / "ball_plate.yaml",
        "--trials", "20", "--workers", "1",
    ),
    "effort": ("plan", "effort", "--grid", "12", "--need", "ECC=0.06", "--most-balls", "6"),
    "trade": ("plan", "trade", "plate", "--grid", "12", "--balls", "6"),
    "reliability": (
        "plan", "reliability", CONFIG / "ball_plate_demo.yaml", "--worst", "2",
    ),
}  # fmt: skip
NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?")


@pytest.fixture(scope="module")
def at_terminal(warm):
    """Return what a verb prints at a terminal of some width, in characters, without colours."""

    @cache
    def shown(verb, width):
        leader, follower = pty.openpty()
        environment = {**os.environ, "COLUMNS": str(width), "LINES": "50", "TERM": "xterm"}
        with Path(os.devnull).open("r+") as nothing:
            process = warm.start(
                "rotcal", *VERBS[verb], env=environment,
                stdin=nothing, stdout=follower, stderr=nothing,
            )  # fmt: skip
        os.close(follower)
        text = b""
        with contextlib.suppress(OSError):  # the other end is closed
            while part := os.read(leader, 65536):
                text += part
        os.close(leader)
        assert process.wait() in (0, 1)
        return re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", text.decode()).replace("\r", "")

    return shown


@pytest.mark.slow
@pytest.mark.parametrize("verb", VERBS)
def test_in_a_pipe_there_is_one_table_of_csv_and_words_elsewhere(verb, warm):
    done = warm.run("rotcal", *VERBS[verb])
    assert done.returncode in (0, 1), done.stderr
    header, *rows = csv.reader(io.StringIO(done.stdout))
    assert rows
    assert {len(row) for row in rows} == {len(header)}
    assert len(set(header)) == len(header)
    assert not re.search(r"verdict|[│┃━]", done.stdout)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("verb", "width"), [(verb, (40, 60)[n % 2]) for n, verb in enumerate(VERBS)]
)
def test_at_a_narrow_terminal_no_digit_and_no_unit_is_cut(verb, width, at_terminal):
    narrow, wide = at_terminal(verb, width), at_terminal(verb, 250)
    assert "…" not in narrow
    drawn = [line for line in narrow.splitlines() if line[:1] in "┃│┏┡└"]
    assert max(map(len, drawn)) <= width

    def cells(text):
        lines = [line for line in text.splitlines() if line[:1] in ("│", "┃")]
        return {cell.strip() for line in lines for cell in re.split("[│┃]", line)}

    numbers = {cell for cell in cells(wide) if NUMBER.match(cell) and " " not in cell}
    assert numbers <= cells(narrow)
    units = {unit for cell in cells(wide) for unit in re.findall(r"/(\S+)", cell)}
    assert units <= set(re.findall(r"/(\S+)", " ".join(cells(narrow))))


@pytest.mark.parametrize("verdict", ["ok", "suspect", "failed"])
def test_in_a_pipe_u_is_what_the_words_say_and_withheld_where_they_withhold_it(verdict, capsys):
    data = json.loads(TRACER.read_text())
    print_result(Result.from_dict({**data, "verdict": verdict, "warnings": ["a doubt"]}))
    out, words = capsys.readouterr()
    header, *rows = csv.reader(io.StringIO(out))
    assert header == ["angle/deg", "ECC/arcsec", "U(ECC) (k = 2)/arcsec"]
    twice = [2.0 * math.degrees(u) * 3600.0 for u in data["std"]["ECC"]]
    values = [math.degrees(value) * 3600.0 for value in data["deviations"]["ECC"]]
    # Two digits of U, the value to the same place; the curve counts from its first angle.
    places = [2 - math.ceil(math.log10(u)) for u in twice[1:]]

    def rounded(numbers):
        pairs = zip(numbers[1:], places, strict=True)
        return ["0", *(f"{number:.{place}f}" for number, place in pairs)]

    assert [row[1] for row in rows] == rounded(values)
    if verdict == "ok":
        assert [row[2] for row in rows] == rounded(twice)
        assert "U (k = 2)" in words
    else:
        assert [row[2] for row in rows] == [""] * len(rows)
        assert f"U: not stated, because the verdict is {verdict}" in words


@pytest.mark.parametrize("verdict", ["ok", "suspect"])
def test_u_of_trials_is_withheld_where_the_verdict_on_the_data_withholds_it(verdict, capsys):
    result = replace(
        Result.from_dict(json.loads(TRACER.read_text())), verdict=verdict, warnings=()
    )
    std = result.std["ECC"]
    spread = Propagation(
        result.deviations["ECC"], std, -2.0 * std, 2.0 * std, np.diag(std**2), 0.95, 2, 400,
        stable=True,
    )  # fmt: skip
    print_uncertainty(PropagatedResult(result, spread, 1))
    out, words = capsys.readouterr()
    header, *rows = csv.reader(io.StringIO(out))
    stated = [
        header.index(name) for name in ("U solver (k = 2)", "U trials (k = 2)", "from", "to")
    ]
    assert all((row[column] != "") == (verdict == "ok") for row in rows for column in stated)
    assert ("U: not stated, because the verdict is suspect" in words) == (verdict != "ok")


def test_columns_are_stacked_with_the_first_one_in_each_group():
    columns = [Column(name, [1.0], ".3f") for name in ("angle", "a", "b", "c")]
    # one of 5 characters in 8, of 5 in 8, and a border: 17, and 25 with one more
    assert [[c.heading for c in group] for group in split_columns(columns, 24)] == [
        ["angle", "a"], ["angle", "b"], ["angle", "c"]
    ]  # fmt: skip
    assert [[c.heading for c in group] for group in split_columns(columns, 25)] == [
        ["angle", "a", "b"], ["angle", "c"]
    ]  # fmt: skip


def test_who_has_read_enough_ends_a_verb_without_a_word():
    command = [sys.executable, "-m", "rotcal_ros.cli.main", *map(str, VERBS["reliability"])]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as child:
        child.stdout.close()
        words = child.stderr.read()
    assert child.returncode == 141
    assert "roken pipe" not in words
    assert "Exception" not in words
