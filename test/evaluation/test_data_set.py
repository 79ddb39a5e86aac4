"""The open data set: made twice it has the same bits, and says itself how it is solved."""

import hashlib
import json
import re
import runpy
from pathlib import Path

import numpy as np
import pytest

import rotcal_ros as rc
from rotcal_ros.evaluation.truth_scores import NO_EFFECT, score_folder

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
FEW = (
    "--method",
    "tracer",
    "--method",
    "plane_mirror",
    "--effect",
    NO_EFFECT,
    "--effect",
    "knock",
)


@pytest.fixture(scope="module")
def made(tmp_path_factory, warm):
    """Return two folders with the same part of the data set."""
    folders = [tmp_path_factory.mktemp("made") / "dataset" for _ in range(2)]
    for folder in folders:
        done = warm.run(
            "python", str(ROOT / "research" / "make_dataset.py"), str(folder), *FEW,
            folder=folder.parent,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
    return folders


def contents(folder):
    files = (path for path in folder.rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): path.read_bytes() for path in files}


def test_made_twice_it_is_the_same_bit_for_bit(made):
    first, second = map(contents, made)
    assert len(first) > 20
    assert first.keys() == second.keys()
    assert [name for name in first if first[name] != second[name]] == []


def test_the_checksums_are_those_of_all_other_files(made):
    files = contents(made[0])
    rows = [line.split("  ") for line in files.pop("SHA256SUMS").decode().splitlines()]
    assert {name: digest for digest, name in rows} == {
        name: hashlib.sha256(data).hexdigest() for name, data in files.items()
    }


def test_the_readme_tells_each_effect_with_its_size(made):
    text = (made[0] / "README.md").read_text()
    sizes = runpy.run_path(str(ROOT / "research" / "make_dataset.py"))["SIZES"]
    for plan, effects in sizes.items():
        for effect, size in effects.items():
            assert f"| {plan} | {effect.replace(' ', '_')} | {size:g} " in text
    assert "CC BY 4.0" in text
    assert "rotcal compare FOLDER --truth" in text


@pytest.mark.parametrize("plan", ["tracer", "plane_mirror"])
def test_bag_and_table_give_what_the_result_says(made, plan):
    case = made[0] / plan / f"{NO_EFFECT}_1"
    found = json.loads((case / "result_rotcal.json").read_text())["deviations"]["ECC"]
    by_bag = rc.read_bag(case / "bag").solve()
    assert by_bag.deviations["ECC"] == pytest.approx(found, abs=1e-15)
    table = next(case / name for name in ("lengths.csv", "tracker.csv") if (case / name).exists())
    by_table = rc.read_table(table, case / "setup.yaml").solve()
    assert by_table.deviations["ECC"] == pytest.approx(found, abs=0.05 * by_bag.std["ECC"].max())


def test_what_is_sound_holds_the_truth_and_a_knock_is_there(made):
    scores = {(s.case, s.entry): s for s in score_folder(made[0])}
    for plan, entries in {"tracer": 4, "plane_mirror": 4}.items():
        assert sum(case == f"{plan}/{NO_EFFECT}_1" for case, _ in scores) == entries
        assert scores[f"{plan}/{NO_EFFECT}_1", "rotcal"].agree
    assert json.loads((made[0] / "tracer" / "knock_1" / "truth.json").read_text())["size"] == 2.1


def test_the_readme_is_enough_for_scipy_alone(made, warm):
    case = made[0] / "tracer" / f"{NO_EFFECT}_1"
    script = str(ROOT / "examples" / "13_data_set_with_scipy.py")
    done = warm.run("python", script, str(case), folder=case.parent)
    assert done.returncode == 0, done.stderr
    assert 0.4 < float(re.search(r"uncertainty: (\S+)", done.stdout)[1]) < 1.6
    mine, ours = (
        np.array(json.loads((case / f"result_{name}.json").read_text())["deviations"]["ECC"])
        for name in ("mine", "rotcal")
    )
    difference = mine - ours
    assert np.abs(difference - difference.mean()).max() < 0.3 * rc.ARCSEC
    (case / "result_mine.json").unlink()
