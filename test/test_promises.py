"""What docs/compatibility.json promises is there; scripts/promises.py finds what is not."""

import json
import runpy
from pathlib import Path

import pytest
from test_package import with_all

ROOT = Path(__file__).parents[1]
PROMISES = runpy.run_path(str(ROOT / "scripts" / "promises.py"))
broken = PROMISES["broken"]


@with_all
def test_what_was_promised_is_there():
    found, promised = PROMISES["promises"](), json.loads(PROMISES["RECORD"].read_text())
    if any(message["hash"] is None for message in found["messages"].values()):
        del promised["messages"]  # without rotcal_msgs
    lines = list(broken(promised, found))
    assert not lines, "\n".join([*lines, "docs/compatibility.md says what may change when"])


@pytest.mark.parametrize(
    ("found", "line"),
    [
        ({"verbs": {"solve": ["--json", "bag"]}, "exit codes": {"BagError": 2}}, None),
        (
            {"verbs": {"solve": ["--json"]}, "exit codes": {"BagError": 2}},
            "verbs: solve: bag is gone",
        ),
        ({"verbs": {}, "exit codes": {"BagError": 2}}, "verbs: solve is gone"),
        (
            {"verbs": {"solve": ["bag", "--new", "--json"]}, "exit codes": {"BagError": 3}},
            "exit codes: BagError was 2, and is 3",
        ),
    ],
)
def test_what_goes_or_changes_is_named_and_what_comes_is_not(found, line):
    promised = {"verbs": {"solve": ["--json", "bag"]}, "exit codes": {"BagError": 2}}
    assert list(broken(promised, {**found, "new": {}})) == ([] if line is None else [line])


def test_the_code_of_the_nodes_names_the_topics_of_a_recorded_cell():
    rows = json.loads(PROMISES["RECORD"].read_text())["topics"]
    metadata = (ROOT / "test" / "golden" / "tracer" / "bag" / "metadata.yaml").read_text()
    recorded = {
        line.rpartition("/cell/")[2]
        for line in metadata.splitlines()
        if line.strip().startswith("name: /cell/") and line.count("/") == 2
    }
    assert len(recorded) > 10
    assert recorded - set(rows) == set()


COMPARED = runpy.run_path(str(ROOT / "scripts" / "compare_release.py"))
STORED = (ROOT / "test" / "golden" / "tracer" / "table" / "result.json").read_text()


def compared(change, code=0, files=({}, {})):
    """Return what is said of a golden result and a changed one."""
    other = json.loads(STORED)
    change(other)
    outcomes = [
        {"code": 0, "out": STORED, "error": ""},
        {"code": code, "out": json.dumps(other), "error": "no reader"},
    ]
    return COMPARED["judged"](*outcomes, list(files))


def moved(share):
    """Return what moves one deviation by a share of its u."""

    def change(result):
        result["deviations"]["ECC"][2] += share * result["std"]["ECC"][2]

    return change


def test_two_versions_are_alike_within_a_tenth_of_u():
    same = {"code": 0, "out": STORED, "error": ""}
    assert COMPARED["judged"](same, dict(same), [{}, {}]) == "same bits"
    assert compared(moved(0.05)) == "deviations and u differ by at most 0.05 u"


@pytest.mark.parametrize(
    ("change", "code", "files", "word"),
    [
        (moved(0.2), 0, ({}, {}), "0.2 u"),
        (lambda result: result.update(verdict="suspect"), 0, ({}, {}), "inf u"),
        (lambda result: result["deviations"].pop("ECC"), 0, ({}, {}), "inf u"),
        (lambda _: None, 2, ({}, {}), "exit code 0, then 2: no reader"),
        (lambda _: None, 0, ({"c.csv": "1"}, {"c.csv": "2"}), "c.csv"),
    ],
)
def test_what_two_versions_do_differently_is_named(change, code, files, word):
    words = compared(change, code, files)
    assert words.startswith("different")
    assert word in words
