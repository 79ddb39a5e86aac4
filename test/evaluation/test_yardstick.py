"""The yardstick sees what is worse, and goes on where it was interrupted."""

import csv
import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
RESEARCH = ROOT / "research"
PLAN = "golden/tracer"
WORSE = """
_solve = Calibration.solve


def _worse(*given):
    found = _solve(*given)
    std = {name: values / 4.0 for name, values in found.std.items()}
    return replace(found, verdict="suspect", std=std)


Calibration.solve = _worse
"""


def compare(results, runs, *more):
    """Run the script on the present code, and return the ended process."""
    command = [sys.executable, str(RESEARCH / "yardstick.py"), "--old", str(ROOT), "--plan", PLAN]
    command += ["--part", "sound", "--runs", str(runs), "--results", str(results), *more]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def test_what_was_measured_is_kept_and_a_cut_line_measured_again(tmp_path):
    assert compare(tmp_path, 1).returncode == 0
    [file] = tmp_path.glob("*.jsonl")
    first = file.read_text()
    ended = compare(tmp_path, 2)
    assert file.read_text().startswith(first)
    assert f"{PLAN} , sound: 1" in ended.stderr
    whole = [json.loads(line)["z"] for line in file.read_text().splitlines()]
    file.write_text(file.read_text()[:-40])
    again = compare(tmp_path, 2)
    assert [json.loads(line)["z"] for line in file.read_text().splitlines()] == whole
    assert again.stdout == ended.stdout
    assert f"| {PLAN} | 2 | 0 |" in again.stdout


def test_a_worse_code_is_seen_as_worse_and_the_same_code_is_not(tmp_path):
    worse = tmp_path / "worse"
    shutil.copytree(ROOT / "rotcal_ros", worse / "rotcal_ros", copy_function=os.symlink)
    spoiled = worse / "rotcal_ros" / "methods" / "calibration.py"
    text = spoiled.read_text()
    spoiled.unlink()
    spoiled.write_text(text + WORSE)
    found = compare(tmp_path, 3, "--new", str(worse))
    assert found.returncode == 1, found.stderr
    assert f"| {PLAN} | 3 | 0 | 3 | **missed** |" in found.stdout
    assert "**missed**" in next(line for line in found.stdout.splitlines() if "| ECC |" in line)
    same = compare(tmp_path, 3, "--new", str(ROOT))
    assert same.returncode == 0, same.stdout


def test_the_page_has_whole_tables_and_leads_to_each():
    page = (ROOT / "docs" / "yardstick.md").read_text("utf-8")
    linked = re.findall(r"^\[.*\]\(\.\./research/yardstick/(\w+\.csv)\)$", page, re.MULTILINE)
    files = sorted((RESEARCH / "yardstick").glob("*.csv"))
    assert sorted(linked) == [file.name for file in files]
    for file in files:
        head, *rows = csv.reader(file.read_text("utf-8").splitlines())
        assert head[0] in ("plan", "recording", "paper")
        assert {len(row) for row in rows} == {len(head)}


@pytest.fixture
def scripts(monkeypatch):
    monkeypatch.syspath_prepend(str(RESEARCH))
    import yardstick
    import yardstick_codes

    return yardstick, yardstick_codes


@pytest.mark.parametrize(
    ("noticed", "error", "named", "mark"),
    [
        (95, 1.5, False, ""),
        (90, 1.5, False, ""),
        (89, 1.5, False, "**missed**"),
        (95, 2.5, False, "**missed**"),
        (95, 2.5, True, ""),
    ],
)
def test_an_effect_has_to_be_noticed_and_its_error_named_or_no_larger(
    scripts, tmp_path, noticed, error, named, mark
):
    page, codes = scripts
    size = {"tried": 2.0, "reached": True, "allowed": None, "unit": "um", "unit_si": 1.0}

    def code(name, noticed, error, named):
        records = {("sizes", "tracer", "knock", 0): {"case": "knock", **size}}
        for tried, count in ((2.0, noticed), (1.0, noticed // 2)):
            for number in range(100):
                records["power", "tracer", codes.of_size("knock", tried), number] = {
                    "noticed": number < count, "named": named, "error": [tried / 2.0 * error, 0.0],
                }  # fmt: skip
        return codes.Code(name, tmp_path, tmp_path / name, records)

    old, new = code("old", 95, 1.5, False), code("new", noticed, error, named)
    [line] = page.effects(codes.Comparison(old, new, ("tracer",), 100))
    assert line[0] == ("tracer", "knock", "2 um")
    assert line[1][0] == ("95", "1.5", "")
    assert line[2] == mark


def test_shares_beyond_the_wanted_ones_are_missed_unless_the_old_were_no_better(scripts):
    page, _ = scripts
    covered = page._covered
    assert covered((99.5, 0.1)) == "outside"
    assert covered((95.0, 0.5), (92.5, 0.5)) == ""  # within two standard errors
    assert covered((95.0, 0.5), (91.0, 0.5)) == "**missed**"
    assert covered((99.5, 0.1), (99.4, 0.1)) == "as old"
    assert covered((90.0, 0.5), (85.0, 0.5)) == "**missed**"


def test_more_time_is_missed_and_a_result_that_moved(scripts):
    page, _ = scripts
    quick, slow = [{"seconds": 1.0, "peak_mb": 100.0}], [{"seconds": 1.2, "peak_mb": 100.0}]
    assert page._raced([quick, slow], 1.5)[1] == ""
    assert page._raced([quick, slow], 1.05)[1] == "**missed**"
    assert page._raced([[{"failed": "memory"}], slow], 1.05)[1] == ""
    assert page._raced([quick, [{"failed": "memory"}]], 1.05)[1] == "**missed**"
    old = {
        "code": 0,
        "verdict": "ok",
        "deviations": {"ECC": [0.0, 1.0]},
        "std": {"ECC": [0.0, 1.0]},
    }
    assert page._apart(old, old) == ("0", "")
    assert page._apart(old, {**old, "deviations": {"ECC": [0.0, 2.5]}}) == ("1.5", "**missed**")
    assert page._apart(old, {**old, "verdict": "suspect"})[1] == "**missed**"
